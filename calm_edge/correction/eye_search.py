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
    """K (3, 3) px, log_sigma of its focal (inf where no matrix could tell) and damping.

    Without the config's `weighted` and `refine`: the paper's search. K is the guess of least mean
    score; a new guess is taken when it scores lower, a new group judges all again. `refine`: the
    least score there is replaces the guess. `weighted`: a bank that cannot tell leaves K at the
    median of the guesses and damping at 0.
    """

    def __init__(self, config: CorrectionConfig) -> None:
        self._config = config
        self.bank = TestBank(config)
        self._candidates: deque[Float] = deque(maxlen=MAX_CANDIDATES)
        self._best: Float | None = None
        self._asked = BankFocal(0.0, float(np.inf), np.zeros(0), 0.0)
        self.damping = 0.0

    @property
    def K(self) -> Float | None:
        """(3, 3) px held true; None before the first sub-map."""
        if self._best is None or not self._config.weighted or self.is_informed:
            return self._best
        return self.shape()

    @property
    def is_informed(self) -> bool:
        """Whether the bank's verdict is that it can tell the focal."""
        return bool(np.isfinite(self._asked.log_sigma))

    @property
    def log_sigma(self) -> float:
        """One sigma of log focal; inf where no matrix could tell."""
        return self._asked.log_sigma

    @property
    def n_effective(self) -> float:
        """Matrices in the bank, counted by what they tell where the search is weighted."""
        return bank_focal.effective_count(self._asked.weights)

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
        self._damp()

    def add_group(self, group: BankGroup) -> None:
        """Stage two: a group that gets into the bank judges every guess anew."""
        shape, weighted = self.shape(), self._config.weighted
        start = np.exp(self._asked.log_focal) if self.is_informed else shape[0, 0]
        if not self.bank.add(group, float(np.log(start)), self._asked.model_noise):
            return
        self._asked = bank_focal.minimise(self.bank, shape, start, weighted=weighted)
        if self._config.refine:
            self._best = spectral.at_focal(shape, np.exp(self._asked.log_focal))
        else:
            self._best = self._least()
        self._damp()

    def curve(self, focals: Float) -> Float:
        """The score (G,) at focals (G,) px, as it is now weighed; nan without a group."""
        if not self.bank.groups:
            return np.full(len(focals), np.nan)
        return bank_focal.curve(self.bank, self.shape(), focals, self._asked.weights)

    def _beats(self, K: Float, held: Float) -> bool:
        if self._config.refine or not self.bank.groups:
            return False
        new, old = self._scores(np.stack([K, held]))
        return bool(new < old)

    def _scores(self, K: Float) -> Float:
        """(C,) weighted mean scores of guesses (C, 3, 3) px."""
        scores = spectral.score(K, self.bank.F)
        return np.asarray(np.average(scores, -1, self._asked.weights))

    def _least(self) -> Float:
        """(3, 3) px: the guess of least score, the one held among them."""
        held = [] if self._best is None else [self._best]
        K = np.stack([*self._candidates, *held])
        return np.asarray(K[np.argmin(self._scores(K))])

    def _damp(self) -> None:
        config, K = self._config, self.K
        if K is None or not self.bank.groups or (config.weighted and not self.is_informed):
            self.damping = 0.0
        elif not config.adaptive_damping:
            self.damping = 1.0
        elif config.weighted:
            log_focals = np.log([candidate[0, 0] for candidate in self._candidates])
            self.damping = damping.from_uncertainty(
                log_focals, float(np.log(K[0, 0])), self.log_sigma, self.damping
            )
        else:
            self.damping = damping.from_density(len(self.bank.F), config)
