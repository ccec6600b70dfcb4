import cv2
import numpy as np
import pytest

from calm_edge.backbones.bundle.first_sight import FirstSights
from calm_edge.backbones.bundle.tracks import detect_corners, temporal_tracks

WIDTH, HEIGHT = 320, 200


@pytest.fixture(scope="module")
def texture():
    rng = np.random.default_rng(3)
    rough = rng.uniform(0, 255, (HEIGHT, WIDTH)).astype(np.float32)
    blurred = cv2.GaussianBlur(rough, (0, 0), 2.0)
    return cv2.normalize(blurred, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def warped(texture, H, *, gain=1.0, offset=0.0, noise=0.0, seed=0):
    seen = cv2.warpPerspective(
        texture, H, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )
    rng = np.random.default_rng(seed)
    return np.clip(gain * seen + offset + rng.normal(0, noise, seen.shape), 0, 255).astype(np.uint8)


def zoomed(factor, degrees=0.0):
    about = cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), degrees, factor)
    return np.vstack([about, [0, 0, 1]])


def moved(uv, H):
    return cv2.perspectiveTransform(uv[:, None].astype(np.float64), H)[:, 0].astype(np.float32)


def inner(uv, H):
    there = moved(uv, H)
    return uv[((there > 20) & (there < [WIDTH - 20, HEIGHT - 20])).all(1) & ((uv > 20).all(1))]


def test_an_error_of_the_track_is_corrected_under_zoom_turn_gain_and_noise(texture):
    H = zoomed(1.12, 3.0)
    uv = inner(detect_corners(texture, np.zeros((0, 2), np.float32)), H)
    sights = FirstSights()
    sights.add(texture, uv)
    true = moved(uv, H)
    off = np.random.default_rng(1).uniform(-1, 1, true.shape).astype(np.float32)
    picture = warped(texture, H, gain=0.7, offset=20.0, noise=2.0)
    found, ok = sights.corrected(picture, true + off)
    error = np.linalg.norm(found - true, axis=1)[ok]
    assert ok.mean() > 0.9
    assert np.median(error) < 0.1 and np.percentile(error, 90) < 0.3


def test_the_warp_follows_a_zoom_step_by_step(texture):
    uv = inner(detect_corners(texture, np.zeros((0, 2), np.float32)), zoomed(1.8))
    sights = FirstSights()
    sights.add(texture, uv)
    factors = 1.08 ** np.arange(1, 8)
    for factor in factors:
        H = zoomed(factor)
        found, ok = sights.corrected(warped(texture, H), moved(uv, H) + np.float32(0.5))
    assert ok.mean() > 0.8
    assert np.median(np.linalg.norm(found - moved(uv, H), axis=1)[ok]) < 0.1


def test_another_patch_is_not_registered_and_keeps_its_place(texture):
    uv = detect_corners(texture, np.zeros((0, 2), np.float32))
    uv = uv[((uv > 30) & (uv < [WIDTH - 30, HEIGHT - 30])).all(1)]
    sights = FirstSights()
    sights.add(texture, uv)
    other = warped(texture, np.array([[1, 0, 11.0], [0, 1, 7.0], [0, 0, 1]]))
    found, ok = sights.corrected(other, uv)
    assert ok.mean() < 0.1
    assert np.array_equal(found[~ok], uv[~ok])


def test_uniform_patches_and_none_are_no_error(texture):
    sights = FirstSights()
    flat = np.full((HEIGHT, WIDTH), 90, np.uint8)
    at = np.array([[100, 100], [200, 50]], np.float32)
    sights.add(flat, at)
    found, ok = sights.corrected(flat, at)
    assert not ok.any() and np.array_equal(found, at)
    sights.keep(np.zeros(0, np.int64))
    sights.add(flat, np.zeros((0, 2), np.float32))
    found, ok = sights.corrected(texture, np.zeros((0, 2), np.float32))
    assert len(found) == len(ok) == 0


def test_long_tracks_stay_on_their_point(texture):
    # a slow zoom with noise: the errors of single steps add up without the first sight
    steps = [zoomed(1.04**k, 0.4 * k) for k in range(12)]
    pictures = [warped(texture, H, noise=4.0, seed=k) for k, H in enumerate(steps)]
    seen = list(temporal_tracks(pictures))
    first, start, _ = seen[0]
    last, end, _ = seen[-1]
    common, i, j = np.intersect1d(first, last, return_indices=True)
    assert len(common) > 30
    error = np.linalg.norm(end[j] - moved(start[i], steps[-1]), axis=1)
    assert np.median(error) < 0.2 and np.percentile(error, 90) < 0.5
