import dataclasses

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.geometry.camera import project_each
from calm_edge.mapping.extract import cell_of, draw_candidates, extract
from calm_edge.types import AnchorTable
from tests.mapping import scene

STREET = scene.street(2)
GRID = 24


def run(piece, seed=0, seeds=None, first_id=0):
    return extract(
        piece.views(),
        AnchorTable.empty() if seeds is None else seeds,
        first_id,
        GRID,
        0.02,
        np.random.default_rng(seed),
    )


@pytest.fixture(scope="module")
def piece():
    return scene.piece(STREET, 4, list(range(5)), scale=0.4)


@pytest.fixture(scope="module")
def table(piece):
    return run(piece)


def test_candidates_are_one_random_usable_pixel_per_wanted_cell():
    rng = np.random.default_rng(0)
    usable = rng.random((50, 70)) > 0.7
    usable[:10] = False
    wanted = rng.random(36) > 0.3
    row, column = (((np.arange(n) + 0.5) * 6 / n).astype(int) for n in (50, 70))
    cell = (row[:, None] * 6 + column).ravel()
    drawn = np.array([draw_candidates(usable, wanted, 6, rng) for _ in range(300)])
    assert usable.ravel()[drawn].all()
    has_any = np.bincount(cell[usable.ravel()], minlength=36) > 0
    for picks in drawn[:5]:
        np.testing.assert_array_equal(np.sort(cell[picks]), np.flatnonzero(wanted & has_any))
    # uniform: all usable pixels of a cell are drawn about equally often
    first = drawn[:, 0]
    options = np.flatnonzero(usable.ravel() & (cell == cell[first[0]]))
    counts = np.array([(first == o).sum() for o in options])
    assert counts.min() > 0 and counts.max() < 5 * 300 / len(options)


def test_anchors_lie_on_the_scene(piece, table):
    p_w = se3.transform(piece.submap.T_w_s, table.p_s)
    assert len(table.anchor) > GRID * GRID
    assert scene.distance_to_scene(STREET, p_w).max() < 1e-3


def test_sightings_are_projections_in_pixels_of_the_full_image(piece, table):
    order = np.argsort(table.anchor)
    p_s = table.p_s[order[np.searchsorted(table.anchor[order], table.seen_anchor)]]
    T_c_s = se3.inverse(piece.submap.T_s_c)[table.seen_view]
    p_c = (T_c_s[:, :3, :3] @ p_s[..., None])[..., 0] + T_c_s[:, :3, 3]
    uv = project_each(piece.submap.cameras, table.seen_view, p_c)
    np.testing.assert_allclose(table.uv, uv, atol=1e-2)
    assert table.uv[:, 0].max() > scene.DEPTH[0]


def test_both_eyes_and_at_least_two_views_see_every_anchor(table):
    assert np.bincount(table.seen_anchor).min() >= 2
    assert set(table.seen_view) == set(range(10))


def test_the_first_frame_has_at_most_one_anchor_per_cell_and_later_ones_fill_gaps(piece, table):
    views = piece.views()
    # in the frame it was sampled from, an anchor is at a pixel centre
    xy = views.to_map(table.seen_view, table.uv)
    made = np.abs(xy - np.rint(xy)).max(-1) < 1e-4
    assert made.sum() == len(table.anchor)
    own = np.empty(len(table.anchor), int)
    own[table.seen_anchor[made]] = table.seen_view[made]
    assert (np.diff(own) >= 0).all() and len(set(own)) == 10
    place = table.seen_view * GRID**2 + cell_of(views, table.seen_view, table.uv, GRID)
    filled = np.empty(0, int)
    for t in range(10):
        batch = own[table.seen_anchor] == t
        fresh = place[batch & made]
        assert len(fresh) == len(np.unique(fresh))
        assert not np.isin(fresh, filled).any()
        filled = np.concatenate([filled, place[batch]])


def test_seeds_are_kept_and_occupy_their_cells(piece, table):
    again = run(piece, seed=5, seeds=table, first_id=len(table.anchor))
    np.testing.assert_array_equal(again.anchor[: len(table.anchor)], table.anchor)
    new = again.anchor[len(table.anchor) :]
    assert len(new) < 0.2 * len(table.anchor)
    assert (new >= len(table.anchor)).all()


def test_a_point_confirmed_by_no_other_frame_is_no_anchor(piece):
    depth = piece.depth.copy()
    depth[2, 40:90, 30:130] *= 0.7
    broken = dataclasses.replace(piece, depth=depth)
    table = run(broken)
    p_w = se3.transform(piece.submap.T_w_s, table.p_s)
    assert scene.distance_to_scene(STREET, p_w).max() < 0.02 * 30


def test_unconfident_pixels_make_no_anchors(piece):
    confidence = piece.confidence.copy()
    confidence[:, :, :80] = 0.5
    table = run(dataclasses.replace(piece, confidence=confidence))
    assert table.uv[:, 0].min() >= 79 * 2


def test_a_seed_repeats_the_anchors_bit_for_bit(piece, table):
    again, other = run(piece), run(piece, seed=1)
    for field in dataclasses.fields(table):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(table, field.name))
    assert not np.array_equal(other.p_s[:100], table.p_s[:100])
