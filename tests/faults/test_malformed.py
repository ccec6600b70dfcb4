"""A few hundred damaged inputs of each kind; the fault table feeds ten thousand."""

from __future__ import annotations

import random

import pytest

from tests.faults.malformed_rows import malformed
from tests.faults.mutation import mutated


@pytest.mark.parametrize(
    ("kind", "count"), [("recordings", 150), ("configs", 300), ("models", 300), ("serial", 300)]
)
def test_damaged_input_gives_at_most_one_line(kind: str, count: int) -> None:
    row = malformed(kind, count)
    assert row.kept, row


def test_mutations_change_the_data_and_are_reproducible() -> None:
    data = bytes(range(256)) * 8
    made = [mutated(data, random.Random(k), [data]) for k in range(200)]
    assert made == [mutated(data, random.Random(k), [data]) for k in range(200)]
    assert sum(m != data for m in made) > 190
