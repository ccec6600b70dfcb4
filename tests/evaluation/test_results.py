"""Keys of `eval --json` for estimates with known errors."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.estimate import Estimate, from_updates, pose_ages
from calm_edge.evaluation.results import common_origin, compare, evaluate
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.trajectories import write_kitti, write_tum
from tests.evaluation.worlds import curve, stamps, update

N = 240
KEYS = {
    "frames",
    "keyframes",
    "submaps",
    "path_m",
    "truth_moves",
    "ate_se3_m",
    "ate_sim3_m",
    "sim3_scale",
    "ate_percent",
    "rpe_trans_percent",
    "rpe_rot_deg_per_m",
    "scale_mean",
    "scale_std",
    "focal_px",
    "focal_sigma_percent",
    "focal_error_px",
    "focal_error_percent",
    "map_accuracy_m",
    "map_completeness_m",
    "map_chamfer_m",
    "pose_age_ms",
    "stage_ms",
}


def _truth(cloud: bool = False) -> Truth:
    cameras = tuple(Perspective(f, f, 319.5, 119.5, 640, 240) for f in (500.0, 640.0))
    ground = curve(N)[:, :3, 3].astype(np.float32) + np.float32([0, 1.5, 0])
    return Truth(stamps(N), curve(N), cameras, ground if cloud else None)


def _moved(T: np.ndarray, scale: float = 1.0) -> np.ndarray:
    R = se3.so3_exp(np.array([0.2, -0.4, 1.0]))
    return se3.compose(R @ T[:, :3, :3], scale * T[:, :3, 3] @ R.T + [3.0, 4, 5])


def _estimate(scale: float = 1.0, every: int = 3, **more: object) -> Estimate:
    T = _moved(curve(N), scale)[::every]
    return replace(Estimate("here", stamps(N)[::every], T), **more)  # type: ignore[arg-type]


def test_a_perfect_metric_drive() -> None:
    result = compare(_estimate(spacing_m=0.5), _truth())
    assert set(result) >= KEYS
    assert result["align"] == "se3"
    assert result["path_m"] == pytest.approx(237, rel=0.01)
    for key in ("ate_se3_m", "ate_sim3_m", "ate_percent", "rpe_trans_percent"):
        assert result[key] == pytest.approx(0, abs=1e-9)
    assert result["sim3_scale"] == pytest.approx(1)
    # interpolation between keyframes adds a small error on curves
    assert result["scale_mean"] == pytest.approx(0, abs=1e-3)
    assert result["coverage_percent"] == pytest.approx(100 * 237 / 239, rel=0.01)
    json.dumps(result, allow_nan=False)


def test_the_spacing_decides_the_alignment_and_align_overrides() -> None:
    wrong = _estimate(scale=1.25)
    free = compare(wrong, _truth())
    metric = compare(replace(wrong, spacing_m=0.5), _truth())
    assert free["sim3_scale"] == pytest.approx(0.8)
    assert free["ate_percent"] == pytest.approx(0, abs=1e-6)
    assert metric["ate_percent"] == pytest.approx(100 * metric["ate_se3_m"] / metric["path_m"])
    assert metric["ate_percent"] > 5
    assert metric["rpe_trans_percent"] == pytest.approx(25, rel=0.01)
    assert compare(replace(wrong, spacing_m=0.5), _truth(), "sim3")["ate_percent"] < 1e-6
    assert compare(wrong, _truth(), "se3")["ate_percent"] == metric["ate_percent"]


def test_focal_errors_are_null_when_unobserved() -> None:
    focal = _estimate(focal_px=(510.0, 600.0), focal_sigma_percent=(1.0, 5.1))
    result = compare(focal, _truth())
    assert result["focal_px"] == [510.0, 600.0]
    assert result["focal_error_px"] == [10.0, None]
    assert result["focal_error_percent"] == [pytest.approx(2.0), None]
    unknown = compare(replace(focal, focal_sigma_percent=(None, 5.0)), _truth())
    assert unknown["focal_error_px"] == [None, -40.0]
    assert compare(_estimate(), _truth())["focal_px"] is None


def test_the_map_error_is_computed_after_alignment() -> None:
    truth = _truth(cloud=True)
    assert truth.cloud is not None
    ground = se3.compose(np.tile(np.eye(3), (N, 1, 1)), truth.cloud.astype(float))
    points = _moved(ground, 2.0)[:, :3, 3].astype(np.float32)
    result = compare(_estimate(scale=2.0, points_w=points), truth)
    assert result["map_chamfer_m"] == pytest.approx(0, abs=1e-3)
    shifted = compare(_estimate(scale=2.0, points_w=points + np.float32(0.2)), truth)
    assert shifted["map_accuracy_m"] == pytest.approx(0.1 * np.sqrt(3), rel=0.15)
    assert compare(_estimate(points_w=points), _truth())["map_chamfer_m"] is None


def test_updates_give_counts_focals_ages_and_stages() -> None:
    T, t = _moved(curve(N)), stamps(N)
    updates = [
        update(T[:50:5], t[:50:5], submap_id=0, stage_ms={"infer": 100.0, "loop": 8.0}),
        update(
            T[::5],
            t[::5],
            focal=(505.0, 645.0),
            sigma=(0.02, np.inf),
            submap_id=1,
            stage_ms={"infer": 300.0},
        ),
    ]
    ages = pose_ages(t[:100] + np.arange(1, 101) * 1_000_000, t[:100])
    result = compare(from_updates("r", updates, N, 0.5, ages), _truth())
    assert (result["frames"], result["keyframes"], result["submaps"]) == (N, 48, 2)
    assert result["focal_px"] == [505.0, 645.0]
    assert result["focal_sigma_percent"] == [2.0, None]
    assert result["focal_error_px"] == [5.0, None]
    assert result["stage_ms"] == {"infer": 200.0, "loop": 8.0}
    assert result["pose_age_ms"] == {"p50": pytest.approx(50.5), "p99": pytest.approx(99.01)}
    assert result["align"] == "se3" and result["ate_se3_m"] < 1e-9


def test_an_incomplete_final_trajectory_does_not_shorten_the_drive() -> None:
    T, t = _moved(curve(N)), stamps(N)
    whole, piece = update(T, t, submap_id=3), update(T[:9], t[:9], submap_id=0)
    assert compare(from_updates("r", [whole, piece]), _truth())["keyframes"] == N
    better = update(curve(N), t, focal=(501.0, 600.0), submap_id=3)
    chosen = from_updates("r", [whole, piece, better])
    assert chosen.focal_px == (501.0, 600.0) and np.array_equal(chosen.T_w_c, curve(N))


def test_a_run_without_sub_maps_is_null_not_an_error() -> None:
    result = compare(from_updates("r", [], frames=7), _truth())
    assert (result["frames"], result["keyframes"], result["submaps"]) == (7, 0, 0)
    assert result["ate_se3_m"] is None and result["focal_px"] is None


def test_the_truth_of_another_drive_is_an_error() -> None:
    late = replace(_estimate(), t_ns=stamps(N)[::3] + 10**15)
    with pytest.raises(EvaluationError, match="0 poses within 10 ms"):
        compare(late, _truth())


def test_foreign_stamps_without_our_offset() -> None:
    t = stamps(N)
    assert np.array_equal(common_origin(t - 1_000_000_000, t), t)
    assert np.array_equal(common_origin(t[3:-3], t), t[3:-3])


def test_a_paced_replay_is_moved_back_by_its_first_frame() -> None:
    late = 77_000_000_123
    live = replace(
        _estimate(), t_ns=stamps(N)[::3] + late, first_frame=(2, int(stamps(N)[2]) + late)
    )
    assert compare(live, _truth())["ate_sim3_m"] < 1e-9
    wrong = replace(live, first_frame=(12, int(stamps(N)[2]) + late))
    assert compare(wrong, _truth())["ate_sim3_m"] > 0.1


def test_ages_of_stamps_from_another_clock_are_unknown() -> None:
    t = stamps(5)
    assert pose_ages(t + 10**15, t) is None
    assert pose_ages(t - 1, t) is None
    assert pose_ages(t[:0], t[:0]) is None


def test_a_tum_file_from_disk(tmp_path: Path) -> None:
    write_kitti(tmp_path / "poses0.txt", curve(N))
    write_tum(tmp_path / "o.tum", stamps(N), _moved(curve(N), 0.5))
    result = evaluate(tmp_path / "o.tum", tmp_path)
    assert result["sim3_scale"] == pytest.approx(2, rel=1e-6)
    assert result["poses"] == N
    assert result["scale_std"] == pytest.approx(0, abs=1e-6)
    for key in ("frames", "keyframes", "submaps", "focal_px", "pose_age_ms", "stage_ms"):
        assert result[key] is None
    with pytest.raises(EvaluationError, match="not found"):
        evaluate(tmp_path / "nothing", tmp_path)


def test_a_map_folder_from_disk(tmp_path: Path) -> None:
    write_kitti(tmp_path / "poses0.txt", curve(N))
    (tmp_path / "calib.txt").write_text("500 500 0 0 9 9\n600 600 0 0 9 9\n")
    write_tum(tmp_path / "trajectory.tum", stamps(N), curve(N))
    summary = {
        "frames": N,
        "keyframes": 80,
        "submaps": 6,
        "spacing_m": 0.5,
        "focal_px": [505, 606.0],
        "focal_sigma_percent": [0.5, None],
        "pose_age_ms": {"p50": 20.0, "p99": 60.0},
        "stage_ms": {"infer": 200.0},
    }
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    result = evaluate(tmp_path, tmp_path)
    for key in ("frames", "keyframes", "submaps", "pose_age_ms", "stage_ms"):
        assert result[key] == summary[key]
    assert result["align"] == "se3"
    assert result["focal_error_percent"] == [1.0, None]
    (tmp_path / "summary.json").write_text("{")
    with pytest.raises(EvaluationError, match=r"summary.json: not a readable"):
        evaluate(tmp_path, tmp_path)


@pytest.mark.parametrize("wander_m", [0.0, 0.02])
def test_a_truth_without_motion_has_no_path_error(wander_m: float) -> None:
    still = np.tile(np.eye(4), (N, 1, 1))
    still[:, :3, 3] = np.random.default_rng(0).normal(0, 0.005, (N, 3))
    estimate = replace(_estimate(every=1, spacing_m=0.5), T_w_c=np.tile(np.eye(4), (N, 1, 1)))
    estimate.T_w_c[:, 2, 3] = wander_m * np.arange(N) / N
    figures = compare(estimate, Truth(stamps(N), still))
    assert figures["truth_moves"] is False and figures["poses"] == N
    for key in ("ate_sim3_m", "ate_percent", "sim3_scale", "scale_std", "rpe_trans_percent"):
        assert figures[key] is None
    assert 0.005 < figures["ate_se3_m"] < 0.03
