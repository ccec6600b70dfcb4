"""TOML tables become dataclasses; every error is one line with the key."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import pytest

from calm_edge import typed
from calm_edge.types import CalmEdgeError


class TableError(CalmEdgeError):
    """Of these tests."""


@dataclass(frozen=True)
class Part:
    size: int
    share: float = 0.5


@dataclass(frozen=True)
class Whole:
    name: str
    kind: Literal["a", "b"]
    parts: dict[str, Part]
    extra: Part | None = None
    numbers: tuple[float, ...] = (1.0,)
    more: dict[str, str] = field(default_factory=dict)


GOOD = {"name": "x", "kind": "a", "parts": {"one": {"size": 1}}}


def test_a_table_becomes_its_dataclass():
    whole = typed.record("", Whole, GOOD | {"extra": {"size": 2, "share": 1}}, TableError)
    assert whole == Whole("x", "a", {"one": Part(1)}, Part(2, 1.0))
    assert type(whole.extra.share) is float


def test_a_single_number_becomes_a_tuple():
    assert typed.record("", Whole, GOOD | {"numbers": 3}, TableError).numbers == (3.0,)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"nme": "y"}, "nme: no such key; known: name, kind, parts, extra, numbers, more"),
        ({"kind": "c"}, "kind = 'c': expected one of a, b"),
        ({"name": 3}, "name: expected str, got 3"),
        ({"parts": {"one": {}}}, "parts.one.size: missing"),
        ({"parts": {"one": {"size": True}}}, "parts.one.size: expected int, got True"),
        ({"parts": {"one": {"size": 1, "x": 1}}}, "parts.one.x: no such key; known: size, share"),
        ({"extra": 4}, "extra: expected a table of keys"),
        ({"numbers": ["a"]}, "numbers: expected float, got 'a'"),
        ({"numbers": "a"}, "numbers: expected a list, got 'a'"),
        ({"numbers": [float("nan")]}, "numbers: expected a finite number"),
        ({"numbers": 10**400}, "numbers: expected a finite number"),
        ({"more": {"k": 1}}, "more.k: expected str, got 1"),
    ],
)
def test_an_invalid_table_raises_one_line_with_the_key(change, line):
    with pytest.raises(TableError) as caught:
        typed.record("", Whole, GOOD | change, TableError)
    assert str(caught.value) == line


def test_a_key_without_a_default_is_required():
    with pytest.raises(TableError, match=r"^whole\.name: missing$"):
        typed.record("whole", Whole, {"kind": "a", "parts": {}}, TableError)
