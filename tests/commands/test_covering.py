from __future__ import annotations

from collections.abc import Sequence

import pytest

from calm_edge.commands.covering import CoveringError, covered

BRIGHT = (100.0, 80.0)


def found(*seen: tuple[float, float] | None) -> int:
    polls: Sequence[tuple[float, float] | None] = seen
    return covered(iter(polls).__next__, len(polls))


@pytest.mark.parametrize(("dark", "index"), [((10.0, 75.0), 0), ((90.0, 20.0), 1)])
def test_the_lens_that_stays_dark_is_found(dark: tuple[float, float], index: int) -> None:
    assert found(BRIGHT, BRIGHT, dark, None, dark, dark) == index


@pytest.mark.parametrize(
    "seen",
    [
        [BRIGHT] * 6,
        # a hand that passes both lenses
        [BRIGHT, (10.0, 80.0), (10.0, 80.0), (100.0, 8.0), (100.0, 8.0), BRIGHT],
        # the light is switched off
        [BRIGHT, *[(10.0, 8.0)] * 5],
        # both grow darker by the exposure, one is half covered
        [BRIGHT, *[(60.0, 50.0)] * 5],
        [None] * 6,
    ],
)
def test_anything_else_is_refused(seen: list[tuple[float, float] | None]) -> None:
    with pytest.raises(CoveringError, match="no lens became dark"):
        found(*seen)
