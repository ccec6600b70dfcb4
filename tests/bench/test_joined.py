"""Requirements on two drives in one map."""

from __future__ import annotations

from typing import Any

import pytest

from bench.joined import apart_checks, joined_checks


def content(apart: bool, closures: int, ate_m: float | None = None) -> dict[str, Any]:
    """What `map` writes of two drives."""
    return {
        "drives": [{"name": "a", "apart": False}, {"name": "b", "apart": apart}],
        "joined": [{"drives": ["a", "b"], "closures": closures}] if closures else [],
        "error": None if ate_m is None else {"ate_m": ate_m, "by_drive": [ate_m, ate_m]},
    }


def test_drives_that_are_apart_have_to_be_said_to_be() -> None:
    assert all(check.passed for check in apart_checks(content(True, 0), 3, reported=True))
    for found, code, said in (
        (content(False, 4), 0, False),
        (content(True, 0), 0, True),
        (content(True, 0), 3, False),
    ):
        assert not all(check.passed for check in apart_checks(found, code, reported=said))


@pytest.mark.parametrize(
    ("places", "ate_m", "met"), [(5, 0.12, True), (5, 0.2, False), (1, 0.1, False), (5, None, True)]
)
def test_joined_drives_are_as_good_as_the_worse_one(
    places: int, ate_m: float | None, met: bool
) -> None:
    checks = joined_checks(content(False, places, ate_m), [0.05, 0.1])
    assert all(check.passed for check in checks) is met
    assert len(checks) == (1 if ate_m is None else 2)
