from pathlib import Path

import numpy as np
import pytest

from calm_edge import trajectories
from calm_edge.geometry import se3
from calm_edge.trajectories import folded, tum_text
from calm_edge.types import Trajectory
from tests.evaluation.worlds import curve


def piece(ids, z, epoch):
    T = se3.exp(np.array([[0, 0, value, 0, 0, 0.0] for value in z]))
    return Trajectory(np.array(ids), np.array(ids) * 10, T, np.eye(4), epoch)


def test_nothing_said_is_no_trajectory():
    assert folded([]) is None


def test_the_later_pose_of_a_keyframe_holds():
    whole = folded([piece([0, 1, 2], [0, 1, 2], 0), piece([2, 3], [2.5, 3.5], 0)])
    assert whole.keyframe_ids.tolist() == [0, 1, 2, 3]
    assert whole.t_ns.tolist() == [0, 10, 20, 30]
    assert whole.T_w_c[:, 2, 3].tolist() == [0, 1, 2.5, 3.5]


def test_a_whole_trajectory_replaces_all_before_it():
    whole = folded([piece([0, 1], [0, 1], 0), piece([0, 1, 2], [5, 6, 7], 1)])
    assert whole.T_w_c[:, 2, 3].tolist() == [5, 6, 7]
    assert whole.epoch == 1


def test_tum_row_is_the_fields_convention():
    T = se3.compose(se3.so3_exp(np.array([0, 0, np.pi / 2])), np.array([1.0, -0.0, 3]))[None]
    text = tum_text(np.array([1_000_000_005]), T)
    half = f"{np.sqrt(0.5):.9f}"
    assert text == (
        f"1.000000005 1.000000000 0.000000000 3.000000000 0.000000000 0.000000000 {half} {half}\n"
    )


def test_tum_keeps_poses_and_nanoseconds(tmp_path: Path) -> None:
    T = curve(20)
    T[7, :3, :3] = se3.so3_exp(np.array([np.pi, 0, 0]))
    t_ns = 1_763_000_000_123_456_789 + np.arange(20, dtype=np.int64) * 100_000_001
    trajectories.write_tum(tmp_path / "t.tum", t_ns, T)
    got_t, got = trajectories.read_tum(tmp_path / "t.tum")
    assert np.array_equal(got_t, t_ns)
    assert np.allclose(got, T, atol=3e-9)


def test_tum_of_others_is_sorted_normalised_and_may_have_comments(tmp_path: Path) -> None:
    file = tmp_path / "t.tum"
    file.write_text("# t x y z q\n2.5 1 2 3 0 0 0 2\n\n1e0,4,5,6,0,0,0,-1\n")
    t_ns, T = trajectories.read_tum(file)
    assert t_ns.tolist() == [1_000_000_000, 2_500_000_000]
    assert np.allclose(T[:, :3, :3], np.eye(3))
    assert T[:, :3, 3].tolist() == [[4, 5, 6], [1, 2, 3]]


def test_tum_keeps_stamps_before_zero(tmp_path: Path) -> None:
    t_ns = np.array([-1_500_000_001, -1, 0, 1_500_000_000])
    trajectories.write_tum(tmp_path / "t.tum", t_ns, curve(4))
    text = (tmp_path / "t.tum").read_text()
    assert text.startswith("-1.500000001 ") and "\n-0.000000001 " in text
    assert trajectories.read_tum(tmp_path / "t.tum")[0].tolist() == t_ns.tolist()


def test_kitti_keeps_poses(tmp_path: Path) -> None:
    trajectories.write_kitti(tmp_path / "p.txt", curve(9))
    assert np.allclose(trajectories.read_kitti(tmp_path / "p.txt"), curve(9), atol=1e-8)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1 2 3\n", ":1: 3 columns"),
        ("1 0 0 0 0 0 0 1\nx 0 0 0 0 0 0 1\n", ":2: not a row"),
        ("1 0 0 nan 0 0 0 1\n", ":1: contains inf or nan"),
        ("1 0 0 0 0 0 0 0\n", ":1: the quaternion is zero"),
        ("# nothing\n", "contains no poses"),
    ],
)
def test_bad_tum_ends_in_one_line(tmp_path: Path, text: str, says: str) -> None:
    file = tmp_path / "t.tum"
    file.write_text(text)
    with pytest.raises(trajectories.TrajectoryError) as error:
        trajectories.read_tum(file)
    assert f"{file}" in str(error.value) and says in str(error.value)


def test_a_binary_or_missing_file_ends_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "b").write_bytes(b"\xff\xfe\x00\x01")
    for name in ("b", "missing"):
        with pytest.raises(trajectories.TrajectoryError, match="cannot be read"):
            trajectories.read_tum(tmp_path / name)
