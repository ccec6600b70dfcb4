"""A mount that slips in mid-drive: the kit is learned again from there."""

import dataclasses

import numpy as np
import pytest

from bench.scripted import ScriptedBackbone, ScriptedErrors
from calm_edge.backbones.base import BackboneError
from calm_edge.estimator.localizer import Localizer
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import Hints, KitBelief, LocalizerUpdate, Trajectory
from tests.drives import PERIOD_NS, START_NS, T_P_A, position_error, scene, windows
from tests.estimator.test_solving_again import METRES, straight

N = 82
TURNED = np.radians(2.0)
SLIPPED = T_P_A @ se3.exp(np.array([0, 0, 0, 0, TURNED, 0]))
SIGMA = 0.003
FROM = 4  # first window with the new rig


class Slipping(ScriptedBackbone):
    """Two scenes, one before and one after the slip; a wrong rig stretches the motion.

    bad: windows whose evidence is wrong in another way each. refuses: a window that does not fit
    the belief fails, else it only gives no evidence.
    """

    def __init__(self, T, *, refuses=False, bad=(), slips=True):
        super().__init__(scene(T), ScriptedErrors())
        after = scene(T, SLIPPED) if slips else scene(T)
        self.after = ScriptedBackbone(after, ScriptedErrors())
        self.refuses, self.bad, self.slips, self.inferred = refuses, bad, slips, []

    def kit_sigma(self, hints):
        return np.array([self._rig_sigma(hints), 0.02])

    @staticmethod
    def _rig_sigma(hints):
        turn = layout.RIG_ROTATION.start + 1
        known = 0.0 if hints.kit is None else hints.kit.information[turn, turn]
        return min(0.5, (known + 1e-9) ** -0.5)

    def infer(self, images, hints):
        number = int(hints.t_ns[0] - START_NS) // PERIOD_NS // 12
        self.inferred.append(number)
        slipped = self.slips and number >= FROM
        solver = super() if not slipped else self.after
        prediction = solver.infer(images, hints)
        turn = TURNED * slipped + (0.1 * number if number in self.bad else 0.0)
        mean = np.zeros(layout.SIZE)
        mean[layout.RIG] = layout.rig_vector(T_P_A)
        mean[layout.RIG_ROTATION.start + 1] += turn
        kit, T = KitBelief(mean, np.eye(layout.SIZE) / SIGMA**2), prediction.T_s_c.copy()
        sigma = self._rig_sigma(hints)
        fits = sigma > 0.1 or abs((hints.kit.mean - mean)[layout.RIG_ROTATION]).max() < 3 * SIGMA
        if not fits and self.refuses:
            raise BackboneError("does not fit")
        if not fits:
            T[:, 2, 3] *= 1.3
        return dataclasses.replace(
            prediction,
            T_s_c=T,
            kit=kit if fits else None,
            kit_sigma=self.kit_sigma(hints),
            focal_log_sigma=np.full(len(T), 0.02),
            landmarks=None,
        )

    def resolve(self, prediction, hints):
        return prediction


@pytest.mark.parametrize("refuses", [False, True])
def test_a_new_epoch_begins_where_the_mount_slipped(refuses):
    T = straight(N)
    localizer = Localizer(METRES, Slipping(T, refuses=refuses))
    updates = [localizer.process(window) for window in windows(N)]
    notices = [update.notices for update in updates]
    # window 4 alone may be a bad one
    (line,) = notices[FROM + 1]
    assert [len(lines) for lines in notices] == [0] * (FROM + 1) + [1] + [0] * (len(notices) - 6)
    assert line.startswith("the kit changed 0:04 into the drive: the assistant has moved")
    assert "turned by 2.0 deg" in line
    final = localizer.finish()
    assert position_error(final.T_w_c, T).max() < 1e-6
    assert [s.kit_epoch for s in localizer.submaps] == [0] * FROM + [1] * (len(updates) - FROM)
    # the newest rig is published and saved
    assert np.abs(final.T_p_a[:3, :3] - SLIPPED[:3, :3]).max() < 1e-6
    turn = layout.RIG_ROTATION.start + 1
    expected = layout.rig_vector(T_P_A)[1] + TURNED
    assert localizer.kit.mean[turn] == pytest.approx(expected, abs=1e-6)
    # what one window says of the optics before still counts
    of_one = 1 / SIGMA**2
    assert localizer.kit.information[0, 0] == pytest.approx(of_one * len(updates))
    assert localizer.kit.information[turn, turn] == pytest.approx(of_one * (len(updates) - FROM))


def test_a_bad_window_alone_is_no_change():
    T = straight(N)
    localizer = Localizer(METRES, Slipping(T, bad={3, 5}, slips=False))
    updates = [localizer.process(window) for window in windows(N)]
    assert not any(update.notices for update in updates)
    localizer.finish()
    assert {submap.kit_epoch for submap in localizer.submaps} == {0}
    # the bad ones teach nothing
    assert localizer.kit.information[0, 0] == pytest.approx((len(updates) - 2) / SIGMA**2)


def test_a_restored_drive_keeps_its_epochs():
    T = straight(N)
    backbone, cut = Slipping(T), windows(N)
    first = Localizer(METRES, backbone)
    for window in cut:
        first.process(window)
    first.finish()
    localizer = Localizer(METRES, backbone)
    for window, submap in zip(cut, first.submaps, strict=True):
        frames = [keyframe.frame for keyframe in window.keyframes()]
        hints = Hints(np.array([f.eye for f in frames]), np.array([f.t_ns for f in frames]))
        prediction = first.solved_again.get(submap.id)
        update = recorded(backbone, submap, prediction, hints)
        if submap.id != FROM + 2:
            localizer.restore(update, hints, final=True)
    before = len(backbone.inferred)
    assert localizer.attempt(cut[FROM + 2]) is not None
    assert backbone.inferred[before:] == [FROM + 2]
    assert position_error(localizer.finish().T_w_c, T).max() < 1e-6
    assert localizer.submaps[FROM + 2].kit_epoch == 1


def recorded(backbone, submap, prediction, hints):
    nothing = np.zeros(0, np.int64)
    trajectory = Trajectory(nothing, nothing, np.zeros((0, 4, 4)), np.eye(4), 0)
    return LocalizerUpdate(submap, prediction or backbone.infer([], hints), trajectory)
