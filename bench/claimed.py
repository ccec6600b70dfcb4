"""What a recording claims to know about its lengths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from calm_edge.types import LocalizerUpdate


def scale_sigma(updates: Sequence[LocalizerUpdate]) -> float | None:
    """Sigma of the drive's log scale after the last update: inf if unknown, None if not reported.

    A version that does not report it leaves neither a sigma nor a reason why there is none.
    """
    metre: Any = getattr(updates[-1], "metre", None) if updates else None
    if metre is None or (not metre.metric and not metre.reason):
        return None
    return float(metre.log_sigma)
