import cv2
import numpy as np
import pytest

from bench.model.degrade import DEGRADATIONS, motion_blur, night
from tests.bench.model.pictures import texture


@pytest.mark.parametrize("name", DEGRADATIONS)
def test_repeatable_and_of_the_same_shape(name):
    image = cv2.cvtColor(texture()[:200, :320], cv2.COLOR_GRAY2BGR)
    worse = DEGRADATIONS[name](image, 3)
    assert worse.shape == image.shape and worse.dtype == np.uint8
    assert np.array_equal(worse, DEGRADATIONS[name](image, 3))
    assert not np.array_equal(worse, image)


def test_night_is_darker_and_noisier_than_gain_alone():
    flat = np.full((100, 100, 3), 100, np.uint8)
    dark = night(flat, 0)
    assert 40 < dark.mean() < 80
    assert dark.std() > 5


def test_motion_blur_keeps_brightness_and_spreads_a_point_along_a_line():
    point = np.zeros((101, 640, 3), np.uint8)
    point[50, 320] = 255
    smeared = motion_blur(point, 1)[..., 0].astype(float)
    assert smeared.sum() == pytest.approx(255, abs=15)
    y, x = np.nonzero(smeared)
    spread = np.linalg.svd(np.stack([x - x.mean(), y - y.mean()], 1), compute_uv=False)
    assert spread[0] > 3 * spread[1]
