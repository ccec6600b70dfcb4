from __future__ import annotations

import numpy as np
import pytest

import calm_edge.loops.same_place as same_place_module
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.sift import Features
from calm_edge.loops.same_place import KnownKit, rig_between, same_place, seen_again, triangulated
from calm_edge.types import Float

SIZE = np.array([640, 240])
T_P_A = se3.exp(np.array([1.0, 0.03, 0.05, 0.02, -0.06, 0.01]))
PRIMARY, ASSISTANT = Perspective.from_hfov(80, 640, 240), Perspective.from_hfov(65, 640, 240)
KIT = KnownKit((PRIMARY, ASSISTANT), T_P_A)
T_Q_PAST = se3.exp(np.array([0.6, 0.02, 1.4, 0.01, 0.05, 0.0]))
# the assistant is exposed 20 ms later, at 13 m/s in a bend
T_LATE = se3.exp(np.array([0.0, 0.0, 0.5, 0.0, 0.008, 0.0]))


def scene(n=160, nearest=6.0, farthest=60.0, seed=0) -> Float:
    """Points (n, 3) in the query camera, spacings, visible in all three images."""
    rng = np.random.default_rng(seed)
    z = np.exp(rng.uniform(np.log(nearest), np.log(farthest), n))
    return np.c_[rng.uniform(-0.45, 0.45, n) * z, rng.uniform(-0.2, 0.2, n) * z, z]


def pictures(points, T_past=T_Q_PAST, noise_px=0.3, seed=1, T_a=T_P_A @ T_LATE):
    """Query, assistant and earlier features of points, each with its own descriptor."""
    rng = np.random.default_rng(seed)
    vector = np.abs(rng.standard_normal((len(points), 128)))
    vector /= np.linalg.norm(vector, axis=1, keepdims=True)
    out = []
    for T, camera in zip((np.eye(4), T_a, T_past), (PRIMARY, ASSISTANT, PRIMARY), strict=True):
        uv = camera.project(se3.transform(se3.inverse(T), points))
        uv = uv + noise_px * rng.standard_normal(uv.shape)
        out.append(Features(uv.astype(np.float32), vector.astype(np.float32)))
    return out


def test_a_return_is_confirmed_with_its_pose():
    found = same_place(*pictures(scene()), KIT, SIZE, 121)
    off = se3.log(se3.inverse(T_Q_PAST) @ found.T_query_match)
    assert np.linalg.norm(off[:3]) < 0.15 and np.linalg.norm(off[3:]) < 0.01
    assert found.is_same


def test_too_few_matches_confirm_nothing():
    assert same_place(*pictures(scene(24)), KIT, SIZE, 30) is None


def test_a_far_ridge_confirms_nothing():
    """Hundreds of matches on one geometry, but none near enough for stereo depth."""
    far = pictures(scene(nearest=400.0, farthest=4000.0))
    assert same_place(*far, KIT, SIZE, 30) is None


def test_one_object_in_a_corner_confirms_nothing():
    points = scene()
    points = points[(points[:, 0] > 0.25 * points[:, 2])]
    points = np.concatenate([points, points * 1.1, points * 1.2])
    assert len(points) > 60
    assert same_place(*pictures(points), KIT, SIZE, 30) is None


def test_points_at_another_stereo_depth_confirm_nothing():
    """The earlier image agrees with the primary alone: another scene at the same pixels."""
    points = scene()
    query, assistant, _ = pictures(points)
    depth = np.random.default_rng(5).permutation(points[:, 2:])
    other = pictures(points / points[:, 2:] * depth)[2]
    assert same_place(query, assistant, other, KIT, SIZE, 30) is None


def test_a_look_alike_confirms_nothing():
    """Half of the points are the same and in place; the others are missing."""
    points = scene()
    query, assistant, past = pictures(points)
    same = np.arange(len(points)) < 70
    stranger = np.abs(np.random.default_rng(7).standard_normal((len(points), 128)))
    stranger /= np.linalg.norm(stranger, axis=1, keepdims=True)
    vector = np.where(same[:, None], past.vector, stranger).astype(np.float32)
    found = same_place(query, assistant, Features(past.uv, vector), KIT, SIZE, 60)
    assert not found.is_same
    # only the share decides: without the missing points it would pass
    seen = (Features(f.uv[same], f.vector[same]) for f in (query, assistant, past))
    assert same_place(*seen, KIT, SIZE, 30).is_same


def test_a_place_too_far_away_or_turned_is_no_return():
    turned = se3.exp(np.array([0, 0, 0, 0, 0, np.radians(75.0)]))
    for T in (se3.exp(np.array([0, 0, -60.0, 0, 0, 0])), turned):
        assert same_place(*pictures(scene(), T), KIT, SIZE, 30) is None


def test_the_rig_includes_the_motion_between_two_exposures():
    points = scene()
    query, assistant, _ = pictures(points, noise_px=0.1)
    uv_p, uv_a = query.uv.astype(np.float64), assistant.uv.astype(np.float64)
    T_p_a = se3.inverse(rig_between(uv_p, uv_a, KIT))
    true = T_P_A @ T_LATE
    direction = T_p_a[:3, 3] / np.linalg.norm(T_p_a[:3, 3])
    assert direction @ true[:3, 3] / np.linalg.norm(true[:3, 3]) > np.cos(np.radians(6.0))
    off = np.linalg.norm(se3.so3_log(T_p_a[:3, :3].T @ true[:3, :3]))
    assert off < 0.4 * np.linalg.norm(se3.so3_log(T_LATE[:3, :3]))


def test_near_points_have_stereo_parallax():
    points = np.concatenate([scene(20, 5, 20), scene(20, 2000, 4000)])
    query, assistant, _ = pictures(points, noise_px=0.0, T_a=T_P_A)
    T_a_p = se3.inverse(T_P_A)
    uv_p, uv_a = query.uv.astype(np.float64), assistant.uv.astype(np.float64)
    found, near = triangulated(uv_p, uv_a, KIT, T_a_p)
    assert near.tolist() == [True] * 20 + [False] * 20
    assert found[:20] == pytest.approx(points[:20], rel=1e-3)


def test_seen_again_is_the_share_found():
    points = scene()
    query, _, past = pictures(points, noise_px=0.0)

    def share(points, past):
        return seen_again(points, query.vector, past, (PRIMARY, PRIMARY), T_Q_PAST, SIZE)

    moved = Features(past.uv + np.float32(same_place_module.SEEN_AGAIN_PX + 1), past.vector)
    assert share(points, past) == 1.0
    assert 0.35 < share(points, Features(past.uv[::2], past.vector[::2])) < 0.65
    assert share(points, moved) == 0.0
    assert share(points * [1, 1, -1], past) == 0.0
    assert share(points, Features(past.uv[:0], past.vector[:0])) == 0.0


def test_many_points_in_one_cell_count_as_one_cell():
    corner = np.c_[np.linspace(0.30, 0.31, 300), np.full(300, 0.1), np.ones(300)] * 20
    rest = scene(60)
    points = np.concatenate([corner, rest])
    query, _, past = pictures(points, noise_px=0.0)
    only_corner = Features(past.uv[:300], past.vector[:300])
    assert seen_again(points, query.vector, only_corner, (PRIMARY, PRIMARY), T_Q_PAST, SIZE) < 0.1
