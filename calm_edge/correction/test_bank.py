"""Fundamental matrices of one eye that intrinsics are tried on: the test bank of paper V-A."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calm_edge.config import CorrectionConfig
from calm_edge.correction import spectral
from calm_edge.correction.matches import PairMatches
from calm_edge.correction.spectral import Telling
from calm_edge.geometry import epipolar
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.epipolar import Fundamental
from calm_edge.types import Float, Int

# image widths: from the widest pinhole lens to a long telephoto
FOCAL_RANGE = (0.3, 3.0)
_FOCALS = 12


@dataclass(frozen=True, slots=True)
class BankGroup:
    """F (P, 3, 3) px of one eye, x_b^T F x_a = 0, and what each can tell at any focal."""

    F: Float
    told: Telling


def focal_range(shape: Camera) -> tuple[float, float]:
    """Shortest and longest focal [px] looked for."""
    return FOCAL_RANGE[0] * shape.width, FOCAL_RANGE[1] * shape.width


class GroupBuilder:
    """Makes a group out of one sub-map's views of one eye, a share of the pairs at a time.

    views: batch indices, keyframe_ids: of these views. All pairs are tried; each keeps the
    matches only as long as the work lasts. A function of its arguments alone.
    """

    def __init__(
        self,
        matches: PairMatches,
        views: Sequence[int],
        keyframe_ids: Sequence[int],
        config: CorrectionConfig,
    ) -> None:
        self._matches, self._config = matches, config
        self._ids = dict(zip(views, keyframe_ids, strict=True))
        self._todo = list(combinations(views, 2))
        self._share = -(-len(self._todo) // max(config.group_every, 1))
        self._found: list[Fundamental] = []

    @property
    def done(self) -> bool:
        return not self._todo

    def advance(self) -> None:
        """The next share of the pairs: all are done after `group_every` calls."""
        pairs, self._todo = self._todo[: self._share], self._todo[self._share :]
        for view_a, view_b in pairs:
            ids = self._ids[view_a], self._ids[view_b]
            fit = epipolar.fundamental(
                *self._matches.pair(view_a, view_b), seed=(ids[0] * 8191 + ids[1]) % (1 << 31)
            )
            if fit is not None and fit.inliers.sum() >= self._config.n_feature:
                self._found.append(fit)

    def finish(self, shape: Camera) -> BankGroup | None:
        """The group, whatever pairs were still to do; None with fewer than n_pair pairs.

        shape: the best camera so far: what the group tells is weighed there.
        """
        while not self.done:
            self.advance()
        if len(self._found) < self._config.n_pair:
            return None
        F = np.stack([fit.F for fit in self._found])
        steps = np.stack([fit.steps for fit in self._found])
        told = spectral.telling(shape, F, steps, np.geomspace(*focal_range(shape), _FOCALS))
        return BankGroup(F, told)


class TestBank:
    """At most n_group groups of one eye.

    As in the paper a full bank takes no more. When `weighted`, a group that can tell more takes
    the place of the one that can tell least.
    """

    __test__ = False  # not a test case, whatever pytest makes of the name

    def __init__(self, config: CorrectionConfig) -> None:
        self._config = config
        self.groups: tuple[BankGroup, ...] = ()

    @property
    def is_closed(self) -> bool:
        """No further group can get in."""
        return len(self.groups) >= self._config.n_group and not self._config.weighted

    @property
    def F(self) -> Float:
        """(P, 3, 3) of all groups, in their order."""
        return np.concatenate([np.zeros((0, 3, 3)), *(group.F for group in self.groups)])

    def add(self, group: BankGroup, log_focal: float, model_noise: float = 0.0) -> bool:
        """Whether the group got in; what groups tell is compared at the focal [log px]."""
        if len(self.groups) < self._config.n_group:
            self.groups = (*self.groups, group)
            return True
        if self.is_closed:
            return False
        candidates = (*self.groups, group)
        told = [spectral.information(g.told, log_focal, model_noise).sum() for g in candidates]
        worst = int(np.argmin(told))
        if told[worst] >= told[-1]:
            return False
        self.groups = candidates[:worst] + candidates[worst + 1 :]
        return True

    def information(self, log_focal: float, model_noise: float = 0.0) -> Float:
        """(P,) on log focal, of every matrix, at a focal [log px]."""
        parts = [spectral.information(g.told, log_focal, model_noise) for g in self.groups]
        return np.concatenate([np.zeros(0), *parts])

    def noise(self, log_focal: float) -> Float:
        """(P,) one sigma of every matrix's score from its matches' noise, at a focal [log px]."""
        return np.concatenate([np.zeros(0), *(g.told.at(log_focal)[1] for g in self.groups)])

    def pull(self, log_focal: float) -> Float:
        """(P, 2) log focal moved by one sigma of the principal point, at a focal [log px]."""
        parts = [spectral.pull(g.told, log_focal) for g in self.groups]
        return np.concatenate([np.zeros((0, 2)), *parts])

    def group_of(self) -> Int:
        """(P,) which group each matrix belongs to."""
        return np.repeat(np.arange(len(self.groups)), [len(g.F) for g in self.groups])
