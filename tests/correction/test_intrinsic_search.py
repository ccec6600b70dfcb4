from dataclasses import replace

import numpy as np
import pytest

from bench.scripted.motions import CAMERA, group, motion, seen
from calm_edge.config import CorrectionConfig
from calm_edge.correction.eye_search import MAX_CANDIDATES
from calm_edge.correction.intrinsic_search import IntrinsicSearch, views_of
from calm_edge.correction.pool import BIAS_LOG_SIGMA
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.through_lens import ThroughLens
from device.frame import Eye
from tests.correction.submaps import both_eyes, submap

CONFIG = CorrectionConfig(group_every=2, n_group=2)
N = 8
GUESSES = 700 * np.exp(0.08 * np.random.default_rng(0).normal(size=(12, 2)) + 0.05)


def drive(config, kind, count=6, focals=GUESSES):
    """The search after some sub-maps of one motion, and the results of `add`."""
    search, answers = IntrinsicSearch(config), []
    for k in range(count):
        name = kind if k % 4 < 2 else f"-{kind}"
        T = motion(name, N)
        landmarks = both_eyes(seen(T, 2 * k, points=900), seen(T, 2 * k + 1, points=900), N)
        answers.append(search.add(submap(k, tuple(focals[k]), N), landmarks, None))
    return search, answers


@pytest.fixture(scope="module")
def turning():
    return drive(CONFIG, "general", 8)


def test_views_of_a_camera_do_not_contain_the_loop_keyframe():
    one = submap(3, (700.0, 800.0), 4)
    assert views_of(one, Eye.PRIMARY) == ([0, 1, 2, 3], [12, 13, 14, 15])
    assert views_of(one, Eye.ASSISTANT) == ([4, 5, 6, 7], [12, 13, 14, 15])


def test_the_estimate_is_none_before_a_sub_map_and_then_the_first_guess():
    search = IntrinsicSearch(CONFIG)
    assert search.intrinsics is None
    assert search.add(submap(0, (650.0, 810.0), 4), None, None) is False
    held = search.intrinsics
    assert held.focals == pytest.approx([650, 810])
    # a single guess gives no correction, and its bias is unknown
    assert (held.damping == 0).all()
    assert held.focal_log_sigma == pytest.approx(BIAS_LOG_SIGMA, rel=0.01)


def test_turning_gives_both_focals_and_reports_one_change(turning):
    search, answers = turning
    held = search.intrinsics
    error = np.abs(np.log(held.focals / 700))
    assert (error < 0.03).all() and (error < 3 * held.focal_log_sigma).all()
    assert (held.damping > 0).all()
    assert answers[0] is False and any(answers) and not all(answers[1:])


def test_the_same_sub_maps_give_the_same_intrinsics(turning):
    again, answers = drive(CONFIG, "general", 8)
    assert answers == turning[1]
    assert again.intrinsics.cameras == turning[0].intrinsics.cameras


def test_on_straights_the_guesses_are_averaged_and_the_focal_is_unobserved():
    search, answers = drive(CONFIG, "straight", 6)
    held = search.intrinsics
    assert held.focals == pytest.approx(np.median(GUESSES[:6], 0), rel=0.01)
    assert (held.damping == 0.8).all() and (held.focal_log_sigma > 0.05).all()
    assert any(answers)


def test_the_search_of_the_paper_selects_the_guess_of_least_score():
    config = replace(CONFIG, weighted=False, refine=False, n_pair=1, n_feature=7)
    focals = np.array([[900, 500], [800, 600], [705, 690], [760, 650], [620, 780.0], [750, 750]])
    search, _ = drive(config, "general", 6, focals)
    held = search.intrinsics
    assert held.focals == pytest.approx([705, 690])
    # damping of V-C: two groups of 28 pairs, n_group = 2, n_pair * n_feature = 7
    assert (held.damping == 1).all()


def test_the_search_of_the_paper_accepts_only_better_guesses():
    config = replace(CONFIG, weighted=False, refine=False)
    search, _ = drive(config, "general", 5, np.array([[900.0, 900.0]] * 5))
    assert search.intrinsics.focals[0] == 900
    search.add(submap(5, (710.0, 900.0), N), None, None)
    assert search.intrinsics.focals[0] == 710
    search.add(submap(6, (980.0, 900.0), N), None, None)
    assert search.intrinsics.focals[0] == 710


def test_damping_can_be_fixed_at_one():
    config = replace(CONFIG, adaptive_damping=False)
    assert (drive(config, "general", 2)[0].intrinsics.damping == 1).all()
    plain = replace(config, weighted=False)
    assert (drive(plain, "general", 8)[0].intrinsics.damping == 1).all()


def test_finish_completes_a_group_being_built():
    search, _ = drive(replace(CONFIG, group_every=50), "general", 2)
    assert search.intrinsics.focal_log_sigma[0] > 0.05
    search.finish()
    assert search.intrinsics.focal_log_sigma[0] < 0.05


def test_the_number_of_candidates_is_bounded():
    search = IntrinsicSearch(CONFIG)
    for k in range(MAX_CANDIDATES + 30):
        search.add(submap(k, (500.0 if k < 30 else 700.0, 700.0), 2), None, None)
    assert search.intrinsics.focals[0] == pytest.approx(700)


def test_there_is_no_estimate_before_views_of_both_cameras():
    search, lonely = IntrinsicSearch(CONFIG), submap(0, (700.0, 700.0), 4)
    assert search.add(replace(lonely, assistant_ids=()), None, None) is False
    assert search.intrinsics is None


def test_sift_is_used_if_configured_or_without_landmarks():
    blank = [np.zeros((60, 80, 3), np.uint8)] * (2 * N + 1)
    T = motion("general", N)
    landmarks = both_eyes(seen(T, 0), seen(T, 1), N)
    sigma = {}
    for matches in ("auto", "sift"):
        search = IntrinsicSearch(replace(CONFIG, matches=matches))
        for k in range(2):
            search.add(submap(k, (700.0, 700.0), N), landmarks, blank)
        search.finish()
        sigma[matches] = search.intrinsics.focal_log_sigma[0]
    # blank images have no features
    assert sigma["auto"] < 0.05 < sigma["sift"]


def test_a_group_with_more_information_changes_the_estimate():
    from calm_edge.correction.eye_search import EyeSearch

    eye = EyeSearch(replace(CONFIG, n_group=1))
    eye.add_candidate(submap(0, (770.0, 770.0), 2).cameras_raw[0])
    eye.add_group(group("straight", 0))
    assert not eye.is_informative
    eye.add_group(group("general", 0))
    assert eye.is_informative and np.exp(eye.measured.log_focal) == pytest.approx(700, rel=0.02)
    eye.add_group(group("tangent", 0))
    assert eye.is_informative and len(eye.bank.groups) == 1


# A lens with barrel distortion, and one that is a pixel off and more.
BARREL = replace(CAMERA, distortion=(-0.25, 0.06))
NEARLY = replace(CAMERA, distortion=(-0.23, 0.06))


def behind(lens: Camera, k: int):
    """Sub-map k whose model got pictures undistorted by `lens`, with guesses of the focal."""
    made = submap(k, tuple(GUESSES[k]), N)
    cameras = tuple(
        ThroughLens(c.fx, c.fy, c.cx, c.cy, c.width, c.height, lens=lens) for c in made.cameras
    )
    return replace(made, cameras=cameras, cameras_raw=cameras)


def drive_behind(search, lenses):
    """Feed the search with matches of pictures by BARREL, undistorted by these lenses."""
    answers = []
    for k, lens in enumerate(lenses):
        T = motion("general" if k % 4 < 2 else "-general", N)
        eyes = (seen(T, 2 * k + eye, camera=BARREL, points=900) for eye in (0, 1))
        made = submap(k, tuple(GUESSES[k]), N) if lens is None else behind(lens, k)
        answers.append(search.add(made, both_eyes(*eyes, N), None))
    return answers


def test_matches_are_undistorted_by_the_lens_that_is_known():
    straight, bent = IntrinsicSearch(CONFIG), IntrinsicSearch(CONFIG)
    drive_behind(straight, [BARREL] * 8)
    drive_behind(bent, [None] * 8)
    off = [np.abs(np.log(s.intrinsics.focals / 700)).max() for s in (straight, bent)]
    assert off[0] < 0.03 < 0.06 < off[1]
    assert all(camera.lens is BARREL for camera in straight.intrinsics.cameras)


def test_a_lens_that_moves_begins_anew_with_the_matches_of_before():
    search = IntrinsicSearch(CONFIG)
    answers = drive_behind(search, [None] * 5 + [BARREL] * 3)
    assert answers[5]
    (earlier,) = {id(each): each for each in search.earlier}.values()
    assert all(not isinstance(camera, ThroughLens) for camera in earlier.cameras)
    search.finish()
    held = search.intrinsics
    assert all(camera.lens is BARREL for camera in held.cameras)
    # the guesses of before do not count, their matches do
    assert np.abs(np.log(held.focals / 700)).max() < 0.03 and (held.focal_log_sigma < 0.05).all()


def test_a_lens_that_hardly_moves_is_the_same():
    near = replace(BARREL, cx=BARREL.cx + 0.5)
    search = IntrinsicSearch(CONFIG)
    drive_behind(search, [BARREL, BARREL, near, near])
    assert search.earlier == ()
    moved = IntrinsicSearch(CONFIG)
    drive_behind(moved, [NEARLY, NEARLY, BARREL, BARREL])
    assert moved.earlier
