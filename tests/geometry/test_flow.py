import cv2
import numpy as np

from calm_edge.geometry.flow import LucasKanade, away_from, corners, follow


def blobs(seed=0):
    noise = np.random.default_rng(seed).normal(size=(120, 200)).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX).astype(
        np.uint8
    )


def test_new_corners_keep_away_from_known_ones():
    first = corners(blobs(), 30)
    assert 15 < len(first) <= 30
    second = corners(blobs(), 200, taken=first)
    apart = np.linalg.norm(second[:, None] - first[None], axis=2).min()
    assert len(second) and apart >= 4.5
    assert len(corners(np.zeros((120, 200), np.uint8), 30)) == 0


def test_the_mask_is_zero_around_points_only():
    mask = away_from((120, 200), np.array([[50.0, 60.0]], np.float32), 7)
    assert mask[60, 50] == mask[60, 56] == 0
    assert mask[60, 60] == 255 and mask.shape == (120, 200)


def test_a_shift_is_tracked_and_points_in_the_margin_are_invalid():
    source = blobs()
    target = cv2.warpAffine(source, np.array([[1, 0, 6.25], [0, 1, -2.5]]), (200, 120))
    uv = corners(source, 60)
    moved, ok = follow(source, target, uv)
    error = np.linalg.norm(moved - uv - [6.25, -2.5], axis=1)
    assert ok.sum() > 15 and np.quantile(error[ok], 0.9) < 0.3
    _, far_from_border = follow(source, target, uv, how=LucasKanade(margin_px=30))
    inside = (moved >= 30).all(1) & (moved <= [169, 89]).all(1)
    assert far_from_border.any() and not (far_from_border & ~inside).any()


def test_the_guess_is_not_modified_and_points_of_other_images_are_invalid():
    uv = corners(blobs(), 60)
    guess = uv.copy()
    follow(blobs(), blobs(), uv, guess)
    assert np.array_equal(guess, uv)
    _, ok = follow(blobs(), blobs(seed=1), uv)
    assert ok.mean() < 0.2
    assert follow(blobs(), blobs(), uv[:0])[1].shape == (0,)
