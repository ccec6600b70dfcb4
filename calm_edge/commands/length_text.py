"""A length as people write it: `0.52`, `52 cm`, `520mm`, `20.5 in`."""

from __future__ import annotations

import re

UNITS = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, '"': 0.0254}
_LENGTH = re.compile(r"(\d+(?:[.,]\d*)?|[.,]\d+)\s*(m|cm|mm|in|\"|)")


def metres_of(text: str) -> float:
    """Metres; raises ValueError with what is wrong."""
    found = _LENGTH.fullmatch(text.strip().lower())
    if found is None:
        raise ValueError(f"{text!r} is no length; give metres such as 0.52, or 52 cm, or 20.5 in")
    return round(float(found[1].replace(",", ".")) * UNITS[found[2]], 6)
