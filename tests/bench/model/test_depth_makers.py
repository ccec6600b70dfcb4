import numpy as np
import pytest

from bench.model.depth_makers import MAKERS, SgbmDepth
from tests.bench.model.pictures import DISTANCE, camera, pose, texture, view


def seen(T_w_c, focals):
    made = [view(camera(f), T, texture()) for T, f in zip(T_w_c, focals, strict=True)]
    return [image for image, _ in made], [t.camera for _, t in made], made[0][1].z


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("side", [0.8, -0.8])
def test_a_plane_is_found_with_either_eye_to_the_right_turned_and_of_another_focal(name, side):
    T_w_c = np.stack([pose(), pose(z=0.4), pose(x=side, roll_deg=2.0), pose(side, 0.4, 2.0)])
    images, cameras, true_z = seen(T_w_c, (250.0, 250.0, 290.0, 290.0))
    z, confidence = MAKERS[name]().depth(images, cameras, T_w_c, np.array([0, 0, 1, 1]), 0)
    assert z.shape == confidence.shape
    known = z > 0
    assert known.mean() > 0.5
    assert np.median(np.abs(z[known] - DISTANCE) / DISTANCE) < 0.02
    assert (confidence[known] > 0).all() and not confidence[~known].any()
    assert true_z == pytest.approx(DISTANCE)


def test_semi_global_matching_knows_nothing_of_pictures_that_have_nothing_in_common():
    T_w_c = np.stack([pose(), pose(x=0.8)])
    a, _ = view(camera(), T_w_c[0], texture(0))
    b, _ = view(camera(), T_w_c[1], texture(1))
    z, _ = SgbmDepth().depth([a, b], [camera()] * 2, T_w_c, np.array([0, 1]), 0)
    assert (z > 0).mean() < 0.2
