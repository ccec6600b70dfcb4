"""Refinement of matches on pictures of the demo drive, moved by a known amount."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calm_edge.backbones.bundle import refine, tracks
from calm_edge.backbones.bundle.matching import Matches
from tests.backbones.bundle.demo_pictures import picture, seen, similarity, through

NONE = np.zeros((0, 2), np.float32)


@pytest.fixture(scope="module")
def gray():
    return cv2.cvtColor(picture(20), cv2.COLOR_BGR2GRAY)


def test_a_guess_is_refined_and_a_wrong_one_dropped(gray):
    H = similarity(gray, 1.0, 0.0, (7.3, -2.6))
    uv = tracks.detect_corners(gray, NONE)
    truth = through(H, uv).astype(np.float32)
    off = np.random.default_rng(0).normal(0, 1.5, truth.shape).astype(np.float32)
    wrong = np.arange(len(uv)) % 10 == 0
    off[wrong] += 60
    guess = Matches(
        truth + off,
        np.ones(len(uv), bool),
        np.full(len(uv), 2.0, np.float32),
        np.zeros(len(uv), bool),
    )
    found = refine.refined(gray, seen(gray, H), uv, guess)
    error = np.linalg.norm(found.uv - truth, axis=1)
    assert np.median(error[found.sure & ~wrong]) < 0.15
    assert found.sure[~wrong].mean() > 0.7 and found.sure[wrong].mean() < 0.2
    information = (1 / found.sigma_px[found.measured] ** 2).mean()
    assert information == pytest.approx(1 / tracks.FOLLOWED_PX**2, rel=0.1)


def test_a_larger_window_is_more_exact_where_all_of_it_moves_alike(gray):
    rng = np.random.default_rng(1)
    noisy = [
        np.clip(gray + rng.normal(0, 12, gray.shape), 0, 255).astype(np.uint8) for _ in range(2)
    ]
    uv = tracks.detect_corners(gray, NONE)
    guess = Matches(
        uv + 1.0, np.ones(len(uv), bool), np.full(len(uv), 2.0, np.float32), np.zeros(len(uv), bool)
    )
    errors = []
    for side in (9, 31):
        how = replace(refine.FROM_FEATURES, window_px=side)
        found = refine.refined(noisy[0], noisy[1], uv, guess, how)
        errors.append(np.median(np.linalg.norm(found.uv - uv, axis=1)[found.measured]))
    assert errors[1] < 0.6 * errors[0]
