import dataclasses
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calm_edge.geometry import se3
from calm_edge.mapping import fuse
from calm_edge.mapping.views import MappingError
from calm_edge.types import AnchorTable
from tests.mapping import scene


@pytest.fixture(scope="module")
def submaps():
    street = scene.street(0)
    return [scene.piece(street, k, list(range(3 * k, 3 * k + 5))).submap for k in range(3)]


def rows(anchor, p_s) -> AnchorTable:
    return dataclasses.replace(
        AnchorTable.empty(),
        anchor=np.asarray(anchor),
        p_s=np.asarray(p_s, float),
    )


def test_the_weight_is_one_over_the_squared_distance_to_the_central_keyframe(submaps):
    centre = fuse.central_centre(submaps[1])
    np.testing.assert_array_equal(centre, submaps[1].T_s_c[2, :3, 3])
    w = fuse.weights(centre + np.array([[2.0, 0, 0], [0, 3, 4], [0, 0, 0]]), centre)
    np.testing.assert_allclose(w[:2], [1 / 4, 1 / 25])
    assert np.isfinite(w[2])


def mean_of(tables, submaps, a, weigh):
    """Fused position of one anchor, by the equation of VI-C."""
    top, bottom = np.zeros(3), 0.0
    for table, submap in zip(tables, submaps, strict=True):
        for i in np.flatnonzero(table.anchor == a):
            d = table.p_s[i] - submap.T_s_c[len(submap.primary_ids) // 2, :3, 3]
            w = 1 / (d @ d) if weigh else 1.0
            top += (submap.T_w_s @ [*table.p_s[i], 1])[:3] * w
            bottom += w
    return top / bottom


@pytest.mark.parametrize("weigh", [True, False])
def test_fusion_is_the_weighted_or_plain_mean_of_vi_c(submaps, tmp_path, weigh):
    rng = np.random.default_rng(0)
    anchors = [np.array([0, 1, 2]), np.array([1, 2]), np.array([2])]
    tables = [rows(a, rng.uniform(3, 9, (len(a), 3))) for a in anchors]
    fusion = fuse.Fusion(tmp_path / "sums", distance_weight=weigh)
    for table, submap in zip(tables, submaps, strict=True):
        fusion.add(table, submap)
    p_w, n = fusion.at(np.arange(3))
    assert n.tolist() == [1, 2, 3] and len(fusion) == 3
    for a in range(3):
        np.testing.assert_allclose(p_w[a], mean_of(tables, submaps, a, weigh))
        other = mean_of(tables, submaps, a, not weigh)
        assert np.allclose(p_w[a], other) == (n[a] == 1)


def test_new_rows_change_only_their_own_anchors(submaps, tmp_path):
    rng = np.random.default_rng(1)
    fusion = fuse.Fusion(tmp_path / "sums")
    fusion.add(rows(np.arange(50), rng.uniform(2, 9, (50, 3))), submaps[0])
    before, _ = fusion.at(np.arange(50))
    touched = np.array([3, 7, 60])
    fusion.add(rows(touched, rng.uniform(2, 9, (3, 3))), submaps[1])
    after, n = fusion.at(np.arange(50))
    untouched = np.setdiff1d(np.arange(50), touched)
    np.testing.assert_array_equal(after[untouched], before[untouched])
    np.testing.assert_array_equal(n[untouched], 1)
    assert not np.allclose(after[[3, 7]], before[[3, 7]])
    assert fusion.at(touched)[1].tolist() == [2, 2, 1]
    assert len(fusion) == 61
    fusion.clear()
    assert len(fusion) == 0


def test_the_memory_of_an_update_does_not_grow_with_the_drive(submaps, tmp_path):
    rng = np.random.default_rng(2)
    peaks = []
    for n_before in (100, 400_000):
        fusion = fuse.Fusion(tmp_path / f"sums{n_before}")
        fusion.add(rows([n_before], [[1.0, 2, 3]]), submaps[0])
        new = rows(np.arange(n_before + 1, n_before + 500), rng.uniform(2, 9, (499, 3)))
        tracemalloc.start()
        fusion.add(new, submaps[1])
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


def test_the_map_moves_with_the_placement(submaps, tmp_path):
    table = rows([0, 1], [[1.0, 2, 3], [4, 5, 6]])
    moved = dataclasses.replace(
        submaps[0], T_w_s=se3.exp(np.array([1.0, 2, 3, 0.1, 0.2, 0.3])) @ submaps[0].T_w_s
    )
    fusion = fuse.Fusion(tmp_path / "sums")
    fusion.add(table, moved)
    got, _ = fusion.at(np.array([1, 0]))
    np.testing.assert_allclose(got, se3.transform(moved.T_w_s, table.p_s[::-1]))


def test_slab_by_slab_gives_the_same_anchors_as_all_at_once(submaps, tmp_path, monkeypatch):
    monkeypatch.setattr(fuse, "SLAB", 37)
    rng = np.random.default_rng(3)
    fusion = fuse.Fusion(tmp_path / "sums")
    p_s = rng.uniform([0, 0, 0], [4, 2, 30], (1500, 3))
    for k, submap in enumerate(submaps):
        seen = np.flatnonzero(rng.random(1500) < (1.0 if k == 0 else 0.4))
        fusion.add(rows(seen, p_s[seen]), submap)
    p_w, n = fusion.at(np.arange(len(fusion)))
    for radius in (0.3, 1.5):
        active = fusion.active(radius)
        np.testing.assert_array_equal(active, fuse.suppress(p_w, n, radius))
        assert 0.05 < active.mean() < 0.95
    assert len(fuse.Fusion(tmp_path / "none").active(1.0)) == 0


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(MappingError, match="sums: cannot be written"):
        fuse.Fusion(tmp_path / "missing" / "sums")


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 60), st.floats(0.05, 2.0))
def test_suppression_is_the_equation_of_vi_c(seed, size, radius):
    rng = np.random.default_rng(seed)
    # points on a lattice of 1/4: many distances equal the radius exactly
    p_w = rng.integers(0, 8, (size, 3)) / 4
    n = rng.integers(1, 5, size)
    radius = round(radius * 4) / 4 if seed % 2 else radius
    distance = np.linalg.norm(p_w[:, None] - p_w, axis=-1)
    beaten = ((distance <= radius) & (n[None, :] > n[:, None])).any(1)
    np.testing.assert_array_equal(fuse.suppress(p_w, n, radius), ~beaten)


def test_equally_observed_neighbours_are_both_active():
    assert fuse.suppress(np.zeros((5, 3)), np.full(5, 3), 1.0).all()
    assert len(fuse.suppress(np.zeros((0, 3)), np.zeros(0, int), 1.0)) == 0
