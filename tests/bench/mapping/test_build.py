import dataclasses

import numpy as np
import pytest

from bench.mapping.build import WAVE, Built, raw_points, warped
from calm_edge.config import MappingConfig
from calm_edge.geometry import se3
from calm_edge.mapping.mapper import Mapper
from calm_edge.mapping.spool import Spool
from tests.mapping import scene

STREET = scene.street(6)
IMAGE = scene.IMAGE


def lifted(piece, depth, view):
    """(h, w, 3) raw points of one view."""
    height, width = depth.shape[1:]
    xy = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).astype(float)
    camera = piece.submap.cameras_raw[view].scaled(width / IMAGE[0], height / IMAGE[1])
    p_c = camera.back_project(xy, depth[view].astype(float))
    return se3.transform(piece.submap.T_s_c_raw[view], p_c)


def test_the_distortion_is_the_wave_at_each_point_and_bounded():
    piece = scene.piece(STREET, 3, [0, 1, 2], scale=2.0)
    depth = warped(piece.submap, piece.depth, IMAGE, 0.05, scene.SPACING)
    assert depth.dtype == np.float32
    share = depth / piece.depth - 1
    assert 0.045 < np.abs(share).max() < 0.0501
    # one wavelength up the street, 40 map units at 2 world units a raw one, it is the same again
    phase = np.random.default_rng([7, 3]).uniform(0, 2 * np.pi, 2)
    rate = 2 * np.pi / (WAVE * scene.SPACING / 2.0)
    p = lifted(piece, piece.depth, 4)
    wave = np.sin(rate * p[..., 2] + phase[0]) * np.cos(rate * p[..., 0] + phase[1])
    np.testing.assert_allclose(share[4], 0.05 * wave, atol=1e-5)


def test_submaps_are_distorted_each_in_its_own_way_and_not_without_an_amplitude():
    a, b = (scene.piece(STREET, k, [0, 1]) for k in (0, 1))
    wa, wb = (warped(p.submap, p.depth, IMAGE, 0.05, scene.SPACING) for p in (a, b))
    assert np.abs(wa / wb - 1).mean() > 0.01
    assert warped(a.submap, a.depth, IMAGE, 0.0, scene.SPACING) is a.depth


def test_raw_points_are_the_mapped_ones_in_the_raw_unit(tmp_path):
    piece = scene.piece(STREET, 5, [0, 1, 2], scale=2.5)
    config = MappingConfig()
    mapper = Mapper(config, scene.SPACING, tmp_path)
    mapper.add(piece.submap, piece.depth, piece.confidence, piece.images)
    built = Built(mapper, Spool(tmp_path), (piece.submap,), (), ())
    raw = raw_points(built, 0, config, scene.SPACING)
    points, _ = mapper.points(5)
    assert len(raw) == pytest.approx(len(points), rel=0.02)
    p_w = se3.transform(piece.submap.T_w_s, 2.5 * raw.astype(float))
    assert scene.distance_to_scene(STREET, p_w).max() < 1e-2
    # raw points do not depend on the rectification
    cameras = tuple(camera.with_focal(1.1 * camera.fx) for camera in piece.submap.cameras)
    bent = dataclasses.replace(piece.submap, cameras=cameras)
    np.testing.assert_array_equal(
        raw_points(dataclasses.replace(built, submaps=(bent,)), 0, config, scene.SPACING), raw
    )
