import cv2
import numpy as np

from calm_edge.backbones.bundle.cost_volume import (
    SweepView,
    match_scores,
    plane_homographies,
    whitened,
)
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective

W, H, DEPTH = 120, 60, 8.0
CAMERA = Perspective(90.0, 90.0, (W - 1) / 2, (H - 1) / 2, W, H)


def texture():
    noise = np.random.default_rng(0).normal(size=(H, W)).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.2), None, 20, 230, cv2.NORM_MINMAX)


def view(gray, x=0.0):
    return SweepView(whitened(gray), CAMERA, se3.compose(np.eye(3), np.array([x, 0.0, 0.0])))


def of_wall(x):
    """The wall at DEPTH with `texture` as the view from the origin sees it, seen from (x, 0, 0)."""
    shift = np.array([[1, 0, -CAMERA.fx * x / DEPTH], [0, 1, 0]])
    return cv2.warpAffine(texture(), shift, (W, H))


def test_whitening_drops_gain_and_exposure():
    gray = texture()
    plain, bright = whitened(gray), whitened(0.7 * gray + 40)
    assert np.abs(plain - bright)[5:-5, 5:-5].max() < 0.1
    assert np.abs(whitened(np.full((H, W), 77, np.uint8))).max() < 1e-3


def test_planes_map_points_of_that_depth():
    a, b = view(texture()), view(texture(), x=0.8)
    zeta = np.array([0.0, 1 / DEPTH])
    homographies, ratio = plane_homographies(a, b, zeta)
    q = homographies @ np.array([40.0, 20.0, 1.0])
    uv = q[:, :2] / q[:, 2:]
    assert np.allclose(uv, [[40, 20], [40 - 90 * 0.8 / DEPTH, 20]])
    assert np.allclose(ratio, 1)


def test_the_right_plane_scores_best_in_spite_of_one_occluded_view():
    zeta = np.linspace(0, 2 / DEPTH, 17)
    others = [view(of_wall(x), x) for x in (0.8, -0.8)]
    scores = match_scores(view(texture()), others, zeta, (W // 2, H // 2))
    assert scores.shape == (17, H // 2, W // 2)
    inside = scores[:, 5:-5, 10:-10]
    assert (inside.argmax(0) == 8).mean() > 0.95
    assert np.median(inside[8]) > 0.6
    hidden = view(np.random.default_rng(1).uniform(0, 255, (H, W)).astype(np.float32), x=-0.8)
    forgiving = match_scores(view(texture()), [others[0], hidden], zeta, (W // 2, H // 2))
    assert (forgiving[:, 5:-5, 10:-10].argmax(0) == 8).mean() > 0.9
