import dataclasses

import numpy as np
import pytest

from calm_edge.config import MappingConfig
from calm_edge.geometry import se3
from calm_edge.mapping.mapper import Mapper
from calm_edge.mapping.propagate import same_pictures
from calm_edge.mapping.skeleton import Skeleton
from calm_edge.mapping.views import MappingError
from tests.mapping import scene

STREET = scene.street(5)
N_SUBMAPS, N_VIEWS = 21, 4
LAST_KEYFRAME = N_SUBMAPS - 1 + N_VIEWS - 1
LOOP_KEYFRAME = 1
# range of 6 m: half-way, the start of the drive is out of range
CONFIG = MappingConfig(max_range=12.0)


def there_and_back(index: int) -> np.ndarray:
    """Poses T_w_c: half of the drive up the street, then backwards to the start."""
    return scene.pose_on_street(min(index, LAST_KEYFRAME - index))


def shrunk(p):
    return np.full(p.shape[:-1], -0.015)


@pytest.fixture(scope="module")
def drive():
    """21 sub-maps; the last has a keyframe of sub-map 0 as loop frame and depth 1.5 % too small."""
    pieces = []
    for k in range(N_SUBMAPS):
        last = k == N_SUBMAPS - 1
        pieces.append(
            scene.piece(
                STREET,
                k,
                list(range(k, k + N_VIEWS)),
                loop=LOOP_KEYFRAME if last else None,
                warp=shrunk if last else None,
                pose=there_and_back,
            )
        )
    return pieces


def without_loop(piece):
    s = piece.submap
    names = ("t_ns", "T_s_c_raw", "cameras_raw", "T_s_c", "cameras")
    cut = {name: getattr(s, name)[:-1] for name in names}
    submap = dataclasses.replace(s, **cut)
    return scene.Piece(submap, piece.depth[:-1], piece.confidence[:-1], piece.images[:-1])


def added(pieces, folder):
    mapper = Mapper(CONFIG, scene.SPACING, folder)
    for p in pieces:
        mapper.add(p.submap, p.depth, p.confidence, p.images)
    return mapper


@pytest.fixture(scope="module")
def looped(drive, tmp_path_factory):
    mapper = added(drive, tmp_path_factory.mktemp("looped"))
    return mapper, list(mapper.finish())


def ids(mapper, submap_id):
    return mapper._skeleton.tables[submap_id].anchor


def test_the_loop_frame_is_the_only_image_common_to_both_ends(drive):
    pairs = same_pictures(drive[0].submap, drive[-1].submap)
    assert pairs.tolist() == [[LOOP_KEYFRAME, 2 * N_VIEWS]]
    assert not len(same_pictures(drive[0].submap, without_loop(drive[-1]).submap))


def test_anchors_propagate_through_a_loop_both_ways(drive, looped, tmp_path):
    mapper, _ = looped
    last = N_SUBMAPS - 1
    shared = np.intersect1d(ids(mapper, 0), ids(mapper, last))
    born_before = shared < ids(mapper, 5).max()
    # seeds copied from sub-map 0 to the last one, and anchors of the last propagated back
    assert born_before.sum() > 100 and (~born_before).sum() > 20
    apart = added([*drive[:-1], without_loop(drive[-1])], tmp_path)
    assert len(np.intersect1d(ids(apart, 0), ids(apart, last))) == 0


def test_anchors_propagate_on_to_the_neighbours_of_the_loop_submap(looped):
    mapper, _ = looped
    came = np.setdiff1d(ids(mapper, 0), np.concatenate([ids(mapper, 4), ids(mapper, 5)]))
    came = np.intersect1d(came, ids(mapper, N_SUBMAPS - 2))
    assert len(came) > 20
    assert len(np.intersect1d(came, ids(mapper, 1))) > 0.5 * len(came)


def test_the_seam_of_a_loop_is_closed_by_the_deformation(looped):
    mapper, _ = looped
    (loop,) = [s for s in mapper.seams() if (s.submap_a, s.submap_b) == (0, N_SUBMAPS - 1)]
    before, after = (np.sqrt((gaps**2).mean()) for gaps in (loop.gaps_before, loop.gaps_after))
    print(f"loop seam {before:.3f} -> {after:.3f}, {len(loop.gaps_before)} anchors")
    assert len(loop.gaps_before) > 100 and before > 0.05
    assert after < before / 4


def test_anchors_of_a_loop_frame_lie_on_the_scene(drive, looped):
    mapper, tiles = looped
    assert len(tiles) == N_SUBMAPS
    p_w = se3.transform(drive[0].submap.T_w_s, mapper._skeleton.tables[0].p_s)
    assert np.quantile(scene.distance_to_scene(STREET, p_w), 0.95) < 0.02


def test_a_loop_view_without_depth_propagates_nothing(drive, tmp_path):
    """A loop keyframe that could not be placed has no depth and has no effect."""
    blind = drive[-1].depth.copy()
    blind[-1] = 0
    pieces = [*drive[:2], dataclasses.replace(drive[-1], depth=blind)]
    mapper = added(pieces, tmp_path)
    assert len(np.intersect1d(ids(mapper, 0), ids(mapper, N_SUBMAPS - 1))) == 0
    assert len(ids(mapper, N_SUBMAPS - 1)) > 100


def test_a_rejected_submap_leaves_the_state_unchanged(drive, tmp_path):
    skeleton = Skeleton(CONFIG, scene.SPACING, tmp_path, 0)
    first, second = drive[:2]
    skeleton.add(first.submap, first.depth, first.confidence, first.images)
    with pytest.raises(MappingError, match="sub-map 1: "):
        skeleton.add(second.submap, second.depth, second.confidence[:2], second.images)
    assert list(skeleton.tables) == [0]
    fresh = skeleton.add(second.submap, second.depth, second.confidence, second.images)
    assert set(fresh) == {0, 1} and skeleton.linked() == [(0, 1)]
    assert np.isin(fresh[0].anchor, fresh[1].anchor).all()
