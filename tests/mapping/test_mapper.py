import dataclasses
import pickle
import time
import tracemalloc

import numpy as np
import pytest

from calm_edge.config import MappingConfig
from calm_edge.geometry import se3
from calm_edge.mapping.fuse import suppress
from calm_edge.mapping.mapper import Mapper
from calm_edge.mapping.views import MappingError
from tests.mapping import scene

STREET = scene.street(0)


def warp(amplitude: float, phase: float) -> scene.Warp:
    """Smooth relative depth error that also changes along the sub-map."""

    def error(p):
        wave = np.sin(p[..., 2] / 6 + phase) * np.cos(p[..., 0] / 8)
        return amplitude * (wave + p[..., 2] / 40)

    return error


WARPS = [warp(0.03, 0.0), warp(-0.03, 1.0), warp(0.03, 2.0)]


def mapped(pieces, folder, seed=0, config=None):
    mapper = Mapper(config or MappingConfig(), scene.SPACING, folder, seed)
    for p in pieces:
        mapper.add(p.submap, p.depth, p.confidence, p.images)
    return mapper


@pytest.fixture(scope="module")
def exact():
    return scene.chain(STREET, 3, 8)


@pytest.fixture(scope="module")
def warped():
    return scene.chain(STREET, 3, 8, WARPS)


@pytest.fixture(scope="module")
def exact_map(exact, tmp_path_factory):
    mapper = mapped(exact, tmp_path_factory.mktemp("exact"))
    return mapper, list(mapper.finish())


@pytest.fixture(scope="module")
def warped_map(warped, tmp_path_factory):
    mapper = mapped(warped, tmp_path_factory.mktemp("warped"))
    return mapper, list(mapper.finish())


def anchors(mapper):
    """Every fused anchor: p_w (A, 3), n_observations (A,), active (A,)."""
    return *mapper._fusion.at(np.arange(len(mapper._fusion))), mapper._active()


def placed(mapper, anchor):
    """(sub-map id, position in it) of each placement of an anchor."""
    tables = mapper._skeleton.tables
    return [
        (k, tables[k].p_s[row])
        for k in tables
        for row in np.flatnonzero(tables[k].anchor == anchor)
    ]


def rms(seam):
    """Before and after the deformation."""
    return [np.sqrt((gaps**2).mean()) for gaps in (seam.gaps_before, seam.gaps_after)]


def test_perfect_depth_gives_back_the_scene(exact_map):
    mapper, tiles = exact_map
    assert len(tiles) == 3
    for tile in tiles:
        assert tile.points_w.dtype == np.float32 and tile.color.dtype == np.uint8
        assert len(tile.points_w) > 2000
        off = scene.distance_to_scene(STREET, tile.points_w.astype(float))
        assert off.mean() < 2e-3 and np.quantile(off, 0.99) < 0.03
        assert (tile.color == [30, 20, 10]).all()
    p_w, n, _ = anchors(mapper)
    assert np.bincount(n)[2:].sum() > 500
    off = scene.distance_to_scene(STREET, p_w)
    assert np.quantile(off, 0.95) < 0.01


def test_a_smooth_warp_is_undone_across_submaps(warped_map):
    seams = warped_map[0].seams()
    assert [(s.submap_a, s.submap_b) for s in seams] == [(0, 1), (1, 2)]
    for seam in seams:
        before, after = rms(seam)
        print(f"seam {before:.3f} -> {after:.3f}, {len(seam.gaps_before)} anchors")
        assert len(seam.gaps_before) > 300
        assert before > 0.1
        assert after < before / 3


def test_pixels_that_are_no_anchors_are_aligned_too(warped, warped_map):
    """Distances of the same pixels of a common image in both sub-maps, before and after."""
    mapper, _ = warped_map
    y, x = np.mgrid[30:92:3, 5:155:3]
    y, x = (
        a[warped[0].views().usable[5, y, x] & warped[1].views().usable[0, y, x]] for a in (y, x)
    )
    gaps = {}
    for use in (False, True):
        ends = []
        for k, view in ((0, 5), (1, 0)):
            piece, views = warped[k], warped[k].views()
            z = 1 / views.inverse_depth[view, y, x].astype(float)
            uv = views.to_image(np.full(z.shape, view), np.stack([x, y], -1))
            p_s = se3.transform(views.T_s_c[view], views.cameras[view].back_project(uv, z))
            if use:
                p_s = mapper.deformations()[k].apply(p_s)
            ends.append(se3.transform(piece.submap.T_w_s, p_s))
        gaps[use] = np.linalg.norm(ends[0] - ends[1], axis=1)
    print(f"pixels {gaps[False].mean():.3f} -> {gaps[True].mean():.3f}")
    assert gaps[True].mean() < gaps[False].mean() / 5


def test_anchors_propagate_back_by_two_submaps(exact, tmp_path):
    mapper = mapped(exact[:2], tmp_path)
    tables = mapper._skeleton.tables
    first_new = max(tables[k].anchor.max() for k in tables) + 1
    last = exact[2]
    mapper.add(last.submap, last.depth, last.confidence, last.images)
    # sub-map 0 has no image in common with sub-map 2, but anchors first extracted there
    assert not set(exact[0].submap.primary_ids) & set(last.submap.primary_ids)
    assert (tables[0].anchor >= first_new).sum() > 20
    for k in tables:
        assert len(np.unique(tables[k].anchor)) == len(tables[k].anchor)


def test_fused_positions_are_the_weighted_mean_of_the_table(exact, exact_map):
    mapper, _ = exact_map
    (p_w, n, active), tables = anchors(mapper), mapper._skeleton.tables
    np.testing.assert_array_equal(
        n, np.bincount(np.concatenate([t.anchor for t in tables.values()]))
    )
    most = int(np.argmax(n))
    top, bottom = np.zeros(3), 0.0
    for k, p_s in placed(mapper, most):
        submap = exact[k].submap
        w = 1 / ((p_s - submap.T_s_c[submap.n_primary // 2, :3, 3]) ** 2).sum()
        top, bottom = top + w * se3.transform(submap.T_w_s, p_s), bottom + w
    np.testing.assert_allclose(p_w[most], top / bottom)
    # 0.75 map units, and the world unit is half a map unit here
    expected = suppress(p_w, n, 0.75 * scene.SPACING)
    np.testing.assert_array_equal(active, expected)
    assert 0.5 < active.mean() < 0.99
    assert n[most] == 3


def test_newer_placements_move_the_whole_map(exact, tmp_path):
    T = se3.exp(np.array([5.0, -1, 2, 0.0, 0.4, 0]))
    moved = [dataclasses.replace(p.submap, T_w_s=T @ p.submap.T_w_s) for p in exact]
    for tile in mapped(exact, tmp_path).finish(moved):
        back = se3.transform(se3.inverse(T), tile.points_w.astype(float))
        assert np.quantile(scene.distance_to_scene(STREET, back), 0.99) < 0.03


def test_the_same_seed_gives_the_same_map(warped, warped_map, tmp_path):
    again = list(mapped(warped, tmp_path / "same").finish())
    for a, b in zip(warped_map[1], again, strict=True):
        np.testing.assert_array_equal(a.points_w, b.points_w)
        np.testing.assert_array_equal(a.color, b.color)
    other = list(mapped(warped[:2], tmp_path / "other", seed=1).finish())
    assert not np.array_equal(other[0].points_w, again[0].points_w)


def test_lengths_scale_with_the_world_unit(exact, exact_map, tmp_path):
    """A drive in another world unit gives the same map, scaled by the unit."""
    base = exact_map[1]
    unit = 4.0
    mapper = Mapper(MappingConfig(), scene.SPACING * unit, tmp_path)
    for p in exact:
        T_s_c, T_w_s = p.submap.T_s_c.copy(), p.submap.T_w_s.copy()
        T_s_c[:, :3, 3] *= unit
        T_w_s[:3, 3] *= unit
        submap = dataclasses.replace(
            p.submap, T_s_c=T_s_c, T_w_s=T_w_s, scale=p.submap.scale * unit
        )
        mapper.add(submap, p.depth, p.confidence, p.images)
    for tile, other in zip(base, mapper.finish(), strict=True):
        assert len(other.points_w) == pytest.approx(len(tile.points_w), rel=0.02)
        off = scene.distance_to_scene(STREET, other.points_w.astype(float) / unit)
        assert np.quantile(off, 0.99) < 0.03


SWITCHES = ({}, {"suppress": False}, {"distance_weight": False}, {"deform": False})


@pytest.mark.parametrize("switch", SWITCHES, ids=str)
def test_a_variant_is_the_map_of_its_config_without_extracting_again(
    warped, warped_map, tmp_path, switch
):
    config = dataclasses.replace(MappingConfig(), **switch)
    alone = mapped(warped, tmp_path / "alone", config=config)
    variant = warped_map[0].variant(config, tmp_path / "variant")
    for a, b in zip(alone.finish(), variant.finish(), strict=True):
        np.testing.assert_array_equal(a.points_w, b.points_w)
        np.testing.assert_array_equal(a.color, b.color)


def test_without_suppression_every_anchor_is_active(warped_map, tmp_path):
    mapper = warped_map[0].variant(MappingConfig(suppress=False), tmp_path)
    (full, _, steering), (free, _, all_steer) = anchors(warped_map[0]), anchors(mapper)
    assert all_steer.all() and not steering.all()
    np.testing.assert_allclose(free, full, rtol=1e-12)


def test_without_the_distance_weight_anchors_are_plain_means(warped, warped_map, tmp_path):
    plain = warped_map[0].variant(MappingConfig(distance_weight=False), tmp_path)
    p_w, n, _ = anchors(plain)
    most = int(np.argmax(n))
    ends = [se3.transform(warped[k].submap.T_w_s, p_s) for k, p_s in placed(plain, most)]
    np.testing.assert_allclose(p_w[most], np.mean(ends, axis=0))
    assert not np.allclose(p_w[most], anchors(warped_map[0])[0][most])


def test_without_deformation_points_are_only_moved_by_the_submap_pose(warped, warped_map, tmp_path):
    mapper = warped_map[0].variant(MappingConfig(deform=False), tmp_path)
    first = next(mapper.finish())
    points, _ = mapper.points(0)
    rigid = se3.transform(warped[0].submap.T_w_s, points).astype(np.float32)
    assert set(map(tuple, first.points_w)) <= set(map(tuple, rigid))
    list(mapper.finish())
    for seam in mapper.seams():
        assert seam.gaps_after == pytest.approx(seam.gaps_before) and rms(seam)[0] > 0.1


def test_infinite_stiffness_gives_rigid_motions(warped_map, tmp_path):
    mapper = warped_map[0].variant(MappingConfig(stiffness=np.inf), tmp_path)
    list(mapper.finish())
    assert not any(len(d.plate.controls) for d in mapper.deformations().values())
    for stiff, soft in zip(mapper.seams(), warped_map[0].seams(), strict=True):
        assert rms(soft)[1] < rms(stiff)[1] / 2


def test_what_stays_in_memory_of_a_submap_is_small(tmp_path):
    # 5 m range: nothing is visible from a sub-map six earlier
    mapper = Mapper(MappingConfig(max_range=10.0), scene.SPACING, tmp_path)
    pieces = scene.chain(STREET, 16, 4)
    held = []
    tracemalloc.start()
    for p in pieces:
        # a copy, so that the memory of the sub-map itself is counted
        mapper.add(pickle.loads(pickle.dumps(p.submap)), p.depth, p.confidence, p.images)
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    growth = (held[-1] - held[11]) / (len(held) - 12)
    print(f"{growth / 1000:.0f} kB a sub-map of 8 views")
    assert growth < 25_000 < 0.02 * pieces[0].depth.nbytes * 4


def test_the_map_has_one_point_per_voxel(exact, tmp_path):
    config = MappingConfig(cloud_voxel=1.0)
    points = np.concatenate(
        [t.points_w for t in mapped(exact[:2], tmp_path, config=config).finish()]
    )
    cells = np.floor(points.astype(float) / scene.SPACING)
    assert len(np.unique(cells, axis=0)) > 0.99 * len(cells)


def test_submaps_that_cannot_be_mapped_are_named(exact, tmp_path):
    mapper = mapped(exact[:1], tmp_path)
    first, second = exact[:2]
    with pytest.raises(MappingError, match="sub-map 0: added twice"):
        mapper.add(first.submap, first.depth, first.confidence, first.images)
    with pytest.raises(MappingError, match="sub-map 1: "):
        mapper.add(second.submap, second.depth, second.confidence[:3], second.images)
    # a rejected sub-map can be added later
    mapper.add(second.submap, second.depth, second.confidence, second.images)
    with pytest.raises(MappingError, match="sub-map 2: has a pose but no depth"):
        next(mapper.finish([exact[2].submap]))
    stretched = dataclasses.replace(first.submap, scale=2.0)
    with pytest.raises(MappingError, match="sub-map 0: scale or geometry changed"):
        next(mapper.finish([stretched]))


def test_an_empty_map_and_a_submap_without_depth_are_no_error(exact, tmp_path):
    assert list(Mapper(MappingConfig(), 1.0, tmp_path / "a").finish()) == []
    blind = dataclasses.replace(exact[0], depth=np.zeros_like(exact[0].depth))
    mapper = mapped([blind, exact[1]], tmp_path / "b")
    tiles = list(mapper.finish())
    assert len(tiles[0].points_w) == 0 and len(tiles[1].points_w) > 2000
    assert mapper.seams() == ()


def test_cost_of_a_submap_of_thirty_views(tmp_path):
    pieces = scene.chain(STREET, 2, 15)
    mapper = Mapper(MappingConfig(), scene.SPACING, tmp_path)
    for p in pieces:
        start = time.perf_counter()
        mapper.add(p.submap, p.depth, p.confidence, p.images)
        print(f"add sub-map {p.submap.id}: {time.perf_counter() - start:.2f} s")
    start = time.perf_counter()
    tiles = list(mapper.finish())
    print(f"tile: {(time.perf_counter() - start) / len(tiles):.2f} s")
    assert len(tiles) == 2
