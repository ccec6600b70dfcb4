import numpy as np

from calm_edge.geometry import se3
from calm_edge.trajectories import folded, tum_text
from calm_edge.types import Trajectory


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
