"""Intrinsic search of one camera: candidates, test bank and two-stage update (paper V-A).

A candidate is the camera that the backbone found in one sub-map. The test bank holds fundamental
matrices of image pairs, by which the candidates are scored.
"""

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

# older candidates are dropped, which bounds the time per sub-map
MAX_CANDIDATES = 64


class EyeSearch:
    """Candidates and test bank of one camera, and the camera and damping estimated from them.

    Without `weighted` and `refine` of the config it is the paper's search: `camera` is the
    candidate of least mean score, replaced by a new candidate with a lower score, and chosen again
    from all candidates after a new test group. `refine`: `camera` has the focal that
    minimises the score. `weighted`: `measured` is the bank's focal with a sigma, combined with
    candidates in pool.py.
    """

    def __init__(self, config: CorrectionConfig) -> None:
        self._config = config
        self.bank = TestBank(config)
        self._candidates: deque[Camera] = deque(maxlen=MAX_CANDIDATES)
        self._best: Camera | None = None
        self.measured = BankFocal(0.0, float(np.inf), np.zeros(0), 0.0)

    @property
    def camera(self) -> Camera | None:
        """Best estimate of the camera so far (K_global), undamped; None before any sub-map."""
        return self._best

    @property
    def log_focals(self) -> Float:
        """Log focals (C,) [log px] of the candidates, oldest first."""
        return np.log([camera.fx for camera in self._candidates])

    @property
    def is_informative(self) -> bool:
        """Whether the fundamental matrices of the test bank determine the focal."""
        return bool(np.isfinite(self.measured.log_sigma))

    @property
    def damping(self) -> float:
        """Share of the focal's error to correct, by the number of matrices in the bank (V-C)."""
        if not self.bank.groups:
            return 0.0
        if not self._config.adaptive_damping:
            return 1.0
        return damping.from_density(len(self.bank.F), self._config)

    def shape(self) -> Camera:
        """Camera with the candidates' median focal, aspect ratio and principal point."""
        focal = float(np.exp(np.median(self.log_focals)))
        aspect = float(np.median([camera.fy / camera.fx for camera in self._candidates]))
        return replace(median(self._candidates), fx=focal, fy=focal * aspect)

    def add_candidate(self, camera: Camera) -> None:
        """Stage one of the update: add the camera of a sub-map, which may replace the best."""
        self._candidates.append(camera)
        if self._best is None or self._is_better(camera, self._best):
            self._best = camera

    def add_group(self, group: BankGroup) -> None:
        """Add a test group and score all candidates again: stage two of the update."""
        shape, weighted = self.shape(), self._config.weighted
        start = np.exp(self.measured.log_focal) if self.is_informative else shape.fx
        if not self.bank.add(group, float(np.log(start)), self.measured.model_noise):
            return
        self.measured = bank_focal.minimise(self.bank, shape, start, weighted=weighted)
        if self._config.refine:
            self._best = shape.with_focal(float(np.exp(self.measured.log_focal)))
        else:
            self._best = self._best_candidate()

    def _is_better(self, camera: Camera, current: Camera) -> bool:
        if self._config.refine or not self.bank.groups:
            return False
        new, old = self._scores([camera, current])
        return bool(new < old)

    def _scores(self, cameras: Sequence[Camera]) -> Float:
        """Weighted mean scores (C,) of C cameras on the bank's fundamental matrices; 0: perfect."""
        scores = spectral.score_of(cameras, self.bank.F)
        return np.asarray(np.average(scores, -1, self.measured.weights))

    def _best_candidate(self) -> Camera:
        """The camera of least score among the candidates and the current one."""
        current = [] if self._best is None else [self._best]
        cameras = [*self._candidates, *current]
        return cameras[int(np.argmin(self._scores(cameras)))]


def median(cameras: Iterable[Camera]) -> Camera:
    """Camera with the median focals and principal point; the rest is that of the first one."""
    first, *rest = cameras
    rows = [(camera.fx, camera.fy, camera.cx, camera.cy) for camera in (first, *rest)]
    fx, fy, cx, cy = np.median(rows, 0).tolist()
    return replace(first, fx=fx, fy=fy, cx=cx, cy=cy)
