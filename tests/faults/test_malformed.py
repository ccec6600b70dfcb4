"""Some hundred damaged inputs of each kind; the fault table feeds ten thousand."""

from __future__ import annotations

import random

import pytest

from tests.faults.malformed_rows import malformed
from tests.faults.mutation import mutated


@pytest.mark.parametrize(
    ("kind", "count"), [("recordings", 150), ("configs", 300), ("models", 300), ("serial", 300)]
)
def test_no_damaged_input_is_more_than_a_line(kind: str, count: int) -> None:
    row = malformed(kind, count)
    assert row.kept, row


def test_damage_is_damage_and_the_same_for_the_same_seed() -> None:
    data = bytes(range(256)) * 8
    made = [mutated(data, random.Random(k), [data]) for k in range(200)]
    assert made == [mutated(data, random.Random(k), [data]) for k in range(200)]
    assert sum(m != data for m in made) > 190
