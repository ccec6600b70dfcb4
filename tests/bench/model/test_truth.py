import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.model.truth import PosedDepth, transfer
from calm_edge.geometry import se3
from tests.bench.model.pictures import DISTANCE, camera, pose, texture, view


@settings(max_examples=5, deadline=None)
@given(st.floats(-1, 1), st.floats(-2, 2), st.floats(-20, 20))
def test_a_plane_s_points_go_where_they_are(x, z, roll_deg):
    plane = texture()
    _, a = view(camera(), pose(), plane)
    _, b = view(camera(300.0), pose(x, z, roll_deg), plane)
    uv = np.array([[150.3, 90.7], [170.0, 110.0]])
    there, seen = transfer(a, b, uv)
    assert seen.all()
    p_w = a.camera.back_project(uv, np.full(2, DISTANCE))
    expected = b.camera.project(se3.transform(se3.inverse(b.T_w_c), p_w))
    assert np.allclose(there, expected, atol=1e-3)


def test_sky_jumps_of_depth_and_what_is_hidden_have_no_truth():
    near = np.full((200, 320), 20.0, np.float32)
    near[:, 150:200] = 5.0  # a post
    near[:40] = 0.0  # sky
    far = np.full((200, 320), 20.0, np.float32)
    with_post, without = PosedDepth(camera(), pose(), near), PosedDepth(camera(), pose(x=0.1), far)
    uv = np.array([[100.0, 100.0], [150.2, 100.0], [100.0, 20.0], [175.0, 100.0]])
    # open, on the post's edge, sky, and the post that the other does not show
    assert transfer(with_post, without, uv)[1].tolist() == [True, False, False, False]
    # the wall behind the post
    assert transfer(without, with_post, np.array([[175.0, 100.0], [100.0, 100.0]]))[1].tolist() == [
        False,
        True,
    ]


def test_outside_and_behind_are_not_seen():
    z = np.full((200, 320), 20.0, np.float32)
    here = PosedDepth(camera(), pose(), z)
    uv = np.array([[160.0, 100.0]])
    assert not transfer(here, PosedDepth(camera(), pose(x=40.0), z), uv)[1].any()
    assert not transfer(here, PosedDepth(camera(), pose(z=30.0), z), uv)[1].any()
