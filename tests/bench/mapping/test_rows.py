import dataclasses

import numpy as np
import pytest

from bench.baselines.chain import BaselineResult
from bench.mapping.build import Built, warped
from bench.mapping.rows import (
    VARIANTS,
    Cameras,
    baseline,
    judged,
    on_true_poses,
    ours,
)
from calm_edge.config import MappingConfig
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry import se3
from calm_edge.geometry.camera import back_project_each
from calm_edge.mapping.mapper import Mapper
from calm_edge.mapping.spool import Spool
from tests.mapping import scene

STREET = scene.street(7)
CONFIG = MappingConfig(max_range=24.0)
AWAY = se3.exp(np.array([3.0, 1.0, -2.0, 0.1, 0.7, -0.2]))


@pytest.fixture(scope="module")
def pieces():
    return scene.chain(STREET, 3, 6)


@pytest.fixture(scope="module")
def truth(pieces):
    t_ns = np.arange(12) * 10**8
    T_w_c = np.array([scene.pose_on_street(i) for i in range(12)])
    points = []
    for i in range(0, 12, 2):
        p = scene.piece(STREET, 0, [i])
        mapper_points = p.views(12.0)
        view, y, x = np.nonzero(mapper_points.usable)
        uv = mapper_points.to_image(view, np.stack([x, y], -1))
        z = 1 / mapper_points.inverse_depth[view, y, x].astype(float)
        p_c = back_project_each(mapper_points.cameras, view, uv, z)
        p_s = (mapper_points.T_s_c[view, :3, :3] @ p_c[..., None])[..., 0]
        p_s += mapper_points.T_s_c[view, :3, 3]
        points.append(se3.transform(p.submap.T_w_s, p_s))
    return Truth(t_ns, T_w_c, None, np.concatenate(points).astype(np.float32))


def built_of(pieces, folder, warp=0.0):
    mapper = Mapper(CONFIG, scene.SPACING, folder)
    for p in pieces:
        depth = warped(p.submap, p.depth, scene.IMAGE, warp, scene.SPACING)
        mapper.add(p.submap, depth, p.confidence, p.images)
    return Built(mapper, Spool(folder), tuple(p.submap for p in pieces), (), ())


def cameras_of(truth, T=None, unit=1.0, scale=False):
    T = np.eye(4) if T is None else T
    return Cameras(truth.t_ns, unit * se3.transform(T, truth.T_w_c[:, :3, 3]), scale)


def test_a_map_is_moved_to_the_truth_by_its_own_cameras(truth):
    moved = se3.transform(AWAY, truth.cloud.astype(float))
    halves = np.array_split(moved, 2)
    error = judged(halves, cameras_of(truth, AWAY), truth)
    assert error is not None and error.chamfer_m < 1e-3
    half = [0.5 * h for h in halves]
    assert judged(half, cameras_of(truth, AWAY, 0.5, True), truth).chamfer_m < 1e-3
    assert judged(half, cameras_of(truth, AWAY, 0.5, False), truth).chamfer_m > 0.3


def test_what_cannot_be_compared_is_said(truth):
    with pytest.raises(EvaluationError, match=r"no cloud\.npy"):
        judged([], cameras_of(truth), dataclasses.replace(truth, cloud=None))
    with pytest.raises(EvaluationError, match="2 cameras have a true pose"):
        judged([], Cameras(truth.t_ns[:2], np.zeros((2, 3)), False), truth)
    assert judged([], cameras_of(truth), truth) is None


def test_the_alignment_undoes_a_distortion_and_each_variant_is_a_map_of_its_own(
    pieces, truth, tmp_path
):
    built = built_of(pieces, tmp_path / "depth", 0.05)
    submaps = built.submaps
    rows = {q.name: q for q in ours(built, CONFIG, submaps, cameras_of(truth), truth, tmp_path)}
    assert list(rows) == [name for name, _ in VARIANTS]
    full, without = rows["full"], rows["without alignment"]
    assert full.seams.median_after < without.seams.median_after / 3
    assert without.seams.median_after == pytest.approx(without.seams.median_before)
    assert full.error.accuracy_m < without.error.accuracy_m
    assert len({q.error for q in rows.values()}) == len(VARIANTS)
    assert full.ghosts.points > 100 and full.ghosts.share < 0.05


def test_true_poses_take_the_drift_away(pieces, truth, tmp_path):
    drifted = [dataclasses.replace(p.submap, T_w_s=AWAY @ p.submap.T_w_s) for p in pieces]
    central = np.array([s.t_ns[s.n_primary // 2] for s in drifted])
    for placed, p in zip(on_true_poses(drifted, central, truth), pieces, strict=True):
        np.testing.assert_allclose(placed.T_w_s, p.submap.T_w_s, atol=1e-9)
    with pytest.raises(EvaluationError, match="1 sub-maps have no true pose"):
        on_true_poses(drifted, central + np.array([0, 0, 10**12]), truth)


def test_a_baseline_is_a_row_even_when_it_fails(pieces, truth, tmp_path):
    built = built_of(pieces, tmp_path)
    ids = np.arange(12)
    # a perfect chain: its transforms take raw points to a world of another unit
    transforms = np.array(
        [0.3 * p.submap.T_w_s @ np.diag([p.submap.scale] * 3 + [1]) for p in pieces]
    )
    transforms[:, 3] = [0, 0, 0, 1]
    T_w_c = truth.T_w_c.copy()
    T_w_c[:, :3, 3] *= 0.3
    result = BaselineResult("Sim(3)", ids, truth.t_ns, T_w_c, "", transforms)
    row = baseline(built, result, CONFIG, scene.SPACING, truth.t_ns, truth)
    assert row.name == "Sim(3)" and row.error is not None and row.error.accuracy_m < 0.1
    failed = dataclasses.replace(result, T_w_c=None, failed="sub-map 1 by 0: too few points")
    row = baseline(built, failed, CONFIG, scene.SPACING, truth.t_ns, truth)
    assert row.error is None and row.failed.startswith("sub-map 1")
