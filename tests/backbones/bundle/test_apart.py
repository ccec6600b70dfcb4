from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.bundle.apart import solved_apart
from calm_edge.geometry import se3
from calm_edge.kit import layout
from tests.backbones.bundle.exact_window import theta_of, turn, window

AHEAD = np.array([0.0, 0.0, 1.0])

N = 12
PRIOR = layout.prior((None, None))


def made(delay_s=0.0, noise_px=0.3, outliers=0.05):
    """The true focals differ from the prior's by 8 and 18 %."""
    return window(
        turn(N), theta_of((78.0, 64.0)), n_points=400, noise_px=noise_px, outliers=outliers,
        delay_s=delay_s,
    )  # fmt: skip


def rotations_off_deg(T_s_c, truth):
    """Error of the rotation from the primary to the assistant taken at the same time."""
    R, R_true = (T[:, :3, :3] for T in (T_s_c, se3.inverse(truth.T_c_s)))
    between = [np.swapaxes(r[:N], 1, 2) @ r[N:] for r in (R, R_true)]
    off = np.swapaxes(between[1], 1, 2) @ between[0]
    return np.degrees(np.linalg.norm(se3.so3_log(off), axis=1))


@pytest.mark.parametrize("delay_s", [0.0, -0.4, 0.4])
def test_the_assistant_is_placed_where_its_pictures_show_it(delay_s):
    drive = made(delay_s)
    T = solved_apart(drive.m, AHEAD, PRIOR)
    placed = np.isfinite(T[N:, 0, 0])
    assert placed.sum() >= N - 3
    off = rotations_off_deg(T, drive.truth)
    # the rig's turn may be off by a constant, as long as the focals are unknown
    assert np.nanmedian(off) < 1.0 and np.nanstd(off) < 0.4


def test_the_stamps_of_the_assistant_have_no_influence():
    m = made().m
    late = replace(m, t=m.t + np.where(m.eye == 1, 0.4, 0.0))
    T, T_late = (solved_apart(each, AHEAD, PRIOR) for each in (m, late))
    assert np.array_equal(T, T_late, equal_nan=True)


def test_an_assistant_without_matches_has_no_pose():
    m = made().m
    rows = m.view < N + 2
    few = replace(
        m, view=m.view[rows], point=m.point[rows], uv=m.uv[rows], sigma_px=m.sigma_px[rows]
    )
    T = solved_apart(few, AHEAD, PRIOR)
    assert np.isfinite(T[: N + 2]).all() and np.isnan(T[N + 2 :, :3]).all()
    rows = m.view < N
    none = replace(
        m, view=m.view[rows], point=m.point[rows], uv=m.uv[rows], sigma_px=m.sigma_px[rows]
    )
    assert solved_apart(none, AHEAD, PRIOR) is None
