"""Print results as a table on the terminal or as one JSON object."""

from __future__ import annotations

import json
import shutil
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def pretty(value: Any) -> str:
    """Format a value of a result for people; None is a dash, empty texts are left out."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
    if isinstance(value, dict):
        return ", ".join(f"{k} {pretty(v)}" for k, v in value.items() if v != "") or "–"
    if isinstance(value, list | tuple):
        return ", ".join(pretty(v) for v in value) or "–"
    return str(value)


# units of figures whose name does not end with one; none: a name, or a yes or no
_UNITS = {
    "frames": "frames",
    "keyframes": "keyframes",
    "submaps": "sub-maps",
    "poses": "poses",
    "sim3_scale": "estimate / truth",
    "scale_mean": "of the first",
    "scale_std": "of the first",
    "align": "",
    "truth_moves": "",
    "metre": "",
    "live": "",
}
# by the end of the name, the longest first
_ENDINGS = {
    "deg_per_m": "deg/m",
    "percent": "%",
    "deg": "deg",
    "px": "px",
    "ms": "ms",
    "m": "m",
    "s": "s",
}


def unit(name: str) -> str:
    """Unit of a figure, by its name; raises KeyError if it has none."""
    if name in _UNITS:
        return _UNITS[name]
    return next(text for end, text in _ENDINGS.items() if name.endswith(f"_{end}"))


def label(name: str) -> str:
    """Name of a figure for people, without its unit."""
    if name in _UNITS:
        return name.replace("_", " ")
    end = next(end for end in _ENDINGS if name.endswith(f"_{end}"))
    return name.removesuffix(f"_{end}").replace("_", " ")


def measured(name: str, value: Any) -> str:
    """Format a figure with its unit."""
    return f"{pretty(value)} {unit(name)}".rstrip() if value is not None else pretty(value)


def json_text(result: Mapping[str, Any]) -> str:
    """The line of JSON for `--json`. Raises ValueError for NaN, which JSON does not allow."""
    return json.dumps(result, allow_nan=False)


def aligned(rows: Iterable[Sequence[Any]], columns: Sequence[str] = ()) -> list[str]:
    """Lines of a table in columns two spaces apart, each as wide as its widest value.

    Values are formatted by `pretty`. columns: names, underlined, above the rows.
    """
    cells = [[pretty(value) for value in row] for row in rows]
    if columns:
        cells.insert(0, list(columns))
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    if columns:
        cells.insert(1, ["-" * width for width in widths])
    return [
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()
        for row in cells
    ]


def print_result(result: Mapping[str, Any], title: str = "") -> None:
    """Print a table on stdout with one row per figure."""
    if title:
        print(title)
    width = max(shutil.get_terminal_size((100, 24)).columns, 60)
    indent = " " * (max(map(len, result)) + 2)
    for line in aligned((name, measured(name, value)) for name, value in result.items()):
        print(textwrap.fill(line, width, subsequent_indent=indent, break_long_words=False))
