import cv2
import numpy as np
import pytest

from calm_edge.backbones.bundle import tracks
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.flow import follow

SIZE = (320, 128)
MIDDLE = np.array([159.5, 63.5])


def texture(size=SIZE, seed=0):
    """Soft random blobs of a few pixels, uint8 (height, width)."""
    noise = np.random.default_rng(seed).normal(size=size[::-1]).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 1.6) + 2 * cv2.GaussianBlur(noise, (0, 0), 6.0)
    return cv2.normalize(soft, None, 10, 245, cv2.NORM_MINMAX).astype(np.uint8)


def similarity(zoom, roll_deg, shift):
    """H (3, 3): zoom and roll about the middle of the picture, then a shift [px]."""
    c, s = zoom * np.cos(np.radians(roll_deg)), zoom * np.sin(np.radians(roll_deg))
    A = np.array([[c, -s], [s, c]])
    return np.block([[A, (MIDDLE - A @ MIDDLE + shift)[:, None]], [0, 0, 1]])


def moved(H, uv):
    q = np.c_[uv, np.ones(len(uv))] @ H.T
    return q[:, :2] / q[:, 2:]


def error_px(found, H, uv):
    return np.linalg.norm(found - moved(H, uv), axis=1)


NONE = np.zeros((0, 2), np.float32)


def test_corners_are_spread_over_the_grid():
    picture = texture()
    # all the contrast in one corner must not draw all the corners there
    picture[:, 80:] = 120 + (picture[:, 80:].astype(float) - 120) * 0.3
    uv = tracks.detect_corners(picture, NONE)
    assert uv.dtype == np.float32
    assert ((uv > 8) & (uv < np.array(SIZE) - 9)).all()
    cells = (uv // (np.array(SIZE) / tracks.GRID)).astype(int)
    counts = np.bincount(cells[:, 0] + 8 * cells[:, 1], minlength=32)
    assert (counts > 0).all() and counts.max() <= tracks.CORNERS_PER_VIEW / 32


def test_new_corners_keep_away_from_known_ones():
    first = tracks.detect_corners(texture(), NONE, count=64)
    second = tracks.detect_corners(texture(), first, count=160)
    apart = np.linalg.norm(second[:, None] - first[None], axis=2).min(1)
    assert len(second) > 32 and apart.min() > 4
    # cells that are full get none
    assert len(tracks.detect_corners(texture(), first, count=32)) < 8


def test_a_known_warp_is_tracked():
    picture, H = texture(), similarity(1.03, 1.0, [6.4, -2.3])
    target = cv2.warpPerspective(picture, H, SIZE)
    uv = tracks.detect_corners(picture, NONE)
    found, ok = follow(picture, target, uv, uv.copy(), tracks.MATCHING)
    assert ok.mean() > 0.8
    assert np.quantile(error_px(found, H, uv)[ok], 0.95) < 0.2
    assert np.median(error_px(found, H, uv)[ok]) < 0.1


def test_a_guess_reaches_where_the_pyramid_does_not():
    picture, H = texture(), similarity(1.0, 0.0, [90.0, 0.0])
    target = cv2.warpPerspective(picture, H, SIZE)
    uv = tracks.detect_corners(picture, NONE)
    inside = moved(H, uv)[:, 0] < SIZE[0] - 12

    def share_found(guess):
        found, ok = follow(picture, target, uv, guess, tracks.MATCHING)
        return (ok & (error_px(found, H, uv) < 0.5))[inside].mean()

    assert share_found(uv.copy()) < 0.1
    assert share_found(uv + np.float32([86, 1])) > 0.9


def test_a_point_that_fails_the_backward_check_is_dropped():
    uv = tracks.detect_corners(texture(), NONE)
    _, ok = follow(texture(), texture(seed=1), uv, uv.copy(), tracks.MATCHING)
    assert ok.mean() < 0.1
    assert follow(texture(), texture(), NONE, NONE, tracks.MATCHING)[1].shape == (0,)


def test_outliers_are_found_off_their_epipolar_lines():
    rng = np.random.default_rng(0)
    p = np.c_[rng.uniform(-1, 1, (200, 2)) * [4, 1.5], rng.uniform(4, 20, 200)]
    q = p @ cv2.Rodrigues(np.array([0.01, 0.05, 0.0]))[0].T + [0.3, 0.0, -1.0]
    a, b = (300 * x[:, :2] / x[:, 2:] + MIDDLE for x in (p, q))
    wrong = rng.random(200) < 0.25
    b[wrong] += rng.uniform(5, 20, (int(wrong.sum()), 2)) * rng.choice([-1, 1], (wrong.sum(), 2))
    kept = tracks.on_epipolar_lines(a.astype(np.float32), b.astype(np.float32), 1.0)
    assert kept[~wrong].mean() > 0.97
    # an outlier along its epipolar line is not detected
    assert kept[wrong].mean() < 0.25
    assert tracks.on_epipolar_lines(a[:15], b[:15], 1.0).all()


def test_near_points_are_kept_where_most_are_too_far_to_show_the_epipole():
    rng = np.random.default_rng(0)
    f, R = 400.0, cv2.Rodrigues(np.array([0.0, 0.06, 0.0]))[0]
    z = np.r_[np.full(200, 1e6), rng.uniform(5, 12, 20)]
    p = np.c_[rng.uniform(-0.6, 0.6, 220), rng.uniform(-0.4, 0.4, 220), np.ones(220)] * z[:, None]
    q = p @ R.T + [0.5, 0.0, -1.0]
    noise = rng.normal(0, 0.15, (220, 2))
    a, b = (np.asarray(f * x[:, :2] / x[:, 2:] + [320, 180], np.float32) for x in (p, q))
    b += noise.astype(np.float32)
    assert tracks.on_epipolar_lines(a, b, 1.0).all()


def test_distortion_is_undone_before_epipolar_lines_are_fitted():
    lens = Fisheye(280.0, 280.0, 319.5, 179.5, 640, 360, (0.02, -0.01))
    rng = np.random.default_rng(0)
    p = np.c_[rng.uniform(-1, 1, (300, 2)) * [20, 8], rng.uniform(4, 20, 300)]
    q = p @ cv2.Rodrigues(np.array([0.01, 0.25, 0.0]))[0].T + [0.3, 0.0, -1.0]
    a, b = (lens.project(x).astype(np.float32) for x in (p, q))
    wrong = rng.random(300) < 0.25
    shift = rng.uniform(5, 20, (int(wrong.sum()), 2)) * rng.choice([-1, 1], (wrong.sum(), 2))
    b[wrong] += shift.astype(np.float32)
    kept = tracks.on_epipolar_lines(a, b, 1.0, [(lens, lens)])
    assert kept[~wrong].mean() > 0.97 and kept[wrong].mean() < 0.25
    as_pinhole = tracks.on_epipolar_lines(a, b, 1.0, [(lens.pinhole, lens.pinhole)])
    assert as_pinhole[~wrong].mean() < 0.9
    # of two lenses the right one counts
    either = [(lens.pinhole, lens.pinhole), (lens, lens)]
    assert np.array_equal(tracks.on_epipolar_lines(a, b, 1.0, either), kept)


@pytest.fixture(scope="module")
def eyes():
    """A primary picture, the assistant's at 1.16 the zoom and 4 degrees of roll, H_a_p."""
    primary, H = texture(), similarity(1.16, 4.0, [-5.0, 3.0])
    return primary, cv2.warpPerspective(primary, H, SIZE), H


def test_corners_are_found_across_zoom_and_roll(eyes):
    primary, assistant, H = eyes
    uv = tracks.detect_corners(primary, NONE)
    inside = ((moved(H, uv) > 0) & (moved(H, uv) < np.array(SIZE) - 1)).all(1)
    # the homography is known only roughly: 3 px off
    rough = similarity(1.16, 4.0, [-3.0, 0.8])
    found, ok = tracks.across_eyes(primary, assistant, rough, uv, np.zeros_like(uv))
    assert ok[inside].mean() > 0.6 and not ok[~inside].any()
    error = np.median(error_px(found, H, uv)[ok])
    assert error < 0.1
    # unwarped patches are found as well, but not where they should be
    bare, ok = follow(primary, assistant, uv, moved(rough, uv).astype(np.float32), tracks.MATCHING)
    assert np.median(error_px(bare, H, uv)[ok]) > 5 * error


def test_a_moving_object_is_not_matched_across_eyes():
    primary, still = texture(), np.eye(3)
    assistant = primary.copy()
    # depth may shift a part along one direction; a smaller part that goes another way is traffic
    assistant[20:110, 20:150] = primary[26:116, 20:150]
    assistant[20:110, 200:260] = primary[20:110, 206:266]
    uv = tracks.detect_corners(primary, NONE)
    found, ok = tracks.across_eyes(primary, assistant, still, uv, np.zeros_like(uv))

    def inside(left, right):
        return (uv > [left + 15, 40]).all(1) & (uv < [right - 15, 95]).all(1)

    near, traffic = inside(20, 150), inside(200, 260)
    assert near.sum() > 20 and ok[near].mean() > 0.8
    assert np.median(found[near & ok] - uv[near & ok], axis=0) == pytest.approx([0, -6], abs=0.1)
    assert traffic.sum() > 5 and ok[traffic].mean() < 0.2


def test_a_homography_is_found_without_a_guess(eyes):
    primary, assistant, H = eyes
    found = tracks.sift_homography(primary, assistant)
    grid = np.stack(np.meshgrid([40, 160, 280], [30, 64, 98]), -1).reshape(-1, 2)
    assert error_px(moved(found, grid), H, grid).max() < 3
    assert tracks.sift_homography(primary, np.zeros_like(assistant)) is None


def test_tracks_of_a_window_are_the_same_points_in_every_view():
    big = texture((480, 200))
    shifts = np.array([[4.0 * k, 0.5 * k] for k in range(4)])
    primary = [cv2.warpPerspective(big, similarity(1.0, 0.0, s), SIZE) for s in shifts]
    H_a_p = similarity(1.16, 4.0, [-5.0, 3.0])
    assistant = [cv2.warpPerspective(p, H_a_p, SIZE) for p in primary[:3]]
    for H in (None, H_a_p):
        found = tracks.window_tracks(primary, assistant, [0, 1, 2], H)
        assert set(found.view) == set(range(7))
        # where the point would be in the first view
        home = np.where((found.view < 4)[:, None], found.uv, moved(np.linalg.inv(H_a_p), found.uv))
        home = home - shifts[np.where(found.view < 4, found.view, found.view - 4)]
        first = home[np.unique(found.track, return_index=True)[1]]
        off = np.linalg.norm(home - first[np.unique(found.track, return_inverse=True)[1]], axis=1)
        assert np.median(off) < 0.1 and np.quantile(off, 0.95) < 0.5
        long = np.bincount(np.bincount(found.track))
        assert long[4:].sum() > 100
        pairs = np.c_[found.track, found.view]
        assert len(np.unique(pairs, axis=0)) == len(pairs)


def test_parallax_that_grows_from_view_to_view_is_tracked():
    big = texture((480, 200))
    primary = [big[:128, :320].copy()] * 5
    assistant = [big[:128, 16 * k : 320 + 16 * k].copy() for k in range(1, 6)]
    found = tracks.window_tracks(primary, assistant, list(range(5)), np.eye(3))
    views = [dict(zip(found.track[found.view == v], found.uv[found.view == v], strict=True))
             for v in (0, 9)]  # fmt: skip
    both = sorted(views[0].keys() & views[1].keys())
    moved_by = np.array([views[1][i] - views[0][i] for i in both])
    assert len(both) > 0.5 * len(views[0])
    assert (np.abs(moved_by - [-80, 0]).max(1) < 0.1).mean() > 0.95


def test_matches_are_all_kept_where_opencv_fails(monkeypatch):
    """Seen on a drive: USAC's own assertion (`!model.empty()`), which no small case reproduces."""

    def fails(*_):
        raise cv2.error("Assertion failed")

    monkeypatch.setattr(tracks.cv2, "findFundamentalMat", fails)
    uv = np.random.default_rng(0).uniform(0, 300, (40, 2)).astype(np.float32)
    assert tracks.on_epipolar_lines(uv, uv + 3, 1.0).all()


def test_an_upright_picture_has_the_corners_of_the_lying_one():
    lying = tracks.detect_corners(texture(), NONE)
    upright = tracks.detect_corners(np.ascontiguousarray(texture().T), NONE)
    assert abs(len(upright) - len(lying)) <= 0.05 * len(lying)
    nearest = np.linalg.norm(lying[:, None] - upright[None, :, ::-1], axis=2).min(1)
    assert (nearest < 1.0).mean() > 0.95


def test_nothing_is_tracked_in_parts_that_are_left_out():
    pictures = [texture((320, 128), 3)]
    for step in (4, 8, 12):
        pictures.append(np.roll(pictures[0], step, axis=0))
    used = np.full((128, 320), 255, np.uint8)
    used[88:] = 0
    seen = list(tracks.temporal_tracks(pictures, used=used))
    assert all(len(uv) > 20 and uv[:, 1].max() < 88 for _, uv, _ in seen)
    # points move down, into the part that is left out, and end there
    assert any(uv[:, 1].max() > 88 for _, uv, _ in tracks.temporal_tracks(pictures))


def test_no_match_ends_in_a_part_of_the_other_camera_that_is_left_out():
    picture = texture((320, 128), 4)
    used = np.full((128, 320), 255, np.uint8)
    used[:, :100] = 0
    found = tracks.window_tracks([picture] * 3, [picture], [1], np.eye(3), used=(None, used))
    across = found.uv[found.view == 3]
    assert len(across) > 20 and across[:, 0].min() > 99
