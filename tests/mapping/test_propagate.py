import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.mapping.extract import extract
from calm_edge.mapping.propagate import (
    carried,
    copy_forward,
    picture_keys,
    place,
    same_pictures,
    spread_back,
)
from calm_edge.types import AnchorTable
from tests.mapping import scene

STREET = scene.street(3)


def extracted(piece, first_id, seeds=None):
    return extract(
        piece.views(),
        AnchorTable.empty() if seeds is None else seeds,
        first_id,
        24,
        0.02,
        np.random.default_rng(0),
    )


def on_scene(piece, table):
    p_w = se3.transform(piece.submap.T_w_s, table.p_s)
    return scene.distance_to_scene(STREET, p_w)


@pytest.fixture(scope="module")
def chain():
    """Three sub-maps of 5 keyframes, overlapping by 3: 0 and 2 share one image per camera."""
    pieces = [scene.piece(STREET, k, list(range(2 * k, 2 * k + 5)), scale=1 + k) for k in range(3)]
    return pieces


@pytest.fixture(scope="module")
def far_chain():
    """Three sub-maps of which 0 and 2 have no common image."""
    return [scene.piece(STREET, k, list(range(3 * k, 3 * k + 6)), scale=1 + k) for k in range(3)]


def test_common_images_are_found_by_camera_and_time(chain):
    pairs = same_pictures(chain[0].submap, chain[1].submap)
    assert pairs.tolist() == [[2, 0], [7, 5], [3, 1], [8, 6], [4, 2], [9, 7]]
    looped = scene.piece(STREET, 9, [40, 41], loop=3)
    assert same_pictures(looped.submap, chain[0].submap).tolist() == [[4, 3]]
    # an assistant image with the same stamp is a different image
    assert picture_keys(looped.submap)[4] not in picture_keys(chain[0].submap)[5:]


def test_forward_seeds_keep_their_pixel_and_take_the_new_depth(chain):
    old, new = chain[0], chain[1]
    table = extracted(old, 0)
    pairs = same_pictures(old.submap, new.submap)
    seeds = copy_forward([(table, pairs)], new.views(), 0.02)
    seen = np.unique(table.seen_anchor[np.isin(table.seen_view, pairs[:, 0])])
    # the others are on edges, where the views of the new sub-map disagree
    assert len(seeds.anchor) > 0.85 * len(seen)
    assert np.isin(seeds.anchor, seen).all() and len(np.unique(seeds.anchor)) == len(seeds.anchor)
    assert np.quantile(on_scene(new, seeds), 0.95) < 0.01
    pixels = {
        (int(a), int(v)): tuple(uv)
        for a, v, uv in zip(table.seen_anchor, table.seen_view, table.uv, strict=True)
    }
    back = dict(pairs[:, ::-1].tolist())
    copied = sum(
        pixels.get((int(a), back.get(int(v), -1))) == tuple(uv)
        for a, v, uv in zip(seeds.seen_anchor, seeds.seen_view, seeds.uv, strict=True)
    )
    assert copied >= len(seeds.anchor)


def test_of_several_common_images_the_best_confirmed_is_used(chain):
    old, new = chain[0], chain[1]
    table = extracted(old, 0)
    pairs = same_pictures(old.submap, new.submap)
    depth = new.depth.copy()
    depth[0] *= 1.015
    views = scene.Piece(new.submap, depth, new.confidence, new.images).views()
    both = place(carried(table, pairs, np.empty(0, int)), views, 0.02)
    only = place(carried(table, pairs[:1], np.empty(0, int)), views, 0.02)
    shared, a, b = np.intersect1d(both.anchor, only.anchor, return_indices=True)
    assert len(shared) > 100
    assert np.median(on_scene(new, both)[a]) < 0.3 * np.median(on_scene(new, only)[b])


def test_observations_the_target_does_not_confirm_are_dropped(chain):
    old, new = chain[0], chain[1]
    table = extracted(old, 0)
    pairs = same_pictures(old.submap, new.submap)[:1]
    depth = new.depth.copy()
    depth[0] *= 1.2
    views = scene.Piece(new.submap, depth, new.confidence, new.images).views()
    seeds = copy_forward([(table, pairs)], views, 0.02)
    candidates = carried(table, pairs, np.empty(0, int))
    assert len(seeds.anchor) < 0.02 * len(candidates.seen_anchor)


def linked(pieces):
    def shared(at):
        return [
            (o.submap.id, pairs)
            for o in pieces
            if o.submap.id != at and len(pairs := same_pictures(pieces[at].submap, o.submap))
        ]

    return shared


def test_backward_propagation_recurses_to_the_submap_before_last(far_chain):
    shared = linked(far_chain)
    assert [o for o, _ in shared(2)] == [1]
    tables = {0: extracted(far_chain[0], 0), 1: extracted(far_chain[1], 10_000)}
    tables[2] = extracted(far_chain[2], 20_000)
    added = spread_back(2, tables, shared, lambda i: far_chain[i].views(), 0.02)
    assert set(added) == {0, 1}
    fresh = added[0].anchor[added[0].anchor >= 20_000]
    assert len(fresh) > 50
    # propagated through sub-map 1, each anchor once
    assert np.isin(fresh, added[1].anchor).all()
    for k in (0, 1):
        ids = np.concatenate([tables[k].anchor, added[k].anchor])
        assert len(ids) == len(np.unique(ids))
        assert np.quantile(on_scene(far_chain[k], added[k]), 0.95) < 0.01
    # a second propagation adds almost nothing
    tables = {
        k: AnchorTable.joined([tables[k], added[k]] if k in added else [tables[k]]) for k in tables
    }
    again = spread_back(2, tables, shared, lambda i: far_chain[i].views(), 0.02)
    assert sum(len(t.anchor) for t in again.values()) < 0.05 * len(fresh)


def test_a_loop_frame_carries_anchors_both_ways():
    old = scene.piece(STREET, 0, [0, 1, 2, 3])
    # the same place ten keyframes later, with one old image in the batch
    back = scene.piece(STREET, 1, [10, 11, 12], loop=2, pose=lambda i: scene.pose_on_street(i % 10))
    pieces = [old, back]
    pairs = same_pictures(old.submap, back.submap)
    assert pairs.tolist() == [[2, 6]]
    table = extracted(old, 0)
    seeds = copy_forward([(table, pairs)], back.views(), 0.02)
    assert len(seeds.anchor) > 200
    tables = {0: table, 1: extracted(back, 10_000)}
    added = spread_back(1, tables, linked(pieces), lambda i: pieces[i].views(), 0.02)
    assert (added[0].anchor >= 10_000).all() and len(added[0].anchor) > 200
    assert np.quantile(on_scene(old, added[0]), 0.8) < 0.01
    assert on_scene(old, added[0]).max() < 0.02 * 30


def test_depth_is_only_loaded_if_a_common_image_observes_an_anchor(far_chain):
    tables = {0: AnchorTable.empty(), 1: AnchorTable.empty(), 2: AnchorTable.empty()}

    def never(_):
        raise AssertionError("loaded")

    assert spread_back(2, tables, linked(far_chain), never, 0.02) == {}
