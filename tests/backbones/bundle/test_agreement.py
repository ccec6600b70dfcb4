import numpy as np

from calm_edge.backbones.bundle.agreement import DepthView, agree
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective

W, H, DEPTH = 60, 40, 10.0
CAMERA = Perspective(50.0, 50.0, (W - 1) / 2, (H - 1) / 2, W, H)


def wall(x=0.0, z=0.0, error=1.0):
    """A view of a wall at z = DEPTH of the first, from (x, 0, z), its depth off by `error`."""
    T_s_c = se3.compose(np.eye(3), np.array([x, 0.0, z]))
    zeta = np.full((H, W), 1 / ((DEPTH - z) * error), np.float32)
    return DepthView(zeta, CAMERA, T_s_c)


def test_right_views_of_a_wall_agree_where_they_overlap():
    found = agree(wall(), [wall(x=1.0), wall(z=2.0), wall(x=-1.0, z=-2.0)], 0.01, 0.0)
    middle = found.votes[10:30, 15:45]
    assert (middle == 3).all()
    assert np.abs(found.zeta - 1 / DEPTH).max() < 1e-5
    assert found.spread.max() < 1e-5
    # one pixel of depth ten is five columns over: the left edge is not in the view from the right
    assert (found.votes[:, 0] < 3).all()


def test_an_outlier_view_gets_no_vote_and_an_inlier_is_averaged():
    found = agree(wall(), [wall(x=1.0, error=1.2), wall(x=-1.0, error=1.02)], 0.05, 0.0)
    middle = (slice(10, 30), slice(15, 45))
    assert (found.votes[middle] == 1).all()
    assert np.allclose(found.zeta[middle], (0.1 + 0.1 / 1.02) / 2, rtol=1e-4)
    assert np.allclose(found.spread[middle], 0.1 - 0.1 / 1.02, rtol=1e-2)


def test_without_other_views_there_are_no_votes():
    found = agree(wall(), [], 0.05, 0.0)
    assert not found.votes.any() and not found.spread.any()
    assert np.array_equal(found.zeta, wall().zeta)
