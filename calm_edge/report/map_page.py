"""Write map.html: the map to walk through in a browser, offline.

The page holds the viewer (`viewer/`), the drive and the points, each piece in a script element, so
that the first picture is drawn while the rest is read. Points beyond EMBEDDED are in files beside
the page, in the folder `map_points`: a page opened from the disk may load scripts but not fetch.
"""

from __future__ import annotations

import base64
import html
import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from calm_edge.report import map_image, point_records
from calm_edge.report.events import MarkedEvent, time
from calm_edge.report.keyframe_pictures import KeyframePictures
from calm_edge.types import Bytes, Float, Float32, Int

FOLDER = "map_points"
# points in the page itself, 16 bytes each in base64; all, if there are no more than LIMIT
EMBEDDED, LIMIT = 1_000_000, 5_000_000
# the first piece is small and soon drawn
FIRST, PIECE = 100_000, 500_000
# places of seams in the page, 22 bytes each
MAX_SEAM_MARKS = 20_000
PAIRS_A_SCRIPT = 16
SCRIPTS = (
    "matrices.js",
    "view.js",
    "points.js",
    "lines.js",
    "seams.js",
    "pointer.js",
    "panel.js",
    "main.js",
)


@dataclass(frozen=True, slots=True)
class MapView:
    """What the page shows.

    unit: of the world, `m` or `spacings`. grain: distance between neighbouring points. points_w:
    (P, 3), color: (P, 3) RGB, submap: (P,) index of each point's sub-map. submap_s: (S,) and t_s:
    (K,) seconds since the start of sub-maps and keyframes. T_w_c: (K, 4, 4) of keyframes, K >= 1.
    seams: (M, 4) of common anchors of two sub-maps: place in the world, and how far these disagree.
    drives: name and first keyframe of each drive of a map of several, none of one.
    events: what was marked while driving.
    """

    title: str
    unit: str
    grain: float
    points_w: Float32
    color: Bytes
    submap: Int
    submap_s: Float
    T_w_c: Float
    t_s: Float
    pictures: Sequence[KeyframePictures] = ()
    seams: Float32 = field(default_factory=lambda: np.zeros((0, 4), np.float32))
    drives: tuple[tuple[str, int], ...] = ()
    events: Sequence[MarkedEvent] = ()


@dataclass(frozen=True, slots=True)
class Written:
    """Size of what was written: bytes of the page, of the files beside it, and points."""

    page: int
    beside: int
    points: int

    def __str__(self) -> str:
        beside = f" and {self.beside / 1e6:.1f} MB in {FOLDER}" if self.beside else ""
        return f"{self.points:,} points, {self.page / 1e6:.1f} MB{beside}"


def write_map_page(path: Path, view: MapView) -> Written:
    """Write the page, replacing an earlier one; points that are not finite are left out."""
    beside = path.parent / FOLDER
    shutil.rmtree(beside, ignore_errors=True)
    R = map_image.level_rotation(view.T_w_c)
    keep = np.flatnonzero(np.isfinite(view.points_w).all(1))
    keep = keep[point_records.random_order(len(keep))]
    points = view.points_w[keep] @ R.T.astype(np.float32)
    box = point_records.bounding_box(points)
    group = -(-max(len(view.submap_s), 1) // point_records.MAX_SUBMAPS)
    records = point_records.packed(points, view.color[keep], view.submap[keep] // group, box)
    inside = len(records) if len(records) <= LIMIT else EMBEDDED
    outside = _outside(beside, records[inside:]) if inside < len(records) else []
    drive = _drive(view, R, points, box, group) | {"count": len(records), "files": outside}
    part = path.with_name(path.name + ".part")
    with part.open("w", encoding="utf-8") as page:
        _write(page, view, drive, records[:inside], _seam_marks(view.seams, R))
    part.rename(path)
    size = sum((path.parent / name).stat().st_size for name in outside)
    return Written(path.stat().st_size, size, len(records))


def _drive(
    view: MapView, R: Float, points: Float32, box: point_records.Box, group: int
) -> dict[str, Any]:
    """What the viewer has to know besides points and pictures; lengths in the level frame."""
    path = view.T_w_c[:, :3, 3] @ R.T
    forward = view.T_w_c[:, :3, 2] @ R.T
    heights = np.quantile(points[:100_000, 2], [0.02, 0.98]) if len(points) else np.zeros(2)
    return {
        "title": view.title,
        "unit": view.unit,
        "grain": view.grain,
        "low": box.low.tolist(),
        "step": box.step,
        "heights": heights.tolist(),
        "path": path.round(4).tolist(),
        "heading": np.arctan2(forward[:, 1], forward[:, 0]).round(4).tolist(),
        "seconds": view.t_s.round(3).tolist(),
        "drives": view.drives,
        "events": [
            [event.keyframe, f"{time(event)} {event.text}".strip()]
            for event in view.events
            if event.keyframe is not None
        ],
        "submapSeconds": view.submap_s[::group].round(3).tolist(),
    }


def _pieces(records: np.ndarray[Any, Any], first: int) -> Iterator[str]:
    """Base64 of the records, `first` of them and then PIECE at a time."""
    start, size = 0, first
    while start < len(records):
        yield base64.b64encode(records[start : start + size].tobytes()).decode()
        start, size = start + size, PIECE


def _outside(folder: Path, records: np.ndarray[Any, Any]) -> list[str]:
    """Write the files beside the page; return their names relative to it."""
    folder.mkdir(parents=True)
    names = []
    for number, piece in enumerate(_pieces(records, PIECE)):
        names.append(f"{FOLDER}/{number:04d}.js")
        (folder.parent / names[-1]).write_text(f'calmEdgeMap.points("{piece}")\n')
    return names


def _seam_marks(seams: Float32, R: Float) -> Float32:
    """At most MAX_SEAM_MARKS of the rows of MapView.seams, in the level frame."""
    marks = seams[:: max(-(-len(seams) // MAX_SEAM_MARKS), 1)]
    return np.column_stack([marks[:, :3] @ R.T, marks[:, 3]]).astype("<f4")


def _write(
    page: TextIO,
    view: MapView,
    drive: dict[str, Any],
    records: np.ndarray[Any, Any],
    seams: Float32,
) -> None:
    viewer = files("calm_edge.report") / "viewer"
    body = (viewer / "body.html").read_text("utf-8")
    code = "\n".join((viewer / name).read_text("utf-8") for name in SCRIPTS)
    page.write(
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{html.escape(view.title)}</title>"
        f"<style>{(viewer / 'viewer.css').read_text('utf-8')}</style></head><body>{body}"
        f"<script>const DRIVE={_json(drive)};</script>"
        f'<script>"use strict";(() => {{\n{code}\n}})();</script>\n'
    )
    for piece in _pieces(records, FIRST):
        page.write(f'<script>calmEdgeMap.points("{piece}")</script>\n')
    for first in range(0, len(view.pictures), PAIRS_A_SCRIPT):
        rows = [
            [p.keyframe, _base64(p.primary), _base64(p.assistant), p.later_ns / 1e9]
            for p in view.pictures[first : first + PAIRS_A_SCRIPT]
        ]
        page.write(f"<script>calmEdgeMap.pictures({_json(rows)})</script>\n")
    if len(seams):
        page.write(f'<script>calmEdgeMap.seams("{_base64(seams.tobytes())}")</script>\n')
    page.write("<script>calmEdgeMap.end()</script></body></html>\n")


def _base64(data: bytes | None) -> str | None:
    return None if data is None else base64.b64encode(data).decode()


def _json(value: object) -> str:
    """JSON that may stand in a script element."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
