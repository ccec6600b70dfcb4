"""Page that compares two recordings or maps: paths overlaid, and a table of their figures."""

from __future__ import annotations

import html
from itertools import groupby

import numpy as np

from calm_edge.evaluation.difference import Overlay, Row
from calm_edge.evaluation.side import Side
from calm_edge.report import curves, map_image, page, tables

NAMES = ("A", "B")


def render(a: Side, b: Side, rows: list[Row], overlay: Overlay) -> str:
    """The page as self-contained HTML text."""
    title = f"{a.path.name} and {b.path.name}"
    lead = f"A: {a.kind} {a.path}. B: {b.kind} {b.path}."
    parts = [f'<h1>{html.escape(title)}</h1><p class="lead">{html.escape(lead)}</p>']
    missing = [
        f"{name}: {line}" for name, side in zip(NAMES, (a, b), strict=True) for line in side.missing
    ]
    if missing:
        items = "".join(f"<li>{html.escape(line)}</li>" for line in missing)
        parts.append(page.section("Not complete", "", f"<ul>{items}</ul>", "warn"))
    if len(overlay.path_a) and len(overlay.path_b):
        R = map_image.level_rotation(a.estimate.T_w_c)
        paths = overlay.path_a @ R.T, overlay.path_b @ R.T
        drawn = curves.overlaid(paths, NAMES, rows_unit(rows))
        parts.append(page.section("Both paths from above", apart(overlay, rows_unit(rows)), drawn))
    for group, members in groupby(rows, key=lambda row: row.figure.group):
        cells = [row.cells() for row in members]
        table = tables.rows(("", *NAMES, "change"), cells)
        parts.append(page.section(group.capitalize(), "", table))
    return page.whole(title, parts)


def rows_unit(rows: list[Row]) -> str:
    """Unit of the first side's world."""
    return next((row.a.unit for row in rows if row.key == "length" and row.a), "m")


def apart(overlay: Overlay, unit: str) -> str:
    """How far the paths are apart, and by what they were placed, in a sentence."""
    placed = f"B is placed by {overlay.by}."
    if overlay.rms is None or overlay.most is None:
        return placed
    stretched = "" if np.isclose(overlay.scale, 1.0, atol=1e-12) else f", scale {overlay.scale:.5g}"
    rms, most = (
        f"{v:.3g}" if v >= 0.001 else "less than 0.001" for v in (overlay.rms, overlay.most)
    )
    return f"{placed} Keyframes are {rms} {unit} apart (rms), at most {most} {unit}{stretched}."
