import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calm_edge.geometry import se3
from calm_edge.mapping import anchor_rows, fuse
from calm_edge.types import AnchorTable
from tests.mapping import scene


@pytest.fixture(scope="module")
def submaps():
    street = scene.street(0)
    return [scene.piece(street, k, list(range(3 * k, 3 * k + 5))).submap for k in range(3)]


def rows(submap_id, anchor, p_s) -> AnchorTable:
    return dataclasses.replace(
        anchor_rows.empty(),
        anchor=np.asarray(anchor),
        submap=np.full(len(anchor), submap_id),
        p_s=np.asarray(p_s, float),
    )


def test_the_weight_is_one_over_the_squared_distance_to_the_central_keyframe(submaps):
    centre = fuse.central_centre(submaps[1])
    np.testing.assert_array_equal(centre, submaps[1].T_s_c[2, :3, 3])
    w = fuse.weights(centre + np.array([[2.0, 0, 0], [0, 3, 4], [0, 0, 0]]), centre)
    np.testing.assert_allclose(w[:2], [1 / 4, 1 / 25])
    assert np.isfinite(w[2])


def test_fusion_is_the_weighted_mean_of_the_equation(submaps):
    rng = np.random.default_rng(0)
    anchors = [np.array([0, 1, 2]), np.array([1, 2]), np.array([2])]
    tables = [rows(k, a, rng.uniform(3, 9, (len(a), 3))) for k, a in enumerate(anchors)]
    fusion = fuse.nothing()
    for table, submap in zip(tables, submaps, strict=True):
        fusion = fuse.accumulate(fusion, table, submap)
    got = fuse.global_anchors(fusion, 0.1)
    assert got.n_observations.tolist() == [1, 2, 3]
    for a in range(3):
        top, bottom = np.zeros(3), 0.0
        for table, submap in zip(tables, submaps, strict=True):
            for i in np.flatnonzero(table.anchor == a):
                d = table.p_s[i] - submap.T_s_c[len(submap.primary_ids) // 2, :3, 3]
                top += (submap.T_w_s @ [*table.p_s[i], 1])[:3] / (d @ d)
                bottom += 1 / (d @ d)
        np.testing.assert_allclose(got.p_w[a], top / bottom)


def test_new_rows_change_only_their_own_anchors(submaps):
    rng = np.random.default_rng(1)
    first = fuse.accumulate(
        fuse.nothing(), rows(0, np.arange(50), rng.uniform(2, 9, (50, 3))), submaps[0]
    )
    touched = np.array([3, 7, 60])
    second = fuse.accumulate(first, rows(1, touched, rng.uniform(2, 9, (3, 3))), submaps[1])
    untouched = np.setdiff1d(np.arange(50), touched)
    np.testing.assert_array_equal(second.weighted[untouched], first.weighted[untouched])
    np.testing.assert_array_equal(second.n[untouched], 1)
    assert second.n[[3, 7, 60]].tolist() == [2, 2, 1]
    assert len(first.n) == 50


def test_the_map_moves_with_the_placement(submaps):
    table = rows(0, [0, 1], [[1.0, 2, 3], [4, 5, 6]])
    moved = dataclasses.replace(
        submaps[0], T_w_s=se3.exp(np.array([1.0, 2, 3, 0.1, 0.2, 0.3])) @ submaps[0].T_w_s
    )
    got = fuse.global_anchors(fuse.accumulate(fuse.nothing(), table, moved), 0.1).p_w
    np.testing.assert_allclose(got, se3.transform(moved.T_w_s, table.p_s))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 60), st.floats(0.05, 2.0))
def test_suppression_is_the_equation(seed, size, radius):
    rng = np.random.default_rng(seed)
    # a coarse lattice: many distances are exactly the radius when it is a multiple of 1/4
    p_w = rng.integers(0, 8, (size, 3)) / 4
    n = rng.integers(1, 5, size)
    radius = round(radius * 4) / 4 if seed % 2 else radius
    distance = np.linalg.norm(p_w[:, None] - p_w, axis=-1)
    beaten = ((distance <= radius) & (n[None, :] > n[:, None])).any(1)
    np.testing.assert_array_equal(fuse.suppress(p_w, n, radius), ~beaten)


def test_equally_observed_neighbours_live_side_by_side():
    assert fuse.suppress(np.zeros((5, 3)), np.full(5, 3), 1.0).all()
    assert len(fuse.suppress(np.zeros((0, 3)), np.zeros(0, int), 1.0)) == 0
