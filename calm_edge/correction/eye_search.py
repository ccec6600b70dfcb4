"""What is held true of one eye: candidates, bank, and the two-stage update of paper V-A."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from calm_edge.config import CorrectionConfig
from calm_edge.correction import bank_focal, damping, spectral
from calm_edge.correction.bank_focal import BankFocal
from calm_edge.correction.test_bank import BankGroup, TestBank
from calm_edge.geometry.camera import Camera
from calm_edge.types import Float

# older guesses are forgotten, so that a sub-map costs the same after an hour
MAX_CANDIDATES = 64


class EyeSearch:
    """One eye's guesses and bank, and the camera and damping the paper makes of them.

    Without the config's `weighted` and `refine`: the paper's search. `camera` is the guess of least
    mean score; a new guess is taken when it scores lower, a new group judges all again. `refine`:
    the least score there is replaces the guess. `weighted`: `asked` is a measurement, for pool.py
    to weigh against the guesses.
    """

    def __init__(self, config: CorrectionConfig) -> None:
        self._config = config
        self.bank = TestBank(config)
        self._candidates: deque[Camera] = deque(maxlen=MAX_CANDIDATES)
        self._best: Camera | None = None
        self.asked = BankFocal(0.0, float(np.inf), np.zeros(0), 0.0)

    @property
    def camera(self) -> Camera | None:
        """The paper's choice; None before the first sub-map."""
        return self._best

    @property
    def log_focals(self) -> Float:
        """(C,) log px of the guesses, oldest first."""
        return np.log([camera.fx for camera in self._candidates])

    @property
    def is_informed(self) -> bool:
        """Whether the bank's verdict is that it can tell the focal."""
        return bool(np.isfinite(self.asked.log_sigma))

    @property
    def damping(self) -> float:
        """The paper's, by how many matrices there are (V-C)."""
        if not self.bank.groups:
            return 0.0
        if not self._config.adaptive_damping:
            return 1.0
        return damping.from_density(len(self.bank.F), self._config)

    def shape(self) -> Camera:
        """The median guess: focal, aspect and principal point."""
        focal = float(np.exp(np.median(self.log_focals)))
        aspect = float(np.median([camera.fy / camera.fx for camera in self._candidates]))
        return replace(median(self._candidates), fx=focal, fy=focal * aspect)

    def add_candidate(self, camera: Camera) -> None:
        """A sub-map's guess: stage one of the update."""
        self._candidates.append(camera)
        if self._best is None or self._beats(camera, self._best):
            self._best = camera

    def add_group(self, group: BankGroup) -> None:
        """Stage two: a group that gets into the bank judges every guess anew."""
        shape, weighted = self.shape(), self._config.weighted
        start = np.exp(self.asked.log_focal) if self.is_informed else shape.fx
        if not self.bank.add(group, float(np.log(start)), self.asked.model_noise):
            return
        self.asked = bank_focal.minimise(self.bank, shape, start, weighted=weighted)
        if self._config.refine:
            self._best = shape.with_focal(float(np.exp(self.asked.log_focal)))
        else:
            self._best = self._least()

    def _beats(self, camera: Camera, held: Camera) -> bool:
        if self._config.refine or not self.bank.groups:
            return False
        new, old = self._scores([camera, held])
        return bool(new < old)

    def _scores(self, cameras: Sequence[Camera]) -> Float:
        """(C,) weighted mean scores of guesses."""
        scores = spectral.score_of(cameras, self.bank.F)
        return np.asarray(np.average(scores, -1, self.asked.weights))

    def _least(self) -> Camera:
        """The guess of least score, the one held among them."""
        held = [] if self._best is None else [self._best]
        cameras = [*self._candidates, *held]
        return cameras[int(np.argmin(self._scores(cameras)))]


def median(cameras: Iterable[Camera]) -> Camera:
    """The first of the cameras with the median focals and centre of all."""
    first, *rest = cameras
    rows = [(camera.fx, camera.fy, camera.cx, camera.cy) for camera in (first, *rest)]
    fx, fy, cx, cy = np.median(rows, 0).tolist()
    return replace(first, fx=fx, fy=fy, cx=cx, cy=cy)
