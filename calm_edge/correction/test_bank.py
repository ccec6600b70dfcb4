"""Test bank of one camera: groups of fundamental matrices to score intrinsics on (paper V-A).

A group has the matrices of the image pairs of one sub-map, in undistorted pixels where the lens is
known.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from calm_edge.config import CorrectionConfig
from calm_edge.correction import spectral
from calm_edge.correction.matches import PairMatches, StoredMatches, undistorted
from calm_edge.correction.spectral import FocalSensitivity
from calm_edge.geometry import epipolar
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.epipolar import Fundamental
from calm_edge.types import Float, Int

# shortest and longest focal to search, in image widths
FOCAL_RANGE = (0.3, 3.0)
_FOCALS = 12


@dataclass(frozen=True, slots=True)
class BankGroup:
    """A test group: F (P, 3, 3) px of P image pairs of one camera, x_b^T F x_a = 0.

    The pixels of F are undistorted ones. sensitivity: of the scores of these matrices to the focal,
    and their noise. source: what it was built from, to build it again for another lens.
    """

    F: Float
    sensitivity: FocalSensitivity
    source: GroupSource | None = None


@dataclass(frozen=True, slots=True)
class GroupSource:
    """Matches, as taken, of the pairs of views of a group; keyframe_ids: by batch index."""

    keyframe_ids: dict[int, int]
    matches: StoredMatches = field(default_factory=lambda: StoredMatches({}))

    def builder(self, config: CorrectionConfig, camera: Camera) -> GroupBuilder:
        """Build the group again, in pixels undistorted by another camera."""
        ids = self.keyframe_ids
        again = GroupBuilder(self.matches, list(ids), list(ids.values()), config, camera)
        return again.among(self.matches.pixels)


def focal_range(shape: Camera) -> tuple[float, float]:
    """Shortest and longest focal [px] to search."""
    return FOCAL_RANGE[0] * shape.width, FOCAL_RANGE[1] * shape.width


class GroupBuilder:
    """Builds a test group from all pairs of a sub-map's views of one camera, in several steps.

    views: batch indices, keyframe_ids: of these views. camera: by which pixels are undistorted,
    None to take them as they are. Deterministic. The steps spread the time over several sub-maps;
    `matches` is kept until then.
    """

    def __init__(
        self,
        matches: PairMatches,
        views: Sequence[int],
        keyframe_ids: Sequence[int],
        config: CorrectionConfig,
        camera: Camera | None = None,
    ) -> None:
        self._matches, self._config, self._camera = matches, config, camera
        self._ids = dict(zip(views, keyframe_ids, strict=True))
        self._source = GroupSource(self._ids)
        self._todo = list(combinations(views, 2))
        self._share = -(-len(self._todo) // max(config.group_every, 1))
        self._found: list[Fundamental] = []

    def among(self, pairs: Collection[tuple[int, int]]) -> GroupBuilder:
        """Use these pairs of views alone."""
        self._todo = [pair for pair in self._todo if pair in pairs]
        return self

    @property
    def done(self) -> bool:
        return not self._todo

    def advance(self) -> None:
        """Estimate F for the next share of the pairs; all are done after `group_every` calls."""
        pairs, self._todo = self._todo[: self._share], self._todo[self._share :]
        for view_a, view_b in pairs:
            ids = self._ids[view_a], self._ids[view_b]
            taken = self._matches.pair(view_a, view_b)
            pixels = taken if self._camera is None else undistorted(self._camera, *taken)
            fit = epipolar.fundamental(*pixels, seed=(ids[0] * 8191 + ids[1]) % (1 << 31))
            if fit is not None and fit.inliers.sum() >= self._config.n_feature:
                self._found.append(fit)
                self._source.matches.pixels[view_a, view_b] = taken

    def finish(self, shape: Camera) -> BankGroup | None:
        """Process the remaining pairs and return the group; None if under n_pair pairs have an F.

        shape: current camera, for which the sensitivity is computed.
        """
        while not self.done:
            self.advance()
        if len(self._found) < self._config.n_pair:
            return None
        F = np.stack([fit.F for fit in self._found])
        steps = np.stack([fit.steps for fit in self._found])
        focals = np.geomspace(*focal_range(shape), _FOCALS)
        return BankGroup(F, spectral.focal_sensitivity(shape, F, steps, focals), self._source)


class TestBank:
    """The test groups of one camera, at most n_group.

    As in the paper, a full bank accepts no more groups; with `weighted`, a group with more
    information replaces the one with the least.
    """

    __test__ = False  # so that pytest does not collect this class, because of its name

    def __init__(self, config: CorrectionConfig) -> None:
        self._config = config
        self.groups: tuple[BankGroup, ...] = ()

    @property
    def is_closed(self) -> bool:
        """Whether no further group is accepted."""
        return len(self.groups) >= self._config.n_group and not self._config.weighted

    @property
    def F(self) -> Float:
        """Matrices (P, 3, 3) of all groups, in order."""
        return np.concatenate([np.zeros((0, 3, 3)), *(group.F for group in self.groups)])

    def add(self, group: BankGroup, log_focal: float, model_noise: float = 0.0) -> bool:
        """Add a group; returns whether it was accepted.

        log_focal: [log px] at which the information of groups is compared.
        """
        if len(self.groups) < self._config.n_group:
            self.groups = (*self.groups, group)
            return True
        if self.is_closed:
            return False
        candidates = (*self.groups, group)
        totals = [
            spectral.information(g.sensitivity, log_focal, model_noise).sum() for g in candidates
        ]
        worst = int(np.argmin(totals))
        if totals[worst] >= totals[-1]:
            return False
        self.groups = candidates[:worst] + candidates[worst + 1 :]
        return True

    def information(self, log_focal: float, model_noise: float = 0.0) -> Float:
        """Information (P,) of each matrix on the log focal, at a log focal [log px]."""
        parts = [spectral.information(g.sensitivity, log_focal, model_noise) for g in self.groups]
        return np.concatenate([np.zeros(0), *parts])

    def noise(self, log_focal: float) -> Float:
        """Sigma (P,) of each score due to noise of the matches, at a log focal [log px]."""
        return np.concatenate([np.zeros(0), *(g.sensitivity.at(log_focal)[1] for g in self.groups)])

    def centre_shift(self, log_focal: float) -> Float:
        """Shift (P, 2) of each matrix's best log focal per sigma of the principal point in x, y.

        log_focal: [log px] at which it is linearised.
        """
        parts = [spectral.centre_shift(g.sensitivity, log_focal) for g in self.groups]
        return np.concatenate([np.zeros((0, 2)), *parts])

    def group_of(self) -> Int:
        """Group index (P,) of each matrix."""
        return np.repeat(np.arange(len(self.groups)), [len(g.F) for g in self.groups])
