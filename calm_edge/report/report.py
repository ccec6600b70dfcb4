"""Render the report of a drive as one self-contained HTML page."""

from __future__ import annotations

import base64
import html
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calm_edge.evaluation.table import pretty
from calm_edge.report import chart, curves, map_image, page
from calm_edge.types import Bytes, Float, Float32
from device.frame import jpeg

# Larger clouds are thinned evenly to this number, which suffices for the images.
MAX_DRAWN_POINTS = 3_000_000


@dataclass(frozen=True, slots=True)
class ReportData:
    """Content of the page; fields that are None or empty are left out.

    T_w_c: (N, 4, 4) primary camera -> world. unit: of the world, `m` or `spacings`.
    points_w: (P, 3), color: (P, 3) RGB. truth_w: (M, 3) true positions in this world.
    t_s: (S,) time of each sub-map. scale: (S,) relative to the first. focal_px,
    focal_log_sigma: (S, 2). truth_focal_px: (2,). scale_windows: (W, 2) of (t,
    scale against the truth). stage_ms: mean per sub-map. headline: pairs (number, caption).
    figures: name -> value. notes: sentences on what could not be determined. left_out: pictures
    (h, w, 3) RGB of `mask_image`.
    """

    title: str
    T_w_c: Float
    unit: str = "m"
    points_w: Float32 | None = None
    color: Bytes | None = None
    truth_w: Float | None = None
    t_s: Float = field(default_factory=lambda: np.zeros(0))
    scale: Float = field(default_factory=lambda: np.zeros(0))
    focal_px: Float = field(default_factory=lambda: np.zeros((0, 2)))
    focal_log_sigma: Float = field(default_factory=lambda: np.zeros((0, 2)))
    truth_focal_px: Float | None = None
    scale_windows: Float | None = None
    stage_ms: dict[str, float] = field(default_factory=dict)
    headline: tuple[tuple[str, str], ...] = ()
    figures: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    left_out: tuple[Bytes, ...] = ()


def _photo(image: Bytes) -> str:
    data = jpeg(np.ascontiguousarray(image[..., ::-1]))
    return "data:image/jpeg;base64," + base64.b64encode(data).decode()


def _bar_length(span: float) -> float:
    """Length of a scale bar: 1, 2 or 5 times a power of ten, at most a fifth of the span."""
    power = 10.0 ** np.floor(np.log10(max(span / 5, 1e-12)))
    return float(max(power * k for k in (1, 2, 5) if power * k <= span / 5 * 1.0001))


def _map_from_above(view: map_image.TopDown, path: Float, unit: str) -> str:
    height, width = view.image.shape[:2]
    line = " ".join(f"{u:.1f},{v:.1f}" for u, v in view.to_pixels(path))
    bar = _bar_length(width * view.pixel)
    end = 24 + bar / view.pixel
    stroke = f'fill="none" stroke="{chart.ESTIMATE}" stroke-linejoin="round"'
    return (
        f'<svg viewBox="0 0 {width} {height + 56}" role="img" aria-label="map from above">'
        f'<image width="{width}" height="{height}" href="{_photo(view.image)}"/>'
        f'<polyline points="{line}" {stroke} stroke-width="2.5" stroke-opacity=".85"/>'
        f'<path d="M24 {height + 14}v12H{end:.1f}v-12" fill="none" stroke="{chart.INK}" '
        f'stroke-width="2.5"/><text x="{end + 12:.1f}" y="{height + 30}" font-size="24" '
        f'fill="{chart.INK}">{bar:g} {html.escape(unit)}</text></svg>'
    )


def _map_sections(data: ReportData, R: Float, path: Float) -> list[str]:
    if data.points_w is None or data.color is None:
        return []
    finite = np.flatnonzero(np.isfinite(data.points_w).all(1))
    if len(finite) == 0:
        return []
    drawn = finite[:: max(len(finite) // MAX_DRAWN_POINTS, 1)]
    points, color = np.asarray(data.points_w[drawn], np.float64) @ R.T, data.color[drawn]
    above = _map_from_above(map_image.top_down(points, color, path), path, data.unit)
    views = map_image.best_chases(points, color, path)
    photos = "".join(f'<img alt="map along the street" src="{_photo(v)}">' for v in views)
    return [
        page.section("The map from above", f"{len(finite):,} points in their own colours.", above),
        page.section("The map along the street", "Seen from behind and above the car.", photos),
    ]


def _rows(values: dict[str, Any]) -> str:
    cells = (
        f"<tr><td>{html.escape(name)}</td><td>{html.escape(pretty(value))}</td></tr>"
        for name, value in values.items()
    )
    return f'<table class="pairs">{"".join(cells)}</table>'


def _stages(stage_ms: dict[str, float]) -> str:
    """Table of the mean milliseconds per sub-map with a bar for each stage, longest on top."""
    longest = max(max(stage_ms.values()), 1e-9)
    rows = "".join(
        f'<tr><td>{html.escape(name)}</td><td class="number">{ms:.4g} ms</td><td>'
        f'<div class="bar" style="width:{100 * ms / longest:.1f}%"></div></td></tr>'
        for name, ms in sorted(stage_ms.items(), key=lambda item: -item[1])
    )
    total = f'<td class="number">{sum(stage_ms.values()):.4g} ms</td><td></td>'
    return f'<table class="stages">{rows}<tr><td>all stages</td>{total}</tr></table>'


def render(data: ReportData) -> str:
    """The page as self-contained HTML text."""
    parts = [f'<h1>{html.escape(data.title)}</h1><p class="lead">calm-edge, one drive</p>']
    if data.headline:
        cards = (
            f'<div class="card"><b>{html.escape(number)}</b><span>{html.escape(what)}</span></div>'
            for number, what in data.headline
        )
        parts.append(f'<div class="cards">{"".join(cards)}</div>')
    if data.notes:
        items = "".join(f"<li>{html.escape(note)}</li>" for note in data.notes)
        parts.append(page.section("Not observed, not complete", "", f"<ul>{items}</ul>", "warn"))
    if len(data.T_w_c):
        R = map_image.level_rotation(data.T_w_c)
        path = data.T_w_c[:, :3, 3] @ R.T
        truth = None if data.truth_w is None else data.truth_w @ R.T
        parts += _map_sections(data, R, path)
        drawn = curves.trajectory(path, truth, data.unit)
        against = "With the ground truth." if truth is not None else "No truth was given."
        parts.append(page.section("The trajectory from above", against, drawn))
    if len(data.scale):
        drawn = curves.scale(data.t_s, data.scale, data.scale_windows)
        note = "Scale factor of each sub-map relative to the first (paper IV-B)."
        parts.append(page.section("Scale over time", note, drawn))
    if len(data.focal_px):
        drawn = curves.focal(data.t_s, data.focal_px, data.focal_log_sigma, data.truth_focal_px)
        note = "Bands: one and three sigma. Dashed: ground truth, if given."
        parts.append(page.section("Focal length over time", note, drawn))
    if data.left_out:
        photos = "".join(f'<img alt="picture" src="{_photo(v)}">' for v in data.left_out)
        note = "Red: shows the car or nothing, not the scene; used for no pose and no depth."
        parts.append(page.section("Left out of the pictures", note, photos))
    if data.stage_ms:
        parts.append(page.section("Time by stage", "Mean per sub-map.", _stages(data.stage_ms)))
    if data.figures:
        parts.append(page.section("Figures", "", _rows(data.figures)))
    return page.whole(data.title, parts)


def write_report(path: Path, data: ReportData) -> None:
    """Write the rendered page as UTF-8."""
    path.write_text(render(data), encoding="utf-8")
