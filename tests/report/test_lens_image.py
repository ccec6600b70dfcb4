"""Pictures of a lens: a bent grid as taken, a straight one after."""

from __future__ import annotations

import numpy as np
import pytest

from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.report.lens_image import LINE, WIDTH_PX, bend_px, grid, lens_image

PINHOLE = Perspective(500.0, 500.0, 319.5, 179.5, 640, 360)
BARREL = Perspective(500.0, 500.0, 319.5, 179.5, 640, 360, (-0.25, 0.05))
FISHEYE = Fisheye(280.0, 280.0, 319.5, 179.5, 640, 360, (0.01, -0.002))


def test_the_bend_is_that_of_the_corner() -> None:
    assert bend_px(PINHOLE) == 0.0
    corner = np.zeros(2)
    bent = np.linalg.norm(BARREL.undistorted(corner) - corner)
    assert bend_px(BARREL) == pytest.approx(bent)
    assert bend_px(FISHEYE) > 50


@pytest.mark.parametrize("camera", [PINHOLE, BARREL, FISHEYE])
def test_both_pictures_have_the_grid(camera: Camera) -> None:
    image = lens_image(np.full((720, 1280, 3), 90, np.uint8), camera)
    assert image.taken.shape == image.straight.shape == (270, WIDTH_PX, 3)
    for picture in (image.taken, image.straight):
        yellow = (np.abs(picture.astype(int) - LINE) < 60).all(-1)
        assert 0.01 < yellow.mean() < 0.3
    same = (image.taken == image.straight).mean()
    assert (same > 0.99) == (camera is PINHOLE)
    assert [name for name, _ in image.terms] == ([] if camera is PINHOLE else ["k1", "k2"])


def test_lines_of_the_grid_cover_the_picture() -> None:
    lines = grid(480, 270)
    assert lines.reshape(-1, 2).min() == 0 and lines[..., 0].max() == 479
    straight = np.ptp(lines, axis=1).min(-1)
    assert (straight == 0).all()
