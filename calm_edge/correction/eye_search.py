"""What is held true of one eye: candidates, bank, and the two-stage update of paper V-A."""

from __future__ import annotations

from collections import deque

import numpy as np

from calm_edge.config import CorrectionConfig
from calm_edge.correction import bank_focal, damping, spectral
from calm_edge.correction.bank_focal import BankFocal
from calm_edge.correction.test_bank import BankGroup, TestBank
from calm_edge.types import Float

# older guesses are forgotten, so that a sub-map costs the same after an hour
MAX_CANDIDATES = 64


class EyeSearch:
    """One eye's guesses and bank, and the K (3, 3) px and damping the paper makes of them.

    Without the config's `weighted` and `refine`: the paper's search. K is the guess of least mean
    score; a new guess is taken when it scores lower, a new group judges all again. `refine`: the
    least score there is replaces the guess. `weighted`: `asked` is a measurement, for pool.py to
    weigh against the guesses.
    """

    def __init__(self, config: CorrectionConfig) -> None:
        self._config = config
        self.bank = TestBank(config)
        self._candidates: deque[Float] = deque(maxlen=MAX_CANDIDATES)
        self._best: Float | None = None
        self.asked = BankFocal(0.0, float(np.inf), np.zeros(0), 0.0)

    @property
    def K(self) -> Float | None:
        """(3, 3) px, the paper's choice; None before the first sub-map."""
        return self._best

    @property
    def log_focals(self) -> Float:
        """(C,) log px of the guesses, oldest first."""
        return np.log([K[0, 0] for K in self._candidates])

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

    def shape(self) -> Float:
        """(3, 3) px, the median guess: focal, aspect and principal point."""
        K = np.stack(self._candidates)
        focal = float(np.exp(np.median(np.log(K[:, 0, 0]))))
        aspect = float(np.median(K[:, 1, 1] / K[:, 0, 0]))
        median = np.median(K, 0)
        median[0, 0], median[1, 1] = focal, focal * aspect
        return np.asarray(median)

    def add_candidate(self, K: Float) -> None:
        """A sub-map's guess (3, 3) px: stage one of the update."""
        self._candidates.append(K)
        if self._best is None or self._beats(K, self._best):
            self._best = K

    def add_group(self, group: BankGroup) -> None:
        """Stage two: a group that gets into the bank judges every guess anew."""
        shape, weighted = self.shape(), self._config.weighted
        start = np.exp(self.asked.log_focal) if self.is_informed else shape[0, 0]
        if not self.bank.add(group, float(np.log(start)), self.asked.model_noise):
            return
        self.asked = bank_focal.minimise(self.bank, shape, start, weighted=weighted)
        if self._config.refine:
            self._best = spectral.at_focal(shape, np.exp(self.asked.log_focal))
        else:
            self._best = self._least()

    def _beats(self, K: Float, held: Float) -> bool:
        if self._config.refine or not self.bank.groups:
            return False
        new, old = self._scores(np.stack([K, held]))
        return bool(new < old)

    def _scores(self, K: Float) -> Float:
        """(C,) weighted mean scores of guesses (C, 3, 3) px."""
        scores = spectral.score(K, self.bank.F)
        return np.asarray(np.average(scores, -1, self.asked.weights))

    def _least(self) -> Float:
        """(3, 3) px: the guess of least score, the one held among them."""
        held = [] if self._best is None else [self._best]
        K = np.stack([*self._candidates, *held])
        return np.asarray(K[np.argmin(self._scores(K))])
