import cv2
import numpy as np
import pytest

from calm_edge.geometry.alike import look_alike


def road(shift_px=0.0, seed=0, step=0):
    """A picture of texture; the ground's moves by `shift_px` towards the bottom, the sky's not."""
    rng = np.random.default_rng(seed + step)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (180, 400)).astype(np.float32), (0, 0), 1.2)
    texture = 128 + 3 * (texture - texture.mean())
    x, y = np.meshgrid(np.arange(320.0), np.arange(180.0))
    moved = x + 20 + shift_px * np.maximum(y - 90, 0) / 90
    seen = cv2.remap(texture, moved.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    return np.clip(seen, 0, 255).astype(np.uint8)


def coded(picture, quality):
    return cv2.imdecode(
        cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR
    )


def noisy(picture, seed):
    noise = np.random.default_rng(seed).normal(0, 2, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("size", [(320, 180), (160, 90)])
@pytest.mark.parametrize("quality", [50, 95])
def test_a_copy_is_recognised_behind_coding_size_and_brightness(size, quality):
    primary = [road(step=k) for k in range(6)]
    copies = [coded(cv2.resize((0.8 * p + 10).astype(np.uint8), size), quality) for p in primary]
    assert look_alike(primary, copies)


def test_a_delayed_copy_is_recognised():
    primary = [road(step=k) for k in range(6)]
    assert look_alike(primary, [*primary[2:], road(step=8), road(step=9)])


@pytest.mark.parametrize("parallax_px", [12, 30])
def test_two_cameras_of_a_parked_car_are_not_alike(parallax_px):
    eyes = road(), road(parallax_px)
    primary, assistant = ([noisy(eye, k + 10 * e) for k in range(6)] for e, eye in enumerate(eyes))
    assert not look_alike(primary, assistant)


def test_two_cameras_that_point_apart_by_little_are_not_alike():
    turned = np.float32([[1, 0, 4], [0, 1, 0]])
    eyes = road(), cv2.warpAffine(road(), turned, (320, 180), borderMode=cv2.BORDER_REFLECT)
    primary, assistant = ([noisy(eye, k + 10 * e) for k in range(6)] for e, eye in enumerate(eyes))
    assert not look_alike(primary, assistant)


def test_nothing_is_said_of_dark_or_few_pictures():
    dark = [noisy(np.full((180, 320), 8, np.uint8), k) for k in range(6)]
    assert not look_alike(dark, dark)
    assert not look_alike([road()] * 2, [road()] * 2)
