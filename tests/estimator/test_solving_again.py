"""Windows solved again from their pictures once the kit is known."""

import dataclasses

import numpy as np
import pytest

from bench.scripted import ScriptedBackbone, ScriptedErrors
from calm_edge.backbones.base import BackboneError
from calm_edge.config import Config, merge
from calm_edge.estimator.localizer import Localizer
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import Hints, KitBelief
from tests.drives import PERIOD_NS, START_NS, T_P_A, position_error, scene, windows

METRES = merge(
    Config(),
    {
        "scale": {"spacing_m": float(np.linalg.norm(T_P_A[:3, 3]))},
        "loops": {"enabled": False},
    },
)
N = 70


class Guided(ScriptedBackbone):
    """Solves windows right only with two others' evidence on the kit; `resolve` mends nothing.

    blind: windows, by number, that cannot be solved without it.
    """

    def __init__(self, *arguments, blind=()):
        super().__init__(*arguments)
        self.blind, self.inferred = blind, []

    def kit_sigma(self, hints):
        known = 0.0 if hints.kit is None else hints.kit.information[0, 0]
        return np.array([0.5, 0.3]) if known < 2 else np.array([0.01, 0.02])

    def infer(self, images, hints):
        assert len(images) == len(hints.t_ns)
        number = int(hints.t_ns[0] - START_NS) // PERIOD_NS // 12
        self.inferred.append(number)
        sigma = self.kit_sigma(hints)
        guided = sigma[0] < 0.02
        if number in self.blind and not guided:
            raise BackboneError("no match")
        prediction = super().infer(images, hints)
        T = prediction.T_s_c.copy()
        T[:, 2, 3] *= 1.0 if guided else 1.2
        return dataclasses.replace(
            prediction,
            T_s_c=T,
            kit=KitBelief(np.zeros(layout.SIZE), np.eye(layout.SIZE)),
            kit_sigma=sigma,
            focal_log_sigma=np.full(len(T), 0.02),
            landmarks=None,
        )

    def resolve(self, prediction, hints):
        return prediction


def straight(n):
    return se3.exp(np.arange(n)[:, None] * np.array([0, 0, 1.0, 0, 0.004, 0]))


def drive(blind=(), **options):
    T = straight(N)
    backbone = Guided(scene(T), ScriptedErrors(), blind=blind)
    localizer = Localizer(METRES, backbone, **options)
    return T, backbone, localizer, [localizer.process(window) for window in windows(N)]


def test_windows_matched_before_the_kit_was_known_are_solved_again_one_at_a_time():
    T, backbone, localizer, updates = drive()
    # window 2 is the first that two others guide; then one earlier window goes with each
    assert backbone.inferred == [0, 1, 2, 0, 3, 1, 4, 5]
    assert position_error(updates[1].trajectory.T_w_c, T[12:27]).max() > 1.0
    # the poses exchanged with window 3 are published with it
    assert len(updates[3].trajectory.keyframe_ids) == len(np.unique(updates[3].trajectory.t_ns))
    assert position_error(updates[3].trajectory.T_w_c, T[:51]).max() < 1e-9
    assert position_error(localizer.finish().T_w_c, T).max() < 1e-9
    assert set(localizer.solved_again) == {0, 1}


@pytest.mark.parametrize("blind", [{0}, {1}, {0, 1}])
def test_a_window_that_failed_is_inserted_in_order(blind):
    T, _, localizer, updates = drive(blind)
    assert {k for k, update in enumerate(updates) if update is None} == blind
    final = localizer.finish()
    assert final.keyframe_ids.tolist() == list(range(N))
    assert position_error(final.T_w_c, T).max() < 1e-9
    assert [submap.id for submap in localizer.submaps] == list(range(6))
    assert [submap.n_overlap for submap in localizer.submaps] == [0, 3, 3, 3, 3, 3]
    assert localizer.skipped == ()


def test_a_busy_localizer_solves_again_only_when_told():
    _, backbone, localizer, _ = drive(unhurried=False)
    assert backbone.inferred == [0, 1, 2, 3, 4, 5]
    assert localizer.solve_again() and localizer.solve_again()
    assert not localizer.solve_again()
    assert backbone.inferred[6:] == [0, 1]


def test_a_drive_that_ends_leaves_what_there_is_no_time_for():
    T, backbone, localizer, _ = drive(unhurried=False)
    localizer.finish(limit_s=0.0)
    assert backbone.inferred == [0, 1, 2, 3, 4, 5] and localizer.solved_again == {}
    assert position_error(localizer.finish().T_w_c, T).max() < 1e-9


@pytest.mark.parametrize("missing", [0, 2, 5])
def test_a_missing_window_is_solved_by_what_the_restored_ones_know(missing):
    T, backbone, _, updates = drive()
    cut = windows(N)
    localizer = Localizer(METRES, backbone)
    for window, update in zip(cut, updates, strict=True):
        if window.submap_id != missing:
            frames = [keyframe.frame for keyframe in window.keyframes()]
            hints = Hints(np.array([f.eye for f in frames]), np.array([f.t_ns for f in frames]))
            localizer.restore(update, hints, final=True)
    before = len(backbone.inferred)
    assert localizer.attempt(cut[missing]) is not None
    assert backbone.inferred[before:] == [missing]
    for k in {0, 1} - {missing}:
        assert localizer.attempt(cut[k]) is not None
    final = localizer.finish()
    assert position_error(final.T_w_c, T).max() < 1e-9
    assert final.keyframe_ids.tolist() == list(range(N))
