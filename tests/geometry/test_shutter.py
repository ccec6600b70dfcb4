import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.shutter import at_middle_row

TWIST = np.array([0.3, -0.2, 9.0, 0.1, 0.4, 0.05])
OPTICS = 500.0, 500.0, 319.5, 179.5, 640, 360


def rolling(camera, p_c, readout_s):
    """Pixels (M, 2) whose rows are exposed at their own instants."""
    uv = camera.project(p_c)
    for row, p in enumerate(p_c):
        for _ in range(8):
            after_s = readout_s * (uv[row, 1] / (camera.height - 1) - 0.5)
            uv[row] = camera.project(se3.transform(se3.inverse(se3.exp(TWIST * after_s)), p))
    return uv


@pytest.mark.parametrize(
    "camera", [Perspective(*OPTICS, (-0.2, 0.05)), Fisheye(*OPTICS, (0.01, 0.0))]
)
@pytest.mark.parametrize("readout_s", [0.03, -0.03])
def test_pixels_of_a_rolling_shutter_are_moved_to_those_of_a_global_one(camera, readout_s):
    rng = np.random.default_rng(0)
    p_c = np.c_[rng.uniform(-4, 4, 200), rng.uniform(-2, 2, 200), rng.uniform(8, 60, 200)]
    seen, expected = rolling(camera, p_c, readout_s), camera.project(p_c)
    moved = at_middle_row(camera, p_c, seen, TWIST, readout_s)
    before, after = (np.linalg.norm(uv - expected, axis=1) for uv in (seen, moved))
    assert before.max() > 2.0 and (after < 0.01 * before).all()


def test_a_camera_that_stands_or_a_global_shutter_moves_no_pixel():
    camera = Perspective(*OPTICS)
    p_c = np.array([[1.0, 2.0, 9.0], [0.5, 0.1, -3.0]])
    uv = np.array([[400.0, 20.0], [100.0, 300.0]])
    assert np.array_equal(at_middle_row(camera, p_c, uv, np.zeros(6), 0.03), uv)
    assert np.array_equal(at_middle_row(camera, p_c, uv, TWIST, 0.0), uv)


def test_pixels_of_points_behind_the_camera_stay():
    uv = np.array([[400.0, 20.0]])
    moved = at_middle_row(Perspective(*OPTICS), np.array([[1.0, 2.0, -9.0]]), uv, TWIST, 0.03)
    assert np.array_equal(moved, uv)
