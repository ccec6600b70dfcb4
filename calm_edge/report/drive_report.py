"""Collect the data of the report page from a drive's updates, map and ground truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from calm_edge import __version__
from calm_edge.evaluation import EvaluationError, trajectory
from calm_edge.evaluation.estimate import Estimate
from calm_edge.evaluation.results import (
    MAX_FOCAL_SIGMA_PERCENT,
    MIN_POSES,
    at_frames,
    choose,
    common_origin,
    compare,
)
from calm_edge.evaluation.table import label, measured, pretty
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.polyline import path_length
from calm_edge.geometry.similarity import align
from calm_edge.kit.estimated import cameras
from calm_edge.report.account import account, unit, when
from calm_edge.report.drive_log import DriveLog
from calm_edge.report.events import MarkedEvent
from calm_edge.report.lens_image import LensImage, lens_image
from calm_edge.report.mask_image import shaded
from calm_edge.report.report import LoopRow, ReportData
from calm_edge.types import Bytes, Float, Int, LocalizerUpdate, Submap
from device.frame import Eye

EYES = ("primary", "assistant")


def _truth_in_world(estimate: Estimate, truth: Truth, t_ns: Int) -> Float | None:
    """True positions (M, 3) during the estimate, aligned to the estimate's world.

    None with fewer than MIN_POSES common stamps. t_ns: (N,) of the estimate, on the truth's clock.
    """
    i, j = trajectory.associate(t_ns, truth.t_ns)
    if len(i) < MIN_POSES:
        return None
    p, p_truth = estimate.T_w_c[i, :3, 3], truth.T_w_c[j, :3, 3]
    motion = align(p, p_truth, with_scale=choose(estimate) == "sim3")
    return motion.inverse().points(truth.T_w_c[j[0] : j[-1] + 1, :3, 3])


def _scale_windows(estimate: Estimate, truth: Truth, t_ns: Int) -> Float | None:
    """Scale of the estimate against the truth in sliding windows, relative to the first one.

    (W, 2) of (s since the start, scale).
    """
    p, p_truth = at_frames(t_ns, estimate.T_w_c, truth)
    starts, scales = trajectory.window_scales(p, p_truth)
    if len(scales) == 0:
        return None
    middle = np.searchsorted(truth.t_ns, t_ns[0]) + starts + trajectory.WINDOW_FRAMES // 2
    return np.stack([(truth.t_ns[middle] - t_ns[0]) / 1e9, scales], 1)


def compared(
    estimate: Estimate, truth: Truth | None
) -> tuple[dict[str, Any] | None, Truth | None, list[str]]:
    """Figures against the truth, the truth if it is of this drive, and a line if it is not."""
    if truth is None:
        return None, None, []
    try:
        return compare(estimate, truth), truth, []
    except EvaluationError as error:
        return None, None, [f"not compared with the truth: {error}"]


def unobserved(estimate: Estimate) -> tuple[str, ...]:
    """Sentences for the report on quantities that were not observed: focals, scale, poses."""
    notes = []
    if estimate.focal_px is not None:
        for eye, name in enumerate(EYES):
            sigma = (estimate.focal_sigma_percent or (None, None))[eye]
            if sigma is None or sigma > MAX_FOCAL_SIGMA_PERCENT:
                known = "unknown" if sigma is None else f"{sigma:.1f} %"
                notes.append(
                    f"The focal length of the {name} camera is unobserved: its sigma is {known} "
                    f"(limit {MAX_FOCAL_SIGMA_PERCENT:g} %), so that {estimate.focal_px[eye]:.1f} "
                    "px is a guess. Record a drive with turns."
                )
    if estimate.spacing_m and not estimate.metric and estimate.metre is not None:
        notes.append(f"Lengths are not metric: {estimate.metre.reason}.")
    if not estimate.spacing_m:
        notes.append(
            "Lengths are in camera spacings, not in metres: give the distance between the cameras "
            "with --spacing-m."
        )
    if len(estimate.t_ns) < MIN_POSES:
        notes.append("No sub-map could be placed; the log of the recording names the reason.")
    return tuple(notes)


def _headline(
    estimate: Estimate, unit: str, points: int, figures: Mapping[str, Any]
) -> list[tuple[str, str]]:
    length = path_length(estimate.T_w_c[:, :3, 3])
    cards = [(f"{length:,.1f} {unit}", "driven")]
    if estimate.points_w is not None:
        cards.append((f"{points:,}", "map points"))
    if figures.get("ate_percent") is not None:
        kind = {"se3": "SE(3)", "sim3": "Sim(3)"}[figures["align"]]
        error = figures["ate_se3_m" if figures["align"] == "se3" else "ate_sim3_m"]
        cards.append(
            (f"{error:.2f} m · {figures['ate_percent']:.2f} %", f"trajectory error, {kind}")
        )
    if figures.get("map_chamfer_m") is not None:
        cards.append((f"{figures['map_chamfer_m']:.2f} m", "map error (Chamfer distance)"))
    if estimate.focal_px is not None:
        cards.append((" / ".join(f"{f:.0f}" for f in estimate.focal_px) + " px", "focal lengths"))
    if estimate.pose_age_ms:
        p50, p99 = (estimate.pose_age_ms[k] for k in ("p50", "p99"))
        cards.append((f"{p50:.0f} / {p99:.0f} ms", "pose age, p50 / p99"))
    return cards


def loop_rows(
    updates: Sequence[LocalizerUpdate], estimate: Estimate, origin_ns: int
) -> tuple[LoopRow, ...]:
    """Loop closures whose keyframes are in the trajectory, each once, in order of time.

    origin_ns: stamps of the updates minus the estimate's.
    """
    row_of = {t + origin_ns: row for row, t in enumerate(estimate.t_ns.tolist())}
    rows = {
        key: row_of[t]
        for update in updates
        for key, t in zip(update.submap.primary_ids, update.submap.t_ns.tolist(), strict=False)
        if t in row_of
    }
    loops = [update.loop for update in updates if update.loop is not None]
    closed = {(loop.query_id, loop.match_id) for loop in loops}
    p = estimate.T_w_c[:, :3, 3]
    seconds = (estimate.t_ns - estimate.t_ns[:1]) / 1e9
    found = []
    for query, match in sorted(closed):
        if query in rows and match in rows:
            a, b = rows[query], rows[match]
            apart = float(np.linalg.norm(p[a] - p[b]))
            found.append(LoopRow(float(seconds[a]), float(seconds[b]), p[a], p[b], apart))
    return tuple(found)


def _rows(table: Mapping[str, Any], group: str = "") -> Iterator[tuple[str, str]]:
    """Names and texts of the figures that are known, those of a group each in its own row."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _rows(value, f"{name}, ")
        elif value not in (None, ""):
            try:
                yield group + label(name), measured(name, value)
            except (KeyError, StopIteration):
                yield group + name.replace("_", " "), pretty(value)


def _lenses(
    updates: Sequence[LocalizerUpdate], pictures: Sequence[Bytes | None]
) -> tuple[LensImage | None, ...]:
    """Lens of each eye whose focal length is observed and that has a picture."""
    if not updates:
        return ()
    known = cameras(updates[-1])
    return tuple(
        None if picture is None or eye not in known else lens_image(picture, known[eye])
        for eye, picture in zip(Eye, pictures, strict=False)
    )


def report_data(
    title: str,
    estimate: Estimate,
    updates: Sequence[LocalizerUpdate],
    color: Bytes | None = None,
    truth: Truth | None = None,
    figures: Mapping[str, Any] | None = None,
    notes: Sequence[str] = (),
    pictures: Sequence[Bytes | None] = (),
    log: DriveLog | None = None,
    origin_ns: int = 0,
    events: Sequence[MarkedEvent] = (),
) -> ReportData:
    """Assemble the data of the report page.

    color: (P, 3) RGB of estimate.points_w. figures: from `results.compare`. notes: sentences to
    add to those of `unobserved`. pictures: one (H, W, 3) BGR of each eye, to show its mask and
    lens in. log: facts of the recording. origin_ns: stamps of the updates minus the estimate's.
    events: what was marked.
    """
    figures, log = dict(figures or {}), log or DriveLog()
    truth_w = windows = None
    if truth is not None and len(truth.t_ns) and len(estimate.t_ns) >= MIN_POSES:
        t_ns = common_origin(estimate.t_ns, truth.t_ns, estimate.first_frame)
        truth_w, windows = (
            _truth_in_world(estimate, truth, t_ns),
            _scale_windows(estimate, truth, t_ns),
        )
    start = (estimate.t_ns[0] if len(estimate.t_ns) else 0) + origin_ns
    # the first update of each sub-map: as estimated when it was new, before later optimisations
    first = list({update.submap.id: update for update in reversed(updates)}.values())[::-1]
    submaps = [update.submap for update in first]
    scale = np.array([s.scale for s in submaps])
    points = 0 if estimate.points_w is None else len(estimate.points_w)
    loops = loop_rows(updates, estimate, origin_ns)
    table = {
        "frames": estimate.frames,
        "keyframes": estimate.keyframes,
        "submaps": estimate.submaps,
        "spacing_m": estimate.spacing_m,
        **{name: value for name, value in figures.items() if name != "stage_ms"},
    }
    return ReportData(
        title,
        estimate.T_w_c,
        unit(estimate),
        ", ".join(filter(None, (when(log), f"calm-edge {__version__}"))),
        account(estimate, log, len(loops), events),
        estimate.points_w,
        color,
        truth_w,
        np.array([(s.t_ns.max() - start) / 1e9 for s in submaps]),
        scale / scale[0] if len(scale) else scale,
        np.array([s.scale_log_sigma for s in submaps]),
        _focals(submaps, [s.cameras for s in submaps]),
        _focals(submaps, [u.prediction.cameras for u in first]),
        np.array([s.focal_log_sigma for s in submaps]).reshape(-1, 2),
        None if truth is None or truth.cameras is None else np.array([c.fx for c in truth.cameras]),
        windows,
        estimate.stage_ms,
        headline=tuple(_headline(estimate, unit(estimate), points, figures)),
        figures=dict(_rows(table)),
        notes=(*unobserved(estimate), *notes),
        left_out=shaded(pictures, updates[-1].masks if updates else None),
        lenses=_lenses(updates, pictures),
        loops=loops,
        log=log,
        events=tuple(events),
    )


def _focals(submaps: Sequence[Submap], views_of: Sequence[Sequence[Camera]]) -> Float:
    """Focal lengths (S, 2) [px] of both eyes, from the cameras of each sub-map's views."""
    rows = [
        [views[0].fx, views[s.n_primary if s.assistant_ids else 0].fx]
        for s, views in zip(submaps, views_of, strict=True)
    ]
    return np.array(rows).reshape(-1, 2)
