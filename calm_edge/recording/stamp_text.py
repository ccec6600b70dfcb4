"""Read the stamps of pictures from a text file or from their names; the unit is found by trying.

Understood are seconds (the documented form), ms, us or ns, with a decimal comma, as seconds and
nanoseconds, as date and time; a frame number before it, the name of the picture behind it;
comments, a heading, a byte order mark. What can be read in two ways is refused.
"""

from __future__ import annotations

import codecs
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path

import numpy as np

from calm_edge.recording import SequenceError
from calm_edge.types import Int

UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
# Limits of a camera's median period. Three digits more or less are nearly always outside.
PERIOD_NS = (2_500_000, 4_000_000_000)
# a date between 1980 and 2096, in ns since 1970
_DATES_NS = (315_532_800 * 10**9, 4 * 10**18)
# share of the steps that go forward, in any order of stamps with single errors
_FORWARD_SHARE = 0.7
_LARGEST_NS = 2**62

_COMMENT = ("#", "%", "//")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,2})?")
_COMMA = re.compile(r"([-+]?\d+),(\d{1,9})(?:[\s;]|$)")
_DATE = re.compile(
    r"(\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?(Z|[-+]\d\d:?\d\d)?(?:[\s,;]|$)"
)
_FIELDS = re.compile(r"[\s,;]+")

SECOND_COLUMN = " in the second column"

Readings = dict[str, list[int]]


@dataclass(frozen=True, slots=True)
class StampRows:
    """Stamps of a file in its order.

    t_ns: (N,) as written, in ns. names: (N,) last field of each row if it is no number, such as a
    picture's name, or "". lines: (N,) line numbers. unit: how they were read, such as `ms`.
    """

    t_ns: Int
    names: tuple[str, ...]
    lines: tuple[int, ...]
    unit: str


@dataclass(frozen=True, slots=True)
class _Row:
    line: int
    text: str
    fields: tuple[str, ...]


def read_stamps(path: Path) -> StampRows:
    """Read the stamps of a text file; raises SequenceError, naming the file and the line."""
    rows = _rows(path)
    if not rows:
        return StampRows(np.zeros(0, np.int64), (), (), "s")
    readings: Readings = {}
    for reading in (_numbered, _decimal_comma, _two_columns, _dates):
        readings |= reading(rows)
    if not any(unit.endswith(SECOND_COLUMN) and _is_plausible(readings[unit]) for unit in readings):
        readings = _plain(rows) | readings
    if not readings:
        bad = next((row for row in rows if not _NUMBER.fullmatch(row.fields[0])), rows[0])
        raise SequenceError(f"{path}:{bad.line}: {bad.text!r} is not a time in seconds")
    unit, t_ns = _only_one(readings, f"{path}: its times")
    names = tuple("" if _NUMBER.fullmatch(r.fields[-1]) else r.fields[-1] for r in rows)
    return StampRows(_as_array(t_ns, path), names, tuple(row.line for row in rows), unit)


def stamps_in_names(stems: Sequence[str]) -> tuple[Int, str] | None:
    """Stamps (N,) in ns that names of pictures consist of, and their unit; None for other names.

    A name is a stamp if it ends with a fraction of seconds, or with a number that is a date:
    smaller ones are frame numbers. Raises SequenceError if there are two readings.
    """
    found = [re.search(r"\d+(\.\d+)?$", stem) for stem in stems]
    texts = [f[0] for f in found if f is not None]
    if len(texts) < len(stems):
        return None
    rows = [_Row(0, text, (text,)) for text in texts]
    readings = {
        unit: t_ns
        for unit, t_ns in _plain(rows).items()
        if ("." in texts[0] and unit == "s") or _DATES_NS[0] < t_ns[0] < _DATES_NS[1]
    }
    if not any(_is_plausible(t_ns) for t_ns in readings.values()):
        return None
    unit, t_ns = _only_one(readings, "names of pictures as times")
    return _as_array(t_ns, Path(stems[0])), unit


def _rows(path: Path) -> list[_Row]:
    """Lines with content, split at blanks, commas and semicolons; a heading is left out."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SequenceError(f"{path}: cannot be read ({error.strerror})") from None
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    text = data.decode("utf-16" if wide else "utf-8-sig", "replace")
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        if line and not line.startswith(_COMMENT):
            rows.append(_Row(number, line, tuple(f for f in _FIELDS.split(line) if f) or ("",)))
    has_heading = len(rows) > 1 and not rows[0].text[0].isdigit() and rows[0].text[0] not in "+-."
    return rows[1:] if has_heading else rows


def _decimals(texts: Sequence[str]) -> list[Decimal] | None:
    if not all(_NUMBER.fullmatch(text) for text in texts):
        return None
    return [Decimal(text) for text in texts]


def _in_units(numbers: Sequence[Decimal], what: str = "") -> Readings:
    return {
        unit + what: [int((n * ns).to_integral_value()) for n in numbers]
        for unit, ns in UNITS_NS.items()
        if max(map(abs, numbers)) * ns < _LARGEST_NS
    }


def _plain(rows: Sequence[_Row]) -> Readings:
    """Read the first field of each row as a number."""
    numbers = _decimals([row.fields[0] for row in rows])
    if numbers is None:
        return {}
    readings = _in_units(numbers)
    if "." in rows[0].fields[0] and _is_plausible(readings.get("s", [])):
        # a fraction is the documented form
        return {"s": readings["s"]}
    return readings


def _numbered(rows: Sequence[_Row]) -> Readings:
    """Read the second field of each row, behind a frame number."""
    numbers = _decimals([row.fields[0] for row in rows])
    if numbers is None or len(rows) < 2 or any(len(row.fields) < 2 for row in rows):
        return {}
    if any(b - a != 1 for a, b in itertools.pairwise(numbers)):
        return {}
    times = _decimals([row.fields[1] for row in rows])
    return {} if times is None else _in_units(times, SECOND_COLUMN)


def _decimal_comma(rows: Sequence[_Row]) -> Readings:
    """Read seconds with a decimal comma."""
    found = [_COMMA.match(row.text) for row in rows]
    if not all(found):
        return {}
    numbers = [Decimal(f"{f[1]}.{f[2]}") for f in found if f is not None]
    return {"s with a decimal comma": _in_units(numbers)["s"]}


def _two_columns(rows: Sequence[_Row]) -> Readings:
    """Read whole seconds and nanoseconds in two columns."""
    if not all(len(row.fields) > 1 and all(f.isdigit() for f in row.fields[:2]) for row in rows):
        return {}
    pairs = [(int(row.fields[0]), int(row.fields[1])) for row in rows]
    if not all(ns < 10**9 and s * 10**9 < _LARGEST_NS for s, ns in pairs):
        return {}
    return {"s and ns in two columns": [s * 10**9 + ns for s, ns in pairs]}


def _dates(rows: Sequence[_Row]) -> Readings:
    """Read dates with the time of day, as UTC unless a time zone is given."""
    t_ns = []
    for row in rows:
        found = _DATE.match(row.text)
        if found is None:
            return {}
        try:
            when = datetime.fromisoformat(found[1] + (found[3] or ""))
        except ValueError:
            return {}
        seconds = (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
        t_ns.append(round(seconds) * 10**9 + int((found[2] or "0").ljust(9, "0")))
    return {"date and time": t_ns}


def _only_one(readings: Readings, what: str) -> tuple[str, list[int]]:
    """The one plausible reading; raises SequenceError if there are two, or none."""
    n = len(next(iter(readings.values())))
    if n == 1:
        return _of_one(readings)
    different: Readings = {}
    for unit, t_ns in readings.items():
        if _is_plausible(t_ns) and t_ns not in different.values():
            different[unit] = t_ns
    if len(different) == 1:
        return next(iter(different.items()))
    limits = " and ".join(f"{1e9 / period:g}" for period in reversed(PERIOD_NS))
    if not different:
        raise SequenceError(
            f"{what} do not increase at the rate of a camera, between {limits} Hz, in s, ms, us or "
            "ns; write times in seconds, one a picture"
        )
    each = " or ".join(f"{unit} ({1e9 / _period(t_ns):.3g} Hz)" for unit, t_ns in different.items())
    raise SequenceError(f"{what} can be read as {each}; write seconds with a fraction, such as 0.0")


def _of_one(readings: Readings) -> tuple[str, list[int]]:
    """Reading of a single stamp: the one that is a date, else the first, seconds."""
    dates = [r for r in readings.items() if _DATES_NS[0] < r[1][0] < _DATES_NS[1]]
    return (dates or list(readings.items()))[0]


def _is_plausible(t_ns: Sequence[int]) -> bool:
    """Whether most steps go forward, and their median is a camera's period."""
    if len(t_ns) < 2:
        return False
    steps = np.diff(np.array(t_ns, np.int64))
    forward = steps[steps > 0]
    if len(forward) < _FORWARD_SHARE * len(steps):
        return False
    return bool(PERIOD_NS[0] <= np.median(forward) < PERIOD_NS[1])


def _period(t_ns: Sequence[int]) -> float:
    return float(np.median(np.diff(np.array(t_ns, np.int64))))


def _as_array(t_ns: Sequence[int], path: Path) -> Int:
    return np.array(t_ns, np.int64)
