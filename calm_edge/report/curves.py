"""Plots of the report as SVG text, drawn with matplotlib."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from calm_edge.types import Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK, MUTED, GRID = "#1f2933", "#6b7785", "#e3e7eb"
ESTIMATE, TRUTH, EYES = "#0b6bcb", "#d9822b", ("#0b6bcb", "#a03d8f")


def _figure(width: float, height: float) -> tuple[Any, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.add_subplot()
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(MUTED)
    axes.tick_params(colors=MUTED, labelsize=9)
    return figure, axes


def _svg(figure: Any) -> str:
    import matplotlib

    out = io.StringIO()
    # a fixed salt and no date: the same drive gives the same bytes
    with matplotlib.rc_context({"svg.hashsalt": "calm-edge"}):
        figure.savefig(out, format="svg", metadata={"Date": None}, transparent=True)
    return out.getvalue()


def trajectory(path: Float, truth: Float | None, unit: str) -> str:
    """Top view of a trajectory (N, 3) and of the ground truth (M, 3), in the level frame.

    unit: of the axis labels.
    """
    shown = path if truth is None or len(truth) == 0 else np.concatenate([path, truth])
    span = np.maximum(np.ptp(shown[:, :2], axis=0), 1e-6)
    figure, axes = _figure(10, float(np.clip(10 * span[1] / span[0], 3.0, 9.0)))
    if truth is not None and len(truth):
        axes.plot(truth[:, 0], truth[:, 1], color=TRUTH, linewidth=3.5, alpha=0.6, label="truth")
    axes.plot(path[:, 0], path[:, 1], color=ESTIMATE, linewidth=1.6, label="calm-edge")
    axes.plot(*path[0, :2], "o", color=ESTIMATE, markersize=7, label="start")
    axes.plot(*path[-1, :2], "s", color=ESTIMATE, markersize=6, label="end")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(unit, color=MUTED)
    axes.set_ylabel(unit, color=MUTED)
    axes.legend(frameon=False, fontsize=9, labelcolor=INK)
    return _svg(figure)


def scale(t: Float, values: Float, windows: Float | None) -> str:
    """Scale of the sub-maps over time, relative to the first one.

    t: (S,) s. values: (S,). windows: (W, 2) of (t, scale): scale of the estimate against the ground
    truth in sliding windows, relative to that in the first one.
    """
    figure, axes = _figure(10, 2.8)
    axes.axhline(1.0, color=MUTED, linewidth=1, linestyle=":")
    axes.plot(
        t, values, "o-", color=ESTIMATE, markersize=3.5, linewidth=1, label="applied to the sub-map"
    )
    if windows is not None and len(windows):
        axes.plot(
            windows[:, 0], windows[:, 1], color=TRUTH, linewidth=2, label="100 frames against truth"
        )
    axes.set_xlabel("seconds", color=MUTED)
    axes.set_ylabel("scale, first = 1", color=MUTED)
    axes.legend(frameon=False, fontsize=9, labelcolor=INK)
    return _svg(figure)


def focal(t: Float, focal_px: Float, log_sigma: Float, truth_px: Float | None) -> str:
    """Focal length of both cameras over time with one- and three-sigma bands.

    t: (S,) s. focal_px: (S, 2). log_sigma: (S, 2) sigma of the log focal length.
    truth_px: (2,).
    """
    figure, axes = _figure(10, 3.4)
    for eye, name in enumerate(("primary", "assistant")):
        value, sigma = focal_px[:, eye], np.clip(np.nan_to_num(log_sigma[:, eye], nan=2.0), 0, 2)
        for k, alpha in ((3, 0.10), (1, 0.20)):
            low, high = value * np.exp(-k * sigma), value * np.exp(k * sigma)
            axes.fill_between(t, low, high, color=EYES[eye], alpha=alpha, linewidth=0)
        axes.plot(t, value, color=EYES[eye], linewidth=1.8, label=name)
        if truth_px is not None:
            axes.axhline(
                truth_px[eye], color=EYES[eye], linewidth=1.2, linestyle="--", label=f"{name}, true"
            )
    # axis limits from the values only: the sigma bands are very wide before the first turn
    shown = focal_px if truth_px is None else np.concatenate([focal_px, truth_px[None]])
    shown = shown[np.isfinite(shown).all(1)]
    if len(shown):
        axes.set_ylim(0.75 * float(shown.min()), 1.25 * float(shown.max()))
    axes.set_xlabel("seconds", color=MUTED)
    axes.set_ylabel("focal length, px", color=MUTED)
    axes.legend(frameon=False, fontsize=9, labelcolor=INK, ncols=2)
    return _svg(figure)


def stages(stage_ms: dict[str, float]) -> str:
    """Bar chart of the mean milliseconds per sub-map of each stage, longest on top."""
    names = sorted(stage_ms, key=lambda name: stage_ms[name])
    figure, axes = _figure(10, 0.6 + 0.32 * max(len(names), 1))
    bars = axes.barh(names, [stage_ms[n] for n in names], color=ESTIMATE, height=0.62)
    axes.bar_label(bars, fmt="%.4g ms", padding=4, fontsize=9, color=INK)
    axes.margins(x=0.14)
    axes.set_xlabel("milliseconds per sub-map", color=MUTED)
    return _svg(figure)
