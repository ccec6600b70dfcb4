from __future__ import annotations

import cv2
import numpy as np
import pytest

from calm_edge.loops.descriptor import GradientLayout
from tests.geometry.test_sift import blobs

LAYOUT = GradientLayout()


def picture(seed):
    """A colour image of soft spots, wider than a crop, for shifting sideways."""
    return cv2.cvtColor(blobs(seed, (400, 160)), cv2.COLOR_GRAY2BGR)


def cut(image, left=40):
    return np.ascontiguousarray(image[:, left : left + 320])


@pytest.fixture(scope="module")
def places():
    return np.stack([LAYOUT.describe(cut(picture(seed))) for seed in range(12)])


def test_a_descriptor_is_a_unit_vector(places):
    assert places.dtype == np.float32
    assert np.linalg.norm(places, axis=1) == pytest.approx(np.ones(12), abs=1e-5)
    blank = LAYOUT.describe(np.zeros((48, 64, 3), np.uint8))
    assert np.isfinite(blank).all() and np.linalg.norm(blank) == pytest.approx(1, abs=1e-5)


def test_exposure_and_noise_hardly_change_a_descriptor(places):
    rng = np.random.default_rng(0)
    for seed in range(12):
        dark = 0.6 * cut(picture(seed)) + 8 + 3 * rng.standard_normal((160, 320, 3))
        query = LAYOUT.describe(np.clip(dark, 0, 255).astype(np.uint8))
        score = LAYOUT.similarity(query[None], places)[0]
        assert score.argmax() == seed
        assert score[seed] > 0.8 > LAYOUT.min_similarity > np.delete(score, seed).max()


def test_a_place_shifted_sideways_is_still_similar(places):
    for seed in range(12):
        for left in (12, 72):  # two of the twenty columns
            query = LAYOUT.describe(cut(picture(seed), left))
            score = LAYOUT.similarity(query[None], places)[0]
            assert score.argmax() == seed and score[seed] > LAYOUT.min_similarity


def test_what_all_places_have_in_common_does_not_count():
    """A bonnet and a sky in all images must not make all places similar."""

    def with_frame(seed):
        image = cut(picture(seed)).copy()
        image[:30], image[110:] = cut(picture(99))[:30], cut(picture(99))[110:]
        return LAYOUT.describe(image)

    places = np.stack([with_frame(seed) for seed in range(12)])
    raw = places @ places.T
    score = LAYOUT.similarity(places, places)
    other = ~np.eye(12, dtype=bool)
    assert raw[other].min() > 0.5
    assert score[other].max() < LAYOUT.min_similarity


def test_similarity_has_one_row_per_query(places):
    score = LAYOUT.similarity(places[:3], places)
    assert score.shape == (3, 12) and score.dtype == np.float32
    assert np.array_equal(score.argmax(1), [0, 1, 2])
    assert LAYOUT.similarity(places[:1], places[:1]).shape == (1, 1)
