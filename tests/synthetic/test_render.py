"""The renderer against pinhole geometry, and its pictures against their own ground truth."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from tests.synthetic.drive import Rig, make_rig, make_sequence
from tests.synthetic.path import Drive
from tests.synthetic.render import Scene, render_view, render_views
from tests.synthetic.settings import Settings
from tests.synthetic.shots import T_primary_assistant
from tests.synthetic.surface import Surface, Texture
from tests.synthetic.world import World, make_world

Float = NDArray[np.float64]
SIZE = (336, 144)
BLACK_SKY = np.zeros((8, 16, 3), np.uint8)


@pytest.fixture(scope="module")
def world() -> World:
    return make_world(0, density=14.0)


@pytest.fixture(scope="module")
def rig(world: World) -> Rig:
    # the turn at about 7 s has both rotation and near walls
    return make_rig(world, Settings(frames=4, start_s=2.0, width=SIZE[0], height=SIZE[1]))


def dot(centre: Float) -> Surface:
    """A white disc 0.3 m wide on a black square metre that faces the viewer."""
    yy, xx = np.mgrid[0:200, 0:200]
    disc = (np.hypot(xx - 99.5, yy - 99.5) < 30).astype(np.uint8) * 255
    picture = np.dstack([disc, disc, disc])
    corner = centre - (0.5, 0.5, 0)
    return Surface(corner, np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), Texture(lambda: picture))


def test_a_dot_is_drawn_where_it_projects() -> None:
    camera = Perspective(210.0, 190.0, 70.3, 41.6, 150, 90)
    centre = np.array([0.31, -0.17, 4.0])
    image, depth = render_view(Scene([dot(centre)], BLACK_SKY), np.eye(4), camera)
    # haze lifts the black a little
    weight = np.maximum(image[..., 0].astype(np.float64) - 12, 0)
    rows, columns = np.mgrid[0:90, 0:150]
    found = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
    np.testing.assert_allclose(found, camera.project(centre), atol=0.03)
    assert set(np.unique(depth)) == {0.0, np.float32(4.0)}


def test_depth_of_ground_and_of_the_nearer_of_two_surfaces_is_exact() -> None:
    grey = Texture(lambda: np.full((64, 64, 3), 120, np.uint8))
    ground = Surface(
        np.array([-40, 1.5, 60.0]), np.array([80.0, 0, 0]), np.array([0, 0, -80.0]), grey
    )
    board = Surface(np.array([-1, 0.5, 9.0]), np.array([2.0, 0, 0]), np.array([0, 0.6, 0]), grey)
    camera = Perspective.from_hfov(80.0, 160, 90)
    _, depth = render_view(Scene([ground, board], BLACK_SKY), np.eye(4), camera)
    rows = np.arange(90)
    expected = 1.5 / ((rows - camera.cy) / camera.fy)
    below = (rows > camera.cy + 10) & (np.abs(rows - camera.cy) > 14)
    np.testing.assert_allclose(depth[below, 3], expected[below], rtol=1e-5)
    u, v = np.round(camera.project(np.array([0.0, 0.8, 9.0]))).astype(int)
    assert depth[v, u] == pytest.approx(9.0, rel=1e-6)
    # right down to the picture's lower edge: the near plane leaves no hole
    assert (depth[-1] > 0).all()


def test_a_surface_is_hidden_from_behind() -> None:
    flipped = dot(np.array([0, 0, 4.0]))
    back = Surface(flipped.origin + flipped.along, -flipped.along, flipped.down, flipped.texture)
    camera = Perspective.from_hfov(60.0, 60, 40)
    _, depth = render_view(Scene([back], BLACK_SKY), np.eye(4), camera)
    assert not depth.any()


def matches(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> tuple[Float, Float]:
    sift = cv2.SIFT.create(900)
    (ka, da), (kb, db) = (
        sift.detectAndCompute(cv2.cvtColor(i, cv2.COLOR_BGR2GRAY), None) for i in (a, b)
    )
    pairs = cv2.BFMatcher().knnMatch(da, db, k=2)
    good = [m for m, n in pairs if m.distance < 0.75 * n.distance]
    pa = np.array([ka[m.queryIdx].pt for m in good])
    pb = np.array([kb[m.trainIdx].pt for m in good])
    _, kept = cv2.findFundamentalMat(pa, pb, cv2.USAC_MAGSAC, 1.0, 0.999, 5000)
    return pa[kept.ravel() > 0], pb[kept.ravel() > 0]


def epipolar_error(F: Float, pa: Float, pb: Float) -> Float:
    """Pixels from the epipolar line in the second picture."""
    lines = np.c_[pa, np.ones(len(pa))] @ F.T
    offset = np.abs((lines * np.c_[pb, np.ones(len(pb))]).sum(1))
    return np.asarray(offset / np.hypot(lines[:, 0], lines[:, 1]))


def test_matches_agree_with_the_truth_across_time_and_eyes(world: World, rig: Rig) -> None:
    left, _ = render_views(world.scene, rig.T_w_c[0][[0, 3]], rig.cameras[0])
    right, _ = render_views(world.scene, rig.T_w_c[1][:1], rig.cameras[1])
    across_time = left[1], rig.T_w_c[0][3], rig.cameras[0]
    across_eyes = right[0], rig.T_w_c[1][0], rig.cameras[1]
    for other, T, camera in (across_time, across_eyes):
        pa, pb = matches(left[0], other)
        assert len(pa) > 60
        T_b_a = se3.inverse(T) @ rig.T_w_c[0][0]
        E = se3.hat(T_b_a[:3, 3]) @ T_b_a[:3, :3]
        K_a, K_b = rig.cameras[0].matrix, camera.matrix
        F = np.linalg.inv(K_b).T @ E @ np.linalg.inv(K_a)
        assert np.median(epipolar_error(F, pa, pb)) < 0.3


def test_depth_of_one_view_predicts_the_other(world: World, rig: Rig) -> None:
    (a, b), (depth_a, depth_b) = render_views(world.scene, rig.T_w_c[0][[0, 2]], rig.cameras[0])
    row, column = np.nonzero((depth_a > 0) & (depth_a < 30))
    p_a = rig.cameras[0].back_project(
        np.stack([column, row], -1).astype(float), depth_a[row, column].astype(float)
    )
    p_b = se3.transform(se3.inverse(rig.T_w_c[0][2]) @ rig.T_w_c[0][0], p_a)
    uv = rig.cameras[0].project(p_b)
    at = np.round(uv).astype(int)
    inside = (p_b[:, 2] > 0.5) & ((at > 2) & (at < np.array(SIZE) - 3)).all(1)
    seen = depth_b[at[inside, 1], at[inside, 0]]
    ratio = seen / p_b[inside, 2]
    agree = np.abs(ratio - 1) < 0.03
    # the rest are occlusions and leaves
    assert agree.mean() > 0.85
    sampled = b[at[inside, 1], at[inside, 0]]
    change = np.abs(sampled[agree].astype(float) - a[row, column][inside][agree]).mean()
    assert change < 0.6 * np.abs(b.astype(float) - a).mean()


def test_the_drive_turns_slows_and_comes_back(world: World) -> None:
    settings = Settings()
    rig = make_rig(world, settings)
    p, z_axis = rig.T_w_c[0][:, :3, 3], rig.T_w_c[0][:, :3, 2]
    assert len(p) > 400
    speed = np.linalg.norm(np.diff(p, axis=0), axis=1) * settings.rate_hz
    assert 3.0 < speed[20:].min() < 5.5 and 8.0 < speed.max() < 10.0
    heading = np.unwrap(np.arctan2(z_axis[:, 0], z_axis[:, 2]))
    assert heading[-1] - heading[0] == pytest.approx(2 * np.pi, abs=0.05)
    # the last stretch lies on the first street again
    late = p[heading > heading[-1] - 0.03][None]
    revisit = np.linalg.norm(p[:80, None] - late, axis=2).min(1) < 0.6
    assert np.linalg.norm(np.diff(p[:80][revisit], axis=0), axis=1).sum() > 25
    car = Drive(world.loop, 0)
    assert np.abs(np.diff(car.poses(np.array([5.0, 5.001]))[:, :3, 3], axis=0)).max() < 0.02


def test_the_rig_is_as_declared() -> None:
    T = T_primary_assistant(Settings())
    assert np.linalg.norm(T[:3, 3]) == pytest.approx(0.5, abs=1e-12)
    assert 2 < np.degrees(np.linalg.norm(se3.so3_log(T[:3, :3]))) < 6


def test_a_sequence_folder_can_be_read_back(tmp_path: Path, world: World) -> None:
    rig = make_sequence(tmp_path, 3, 128, 64, world=world)
    poses = np.loadtxt(tmp_path / "poses1.txt").reshape(-1, 3, 4)
    np.testing.assert_allclose(poses, rig.T_w_c[1][:, :3], atol=1e-6)
    np.testing.assert_allclose(rig.T_w_c[0][0], np.eye(4), atol=1e-12)
    assert np.loadtxt(tmp_path / "calib.txt")[1, 0] == pytest.approx(rig.cameras[1].fx)
    times = [np.loadtxt(tmp_path / f"times{eye}.txt") for eye in (0, 1)]
    np.testing.assert_allclose(times[1] - times[0], 0.017, atol=1e-6)
    for eye in (0, 1):
        names = sorted(f.name for f in (tmp_path / f"cam{eye}").iterdir())
        assert names == ["000000.jpg", "000001.jpg", "000002.jpg"]
        picture = cv2.imread(str(tmp_path / f"cam{eye}" / names[0]))
        assert picture is not None and picture.shape == (64, 128, 3) and picture.std() > 20
    cloud = np.load(tmp_path / "cloud.npy")
    assert cloud.dtype == np.float32 and len(cloud) > 500
    # most of the ground the camera sees is 1.5 m below it
    assert (np.abs(cloud[:, 1] - 1.5) < 0.6).mean() > 0.2
