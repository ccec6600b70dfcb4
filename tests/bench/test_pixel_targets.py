"""Verdicts from the figures, with medians, lost drives and unobserved focals."""

import math
from typing import Any

import pytest

from bench.pixel_targets import error_m, focal_observed, ratio, verdicts


def ours(error: float, sigma: float = 2.0, covered: float = 100.0, **more: Any) -> dict[str, Any]:
    sigmas = [sigma, sigma]
    return {
        "ate_se3_m": error,
        "ate_sim3_m": error / 2,
        "coverage_percent": covered,
        "focal_sigma_percent": sigmas,
        **more,
    }


def rival(error: float, placed: float = 1.0, **more: Any) -> dict[str, Any]:
    errors = {"ate_se3_m": error, "ate_sim3_m": error / 2}
    return {**errors, "placed": placed, "coverage_percent": 100.0, **more}


@pytest.mark.parametrize(
    ("mine", "theirs", "expected"),
    [
        (ours(1.0), rival(2.0), 0.5),
        (ours(1.0), rival(2.0, placed=0.5), 0.0),
        (ours(1.0, covered=50.0), rival(2.0), math.inf),
        (ours(1.0, covered=50.0), rival(2.0, placed=0.5), math.inf),
        ({"failed": "x"}, rival(2.0), math.inf),
    ],
)
def test_a_ratio_knows_who_lost_the_drive(
    mine: dict[str, Any], theirs: dict[str, Any], expected: float
) -> None:
    assert ratio(mine, theirs) == expected


def test_errors_and_focals() -> None:
    assert error_m(rival(2.0), "ate_sim3_m") == 1.0
    assert math.isinf(error_m(rival(2.0, placed=0.79)))
    assert math.isinf(error_m(rival(2.0, coverage_percent=79.0)))
    assert focal_observed(ours(1.0, sigma=5.0)) and not focal_observed(ours(1.0, sigma=5.1))
    assert not focal_observed({"focal_sigma_percent": [1.0, None]}) and not focal_observed({})


def drives(errors: list[float], truth: list[float]) -> dict[str, dict[str, dict[str, Any]]]:
    return {
        f"km{k}": {"ours": ours(e), "orbslam3": rival(t), "orbslam3_yaw": rival(10 * t)}
        for k, (e, t) in enumerate(zip(errors, truth, strict=True))
    }


def test_medians_are_over_rendered_drives_with_an_observed_focal() -> None:
    results = drives([1.0, 1.2, 9.0, 99.0], [1.0, 1.0, 1.0, 1.0])
    results["km3"]["ours"]["focal_sigma_percent"] = [9.0, 9.0]
    results["real"] = {"ours": ours(1000.0), "orbslam3": rival(1.0)}
    truth, yaw, frame = verdicts(results, {"km0", "km1", "km2", "km3"})[:3]
    assert truth[0].endswith("3 drives")
    assert truth[2:] == (1.2, True)
    assert yaw[2] == pytest.approx(0.12) and yaw[3] is True
    assert frame[2:] == (None, None)
    worse = verdicts(drives([1.4, 1.4, 1.0], [1.0, 1.0, 1.0]), {"km0", "km1", "km2"})[0]
    assert worse[2:] == (1.4, False)


def test_a_drive_that_ours_lost_counts_against_us() -> None:
    results = drives([1.0, 1.0, 1.0], [1.0, 1.0, 1.0])
    for name in ("km0", "km1"):
        results[name]["ours"]["coverage_percent"] = 10.0
    assert verdicts(results, set(results))[0][2:] == (None, False)


def test_a_drive_that_broke_ours_counts_against_us() -> None:
    results = drives([1.0, 1.0, 1.0], [1.0, 1.0, 1.0])
    results["km0"]["ours"] = results["km1"]["ours"] = {"failed": "it broke"}
    check = verdicts(results, set(results))[0]
    assert check[0].endswith("3 drives") and check[2:] == (None, False)


@pytest.mark.parametrize("why", ["skipped", "failed"])
def test_a_rival_that_did_not_run_is_no_verdict(why: str) -> None:
    results = drives([1.0], [1.0])
    results["km0"]["orbslam3"] = {why: "not here"}
    assert verdicts(results, {"km0"})[0][2:] == (None, None)


def test_the_real_clips_and_colmap() -> None:
    results = {
        "karlsruhe": {
            "ours": ours(1.9, cpu_s=10.0),
            "colmap": rival(2.0, cpu_s=300.0),
        },
        "kitti06": {"ours": ours(0.6, cpu_s=20.0), "colmap": rival(0.5, cpu_s=300.0)},
    }
    said = {check[0]: check[2:] for check in verdicts(results, set())[3:]}
    assert said["karlsruhe, Sim(3) m"] == (0.95, True)
    assert said["kitti06, Sim(3) m"] == (0.3, False)
    assert said["karlsruhe, Sim(3) m, ours and COLMAP"] == ([0.95, 1.0], True)
    assert said["kitti06, Sim(3) m, ours and COLMAP"] == ([0.3, 0.25], False)
    assert said["karlsruhe, CPU of ours over COLMAP's"] == (pytest.approx(1 / 30), True)
    assert said["kitti06, CPU of ours over COLMAP's"][1] is False
