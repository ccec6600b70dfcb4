"""Tables of the report as HTML."""

from __future__ import annotations

import html
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from calm_edge.evaluation.table import pretty


def pairs(values: Mapping[str, Any]) -> str:
    """Table of names and values."""
    cells = (
        f"<tr><td>{html.escape(name)}</td><td>{html.escape(pretty(value))}</td></tr>"
        for name, value in values.items()
    )
    return f'<table class="pairs">{"".join(cells)}</table>'


def durations(values: Mapping[str, float], unit: str) -> str:
    """Table of durations by stage, with a bar for each, longest on top, and their sum."""
    longest = max(*values.values(), 1e-9)
    rows = "".join(
        f'<tr><td>{html.escape(name)}</td><td class="number">{number(value)} {unit}</td><td>'
        f'<div class="bar" style="width:{100 * value / longest:.1f}%"></div></td></tr>'
        for name, value in sorted(values.items(), key=lambda item: -item[1])
    )
    total = f'<td class="number">{number(sum(values.values()))} {unit}</td><td></td>'
    return f'<table class="stages">{rows}<tr><td>all stages</td>{total}</tr></table>'


def number(value: float) -> str:
    """Three or more digits, never an exponent."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def rows(columns: Sequence[str], values: Sequence[Sequence[str]]) -> str:
    """Table with a head."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    body = "".join(
        f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in values
    )
    return f"<table><tr>{head}</tr>{body}</table>"


def files(page: Path, paths: Sequence[Path]) -> str:
    """Table of links from a page to files and folders that exist, with their sizes."""
    found = []
    for path in paths:
        if not path.exists():
            continue
        name = os.path.relpath(path, page.parent)
        size = "folder" if path.is_dir() else f"{path.stat().st_size / 1e6:,.2f} MB"
        link = f'<a href="{html.escape(quote(os.fsencode(name)))}">{html.escape(name)}</a>'
        found.append(f"<tr><td>{link}</td><td>{size}</td></tr>")
    return f'<table class="pairs">{"".join(found)}</table>' if found else ""
