"""Calibration given to a rival: the true one, or wrong by exactly the given amount."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.rivals.calibration import nearest_pairs, true_calibration
from calm_edge.evaluation import EvaluationError
from calm_edge.geometry import se3
from calm_edge.trajectories import write_kitti
from tests.evaluation.worlds import curve

RIG = se3.exp(np.array([0.6, 0.02, -0.05, 0.02, -0.07, 0.01]))
N, LATE_S = 60, 0.03


def write(folder: Path, with_assistant: bool = True) -> Path:
    T = curve(N)
    seconds = np.arange(N) / 10
    for eye, late in ((0, 0.0), (1, LATE_S)):
        (folder / f"cam{eye}").mkdir(parents=True)
        for k in range(N):
            cv2.imwrite(str(folder / f"cam{eye}" / f"{k:06d}.png"), np.zeros((4, 6), np.uint8))
        np.savetxt(folder / f"times{eye}.txt", seconds + late, fmt="%.9f")
    write_kitti(folder / "poses0.txt", T)
    if with_assistant:
        write_kitti(folder / "poses1.txt", se3.interpolate_at(seconds, T, seconds + LATE_S) @ RIG)
    (folder / "calib.txt").write_text("50 51 3 2 6 4\n60 61 3 2 6 4\n")
    return folder


def test_the_rig_is_found_though_the_eyes_are_never_at_one_instant(tmp_path: Path) -> None:
    found = true_calibration(write(tmp_path / "d"))
    np.testing.assert_allclose(found.T_p_a, RIG, atol=1e-6)
    assert found.size == (6, 4)
    assert found.cameras[1].fx == 60 and found.cameras[1].fy == 61


def test_without_the_assistants_poses_the_pictures_are_rectified(tmp_path: Path) -> None:
    folder = write(tmp_path / "d", with_assistant=False)
    expected = np.eye(4)
    expected[0, 3] = 0.54
    np.testing.assert_array_equal(true_calibration(folder, 0.54).T_p_a, expected)
    with pytest.raises(EvaluationError, match="rig is unknown"):
        true_calibration(folder)
    (folder / "calib.txt").unlink()
    with pytest.raises(EvaluationError, match=r"calib\.txt"):
        true_calibration(folder, 0.54)


def test_each_dial_turns_one_thing(tmp_path: Path) -> None:
    truth = true_calibration(write(tmp_path / "d"))
    focal = truth.with_focal(1.02)
    for longer, true in zip(focal.cameras, truth.cameras, strict=True):
        assert (longer.fx / true.fx, longer.fy / true.fy) == pytest.approx((1.02, 1.02))
        assert (longer.cx, longer.cy) == (true.cx, true.cy)
    np.testing.assert_array_equal(focal.T_p_a, truth.T_p_a)
    yaw = truth.with_yaw(0.5)
    assert yaw.cameras == truth.cameras
    turned = se3.log(se3.inverse(truth.T_p_a) @ yaw.T_p_a)
    np.testing.assert_allclose(np.degrees(turned), [0, 0, 0, 0, 0.5, 0], atol=1e-9)


def test_a_partner_is_the_nearest_in_time() -> None:
    t = np.arange(5, dtype=np.int64) * 100
    np.testing.assert_array_equal(nearest_pairs(t, t + 30), [[i, i] for i in range(5)])
    np.testing.assert_array_equal(
        nearest_pairs(t, t - 70), [[0, 1], [1, 2], [2, 3], [3, 4], [4, 4]]
    )
    np.testing.assert_array_equal(nearest_pairs(t, t, shift=1), [[i, i + 1] for i in range(4)])
    np.testing.assert_array_equal(nearest_pairs(t, t[:1]), [[i, 0] for i in range(5)])
