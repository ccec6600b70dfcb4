"""Print results as a table on the terminal or as one JSON object."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def pretty(value: Any) -> str:
    """Format a value of a result for people; None is a dash."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
    if isinstance(value, dict):
        return ", ".join(f"{k} {pretty(v)}" for k, v in value.items()) or "–"
    if isinstance(value, list | tuple):
        return ", ".join(pretty(v) for v in value) or "–"
    return str(value)


def json_text(result: Mapping[str, Any]) -> str:
    """The line of JSON for `--json`. Raises ValueError for NaN, which JSON does not allow."""
    return json.dumps(result, allow_nan=False)


def print_result(result: Mapping[str, Any], title: str = "") -> None:
    """Print a table on stdout with one row per figure."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title or None, show_header=False, box=None, pad_edge=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(justify="left")
    for name, value in result.items():
        table.add_row(name, pretty(value))
    Console().print(table)
