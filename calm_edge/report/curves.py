"""Curves of the report, drawn by `chart`."""

from __future__ import annotations

import numpy as np

from calm_edge.report.chart import ASSISTANT, ESTIMATE, MUTED, TRUTH, WIDTH, Chart, limits
from calm_edge.types import Float

EYES = (ESTIMATE, ASSISTANT)


def trajectory(path: Float, truth: Float | None, unit: str) -> str:
    """Top view of a trajectory (N, 3) and of the ground truth (M, 3), in the level frame.

    unit: of the axis labels.
    """
    shown = path if truth is None or len(truth) == 0 else np.concatenate([path, truth])
    x, y = limits(shown[:, 0]), limits(shown[:, 1])
    height = int(np.clip(WIDTH * (y[1] - y[0]) / (x[1] - x[0]), 300, 860))
    chart = Chart(x, y, (unit, unit), height, equal=True)
    if truth is not None and len(truth):
        chart.line(truth[:, 0], truth[:, 1], TRUTH, "ground truth", width=4.5, opacity=0.6)
    chart.line(path[:, 0], path[:, 1], ESTIMATE, "calm-edge", width=2)
    (x0, y0), (x1, y1) = path[0, :2], path[-1, :2]
    chart.dot(x0, y0, ESTIMATE, "start")
    chart.dot(x1, y1, ESTIMATE, "end", square=True)
    return chart.svg("trajectory from above")


def scale(t: Float, values: Float, windows: Float | None) -> str:
    """Scale of the sub-maps over time, relative to the first one.

    t: (S,) s. values: (S,). windows: (W, 2) of (t, scale): scale of the estimate against the ground
    truth in sliding windows, relative to that in the first one.
    """
    measured = np.zeros((0, 2)) if windows is None else windows
    shown = limits(t, measured[:, 0]), limits(values, measured[:, 1], np.ones(1))
    chart = Chart(*shown, ("seconds", "scale, first = 1"), 290)
    chart.level(1.0, MUTED)
    chart.line(t, values, ESTIMATE, "applied to the sub-map", width=1.2, dots=True)
    if len(measured):
        chart.line(measured[:, 0], measured[:, 1], TRUTH, "100 frames against the truth", width=2.4)
    return chart.svg("scale over time")


def focal(t: Float, focal_px: Float, log_sigma: Float, truth_px: Float | None) -> str:
    """Focal length of both cameras over time with one- and three-sigma bands.

    t: (S,) s. focal_px: (S, 2). log_sigma: (S, 2) sigma of the log focal length.
    truth_px: (2,).
    """
    # axis limits from the values only: the sigma bands are very wide before the first turn
    shown = focal_px if truth_px is None else np.concatenate([focal_px, truth_px[None]])
    low, high = limits(shown, margin=0.0)
    chart = Chart(limits(t), (0.75 * low, 1.25 * high), ("seconds", "focal length, px"), 350)
    for eye, name in enumerate(("primary", "assistant")):
        value, sigma = focal_px[:, eye], np.clip(np.nan_to_num(log_sigma[:, eye], nan=2.0), 0, 2)
        known = np.isfinite(value)
        for k, opacity in ((3, 0.10), (1, 0.20)):
            below, above = value * np.exp(-k * sigma), value * np.exp(k * sigma)
            chart.band(t[known], below[known], above[known], EYES[eye], opacity)
        chart.line(t, value, EYES[eye], name, width=2)
        if truth_px is not None:
            chart.level(float(truth_px[eye]), EYES[eye], f"{name}, true", dash="7 4")
    return chart.svg("focal length over time")
