"""Agreement of the parts of a drive on the focal, by statistical sigmas alone."""

import numpy as np
import pytest

from bench import kit_agreement
from calm_edge.kit import layout
from calm_edge.types import Hints, KitBelief, Prediction


def _evidence(log_focal, sigma):
    """Evidence on both focals and on nothing else."""
    mean, information = np.zeros(layout.SIZE), np.zeros(layout.SIZE)
    mean[layout.LOG_FOCAL] = log_focal
    information[layout.LOG_FOCAL] = sigma**-2.0
    return KitBelief(mean=mean, information=np.diag(information))


def test_windows_with_honest_sigmas_agree():
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(40):
        windows = [_evidence(-0.4 + 0.01 * rng.normal(), 0.01) for _ in range(10)]
        for rows in (kit_agreement.halves(windows), kit_agreement.one_left_out(windows)):
            ratios.append(rows[:, 0] / rows[:, 1])
    assert np.sqrt((np.concatenate(ratios) ** 2).mean()) == pytest.approx(1.0, abs=0.15)


def test_halves_that_differ_are_seen_in_their_sigmas():
    windows = [_evidence(f, 0.01) for f in (-0.4, -0.4, -0.3, -0.3)]
    (difference, sigma), *_ = kit_agreement.halves(windows)
    assert difference == pytest.approx(-0.1, abs=2e-3)
    assert sigma == pytest.approx(0.01, rel=0.01)


def test_a_window_that_knows_nothing_is_not_compared():
    windows = [_evidence(-0.4, 0.01), _evidence(-0.4, 0.01), _evidence(0.5, 5.0)]
    assert len(kit_agreement.one_left_out(windows)) == 4


class _Backbone:
    def infer(self, images, hints):
        return Prediction((), np.zeros((0, 4, 4)), kit=_evidence(float(len(images)), 0.1))

    def resolve(self, prediction, hints):
        return Prediction((), np.zeros((0, 4, 4)), kit=_evidence(7.0, 0.1))


def test_the_witness_keeps_the_newest_evidence_of_each_window():
    witness = kit_agreement.Witness(_Backbone())
    first, second = (Hints(eyes=np.zeros(1, int), t_ns=np.array([t])) for t in (10, 20))
    prediction = witness.infer([1], first)
    witness.infer([1, 2], second)
    witness.resolve(prediction, hints=first)
    means = {t: kit.mean[layout.LOG_FOCAL][0] for t, kit in witness.evidence.items()}
    assert means == {10: 7.0, 20: 2.0}
    assert not hasattr(witness, "expect")
