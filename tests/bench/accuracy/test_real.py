"""Requirements on real clips: errors within sigmas, and lengths of one clip in two runs."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bench.accuracy import real
from bench.outcome import Outcome
from calm_edge.evaluation.estimate import Estimate
from tests.evaluation.worlds import curve, stamps


def _outcome(ate=0.5, scale=1.0, scale_sigma=0.01, focal=0.0, sigma=0.02):
    return Outcome(
        "d", 100.0, 30.0, ate, 0.1, scale, scale_sigma, 1.0, 0.0, (focal, focal), (sigma, sigma)
    )


@pytest.mark.parametrize(
    ("outcome", "passes"),
    [
        (_outcome(ate=0.9), True),
        (_outcome(ate=3.0, scale=0.95), False),
        (_outcome(ate=3.0, scale=0.95, scale_sigma=0.03), True),
        (_outcome(ate=3.0, scale=0.95, scale_sigma=None), False),
        (Outcome("d", 1.0, 1.0, failed="no window"), False),
    ],
)
def test_a_large_error_has_to_be_within_the_sigma_of_the_scale(outcome, passes):
    assert real.narrow(outcome).passed is passes


def test_focals_are_judged_in_sigmas_and_in_percent():
    whole = _outcome(focal=0.03)
    passed = [check.passed for check in real.focals(_outcome(focal=0.05), whole)]
    assert passed == [True, True, True, True]
    passed = [check.passed for check in real.focals(_outcome(focal=0.23, sigma=0.08), whole)]
    assert passed == [True, False, True, False]
    passed = [check.passed for check in real.focals(_outcome(focal=0.06, sigma=0.005), whole)]
    assert passed == [False, True, False, True]
    unknown = replace(whole, focal_error=None, focal_sigma=None)
    assert not any(check.passed for check in real.focals(unknown, whole))


def test_the_length_ratio_is_of_the_common_stretch():
    T, t_ns = curve(120), stamps(120)
    part = T[40:100:3].copy()
    part[:, :3, 3] *= 1.04
    whole = Estimate("w", t_ns[::2], T[::2])
    ratio = real.length_ratio(Estimate("p", t_ns[40:100:3], part), whole)
    assert math.log(ratio) == pytest.approx(math.log(1.04), abs=2e-3)


def test_positions_between_keyframes_are_interpolated():
    T, t_ns = curve()[:10], stamps(10)
    found = real.positions(Estimate("w", t_ns[::3], T[::3]), t_ns[:9])
    np.testing.assert_allclose(found, T[:9, :3, 3], atol=0.05)


NAMES = [drive.name for drive in (real.WHOLE, real.PART, real.HINTED, real.NARROW)]


def test_drives_without_a_result_miss_what_is_asked_of_them(tmp_path):
    found = {name: Outcome(name, 1.0, 1.0, failed="no window") for name in NAMES}
    rows, checks = real.measured(found, tmp_path)
    assert len(checks) == 3 and not any(check.passed for check in checks)
    assert all(row[1] is None for row in rows)


def test_every_requirement_is_checked(monkeypatch, tmp_path):
    found = {name: replace(_outcome(ate=0.2), drive=name) for name in NAMES}
    T, t_ns = curve(), stamps(240)
    monkeypatch.setattr(real, "read_estimate", lambda _: Estimate("r", t_ns, T))
    lengths = np.linalg.norm(T[4:, :3, 3] - T[:-4, :3, 3], axis=1)
    peer = real.stereo.Motions(np.arange(len(lengths)), 1.01 * lengths)
    monkeypatch.setattr(real.stereo, "motions", lambda *_: peer)
    monkeypatch.setattr(real, "SequenceFolder", lambda _: SimpleNamespace(t_ns=lambda _: t_ns))
    checks = {check.what: check for check in real.measured(found, tmp_path)[1]}
    assert all(check.passed for check in checks.values()) and len(checks) == 9
    against = checks["karlsruhe_town: scale against calibrated stereo, %"]
    assert against.measured == pytest.approx(-100 * math.log(1.01), abs=0.05)
