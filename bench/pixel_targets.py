"""Targets of the comparison `bench pixels`, and the check whether results meet them."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from statistics import median
from typing import Any

from calm_edge.evaluation.results import MAX_FOCAL_SIGMA_PERCENT

# (quantity, target, measured value, whether it meets the target or None if not measured yet)
Verdict = tuple[str, str, Any, bool | None]
Results = Mapping[str, Mapping[str, Mapping[str, Any]]]

# A drive counts as lost if a smaller share of its frames has a pose, or of its path is covered.
LOST_BELOW = 0.8
KARLSRUHE_M = 1.07
KITTI06_M = 0.2

# Runs of ORB-SLAM3, with the true and with wrong calibrations: key of its results, title, and the
# largest accepted ratio of our error to its error.
RATIOS = (
    ("orbslam3", "ORB-SLAM3, true calibration", 1.3),
    ("orbslam3_yaw", "ORB-SLAM3, yaw half a degree wrong", 1 / 3),
    ("orbslam3_frame", "ORB-SLAM3, assistant one frame late", 1 / 3),
)


def error_m(figures: Mapping[str, Any], key: str = "ate_se3_m") -> float:
    """The error `key` of a run, m; infinite if the drive was lost or the method failed."""
    value, covered = figures.get(key), (figures.get("coverage_percent") or 0.0) / 100
    kept = min(covered, figures.get("placed", 1.0))
    return math.inf if value is None or kept < LOST_BELOW else float(value)


def focal_observed(figures: Mapping[str, Any]) -> bool:
    """Whether the focal sigma of both eyes is at most MAX_FOCAL_SIGMA_PERCENT."""
    sigma = figures.get("focal_sigma_percent") or (None, None)
    return all(s is not None and s <= MAX_FOCAL_SIGMA_PERCENT for s in sigma)


def ratio(ours: Mapping[str, Any], rival: Mapping[str, Any]) -> float:
    """Our SE(3) error over the rival's; 0 if only the rival lost the drive, inf if ours did."""
    mine, theirs = error_m(ours), error_m(rival)
    if math.isinf(mine):
        return math.inf
    return 0.0 if math.isinf(theirs) else mine / theirs


def verdicts(results: Results, counted: Collection[str]) -> list[Verdict]:
    """Verdicts on all targets. counted: names of the drives that enter the medians."""
    return [*_medians(results, counted), *_real(results), *_against_colmap(results)]


def _measured(figures: Mapping[str, Any] | None) -> bool:
    # a failed rival does not count as beaten: the fault may lie in our use of it
    return figures is not None and not {"skipped", "failed"} & set(figures)


def _counts(ours: Mapping[str, Any] | None) -> bool:
    # a failed run of ours counts, although it has no focal sigma
    return ours is not None and ("failed" in ours or (_measured(ours) and focal_observed(ours)))


def _medians(results: Results, counted: Collection[str]) -> list[Verdict]:
    drives = [
        methods
        for name, methods in results.items()
        if name in counted and _counts(methods.get("ours"))
    ]
    checks: list[Verdict] = []
    for method, rival, most in RATIOS:
        ratios = [ratio(d["ours"], d[method]) for d in drives if _measured(d.get(method))]
        middle = median(ratios) if ratios else None
        finite = middle if middle is not None and math.isfinite(middle) else None
        what = f"median of ours over {rival}, {len(ratios)} drives"
        checks.append((what, f"<= {most:.2f}", finite, None if middle is None else middle <= most))
    return checks


def _real(results: Results) -> list[Verdict]:
    checks: list[Verdict] = []
    for name, most in (("karlsruhe", KARLSRUHE_M), ("kitti06", KITTI06_M)):
        ours = results.get(name, {}).get("ours")
        error = error_m(ours, "ate_sim3_m") if ours is not None else None
        finite = error if error is not None and math.isfinite(error) else None
        passed = None if error is None else error <= most
        checks.append((f"{name}, Sim(3) m", f"<= {most:g}", finite, passed))
    return checks


def _against_colmap(results: Results) -> list[Verdict]:
    checks: list[Verdict] = []
    for name, methods in results.items():
        ours, colmap = methods.get("ours"), methods.get("colmap")
        if ours is None or colmap is None or not _measured(colmap):
            continue
        mine, theirs = error_m(ours, "ate_sim3_m"), error_m(colmap, "ate_sim3_m")
        shown = [v if math.isfinite(v) else None for v in (mine, theirs)]
        checks.append((f"{name}, Sim(3) m, ours and COLMAP", "better", shown, mine < theirs))
        if ours.get("cpu_s") and colmap.get("cpu_s"):
            part = ours["cpu_s"] / colmap["cpu_s"]
            checks.append((f"{name}, CPU of ours over COLMAP's", "<= 0.05", part, part <= 0.05))
    return checks
