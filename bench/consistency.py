"""NEES of the optimised pose graph, squared pose errors over covariances, on scripted drives.

The poses that the scripted backbone predicts have errors of known size, and each sub-map has a
scale of its own. NEES, normalised estimation error squared: Bar-Shalom, Li, Kirubarajan,
"Estimation with applications to tracking and navigation", 2001, 5.4. Its average over independent
runs of a consistent estimator lies in a chi-square interval.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy import stats

from bench.cost import circuit
from bench.graph_covariance import optimised
from bench.normalised import RMS
from bench.scripted import ScriptedBackbone, ScriptedErrors
from bench.tables import OUT, Check, Table, publish
from calm_edge.config import Config, merge
from calm_edge.estimator.localizer import Localizer
from calm_edge.geometry import se3
from calm_edge.posegraph.marginals import Marginals
from calm_edge.types import Float

TRANSLATION_SIGMA_M, ROTATION_SIGMA_RAD, SCALE_LOG_SIGMA = 0.01, 0.001, 0.2
# Keyframes between the two poses of a pair. One keyframe is 1 m and 0.1 s: 10 m and 100 m.
LAGS = (10, 100)
COLUMNS = (
    "keyframes apart",
    "pairs",
    "position error rms, m",
    "sigma, m",
    "error / sigma rms",
    "consistent",
)


def pose_nees(T: Float, T_truth: Float, covariance: Float) -> Float:
    """NEES (M,) of poses T (M, 4, 4) with covariances (M, 6, 6), translation first.

    T, T_truth: relative to the same origin, in the same unit. Covariances: in the axes of each
    pose.
    """
    error = se3.log(se3.inverse(T_truth) @ T)
    solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.asarray((error * solved).sum(-1))


def consistent_band(n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Confidence interval of the mean of n independent pose NEES, divided by 6.

    A mean above it shows that the covariances are too small, one below it that they are too large.
    """
    tail, dof = (1 - confidence) / 2, 6 * n
    low, high = stats.chi2(dof).ppf([tail, 1 - tail]) / dof
    return float(low), float(high)


def solved(seed: int, n_submaps: int) -> tuple[Float, Float, Marginals]:
    """Optimise one scripted drive: poses (N, 4, 4), true poses (N, 4, 4), marginal covariances."""
    spacing_m = float(np.linalg.norm(circuit.T_P_A[:3, 3]))
    known = {"scale": {"spacing_m": spacing_m}, "loops": {"enabled": False}}
    config = merge(Config(), known | {"correction": {"apply": "never"}})
    scene = circuit.scene(circuit.n_keyframes(n_submaps, config.frontend))
    errors = ScriptedErrors(
        scale_log_sigma=SCALE_LOG_SIGMA,
        rotation_sigma_rad=ROTATION_SIGMA_RAD,
        translation_sigma=TRANSLATION_SIGMA_M,
        seed=seed,
    )
    localizer = Localizer(config, ScriptedBackbone(scene, errors))
    for window in circuit.windows(n_submaps, config.frontend):
        localizer.process(window)
    localizer.finish()
    found = optimised(localizer.submaps, config)
    assert found is not None
    trajectory, marginals = found
    return trajectory.T_w_c, scene.T_w_p, marginals


def rows(seeds: int, n_submaps: int) -> tuple[tuple[float | str, ...], ...]:
    """Compute the table: errors of relative poses over their sigmas, a row for each of LAGS.

    seeds: number of drives.
    """
    found: dict[int, list[tuple[float, float, float]]] = {lag: [] for lag in LAGS}
    for seed in range(seeds):
        T, truth, marginals = solved(seed, n_submaps)
        for lag in LAGS:
            # consecutive pairs share only their end keyframes, so their errors are nearly
            # independent
            for origin in range(0, len(T) - lag, lag):
                of_pair = [se3.inverse(X[origin]) @ X[origin + lag] for X in (T, truth)]
                covariance = marginals.covariances(np.array([origin + lag]), origin)
                nees = float(pose_nees(of_pair[0][None], of_pair[1][None], covariance)[0])
                off = float(((of_pair[0] - of_pair[1])[:3, 3] ** 2).sum())
                found[lag].append((off, float(np.trace(covariance[0, :3, :3])), nees / 6))
    table: list[tuple[float | str, ...]] = []
    for lag, values in found.items():
        if values:
            error, claimed, ratio = np.sqrt(np.mean(values, 0)).tolist()
            low, high = np.sqrt(consistent_band(len(values)))
            table.append((lag, len(values), error, claimed, ratio, f"{low:.2f} to {high:.2f}"))
    return tuple(table)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--seeds", type=int, default=20, help="drives")
    parser.add_argument("--submaps", type=int, default=9, help="sub-maps of a drive")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Compute the NEES of all drives, print and save the table, return the exit code."""
    title = "Relative poses of the joint graph against their covariances"
    notes = (f"{options.seeds} drives of {options.submaps} sub-maps",)
    measured = rows(options.seeds, options.submaps)
    low, high = RMS
    checks = tuple(
        Check(f"{lag} keyframes apart: error / sigma rms", f"{low:g} to {high:g}", rms,
              isinstance(rms, float) and low <= rms <= high)
        for lag, _, _, _, rms, _ in measured
    )  # fmt: skip
    table = Table("consistency", title, options.command, COLUMNS, measured, checks, notes)
    return publish(table, options.out)
