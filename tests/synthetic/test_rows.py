"""Pictures exposed row by row through a lens, against projection at the instants of the rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.fisheye import Fisheye
from tests.synthetic.render import Scene, render_view
from tests.synthetic.rows import Part, render_rows
from tests.synthetic.surface import Surface, Texture

Float = NDArray[np.float64]
BLACK_SKY = np.zeros((8, 16, 3), np.uint8)
WEBCAM = Perspective(118.0, 117.0, 97.3, 61.6, 200, 120, (-0.2, 0.03))
# about 110 degrees across
WIDE = Fisheye(105.0, 105.0, 101.1, 57.4, 200, 120, (-0.02, 0.004))
READOUT_S = 0.03
# of the camera in its own axes: m/s and rad/s of a sharp turn over a rough road
MOTION = np.array([0.4, 0.3, 9.0, 0.4, -0.9, 0.5])


def dot(centre: Float) -> Surface:
    """A white disc 0.1 m wide on a black half metre that faces the viewer."""
    yy, xx = np.mgrid[0:200, 0:200]
    disc = (np.hypot(xx - 99.5, yy - 99.5) < 20).astype(np.uint8) * 255
    picture = np.dstack([disc, disc, disc])
    corner = centre - (0.25, 0.25, 0)
    return Surface(corner, np.array([0.5, 0, 0]), np.array([0, 0.5, 0]), Texture(lambda: picture))


def row_times(camera: Camera) -> Float:
    return READOUT_S * (np.arange(camera.height) / (camera.height - 1) - 0.5)


def moving(t: Float) -> Float:
    """T_w_c (N, 4, 4) at seconds t (N,)."""
    return np.asarray(se3.exp(MOTION * np.asarray(t)[:, None]))


def expected(camera: Camera, point_at: Callable[[float], Float]) -> Float:
    """Pixel (2,) of a point that is at point_at(t) in the camera's axes when its row is exposed."""
    uv = camera.project(point_at(0.0))
    for _ in range(20):
        uv = camera.project(point_at(READOUT_S * (uv[1] / (camera.height - 1) - 0.5)))
    return uv


def centroid(image: NDArray[np.uint8]) -> Float:
    # haze lifts the black a little
    weight = np.maximum(image[..., 0].astype(np.float64) - 14, 0)
    rows, columns = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    return np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()


@pytest.mark.parametrize("camera", [WEBCAM, WIDE], ids=["webcam", "wide"])
@pytest.mark.parametrize("place", [(0.1, 0.05), (-0.6, -0.35), (0.62, 0.38)])
def test_a_point_is_on_its_pixel_through_a_lens_when_its_row_is_exposed(
    camera: Camera, place: tuple[float, float]
) -> None:
    point = np.array([*place, 1.0]) * 2.5
    scene = Scene([dot(point)], BLACK_SKY)
    still = render_rows([Part(scene, np.tile(np.eye(4), (camera.height, 1, 1)))], camera)
    np.testing.assert_allclose(centroid(still.image), camera.project(point), atol=0.05)
    rolled = render_rows([Part(scene, moving(row_times(camera)))], camera)
    at = expected(camera, lambda t: se3.transform(se3.inverse(moving(np.array([t]))[0]), point))
    np.testing.assert_allclose(centroid(rolled.image), at, atol=0.1)


def test_a_readout_moves_what_is_far_from_the_middle_row() -> None:
    # so that the test above can fail: without the instants of rows it is pixels off
    point = np.array([-1.5, 0.95, 2.5])
    at = expected(WEBCAM, lambda t: se3.transform(se3.inverse(moving(np.array([t]))[0]), point))
    assert np.linalg.norm(at - WEBCAM.project(point)) > 1.0


def test_a_moving_part_is_where_it_is_when_its_row_is_exposed() -> None:
    point, velocity = np.array([0.9, 0.7, 3.0]), np.array([-6.0, 1.0, -12.0])
    t = row_times(WIDE)
    T_w_part = se3.compose(np.eye(3), velocity * t[:, None])
    ground = Surface(
        np.array([-40, 3, 60.0]),
        np.array([80.0, 0, 0]),
        np.array([0, 0, -62.0]),
        Texture(lambda: np.zeros((8, 8, 3), np.uint8)),
    )
    parts = [
        Part(Scene([ground], BLACK_SKY), moving(t)),
        Part(Scene([dot(point)], BLACK_SKY), se3.inverse(T_w_part) @ moving(t)),
    ]
    view = render_rows(parts, WIDE)

    def seen(t: float) -> Float:
        return se3.transform(se3.inverse(moving(np.array([t]))[0]), point + velocity * t)

    at = expected(WIDE, seen)
    near = np.s_[int(at[1]) - 12 : int(at[1]) + 13, int(at[0]) - 12 : int(at[0]) + 13]
    corner = (near[1].start, near[0].start)
    np.testing.assert_allclose(centroid(view.image[near]) + corner, at, atol=0.1)
    u, v = np.round(at).astype(int)
    assert view.part[v, u] == 1 and view.part[-1, 100] == 0 and view.part[0, 100] == -1
    assert view.depth[v, u] == pytest.approx(seen(t[v])[2], rel=0.01)


@pytest.mark.parametrize("camera", [WEBCAM, WIDE], ids=["webcam", "wide"])
def test_depths_of_rows_lie_on_the_surface(camera: Camera) -> None:
    grey = Texture(lambda: np.full((64, 64, 3), 120, np.uint8))
    tiles = [
        Surface(np.array([x, 1.5, z + 8]), np.array([8.0, 0, 0]), np.array([0, 0, -8.0]), grey)
        for x in range(-40, 40, 8)
        for z in range(-8, 56, 8)
    ]
    T = moving(row_times(camera))
    view = render_rows([Part(Scene(tiles, BLACK_SKY), T)], camera)
    row, column = np.nonzero(view.depth)
    pixels = np.stack([column, row], -1).astype(float)
    p_c = camera.back_project(pixels, view.depth[row, column].astype(float))
    p_w = (T[row, :3, :3] @ p_c[..., None])[..., 0] + T[row, :3, 3]
    np.testing.assert_allclose(p_w[:, 1], 1.5, atol=1e-4)
    # down to the lower edge and from side to side: neither cutting nor boxes leave a hole
    assert (view.depth[-35:] > 0).all()


def test_a_pinhole_that_stands_still_sees_what_render_view_draws() -> None:
    camera = Perspective(118.0, 117.0, 97.3, 61.6, 200, 120)
    rng = np.random.default_rng(3)
    noise = rng.integers(0, 255, (64, 64, 3)).astype(np.uint8)
    ground = Surface(
        np.array([-20, 1.5, 30.0]), np.array([40.0, 0, 0]), np.array([0, 0, -30.0]),
        Texture(lambda: noise),
    )  # fmt: skip
    scene = Scene([ground, dot(np.array([0.3, -0.1, 4.0]))], BLACK_SKY)
    T = se3.exp(np.array([0.3, -0.2, 0.5, 0.05, -0.1, 0.02]))
    image, depth = render_view(scene, T, camera)
    view = render_rows([Part(scene, np.tile(T, (camera.height, 1, 1)))], camera)
    off = np.abs(image.astype(int) - view.image).max(-1)
    # only the outlines differ, by less than a pixel
    assert (off > 3).mean() < 0.02 and off.mean() < 1
    both = (depth > 0) & (view.depth > 0) & (off <= 3)
    np.testing.assert_allclose(view.depth[both], depth[both], rtol=1e-4)
    assert (both == (depth > 0)).mean() > 0.97


def test_a_lens_whose_corners_see_nothing_is_refused() -> None:
    folded = replace(WEBCAM, distortion=(-0.5,))
    scene = Scene([dot(np.array([0, 0, 3.0]))], BLACK_SKY)
    with pytest.raises(ValueError, match="smaller field of view"):
        render_rows([Part(scene, np.tile(np.eye(4), (folded.height, 1, 1)))], folded)
