import cv2
import numpy as np

from calm_edge.correction.matches import StoredMatches, from_landmarks, from_sift, undistorted
from calm_edge.geometry.camera import Perspective
from calm_edge.types import Landmarks


def landmarks():
    return Landmarks(
        points_s=np.zeros((4, 3)),
        index=np.array([3, 0, 1, 1, 3, 2, 0]),
        view=np.array([0, 0, 0, 2, 2, 2, 1]),
        uv=np.arange(14, dtype=np.float32).reshape(7, 2),
    )


def picture(seed=0, size=(200, 320)):
    noise = np.random.default_rng(seed).normal(size=size).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 3)
    gray = cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    return cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)


def test_landmarks_match_if_observed_in_both_views():
    uv_a, uv_b = from_landmarks(landmarks()).pair(0, 2)
    assert uv_a.tolist() == [[4, 5], [0, 1]] and uv_b.tolist() == [[6, 7], [8, 9]]
    swapped = from_landmarks(landmarks()).pair(2, 0)
    assert swapped[0].tolist() == uv_b.tolist() and swapped[1].tolist() == uv_a.tolist()


def test_views_without_common_landmarks_have_no_matches():
    for matches in (from_landmarks(landmarks()), from_landmarks(landmarks(), [0, 2])):
        uv_a, uv_b = matches.pair(1, 2)
        assert uv_a.shape == uv_b.shape == (0, 2)


def test_sift_matches_a_shift_within_a_tenth_of_a_pixel():
    image = picture()
    moved = cv2.warpAffine(
        image, np.array([[1, 0, 6.25], [0, 1, -3.5]]), (320, 200), flags=cv2.INTER_CUBIC
    )
    matches = from_sift([image, moved], [4, 9], 300)
    uv_a, uv_b = matches.pair(4, 9)
    assert len(uv_a) > 60
    error = np.linalg.norm(uv_b - uv_a - [6.25, -3.5], axis=1)
    assert np.median(error) < 0.1 and (error < 1).mean() > 0.95


def test_sift_positions_are_unbiased():
    """Without enable_precise_upscale they would be off by a quarter of a pixel."""
    y, x = np.mgrid[:120, :160]
    blob = np.exp(-((x - 70.3) ** 2 + (y - 51.8) ** 2) / (2 * 5.0**2))
    image = cv2.cvtColor((255 * blob).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    uv = from_sift([image], [0], 20).features[0].uv
    assert np.linalg.norm(uv - [70.3, 51.8], axis=1).min() < 0.1


def test_the_number_of_features_is_bounded_and_a_blank_image_has_none():
    blank = np.zeros((100, 100, 3), np.uint8)
    matches = from_sift([picture(), blank], [0, 1], 25)
    assert 10 < len(matches.features[0].uv) <= 25 and len(matches.features[1].uv) == 0
    assert matches.pair(0, 1)[0].shape == (0, 2)


def test_different_images_have_almost_no_matches():
    matches = from_sift([picture(1), picture(2)], [0, 1], 300)
    assert len(matches.pair(0, 1)[0]) < 10


def test_no_feature_is_matched_twice():
    matches = from_sift([picture(), np.roll(picture(), 4, 1)], [0, 1], 200)
    uv_a, uv_b = matches.pair(0, 1)
    assert len(uv_a) > 50
    assert len(np.unique(uv_a, axis=0)) == len(np.unique(uv_b, axis=0)) == len(uv_a)


def test_matches_are_undistorted_and_those_beyond_the_lens_left_out():
    lens = Perspective(100.0, 100.0, 50.0, 50.0, 400, 400, (-0.3,))
    uv = np.array([[60.0, 55.0], [100.0, 40.0], [350.0, 50.0]])
    pair = StoredMatches({(0, 2): (uv, uv[:, ::-1])}).pair(0, 2)
    a, b = undistorted(lens, *pair)
    assert len(a) == len(b) == 2
    assert np.allclose(a, lens.undistorted(uv[:2])) and np.abs(a[1] - uv[1]).max() > 3
    assert np.array_equal(undistorted(lens.pinhole, *pair)[0], uv)
