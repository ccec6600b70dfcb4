import numpy as np
import pytest

from bench.kilometres.lenses import FISHEYE_HFOV_DEG, LENSES
from calm_edge.geometry.camera import Perspective


def hfov_deg(camera):
    sides = np.array([[-0.5, camera.cy], [camera.width - 0.5, camera.cy]])
    ray = camera.rays(sides)
    return float(np.degrees(np.arctan2(np.abs(ray[:, 0]), ray[:, 2]).sum()))


@pytest.mark.parametrize("hfov", [70.0, 95.0])
def test_a_barrel_lens_has_the_field_of_view_of_the_pinhole_camera(hfov):
    camera = Perspective.from_hfov(hfov, 1280, 400)
    lens = LENSES["barrel"](camera)
    assert lens.distortion[0] == -0.25 and hfov_deg(lens) == pytest.approx(hfov, abs=1e-6)
    assert np.isfinite(lens.rays(lens.pixel_grid(20, 10))).all()


def test_a_fisheye_lens_has_its_own():
    lens = LENSES["fisheye"](Perspective.from_hfov(80.0, 1280, 400))
    assert hfov_deg(lens) == pytest.approx(FISHEYE_HFOV_DEG, abs=1e-6)
