"""Chains of sub-maps: exact input gives exact poses, broken input a row with the reason."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from bench.baselines.chain import ALIGNMENTS, BaselineResult, LoopOverlap, chain
from bench.baselines.overlap import Correspondences
from calm_edge.backbones.base import BackboneError
from calm_edge.evaluation.trajectory import ate
from calm_edge.geometry.similarity import align
from tests.bench.baselines.chains import Drive, drive
from tests.drives import circle, curved

EVERY = pytest.mark.parametrize("name", ["sim3", "sl4", "spacing"])
LINEAR = pytest.mark.parametrize("name", ["sim3", "sl4"])
DRIVE = drive(curved(60))
BENT = drive(curved(60), bend=0.002)


def error(result: BaselineResult, truth: Drive) -> float:
    """Sim(3) ATE, world units."""
    assert result.T_w_c is not None, result.failed
    p, q = result.T_w_c[:, :3, 3], truth.T_w_p[:, :3, 3]
    return ate(align(p, q, with_scale=True).points(p), q)


@EVERY
def test_submaps_that_differ_by_a_similarity_become_one_drive(name: str) -> None:
    result = chain(ALIGNMENTS[name], DRIVE.submaps, DRIVE.overlaps())
    assert result.failed == ""
    # the first sub-map's scale is the unit, its frame the world
    assert np.allclose(result.T_w_c, DRIVE.T_w_p, atol=1e-7)
    assert result.keyframe_ids.tolist() == list(range(60))
    assert np.array_equal(result.t_ns, result.keyframe_ids * 100_000_000)
    p_s = DRIVE.matches(0, 3, DRIVE.points(3)).new
    assert np.allclose(result.transform_points(3, p_s), DRIVE.points(3), atol=1e-6)


def test_submaps_that_differ_by_a_homography_need_sl4() -> None:
    results = {n: chain(ALIGNMENTS[n], BENT.submaps, BENT.overlaps()) for n in ALIGNMENTS}
    assert np.allclose(results["sl4"].T_w_c, BENT.T_w_p, atol=1e-6)
    assert error(results["sim3"], BENT) > 0.05
    assert error(results["spacing"], BENT) > 0.05
    p_s = BENT.matches(0, 3, BENT.points(3)).new
    assert np.allclose(results["sl4"].transform_points(3, p_s), BENT.points(3), atol=1e-5)


@LINEAR
def test_a_loop_takes_the_scale_drift_out(name: str) -> None:
    ring = drive(circle(240, radius=40.0))
    drifting = [replace(m, new=1.03 * m.new) for m in ring.overlaps()]
    last = len(ring.submaps) - 1
    loop = LoopOverlap(0, last, ring.matches(0, last, ring.points(0)))
    opened = chain(ALIGNMENTS[name], ring.submaps, drifting)
    closed = chain(ALIGNMENTS[name], ring.submaps, drifting, [loop])
    assert (opened.loops, closed.loops) == (0, 1)
    assert error(opened, ring) > 3
    assert error(closed, ring) < error(opened, ring) / 4
    assert np.allclose(closed.transforms[0], opened.transforms[0])


@LINEAR
def test_loops_that_agree_move_nothing_and_useless_ones_are_left_out(name: str) -> None:
    exact = LoopOverlap(0, 3, DRIVE.matches(0, 3, DRIVE.points(3)))
    useless = LoopOverlap(0, 3, DRIVE.matches(0, 3, DRIVE.points(3, 2)))
    result = chain(ALIGNMENTS[name], DRIVE.submaps, DRIVE.overlaps(), [exact, useless])
    assert result.loops == 1
    assert np.allclose(result.T_w_c, DRIVE.T_w_p, atol=1e-5)


@LINEAR
def test_twice_the_same_bits(name: str) -> None:
    rng = np.random.default_rng(0)
    noisy = [replace(m, new=m.new + rng.normal(0, 0.05, m.new.shape)) for m in DRIVE.overlaps()]
    loop = LoopOverlap(0, 4, DRIVE.matches(0, 4, DRIVE.points(4)))
    a, b = (chain(ALIGNMENTS[name], DRIVE.submaps, noisy, [loop]) for _ in range(2))
    assert np.array_equal(a.T_w_c, b.T_w_c)
    assert np.array_equal(a.transforms, b.transforms)


def spoilt(k: int, **fields: np.ndarray) -> list[Correspondences]:
    overlaps = DRIVE.overlaps()
    overlaps[k] = replace(overlaps[k], **fields)
    return overlaps


def few(n: int) -> list[Correspondences]:
    overlaps, m = DRIVE.overlaps(), DRIVE.overlaps()[2]
    overlaps[2] = Correspondences(m.previous[:n], m.new[:n], m.weight[:n])
    return overlaps


NAN, ZERO = np.full((200, 3), np.nan), np.zeros((200, 3))


@LINEAR
@pytest.mark.parametrize(
    ("overlaps", "submap"),
    [
        (few(0), 3),
        (few(2), 3),
        (spoilt(1, previous=NAN), 2),
        (spoilt(0, new=ZERO, previous=ZERO), 1),
        (spoilt(0, weight=np.zeros(200)), 1),
        (DRIVE.overlaps()[:2], 3),
    ],
)
def test_a_failure_is_a_row(name: str, overlaps: list[Correspondences], submap: int) -> None:
    result = chain(ALIGNMENTS[name], DRIVE.submaps, overlaps)
    assert result.T_w_c is None
    assert f"sub-map {submap}" in result.failed and "\n" not in result.failed
    assert len(result.transforms) == submap
    assert len(result.keyframe_ids) == 60


@LINEAR
def test_points_beyond_all_floats_are_a_row(name: str) -> None:
    huge = [replace(m, new=1e-200 * m.new) for m in DRIVE.overlaps()]
    result = chain(ALIGNMENTS[name], DRIVE.submaps, huge)
    assert result.T_w_c is None and result.failed


def test_no_common_picture_is_a_row_of_the_spacing_too() -> None:
    apart = [DRIVE.submaps[0], replace(DRIVE.submaps[1], primary_ids=tuple(range(100, 115)))]
    result = chain(ALIGNMENTS["spacing"], apart, DRIVE.overlaps())
    assert (
        result.failed == "sub-map 1 cannot be aligned with 0: the sub-maps have no common picture"
    )


@LINEAR
def test_an_overlap_that_cannot_be_computed_is_a_row(name: str) -> None:
    def lazy() -> Iterator[Correspondences]:
        yield DRIVE.overlaps()[0]
        raise BackboneError("window 2: no depth")

    result = chain(ALIGNMENTS[name], DRIVE.submaps, lazy())
    assert result.failed == "window 2: no depth"
    assert len(result.transforms) == 2


@EVERY
def test_nothing_is_a_row(name: str) -> None:
    result = chain(ALIGNMENTS[name], [], [])
    assert result.T_w_c is None and result.failed == "no sub-map to chain"
    alone = chain(ALIGNMENTS[name], DRIVE.submaps[:1], [])
    assert np.allclose(alone.T_w_c, DRIVE.T_w_p[:15], atol=1e-9)
