"""Curves of the report, drawn by `chart` in the two widths of a page and of a phone."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from calm_edge.report.chart import (
    ASSISTANT,
    BAD,
    ESTIMATE,
    MUTED,
    NARROW,
    TRUTH,
    WIDTH,
    Chart,
    limits,
)
from calm_edge.types import Float

EYES = (ESTIMATE, ASSISTANT)
NAMES = ("primary", "assistant")
TIME = "time since the first keyframe, min:s"


def both_widths(draw: Callable[[int], Chart], alt: str) -> str:
    """HTML with the chart in both widths, of which the page's style shows one."""
    wide, narrow = draw(WIDTH).svg(alt), draw(NARROW).svg(alt)
    return f'<div class="wide">{wide}</div><div class="narrow">{narrow}</div>'


def driven(path: Float) -> Float:
    """Distance driven (N,) at each of the positions (N, 3)."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def trajectory(
    path: Float,
    truth: Float | None,
    unit: str,
    loops: Sequence[tuple[Float, Float]] = (),
    events: Sequence[Float] = (),
) -> str:
    """Top view of a trajectory (N, 3) and of the ground truth (M, 3), in the level frame.

    unit: of the axis labels. loops: positions (3,) of two keyframes that show one place. events:
    positions (3,) of what was marked.
    """
    shown = path if truth is None or len(truth) == 0 else np.concatenate([path, truth])
    x, y = limits(shown[:, 0]), limits(shown[:, 1])

    def draw(width: int) -> Chart:
        chart = Chart(x, y, (unit, unit), plan_height(x, y, width), width=width, equal=True)
        if truth is not None and len(truth):
            chart.line(truth[:, 0], truth[:, 1], TRUTH, "ground truth", width=4.5, opacity=0.6)
        chart.line(path[:, 0], path[:, 1], ESTIMATE, "calm-edge", width=2)
        for number, (a, b) in enumerate(loops):
            ends = np.stack([a, b])
            name = "loop" if number == 0 else ""
            chart.line(ends[:, 0], ends[:, 1], ASSISTANT, name, width=1.4, dots=True)
        (x0, y0), (x1, y1) = path[0, :2], path[-1, :2]
        chart.dot(x0, y0, ESTIMATE, "start")
        chart.dot(x1, y1, ESTIMATE, "end", square=True)
        for number, mark in enumerate(events):
            chart.dot(mark[0], mark[1], BAD, "event" if number == 0 else "")
        return chart

    return both_widths(draw, "trajectory from above")


def overlaid(paths: Sequence[Float], names: Sequence[str], unit: str) -> str:
    """Top view of paths (N, 3), with their names; in a level frame. The first one is broad."""
    every = np.concatenate(paths)
    x, y = limits(every[:, 0]), limits(every[:, 1])
    colors = (ESTIMATE, TRUTH, ASSISTANT)

    def draw(width: int) -> Chart:
        chart = Chart(x, y, (unit, unit), plan_height(x, y, width), width=width, equal=True)
        for number, (path, name) in enumerate(zip(paths, names, strict=True)):
            again, color = divmod(number, len(colors))
            ink, dash = colors[color], f"{9 * again} 5" if again else ""
            broad, opacity = (4.5, 0.5) if number == 0 else (2.0, 1.0)
            x_y = path[:, 0], path[:, 1]
            chart.line(*x_y, ink, name, width=broad, dash=dash, opacity=opacity)
            chart.dot(float(path[0, 0]), float(path[0, 1]), ink)
        return chart

    return both_widths(draw, "paths from above")


def plan_height(x: tuple[float, float], y: tuple[float, float], width: int) -> int:
    """Height [px] of a top view of these limits."""
    return int(np.clip(width * (y[1] - y[0]) / (x[1] - x[0]), 300, 0.9 * width))


def height(path: Float, truth: Float | None, unit: str) -> str:
    """Height of a trajectory (N, 3) and of the ground truth (M, 3) over the distance driven.

    In the level frame, relative to the first position of each.
    """

    def profile(p: Float) -> tuple[Float, Float]:
        return driven(p), p[:, 2] - p[0, 2]

    along, z = profile(path)
    true = None if truth is None or len(truth) == 0 else profile(truth)
    shown = [z] if true is None else [z, true[1]]
    low, high = limits(*shown)
    # a level street must not fill the chart with its noise
    least = 0.02 * float(along[-1])
    more = max(least - (high - low), 0.0) / 2
    far = along if true is None else np.concatenate([along, true[0]])

    def draw(width: int) -> Chart:
        labels = f"distance driven, {unit}", f"height, {unit}"
        chart = Chart(limits(far, margin=0.0), (low - more, high + more), labels, 260, width=width)
        if true is not None:
            chart.line(*true, TRUTH, "ground truth", width=4.5, opacity=0.6)
        chart.line(along, z, ESTIMATE, "calm-edge", width=2)
        return chart

    return both_widths(draw, "height over distance")


def scale(t: Float, values: Float, windows: Float | None, log_sigma: Float) -> str:
    """Scale of the sub-maps over time, relative to the first one.

    t: (S,) s. values: (S,). log_sigma: (S,) of the values, not finite where unknown. windows:
    (W, 2) of (t, scale): scale of the estimate against the ground truth in sliding windows,
    relative to that in the first one.
    """
    measured = np.zeros((0, 2)) if windows is None else windows
    shown = limits(t, measured[:, 0]), limits(values, measured[:, 1], np.ones(1), margin=0.15)

    def draw(width: int) -> Chart:
        chart = Chart(*shown, (TIME, "scale, first = 1"), 290, width=width, clock=True)
        chart.level(1.0, MUTED)
        known = np.isfinite(log_sigma)
        if known.any():
            sigma = log_sigma[known]
            low, high = (values[known] * np.exp(k * sigma) for k in (-1, 1))
            chart.band(t[known], low, high, ESTIMATE, 0.18)
        chart.line(t, values, ESTIMATE, "applied to the sub-map", width=1.2, dots=True)
        if len(measured):
            x, y = measured.T
            chart.line(x, y, TRUTH, "100 frames against the truth", width=2.4)
        return chart

    return both_widths(draw, "scale over time")


def focal(
    t: Float, focal_px: Float, log_sigma: Float, truth_px: Float | None, raw_px: Float
) -> str:
    """Focal length of both cameras over time with one- and three-sigma bands.

    t: (S,) s. focal_px: (S, 2) as chosen. log_sigma: (S, 2) sigma of the log focal length.
    truth_px: (2,). raw_px: (S, 2) as the backbone estimated it in the window.
    """
    # axis limits from the values only: the sigma bands are very wide before the first turn
    shown = focal_px if truth_px is None else np.concatenate([focal_px, truth_px[None]])
    low, high = limits(shown, margin=0.0)

    def draw(width: int) -> Chart:
        labels = TIME, "focal length, px"
        axes = limits(t), (0.75 * low, 1.25 * high)
        chart = Chart(*axes, labels, 350, width=width, clock=True)
        for eye, name in enumerate(NAMES):
            value = focal_px[:, eye]
            sigma = np.clip(np.nan_to_num(log_sigma[:, eye], nan=2.0), 0, 2)
            known = np.isfinite(value)
            for k, opacity in ((3, 0.10), (1, 0.20)):
                below, above = value * np.exp(-k * sigma), value * np.exp(k * sigma)
                chart.band(t[known], below[known], above[known], EYES[eye], opacity)
            if len(raw_px):
                chart.points(t, raw_px[:, eye], EYES[eye], f"{name}, raw")
            chart.line(t, value, EYES[eye], f"{name}, chosen", width=2)
            if truth_px is not None:
                chart.level(float(truth_px[eye]), EYES[eye], f"{name}, true", dash="7 4")
        return chart

    return both_widths(draw, "focal length over time")


def series(t: Float, values: Float, label: str, spans: Sequence[tuple[float, float]] = ()) -> str:
    """One quantity over time: t (N,) s, values (N,), NaN where unknown.

    label: name and unit. spans: (start, seconds) without a live pose, which are shaded.
    """
    low, high = limits(values)

    def draw(width: int) -> Chart:
        end = np.array([start + length for start, length in spans])
        axes = limits(t, end, margin=0.01), (min(low, 0.0) if low < 1 else low, high)
        chart = Chart(*axes, (TIME, label), 220, width=width, clock=True)
        for number, (start, length) in enumerate(spans):
            chart.span(start, start + length, TRUTH, "no live pose" if number == 0 else "")
        chart.line(t, values, ESTIMATE, width=1.8)
        return chart

    return both_widths(draw, f"{label} over time")
