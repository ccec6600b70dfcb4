"""Render the report of a drive as one self-contained HTML page."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calm_edge.report import curves, events, map_image, map_sections, page, tables
from calm_edge.report.chart import minutes
from calm_edge.report.drive_log import DriveLog
from calm_edge.report.events import MarkedEvent
from calm_edge.report.lens_image import LensImage
from calm_edge.report.map_sections import photo
from calm_edge.types import Bytes, Float, Float32

EYES = ("primary", "assistant")
# of the counts that `record` writes at its end
COUNTED = (
    *("frames", "keyframes", "windows", "submaps"),
    *("poses", "unscaled_poses", "lost_poses", "late_poses"),
    *("repeated", "camera_drops", "corrupt", "untracked", "clamped_stamps", "host_stamped"),
    *("estimator_restarts", "tracker_restarts"),
)


@dataclass(frozen=True, slots=True)
class LoopRow:
    """A loop closure: seconds of both keyframes, their positions (3,), and their distance."""

    t_s: float
    match_s: float
    p_w: Float
    match_p_w: Float
    apart: float


@dataclass(frozen=True, slots=True)
class ReportData:
    """Content of the page; fields that are None or empty are left out.

    T_w_c: (N, 4, 4) primary camera -> world. unit: of the world, `m` or `spacings`. lead: date and
    duration. account: sentences on what happened. points_w: (P, 3), color: (P, 3) RGB. truth_w:
    (M, 3) true positions in this world. t_s: (S,) time of each sub-map. scale: (S,) relative to the
    first, scale_log_sigma: (S,). focal_px as chosen, focal_raw_px as the backbone estimated them,
    focal_log_sigma: (S, 2). truth_focal_px: (2,). scale_windows: (W, 2) of (t, scale against the
    truth). stage_ms: mean per sub-map. map_s: seconds of `map` by stage. headline: pairs (number,
    caption). figures: name -> value. notes: sentences on what could not be determined. left_out:
    pictures (h, w, 3) RGB of `mask_image`. files: to link to. map_page: name of the map beside the
    page, empty without one.
    """

    title: str
    T_w_c: Float
    unit: str = "m"
    lead: str = ""
    account: tuple[str, ...] = ()
    points_w: Float32 | None = None
    color: Bytes | None = None
    truth_w: Float | None = None
    t_s: Float = field(default_factory=lambda: np.zeros(0))
    scale: Float = field(default_factory=lambda: np.zeros(0))
    scale_log_sigma: Float = field(default_factory=lambda: np.zeros(0))
    focal_px: Float = field(default_factory=lambda: np.zeros((0, 2)))
    focal_raw_px: Float = field(default_factory=lambda: np.zeros((0, 2)))
    focal_log_sigma: Float = field(default_factory=lambda: np.zeros((0, 2)))
    truth_focal_px: Float | None = None
    scale_windows: Float | None = None
    stage_ms: dict[str, float] = field(default_factory=dict)
    map_s: dict[str, float] = field(default_factory=dict)
    headline: tuple[tuple[str, str], ...] = ()
    figures: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    left_out: tuple[Bytes, ...] = ()
    lenses: tuple[LensImage | None, ...] = ()
    loops: tuple[LoopRow, ...] = ()
    log: DriveLog = field(default_factory=DriveLog)
    files: tuple[Path, ...] = ()
    events: tuple[MarkedEvent, ...] = ()
    map_page: str = ""


def render(data: ReportData, path: Path = Path("report.html")) -> str:
    """The page as self-contained HTML text. path: of the page, from which it links to files."""
    parts = [f'<h1>{html.escape(data.title)}</h1><p class="lead">{html.escape(data.lead)}</p>']
    if data.account:
        lines = " ".join(html.escape(sentence) for sentence in data.account)
        parts.append(f'<p class="account">{lines}</p>')
    if data.headline:
        cards = (
            f'<div class="card"><b>{html.escape(number)}</b><span>{html.escape(what)}</span></div>'
            for number, what in data.headline
        )
        parts.append(f'<div class="cards">{"".join(cards)}</div>')
    if data.notes:
        items = "".join(f"<li>{html.escape(note)}</li>" for note in data.notes)
        parts.append(page.section("Not observed, not complete", "", f"<ul>{items}</ul>", "warn"))
    parts += [*_path(data), *_estimates(data), *_run(data)]
    if data.figures:
        parts.append(page.section("Figures", "", tables.pairs(data.figures)))
    if data.log.rows:
        parts.append(page.section("The recording", "", tables.pairs(data.log.rows)))
    if links := tables.files(path, data.files):
        note = "These open as long as the page stays where it is."
        parts.append(page.section("Files", note, links))
    return page.whole(data.title, parts)


def _path(data: ReportData) -> list[str]:
    """Map, trajectory, height and loops."""
    if not len(data.T_w_c):
        return []
    R = map_image.level_rotation(data.T_w_c)
    path = data.T_w_c[:, :3, 3] @ R.T
    truth = None if data.truth_w is None else data.truth_w @ R.T
    loops = [(R @ loop.p_w, R @ loop.match_p_w) for loop in data.loops]
    marks = [R @ event.p_w for event in data.events if event.p_w is not None]
    drawn = curves.trajectory(path, truth, data.unit, loops, marks)
    against = "With the ground truth." if truth is not None else "No truth was given."
    parts = [page.section("The trajectory from above", against, drawn)]
    if data.events:
        note = "Marked while driving; times since the first keyframe, min:s."
        driven = curves.driven(path)
        table = events.table(data.events, driven, data.unit, data.map_page)
        parts.append(page.section("Events", note, table))
    if len(path) > 1:
        note = "Along the camera's mean up axis, from the first keyframe."
        parts.append(page.section("Height", note, curves.height(path, truth, data.unit)))
    parts += map_sections.sections(data.points_w, data.color, R, [path], data.unit)
    if data.loops:
        found = [
            (minutes(loop.t_s), minutes(loop.match_s), f"{loop.apart:.2f} {data.unit}")
            for loop in data.loops
        ]
        table = tables.rows(("at", "sees again the place of", "distance of the two"), found)
        parts.append(page.section("Loops", "Both times since the first keyframe, min:s.", table))
    return parts


def _estimates(data: ReportData) -> list[str]:
    """Scale, focal lengths, lenses and masks."""
    parts = []
    if len(data.scale):
        drawn = curves.scale(data.t_s, data.scale, data.scale_windows, data.scale_log_sigma)
        note = "Scale factor of each sub-map relative to the first (paper IV-B). Band: one sigma."
        parts.append(page.section("Scale over time", note, drawn))
    if len(data.focal_px):
        drawn = curves.focal(
            data.t_s, data.focal_px, data.focal_log_sigma, data.truth_focal_px, data.focal_raw_px
        )
        note = (
            "Rings: as the backbone estimated it in each window. Lines: as chosen from all "
            "windows so far. Bands: one and three sigma. Dashed: ground truth, if given."
        )
        parts.append(page.section("Focal length over time", note, drawn))
    lenses = [(name, lens) for name, lens in zip(EYES, data.lenses, strict=False) if lens]
    if lenses:
        note = "Left as taken, right straightened. Lines of the grid are straight in the scene."
        drawn = "".join(_lens(name, lens) for name, lens in lenses)
        parts.append(page.section("Lenses", note, drawn))
    if data.left_out:
        photos = "".join(f'<img alt="picture" src="{photo(v)}">' for v in data.left_out)
        note = "Red: shows the car or nothing, not the scene; used for no pose and no depth."
        parts.append(page.section("Left out of the pictures", note, photos))
    return parts


def _lens(name: str, lens: LensImage) -> str:
    terms = ", ".join(f"{term} {value:+.4f}" for term, value in lens.terms) or "no distortion"
    cut = (
        f"; {100 * lens.cut:.0f} % of the picture is beyond 100 degrees" if lens.cut > 0.005 else ""
    )
    text = f"The {name} camera: {terms}; bends the picture by at most {lens.bend_px:.1f} px{cut}."
    taken, straight = (
        f'<img alt="{name} camera, {what}" src="{photo(image)}">'
        for what, image in (("as taken", lens.taken), ("straightened", lens.straight))
    )
    return f'<p class="note">{html.escape(text)}</p><div class="two">{taken}{straight}</div>'


def _run(data: ReportData) -> list[str]:
    """Times of the stages, lost frames, disk and temperature."""
    parts, log = [], data.log
    if data.stage_ms:
        table = tables.durations(data.stage_ms, "ms")
        parts.append(page.section("Time by stage", "While solving, mean per sub-map.", table))
    if data.map_s:
        table = tables.durations(data.map_s, "s")
        parts.append(page.section("Time of the map", "In all, by stage.", table))
    if log.health is not None:
        parts.append(page.section("While driving", "", _health(log)))
    if log.counts:
        counts = {
            name.replace("_", " "): log.counts[name] for name in COUNTED if name in log.counts
        }
        parts.append(page.section("Counts of the recording", "", tables.pairs(counts)))
    return parts


def _health(log: DriveLog) -> str:
    health = log.health
    assert health is not None
    spans: Sequence[tuple[float, float]] = [(span.start_s, span.seconds) for span in log.lost]
    shown = (
        ("pose age, ms", health.pose_age_ms),
        ("frames lost or not tracked", health.lost_frames),
        ("disk space left, GB", health.free_gb),
        ("recorded, MB/s", health.written_mb_s),
        ("temperature, °C", health.celsius),
    )
    known = [(label, values) for label, values in shown if np.isfinite(values).any()]
    return "".join(curves.series(health.t_s, values, label, spans) for label, values in known)


def write_report(path: Path, data: ReportData) -> None:
    """Write the rendered page as UTF-8, replacing an earlier one at once."""
    page.write(path, render(data, path))
