from dataclasses import replace

import numpy as np
import pytest

from calm_edge.config import Config, merge
from calm_edge.estimator.rectifier import Calibration, Rectifier
from calm_edge.estimator.scale import ScaleError
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.through_lens import ThroughLens
from calm_edge.types import GlobalIntrinsics, Submap
from tests.drives import PERIOD_NS, START_NS, T_P_A, curved

N = 12
CAMERA = Perspective(500.0, 500.0, 319.5, 119.5, 640, 240)
SPACING = float(np.linalg.norm(T_P_A[:3, 3]))
ONE_FACTOR = merge(Config(), {"scale": {"rectify": False}})


def raw_submap(submap_id, unit, late_ns=0):
    """unit: raw units per metre."""
    T = np.concatenate([curved(N), curved(N) @ T_P_A])
    T[:, :3, 3] *= unit
    t_ns = START_NS + PERIOD_NS * np.tile(np.arange(N), 2)
    t_ns[N:] += late_ns
    cameras = (Perspective(500.0, 500.0, 319.5, 119.5, 640, 240),) * (2 * N)
    ids = tuple(range(N))
    sigma = np.full(2, 0.1)
    return Submap(submap_id, ids, ids, 0, t_ns, T, cameras, T, cameras, 1.0, np.eye(4), sigma)


def test_each_submap_has_its_own_factor():
    rectifier = Rectifier(Config(), estimates_kit=True)
    for k, unit in enumerate((1.0, 3.0)):
        assert rectifier.rectify(raw_submap(k, unit)).scale == pytest.approx(1 / (unit * SPACING))


def test_known_offsets_of_stamps_do_not_lengthen_the_spacing():
    off_ns = np.random.default_rng(0).normal(0, 5e6, N).astype(np.int64)
    submap = raw_submap(0, 1.0)
    submap.t_ns[N:] += off_ns
    rectifier = Rectifier(Config(), estimates_kit=True)
    corrected = replace(submap, stamps_off_ns=-off_ns)
    assert rectifier.rectify(corrected).scale == pytest.approx(1 / SPACING)
    assert rectifier.rectify(submap).scale < 0.999 / SPACING


def test_without_rectification_all_take_the_current_factor_of_the_first():
    rectifier = Rectifier(ONE_FACTOR, estimates_kit=True)
    first, second = raw_submap(3, 1.0), raw_submap(4, 3.0)
    for unit in (1.0, 2.0):
        # the first one is solved again, in another unit
        first = replace(first, T_s_c_raw=raw_submap(3, unit).T_s_c)
        placed = [rectifier.rectify(submap) for submap in (first, second)]
        assert [s.scale for s in placed] == pytest.approx([1 / (unit * SPACING)] * 2)
        assert np.allclose(placed[1].T_s_c[:, :3, 3], second.T_s_c[:, :3, 3] / (unit * SPACING))
        assert placed[1].T_s_c[-1, 3, 3] == 1


def test_without_rectification_only_the_first_needs_a_scale():
    elsewhere = 3600 * 1_000_000_000
    rectifier = Rectifier(ONE_FACTOR, estimates_kit=True)
    with pytest.raises(ScaleError):
        rectifier.rectify(raw_submap(0, 5.0, late_ns=elsewhere))
    placed = rectifier.rectify(raw_submap(1, 2.0))
    assert rectifier.rectify(raw_submap(2, 3.0, late_ns=elsewhere)).scale == placed.scale
    alone = replace(raw_submap(3, 3.0), assistant_ids=())
    with pytest.raises(ScaleError, match="no assistant"):
        rectifier.rectify(alone)


def test_a_sub_map_is_corrected_by_the_focals_found_behind_its_own_lens():
    before, after = (replace(CAMERA, fx=CAMERA.fx * s, fy=CAMERA.fy * s) for s in (0.9, 1.1))
    lens = replace(CAMERA, distortion=(-0.2,))
    optics = after.fx, after.fy, after.cx, after.cy, after.width, after.height
    behind = ThroughLens(*optics, lens=lens)
    other = replace(behind, lens=replace(lens, distortion=(-0.3,)))
    known = [GlobalIntrinsics((c, c), np.ones(2), np.full(2, 0.01)) for c in (before, behind)]
    calibration = Calibration(tuple(known), 0.0)
    raw = raw_submap(0, 1.0)

    def through(camera):
        cameras = (replace(camera, fx=500.0, fy=500.0),) * (2 * N)
        return replace(raw, cameras=cameras, cameras_raw=cameras)

    rectifier = Rectifier(Config(), estimates_kit=False)
    for camera, focal in ((CAMERA, before.fx), (behind, after.fx), (other, 500.0)):
        placed = rectifier.rectify(through(camera), calibration)
        assert [c.fx for c in placed.cameras] == pytest.approx([focal] * (2 * N))
        assert {type(c) for c in placed.cameras} == {type(camera)}
