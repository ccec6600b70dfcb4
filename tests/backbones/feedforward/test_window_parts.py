"""Splitting of windows into overlapping parts, and stitching of their results."""

from __future__ import annotations

import numpy as np
import pytest

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.feedforward.decode.decoder import Decoded
from calm_edge.backbones.feedforward.window_parts import around, overlap, split, stitch
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.similarity import Similarity


def stamps(n: int):
    """Stamps of n primary views and of n assistant ones shortly after these."""
    t = 100 * np.arange(n)
    return np.concatenate([t, t + 17])


@pytest.mark.parametrize("cap", [2, 3, 4, 7, 9, 29, 30, 40])
def test_every_view_is_in_a_part_and_neighbours_overlap(cap):
    t_ns = stamps(15)
    parts = split(t_ns, cap)
    assert 0 in parts[0] and max(map(len, parts)) <= cap
    assert set(np.concatenate(parts).tolist()) == set(range(30))
    seen = set(parts[0].tolist())
    for part in parts[1:]:
        assert len(part) == cap and len(set(part.tolist())) == cap
        assert len(seen & set(part.tolist())) >= overlap(cap) >= 1
        seen |= set(part.tolist())
    if cap >= 3:
        # both cameras in each part: the scale needs them
        assert all((part < 15).any() and (part >= 15).any() for part in parts)


def test_a_first_view_that_is_not_the_earliest():
    """Parts are then ordered outwards from that of view 0, first forward, then backward."""
    t_ns = np.array([500, 600, 0, 100, 200, 300, 400])
    parts = split(t_ns, 3)
    assert 0 in parts[0]
    seen = set(parts[0].tolist())
    for part in parts[1:]:
        assert seen & set(part.tolist())
        seen |= set(part.tolist())
    assert seen == set(range(7))


def test_around_is_the_view_and_its_neighbours_in_time():
    assert around(np.array([0, 10, 21, 33, 50]), 2, 4).tolist() == [2, 1, 3]
    assert around(np.array([0, 10, 21]), 1, 2).tolist() == [1]


def window(n: int, seed: int = 0) -> Decoded:
    """Random poses and depth in the frame of view 0."""
    rng = np.random.default_rng(seed)
    T = se3.exp(rng.normal(0, 0.4, (n, 6)))
    focals = (100 + rng.random(n)).tolist()
    cameras = tuple(Perspective(f, f, 3.5, 2.5, 8, 6) for f in focals)
    depth = rng.uniform(2, 9, (n, 6, 8)).astype(np.float32)
    return Decoded(cameras, se3.inverse(T[0]) @ T, depth, rng.random((n, 6, 8)).astype(np.float32))


def of_part(whole: Decoded, part, scale: float, noise: float = 0.0, seed: int = 0) -> Decoded:
    """Result of a run on a part alone: frame of its first view, a unit of its own."""
    T = whole.T_s_c[part]
    T = se3.inverse(T[0]) @ T
    rng = np.random.default_rng(seed)
    depth = whole.depth[part] * scale * np.exp(noise * rng.normal(size=whole.depth[part].shape))
    own = Similarity(scale, np.eye(3), np.zeros(3)).poses(T)
    own = own @ se3.exp(noise * rng.normal(size=(len(part), 6)))
    cameras = tuple(whole.cameras[i] for i in part)
    return Decoded(cameras, own, depth.astype(np.float32), whole.strength[part])


@pytest.mark.parametrize("cap", [2, 3, 6, 11])
def test_stitched_parts_are_the_whole(cap):
    whole = window(12)
    parts = split(stamps(6), cap)
    scales = np.exp(np.linspace(0, 1, len(parts)))
    solved = [of_part(whole, p, s) for p, s in zip(parts, scales, strict=True)]
    found = stitch(12, parts, solved)
    assert found.T_s_c == pytest.approx(whole.T_s_c, abs=1e-5)
    assert found.depth == pytest.approx(whole.depth, rel=1e-5)
    assert found.cameras == whole.cameras and np.array_equal(found.strength, whole.strength)


def test_noise_is_averaged_over_what_is_shared():
    whole = window(12)
    parts = split(stamps(6), 8)
    solved = [of_part(whole, p, 1 + i, 0.01, i) for i, p in enumerate(parts)]
    found = stitch(12, parts, solved)
    assert found.T_s_c == pytest.approx(whole.T_s_c, abs=0.08)
    assert np.median(found.depth[11] / whole.depth[11]) == pytest.approx(1, abs=0.01)


def test_depth_of_low_confidence_does_not_affect_the_scale():
    whole = window(12)
    parts = split(stamps(6), 8)
    solved = [of_part(whole, p, 2.0) for p in parts]
    unsure = solved[1].strength < 0.4
    solved[1].depth[unsure] *= 5
    found = stitch(12, parts, solved)
    # all results are in the unit of the first part
    assert found.T_s_c[:, :3, 3] == pytest.approx(2 * whole.T_s_c[:, :3, 3], abs=1e-4)


def test_parts_that_share_no_depth_cannot_be_joined():
    whole = window(12)
    parts = split(stamps(6), 8)
    solved = [of_part(whole, p, 1.0) for p in parts]
    solved[1].depth[:] = 0
    with pytest.raises(BackboneError, match="share no depth"):
        stitch(12, parts, solved)
