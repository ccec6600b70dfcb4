"""Learned matching on pictures of the demo drive, turned and zoomed by known amounts."""

import cv2
import numpy as np
import pytest

from calm_edge.backbones.bundle import learned, refine, tracks
from calm_edge.backbones.bundle.backbone import BundleBackbone
from calm_edge.config import BackboneConfig
from tests.backbones.bundle.demo_pictures import picture, seen, similarity, through

NONE = np.zeros((0, 2), np.float32)


@pytest.fixture(scope="module")
def matching():
    return learned.matcher()


@pytest.fixture(scope="module")
def gray():
    return cv2.cvtColor(picture(20), cv2.COLOR_BGR2GRAY)


def judged(found, truth, gray):
    """Share of the points inside that are found within a pixel; share of the found within three."""
    inside = ((truth > 8) & (truth < np.array(gray.shape[::-1]) - 9)).all(1)
    error = np.where(found.sure, np.linalg.norm(found.uv - truth, axis=1), np.inf)
    return (error[inside] < 1).mean(), (error[found.sure & inside] < 3).mean()


def test_a_shift_beyond_the_pyramid_is_found(matching, gray):
    H = similarity(gray, 1.0, 0.0, (90.0, 12.0))
    uv = tracks.detect_corners(gray, NONE)
    right, of_found = judged(matching.along(gray, seen(gray, H), uv), through(H, uv), gray)
    assert right > 0.6 and of_found > 0.95


@pytest.mark.parametrize(
    ("zoom", "turn"), [(1.0, 12.0), (1.5, 0.0), (0.6, -8.0), (2.0, 20.0), (0.5, -20.0)]
)
def test_rotated_and_zoomed_pictures_are_matched(matching, gray, zoom, turn):
    H = similarity(gray, zoom, turn)
    uv = tracks.detect_corners(gray, NONE)
    right, of_found = judged(matching.match(gray, seen(gray, H), uv), through(H, uv), gray)
    assert right > 0.5 and of_found > 0.9


def test_the_homography_between_the_eyes_is_found(matching, gray):
    H = similarity(gray, 1.3, 6.0)
    rough = matching.homography(gray, seen(gray, H))
    corners = np.array([[100.0, 60.0], [400.0, 60.0], [100.0, 200.0], [400.0, 200.0]])
    apart = np.linalg.norm(through(rough, corners) - through(H, corners), axis=1)
    assert apart.max() < 12


def test_nothing_to_match_gives_nothing(matching, gray):
    flat = np.full_like(gray, 120)
    uv = tracks.detect_corners(gray, NONE)
    assert matching.homography(gray, flat) is None
    assert matching.match(gray, flat, uv).sure.mean() < 0.1


def test_sigma_grows_with_the_error(matching, gray):
    """Over half of the picture something else is in front, as fine as leaves: what is behind moves
    otherwise, and corners on the border between the two are measured wrongly."""
    rng = np.random.default_rng(0)
    H = similarity(gray, 1.0, 0.0, (6.4, -2.3))
    after = seen(gray, H).astype(np.float64)
    leaves = cv2.GaussianBlur(rng.random(gray.shape), (0, 0), 2.0) > 0.52
    leaves[:, : gray.shape[1] // 2] = False
    dull = np.float64(gray).mean()
    here, there = np.where(leaves, dull, gray), np.where(np.roll(leaves, 3, 1), dull, after)
    a, b = (np.clip(p + rng.normal(0, 2, p.shape), 0, 255).astype(np.uint8) for p in (here, there))
    uv = tracks.detect_corners(a, NONE)
    found = matching.along(a, b, uv)
    error = np.linalg.norm(found.uv - through(H, uv), axis=1)[found.sure]
    sigma = found.sigma_px[found.sure]
    assert sigma.min() >= refine.SIGMA_RANGE_PX[0] and sigma.max() <= refine.SIGMA_RANGE_PX[1]
    assert found.sure.sum() > 60
    surest = sigma <= np.quantile(sigma, 0.5)
    assert np.median(error[surest]) < 0.5 * np.median(error[~surest])


def test_a_network_tracks_a_window_as_lucas_kanade_does(matching):
    primary, assistant = (
        [cv2.cvtColor(picture(k, eye), cv2.COLOR_BGR2GRAY) for k in (20, 22, 24)] for eye in (0, 1)
    )
    found = tracks.window_tracks(primary, assistant, [0, 1, 2], None, matching)
    bare = tracks.window_tracks(primary, assistant, [0, 1, 2], None)
    assert set(found.view) == set(range(6))
    assert len(found.uv) == len(found.track) == len(found.sigma_px) > 0.9 * len(bare.uv)
    assert (found.sigma_px > 0).all() and np.isfinite(found.uv).all()


def test_an_expected_picture_is_encoded_before_its_window(matching, monkeypatch):
    encoded = []
    own = matching.net._encoded
    monkeypatch.setattr(matching.net, "_encoded", lambda gray: encoded.append(gray) or own(gray))
    backbone = BundleBackbone(BackboneConfig(), matching)
    image = picture(7)
    backbone.expect(image)
    matching.net.of([image])
    assert len(encoded) == 1
    BundleBackbone(BackboneConfig()).expect(image)


@pytest.mark.parametrize(("gain", "offset"), [(0.4, 0.0), (0.25, 0.0), (0.6, 40.0), (0.8, 0.0)])
def test_both_witnesses_of_a_match_are_blind_to_brightness(matching, gray, gain, offset):
    """As the assistant's exposure differs, or changes within a window."""
    other = cv2.cvtColor(picture(20, 1), cv2.COLOR_BGR2GRAY)
    uv = tracks.detect_corners(gray, NONE)
    dark = np.clip(np.rint(gain * other + offset), 0, 255).astype(np.uint8)
    H = matching.homography(gray, other)
    H_dark = matching.homography(gray, dark)
    assert H is not None and H_dark is not None
    plain, found = matching.across(gray, other, H, uv), matching.across(gray, dark, H, uv)
    both = plain.sure & found.sure
    assert both.sum() > 0.9 * plain.sure.sum() > 50
    apart = np.linalg.norm(found.uv - plain.uv, axis=1)[both]
    assert np.median(apart) < 0.05 and np.quantile(apart, 0.9) < 0.2
    ratio = found.sigma_px[both] / plain.sigma_px[both]
    assert 0.8 < np.median(ratio) < 1.25
