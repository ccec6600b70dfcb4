import cv2
import numpy as np
import pytest

from calm_edge.backbones.bundle.edges import MOST, across, edges

MIDDLE = np.array([[80.0, 60.0]], np.float32)


def drawn(angle_deg, corner):
    """A picture (120, 160) with a straight edge, or the corner of a bright quarter, at MIDDLE."""
    y, x = np.mgrid[:480, :640] / 4 - np.array([60.0, 80.0])[:, None, None] - 0.375
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    bright = -s * x + c * y > 0
    if corner:
        bright &= c * x + s * y > 0
    fine = 60 + 120 * bright.astype(np.float32)
    picture = cv2.GaussianBlur(
        cv2.resize(fine, (160, 120), interpolation=cv2.INTER_AREA), (0, 0), 1
    )
    noise = np.random.default_rng(0).normal(0, 1, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("angle_deg", [3.0, 17.0, 45.0, 88.0, 160.0])
def test_an_edge_has_its_direction_and_a_corner_none(angle_deg):
    direction = [np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))]
    (edge,) = edges(drawn(angle_deg, corner=False), MIDDLE)
    assert abs(edge @ direction) > 0.97
    assert 0.97 < np.linalg.norm(edge) <= np.sqrt(1 - 1 / MOST) + 1e-6
    (corner,) = edges(drawn(angle_deg, corner=True), MIDDLE)
    assert np.linalg.norm(corner) < 0.75


def test_what_counts_is_across_the_edge():
    edge = edges(drawn(17.0, corner=False), MIDDLE)
    along = np.array([[np.cos(np.radians(17.0)), np.sin(np.radians(17.0))]], np.float32)
    normal = along[:, ::-1] * np.array([-1, 1], np.float32)
    assert np.linalg.norm(across(edge, 10 * along)) < 1.0
    assert np.linalg.norm(across(edge, 10 * normal)) == pytest.approx(10, abs=0.2)


def test_the_border_of_a_picture_and_no_points_are_no_exception():
    picture = drawn(0.0, corner=False)
    corners = np.array([[0, 0], [159, 119], [-3, 400]], np.float32)
    assert np.isfinite(edges(picture, corners)).all()
    assert edges(picture, corners[:0]).shape == (0, 2)
    assert np.isfinite(edges(np.full((40, 40), 7, np.uint8), corners)).all()
