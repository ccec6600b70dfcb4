"""Collect the data of the report page from a drive's updates, map and ground truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calm_edge.evaluation import trajectory
from calm_edge.evaluation.estimate import Estimate
from calm_edge.evaluation.results import (
    MAX_FOCAL_SIGMA_PERCENT,
    MIN_POSES,
    at_frames,
    choose,
    common_origin,
)
from calm_edge.evaluation.table import label, measured
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry.similarity import align
from calm_edge.report.mask_image import shaded
from calm_edge.report.report import ReportData
from calm_edge.types import Bytes, Float, Int, LocalizerUpdate

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
    length = trajectory.path_length(estimate.T_w_c[:, :3, 3])
    cards = [(f"{length:,.1f} {unit}", "driven"), (f"{points:,}", "map points")]
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


def unit(estimate: Estimate) -> str:
    """Unit of the world: m, spacings, or `units` where a given spacing did not give metres."""
    return "m" if estimate.metric else "units" if estimate.spacing_m else "spacings"


def report_data(
    title: str,
    estimate: Estimate,
    updates: Sequence[LocalizerUpdate],
    color: Bytes | None = None,
    truth: Truth | None = None,
    figures: Mapping[str, Any] | None = None,
    notes: Sequence[str] = (),
    pictures: Sequence[Bytes] = (),
) -> ReportData:
    """Assemble the data of the report page.

    color: (P, 3) RGB of estimate.points_w. figures: from `results.compare`. notes: sentences to
    add to those of `unobserved`. pictures: one (H, W, 3) BGR of each eye, to show its mask in.
    """
    figures = dict(figures or {})
    truth_w = windows = None
    if truth is not None and len(truth.t_ns) and len(estimate.t_ns) >= MIN_POSES:
        t_ns = common_origin(estimate.t_ns, truth.t_ns, estimate.first_frame)
        truth_w, windows = (
            _truth_in_world(estimate, truth, t_ns),
            _scale_windows(estimate, truth, t_ns),
        )
    start = estimate.t_ns[0] if len(estimate.t_ns) else 0
    # the first update of each sub-map: as estimated when it was new, before later optimisations
    submaps = list({update.submap.id: update.submap for update in reversed(updates)}.values())[::-1]
    focal = [
        [s.cameras[0].fx, s.cameras[s.n_primary if s.assistant_ids else 0].fx] for s in submaps
    ]
    scale = np.array([s.scale for s in submaps])
    points = 0 if estimate.points_w is None else len(estimate.points_w)
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
        estimate.points_w,
        color,
        truth_w,
        np.array([(s.t_ns.max() - start) / 1e9 for s in submaps]),
        scale / scale[0] if len(scale) else scale,
        np.array(focal).reshape(-1, 2),
        np.array([s.focal_log_sigma for s in submaps]).reshape(-1, 2),
        None if truth is None or truth.cameras is None else np.array([c.fx for c in truth.cameras]),
        windows,
        estimate.stage_ms,
        tuple(_headline(estimate, unit(estimate), points, figures)),
        {label(name): measured(name, v) for name, v in table.items() if v is not None},
        (*unobserved(estimate), *notes),
        shaded(pictures, updates[-1].masks if updates else None),
    )
