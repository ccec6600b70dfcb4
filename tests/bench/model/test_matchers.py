import numpy as np
import pytest

from bench.model import described
from bench.model.matchers import BASELINES, KltMatcher, SiftMatcher, around
from bench.model.truth import transfer
from tests.bench.model.pictures import SIZE, camera, pose, texture, view


def errors(name, T_b, focal_b=250.0, kind="corner"):
    plane = texture()
    image_a, a = view(camera(), pose(), plane)
    image_b, b = view(camera(focal_b), T_b, plane)
    gray = described.gray_of(image_a)
    if kind == "corner":
        uv = described.corners(gray, 200).astype(float)
    else:
        uv = np.unique([p.pt for p in described.keypoints(gray, 300)], axis=0)
    true_uv, seen = transfer(a, b, uv)
    assert seen.sum() > 20
    found = BASELINES[name]().match(image_a, image_b, uv[seen])
    off = np.linalg.norm(found.uv_b - true_uv[seen], axis=1)
    return np.where(found.found, off, np.inf)


@pytest.mark.parametrize("name", BASELINES)
def test_a_small_shift_is_found_by_every_matcher(name):
    assert (errors(name, pose(x=0.2)) < 1).mean() > 0.8


@pytest.mark.parametrize("kind", ["SIFT", "corner"])
@pytest.mark.parametrize(("roll_deg", "focal"), [(40.0, 250.0), (0.0, 500.0), (20.0, 500.0)])
def test_sift_finds_keypoints_and_corners_turned_and_enlarged(roll_deg, focal, kind):
    # at a corner the scale is a guess out of three
    least = 0.6 if kind == "SIFT" else 0.3
    assert (errors("SIFT", pose(roll_deg=roll_deg), focal, kind) < 3).mean() > least


def test_only_the_warp_lets_lucas_kanade_follow_a_roll_with_zoom():
    turned = pose(roll_deg=20.0), 400.0
    assert (errors("KLT warped", *turned) < 1).mean() > 0.45
    assert (errors("KLT", *turned) < 1).mean() < 0.3


def test_another_picture_is_refused_by_the_ratio_and_the_backward_check():
    a, _ = view(camera(), pose(), texture(0))
    b, _ = view(camera(), pose(), texture(1))
    uv = described.corners(described.gray_of(a), 100).astype(float)
    for matcher in (SiftMatcher(), KltMatcher()):
        assert matcher.match(a, b, uv).found.mean() < 0.15


def test_an_empty_picture_and_no_queries_give_no_matches():
    blank = np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)
    for make in BASELINES.values():
        assert not make().match(blank, blank, np.array([[50.0, 60.0]])).found.any()
        assert len(make().match(blank, blank, np.zeros((0, 2))).found) == 0


def test_neighbours_flow_is_the_median_of_what_is_known():
    uv = np.array([[0, 0], [1, 0], [2, 0], [50, 0]], np.float32)
    flow = np.array([[1, 0], [2, 0], [30, 0], [9, 9]], np.float32)
    guess = around(uv, flow, np.array([True, True, True, False]))
    assert np.allclose(guess, [2, 0])
    assert np.allclose(around(uv, flow, np.zeros(4, bool)), 0)
