from __future__ import annotations

import pytest

from calm_edge.commands.length_text import metres_of


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("0.52", 0.52),
        ("0,52 m", 0.52),
        ("52cm", 0.52),
        (" 520 MM ", 0.52),
        ("20.5 in", 0.5207),
        (".5", 0.5),
        ('10"', 0.254),
    ],
)
def test_lengths_are_read_with_their_unit(text: str, metres: float) -> None:
    assert metres_of(text) == pytest.approx(metres)


@pytest.mark.parametrize("text", ["", "m", "half a metre", "1.2.3", "-1", "52 km", "1e3", "nan"])
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is no length; give metres such as"):
        metres_of(text)
