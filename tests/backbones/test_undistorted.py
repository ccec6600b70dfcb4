"""Undistorted pictures for a network, and its prediction in the pixels of the pictures as taken."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calm_edge.backbones.undistorted import UndistortedPictures
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.through_lens import ThroughLens
from calm_edge.geometry.undistortion import undistortion
from calm_edge.types import Hints, Landmarks, Prediction

SIZE = W, H = 320, 200
BARREL = Perspective(190.0, 190.0, 159.5, 99.5, *SIZE, (-0.2, 0.04))
FISHEYE = Fisheye(165.0, 165.0, 159.5, 99.5, *SIZE)
LENSES = (BARREL, FISHEYE)
# a wall at this depth, with a grey ramp along its x and y
WALL = 10.0
ZOOM = 1.05
POINTS = np.random.default_rng(0).uniform([-6, -3, WALL], [6, 3, WALL], (50, 3))


def picture(camera):
    """Picture of the wall by a camera."""
    uv = np.stack(np.meshgrid(np.arange(W), np.arange(H)), -1).astype(np.float64)
    p = camera.back_project(uv, np.full((H, W), WALL))
    grey = np.nan_to_num(127 + 60 * np.sin(p[..., 0]) + 40 * np.cos(p[..., 1]))
    return cv2.merge([grey.clip(0, 255).astype(np.uint8)] * 3)


class Network:
    """Records its pictures; finds the wall, a pinhole camera with a focal too long by ZOOM."""

    def infer(self, images, hints):
        self.images, self.hints = images, hints
        cameras = []
        for eye, image in zip(hints.eyes, images, strict=True):
            K = undistortion(hints.lenses[eye]).camera if hints.lenses[eye] else BARREL.pinhole
            cameras.append(K.with_focal(ZOOM * K.fx))
            assert image.shape == (H, W, 3)
        uv = np.concatenate([c.project(POINTS) for c in cameras]).astype(np.float32)
        n, m = len(POINTS), len(images)
        marks = Landmarks(POINTS, np.tile(np.arange(n), m), np.repeat(np.arange(m), n), uv)
        poses = np.tile(np.eye(4), (m, 1, 1))
        return Prediction(tuple(cameras), poses, landmarks=marks)

    def densify(self, images, hints, prediction):
        self.images, self.hints, self.straight = images, hints, prediction
        depth = np.full((len(images), H // 2, W // 2), WALL, np.float32)
        return replace(prediction, depth=depth, confidence=depth / WALL)


def hints_of(*lenses):
    return Hints(np.array([0, 1]), np.array([0, 0]), lenses=lenses)


@pytest.fixture
def network():
    return Network()


TAKEN = [picture(lens) for lens in LENSES]


def test_the_network_gets_pictures_of_pinhole_cameras(network):
    UndistortedPictures(network).infer(TAKEN, hints_of(*LENSES))
    for image, lens in zip(network.images, LENSES, strict=True):
        maps = undistortion(lens)
        inside = np.zeros((H, W), bool)
        inside[2:-2, 2:-2] = True
        inside &= (maps.map_x > 1) & (maps.map_x < W - 2) & (maps.map_y > 1) & (maps.map_y < H - 2)
        off = np.abs(image[inside].astype(float) - picture(maps.camera)[inside])
        assert off.mean() < 1.0
    assert np.abs(network.images[0].astype(float) - TAKEN[0]).mean() > 3
    assert network.hints.lenses == LENSES


def test_without_a_lens_pictures_and_prediction_are_as_they_are(network):
    p = UndistortedPictures(network).infer(TAKEN, hints_of(None, None))
    assert all(a is b for a, b in zip(network.images, TAKEN, strict=True))
    assert all(type(camera) is Perspective for camera in p.cameras)
    mixed = UndistortedPictures(network).infer(TAKEN, hints_of(BARREL, None))
    assert network.images[0] is not TAKEN[0] and network.images[1] is TAKEN[1]
    assert [type(c) for c in mixed.cameras] == [ThroughLens, Perspective]


def test_cameras_and_landmarks_are_those_of_the_pictures_as_taken(network):
    p = UndistortedPictures(network).infer(TAKEN, hints_of(*LENSES))
    for view, (camera, lens) in enumerate(zip(p.cameras, LENSES, strict=True)):
        assert camera.lens == lens and camera.fx == pytest.approx(ZOOM * lens.fx)
        uv = p.landmarks.uv[p.landmarks.view == view]
        np.testing.assert_allclose(camera.project(POINTS), uv, atol=1e-3)
        # a focal that were right would have them where the lens sees them
        right = replace(camera, fx=lens.fx, fy=lens.fy)
        np.testing.assert_allclose(right.project(POINTS), lens.project(POINTS), atol=1e-6)


def test_depth_is_that_of_the_pixels_as_taken(network):
    backbone, hints = UndistortedPictures(network), hints_of(*LENSES)
    p = backbone.infer(TAKEN, hints)
    dense = backbone.densify(TAKEN, replace(hints, lenses=(None, None)), p)
    assert network.hints.lenses == LENSES
    for camera, lens in zip(network.straight.cameras, LENSES, strict=True):
        pinhole = undistortion(lens).camera
        np.testing.assert_allclose(camera.matrix[:2, :2], ZOOM * pinhole.matrix[:2, :2])
    marks = network.straight.landmarks
    straight = network.straight.cameras[1].project(POINTS)
    np.testing.assert_allclose(marks.uv[marks.view == 1], straight, atol=1e-3)
    assert dense.cameras == p.cameras and dense.landmarks is p.landmarks
    for depth, lens in zip(dense.depth, LENSES, strict=True):
        assert depth.shape == (H // 2, W // 2) and depth[H // 4, W // 4] == np.float32(WALL)
        # 0 where the undistorted picture, 100 degrees across, shows nothing
        x = np.arange(0, W, 2) + 0.5
        ray = lens.rays(np.stack([x, np.full(W // 2, 99.5)], -1))
        beyond = np.degrees(np.arctan2(np.abs(ray[:, 0]), ray[:, 2])) > 50.5
        assert (depth[H // 4, beyond] == 0).all()
    assert (dense.depth[1] == 0).any() and np.array_equal(dense.confidence > 0, dense.depth > 0)
    assert backbone.densify(TAKEN, hints, dense) is dense
