import dataclasses

import numpy as np
import pytest

from bench.scripted import ScriptedBackbone, ScriptedErrors
from calm_edge.backbones.base import BackboneError
from calm_edge.config import Config, merge
from calm_edge.estimator import localizer as localizer_module
from calm_edge.estimator import metre
from calm_edge.estimator.localizer import Localizer
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.trajectories import folded
from calm_edge.types import Keyframe, KitBelief
from device.frame import Frame
from tests.drives import PERIOD_NS, START_NS, T_P_A, circle, curved, position_error, scene, windows

SPACING_M = float(np.linalg.norm(T_P_A[:3, 3]))
CORRECTED = merge(Config(), {"scale": {"spacing_m": SPACING_M}})
# these sub-maps have true focals; section V would move them by 1e-5, from float32 pixels
METRES = merge(CORRECTED, {"correction": {"apply": "never"}})
NOISE = ScriptedErrors(scale_log_sigma=0.5, translation_sigma=0.004, rotation_sigma_rad=0.0005)


def drive(T, errors, config=METRES, **cut):
    localizer = Localizer(config, ScriptedBackbone(scene(T), errors))
    updates = [localizer.process(window) for window in windows(len(T), **cut)]
    return localizer, updates


def live(updates):
    """Trajectory of the updates so far."""
    return folded(update.trajectory for update in updates)


def test_submaps_of_any_scale_are_placed_in_metres():
    T = curved(150)
    localizer, updates = drive(T, ScriptedErrors(scale_log_sigma=0.5))
    raw = [1 / update.submap.scale for update in updates]
    assert max(raw) / min(raw) > 2
    assert position_error(live(updates).T_w_c, T).max() < 1e-9
    final = localizer.finish()
    assert position_error(final.T_w_c, T).max() < 1e-9
    assert np.abs(final.T_p_a - T_P_A).max() < 1e-9
    assert final.keyframe_ids.tolist() == list(range(150))
    assert np.array_equal(final.t_ns, START_NS + PERIOD_NS * np.arange(150))
    for submap in localizer.submaps:
        assert np.abs(submap.T_w_c()[: submap.n_primary] - T[list(submap.primary_ids)]).max() < 1e-9


def test_without_a_spacing_the_world_is_in_spacings():
    T = curved(40)
    _, updates = drive(T, ScriptedErrors(scale_log_sigma=0.5), config=Config())
    T_units = T.copy()
    T_units[:, :3, 3] /= SPACING_M
    assert position_error(live(updates).T_w_c, T_units).max() < 1e-9


def test_a_drive_without_a_metre_saves_no_kit(monkeypatch):
    saved = []
    monkeypatch.setattr(localizer_module.KitPrior, "save", lambda *given: saved.append(given))
    T = curved(40)
    driven, _ = drive(T, ScriptedErrors())
    driven.finish()
    assert driven.metre.metric and len(saved) == 1
    T[:, :3, 3] *= 1e-4
    stood, _ = drive(T, ScriptedErrors())
    stood.finish()
    assert not stood.metre.metric and len(saved) == 1


@pytest.mark.parametrize("late_ns", [17_000_000, -40_000_000])
def test_unsynchronised_cameras_add_little_error(late_ns):
    T = curved(150)
    localizer, _ = drive(T, ScriptedErrors(scale_log_sigma=0.5), assistant_late_ns=late_ns)
    error = position_error(localizer.finish().T_w_c, T)
    assert error.max() < 0.001 * 150


@pytest.mark.parametrize("late_ns", [0, 17_000_000])
def test_optimising_a_noisy_loop_lowers_its_error(late_ns):
    T = circle(150)
    noise = dataclasses.replace(NOISE, rotation_sigma_rad=0.004)
    cut = windows(150, assistant_late_ns=late_ns)
    joined = [*cut[:-1], dataclasses.replace(cut[-1], loop_keyframe=cut[0].primary[0])]
    localizer = Localizer(METRES, ScriptedBackbone(scene(T), noise))
    updates = [localizer.process(window) for window in cut]
    before = position_error(live(updates).T_w_c, T)
    epoch = updates[-1].trajectory.epoch
    localizer = Localizer(METRES, ScriptedBackbone(scene(T), noise))
    for window in joined:
        after = localizer.process(window).trajectory
    error = position_error(after.T_w_c, T)
    assert error[-1] < 0.2 * before[-1]
    assert error.mean() < before.mean()
    assert after.epoch == epoch + 1
    assert np.abs(after.T_p_a - T_P_A).max() < 0.02


def test_a_change_of_the_focal_moves_all_earlier_submaps():
    T = curved(75)
    errors = ScriptedErrors(coupled=True, focal_log_sigma=0.08)
    localizer, updates = drive(T, errors, config=CORRECTED)
    localizer.finish()
    true = scene(T).cameras[0].fx
    focals = [(submap.cameras_raw[0].fx, submap.cameras[0].fx) for submap in localizer.submaps]
    raw, corrected = np.abs(np.log(np.array(focals) / true)).T
    assert corrected.max() < raw.max() / 3
    # the first was placed before anything was known
    assert corrected[0] < abs(np.log(updates[0].submap.cameras[0].fx / true))


def test_averaged_placement_drifts_less_with_noise():
    T = curved(150)
    averaged = merge(METRES, {"scale": {"average_placement": True}})
    noise = dataclasses.replace(NOISE, rotation_sigma_rad=0.002)
    error = {
        config: np.mean(
            [
                position_error(
                    live(drive(T, dataclasses.replace(noise, seed=seed), config=config)[1]).T_w_c,
                    T,
                ).mean()
                for seed in range(3)
            ]
        )
        for config in (METRES, averaged)
    }
    assert error[averaged] < error[METRES]


def test_a_keyframe_keeps_the_pose_of_its_first_submap_until_optimised():
    _, updates = drive(curved(40), NOISE)
    for k, later in enumerate(updates[1:], 1):
        before = live(updates[:k])
        n = len(before.keyframe_ids)
        assert np.array_equal(live(updates[: k + 1]).T_w_c[:n], before.T_w_c)
        assert later.trajectory.epoch == 0
        first = later.submap.primary_ids[0]
        assert np.allclose(later.submap.T_w_c()[0], before.T_w_c[first], atol=1e-9)


def test_same_windows_give_the_same_bytes():
    runs = []
    for _ in range(2):
        localizer, updates = drive(curved(60), NOISE, assistant_late_ns=17_000_000)
        runs.append(live(updates).T_w_c.tobytes() + localizer.finish().T_w_c.tobytes())
    assert runs[0] == runs[1]


class Failing(ScriptedBackbone):
    """Raises in the calls numbered in `fails`."""

    def __init__(self, *arguments, fails):
        super().__init__(*arguments)
        self.calls, self.fails = 0, fails

    def infer(self, images, hints):
        self.calls += 1
        if self.calls - 1 in self.fails:
            raise BackboneError("too dark")
        return super().infer(images, hints)


def straight(n):
    return se3.exp(np.arange(n)[:, None] * np.array([0, 0, 1.0, 0, 0.004, 0]))


@pytest.mark.parametrize("fails", [{1}, {2, 3}])
def test_a_window_that_fails_is_bridged_at_constant_velocity(fails):
    T = straight(75)
    localizer = Localizer(METRES, Failing(scene(T), ScriptedErrors(), fails=fails))
    updates = [localizer.process(window) for window in windows(75)]
    assert {k for k, update in enumerate(updates) if update is None} == fails
    assert [s.submap_id for s in localizer.skipped] == sorted(fails)
    assert localizer.skipped[0].reason == "too dark"
    after = updates[max(fails) + 1]
    assert after.submap.n_overlap == 0
    assert updates[max(fails) + 2].submap.n_overlap == 3
    trajectory = localizer.finish()
    known = trajectory.keyframe_ids
    assert len(known) < 75
    assert position_error(trajectory.T_w_c, T[known]).max() < 1e-6


class Thrown(Failing):
    """A network that throws one keyframe of some windows far ahead."""

    def infer(self, images, hints):
        self.calls += 1
        prediction = ScriptedBackbone.infer(self, images, hints)
        if self.calls - 1 not in self.fails:
            return prediction
        T = prediction.T_s_c.copy()
        T[7, :3, 3] += 60 * T[7, :3, 2]
        return dataclasses.replace(prediction, T_s_c=T)


def test_a_window_that_no_car_drives_is_bridged_whatever_the_backbone():
    T = straight(75)
    localizer = Localizer(METRES, Thrown(scene(T), ScriptedErrors(), fails={2}))
    updates = [localizer.process(window) for window in windows(75)]
    assert [k for k, update in enumerate(updates) if update is None] == [2]
    assert localizer.skipped[0].reason == (
        "the window is wrong: the velocity jumps between keyframes as no car's does"
    )
    trajectory = localizer.finish()
    known = trajectory.keyframe_ids
    assert 60 < len(known) < 75
    assert position_error(trajectory.T_w_c, T[known]).max() < 1e-6


def test_a_window_left_out_is_bridged_as_if_it_had_failed():
    T = straight(75)
    localizer = Localizer(METRES, Failing(scene(T), ScriptedErrors(), fails=set()))
    for window in windows(75):
        if window.submap_id in (2, 3):
            stamps = np.array([keyframe.frame.t_ns for keyframe in window.primary])
            localizer.leave_out(window.submap_id, stamps)
        else:
            assert localizer.process(window) is not None
    assert [s.submap_id for s in localizer.skipped] == [2, 3]
    trajectory = localizer.trajectory()
    known = trajectory.keyframe_ids
    assert len(known) < 75
    assert position_error(trajectory.T_w_c, T[known]).max() < 1e-6


def test_long_gaps_between_skipped_keyframes_are_a_standstill():
    T = straight(60)
    # a moving car would have had a keyframe long before
    gap_ns = int(3 * METRES.frontend.max_keyframe_gap_s * 1e9)
    stops = 9  # keyframes 15 to 23, all in window 1, show the car where 14 left it
    lost_ns = stops * gap_ns

    def delayed(keyframe):
        late = min(max(keyframe.id - 14, 0), stops) * (gap_ns - PERIOD_NS)
        frame = keyframe.frame
        return Keyframe(
            keyframe.id, Frame(frame.eye, frame.sequence, frame.t_ns + late, frame.image)
        )

    class Parked(Failing):
        def infer(self, images, hints):
            t_ns = hints.t_ns - lost_ns if self.calls > 1 else hints.t_ns
            return super().infer(images, dataclasses.replace(hints, t_ns=t_ns))

    localizer = Localizer(METRES, Parked(scene(T), ScriptedErrors(), fails={1}))
    for window in windows(60):
        cut = {eye: tuple(map(delayed, getattr(window, eye))) for eye in ("primary", "assistant")}
        localizer.process(dataclasses.replace(window, **cut))
    trajectory = localizer.trajectory()
    jump = np.linalg.norm(np.diff(trajectory.T_w_c[:, :3, 3], axis=0), axis=1)
    assert trajectory.keyframe_ids[15] == 24
    assert jump == pytest.approx(1.0, abs=1e-3)


def test_nothing_reconstructed_is_no_trajectory():
    localizer = Localizer(METRES, Failing(scene(curved(20)), ScriptedErrors(), fails={0, 1}))
    assert [localizer.process(window) for window in windows(20)] == [None, None]
    assert localizer.finish() is None
    assert len(localizer.trajectory().keyframe_ids) == 0


def test_a_window_of_one_camera_or_with_a_broken_image_is_skipped():
    localizer = Localizer(METRES, ScriptedBackbone(scene(curved(40))))
    first, second, third = windows(40)[:3]
    assert localizer.process(dataclasses.replace(first, assistant=())) is None
    broken = dataclasses.replace(second.primary[4].frame, image=b"no picture")
    primary = (*second.primary[:4], Keyframe(second.primary[4].id, broken), *second.primary[5:])
    assert localizer.process(dataclasses.replace(second, primary=primary)) is None
    reasons = [skipped.reason for skipped in localizer.skipped]
    assert "both clocks" in reasons[0] and "not a JPEG" in reasons[1]
    assert localizer.process(third).submap.n_overlap == 0


class Converging(ScriptedBackbone):
    """One log focal, known from the third window on; a wrong focal stretches the motion."""

    WRONG = 0.2

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.inferred, self.resolved = [], []

    def _seen(self, prediction, hints, log_error):
        T, factor = prediction.T_s_c.copy(), float(np.exp(log_error))
        cameras = tuple(camera.with_focal(factor * camera.fx) for camera in prediction.cameras)
        T[:, 2, 3] *= np.exp(log_error)
        sigma = np.full(len(hints.t_ns), 0.002 if log_error == 0 else 0.3)
        mean, information = np.zeros(layout.SIZE), np.zeros((layout.SIZE, layout.SIZE))
        focals = layout.LOG_FOCAL
        mean[focals], information[focals, focals] = log_error, sigma[0] ** -2
        kit = KitBelief(mean, information)
        return dataclasses.replace(
            prediction, cameras=cameras, T_s_c=T, focal_log_sigma=sigma, kit=kit, landmarks=None
        )

    def infer(self, images, hints):
        self.inferred.append(hints.kit)
        late = hints.t_ns[0] > START_NS + 20 * PERIOD_NS
        return self._seen(super().infer(images, hints), hints, 0.0 if late else self.WRONG)

    def kit_sigma(self, hints):
        return np.array([0.5, 0.3])

    def resolve(self, prediction, hints):
        assert prediction.depth is None
        assert hints.kit is not None
        self.resolved.append(int(hints.t_ns[0] - START_NS) // PERIOD_NS)
        if abs(hints.kit.mean[layout.LOG_FOCAL[0]]) > 0.01:
            raise BackboneError("unknown focal")
        return self._seen(ScriptedBackbone.infer(self, [], hints), hints, 0.0)


def test_windows_are_solved_again_once_the_focal_is_known():
    T = straight(70)
    backbone = Converging(scene(T))
    localizer = Localizer(METRES, backbone)
    updates = [localizer.process(window) for window in windows(70)]
    assert backbone.inferred[0] is None
    assert backbone.inferred[1].mean[layout.LOG_FOCAL] == pytest.approx([0.2, 0.2])
    # the third window, from keyframe 24 on, knows the focal: the two before are solved again
    assert backbone.resolved == [0, 12]
    assert [update.trajectory.epoch for update in updates] == [0, 0, 1, 1, 1, 1][: len(updates)]
    old, new = live(updates[:2]), updates[2].trajectory
    assert position_error(old.T_w_c, T[:27]).max() > 1.0
    assert position_error(new.T_w_c, T[:39]).max() < 1e-9
    final = localizer.finish()
    assert backbone.resolved[2:] == [0, 12, 24, 36, 48, 60]
    assert position_error(final.T_w_c, T).max() < 1e-9
    assert final.epoch == 3


def test_the_live_metre_of_a_first_window_waits_for_the_second_unless_the_kit_is_known():
    def metres(kit_sigma):
        backbone = Converging(scene(straight(70)))
        backbone.kit_sigma = lambda hints: np.array(kit_sigma)
        localizer = Localizer(METRES, backbone)
        updates = [localizer.process(window) for window in windows(40)[:2]]
        return [update.metre.reason == metre.ALONE for update in updates], localizer.metre.reason

    assert metres((0.5, 0.3)) == ([True, False], metres((0.001, 0.001))[1])
    assert metres((0.001, 0.001))[0] == [False, False]


def test_a_first_window_alone_has_no_metre_until_the_end_of_the_drive():
    backbone = Converging(scene(straight(70)))
    backbone.resolve = lambda prediction, hints: prediction
    localizer = Localizer(METRES, backbone)
    localizer.process(windows(40)[0])
    assert localizer.metre.reason == metre.ALONE
    localizer.finish()
    assert localizer.metre.reason != metre.ALONE


def test_a_limited_number_of_windows_is_solved_again():
    backbone = Converging(scene(straight(70)))
    config = merge(METRES, {"backbone": {"resolve_windows": 2}})
    localizer = Localizer(config, backbone)
    for window in windows(70):
        localizer.process(window)
    assert backbone.resolved == [12]
    localizer.finish()
    assert backbone.resolved[1:] == [48, 60]


def test_a_late_calibration_is_applied_to_all_at_the_end_at_the_latest(monkeypatch):
    localizer = Localizer(METRES, ScriptedBackbone(scene(curved(150))))
    moved = []
    monkeypatch.setattr(localizer._rectifier, "update", lambda *_: True)
    replacements, begin = localizer._replacements, localizer._replacements.begin
    monkeypatch.setattr(replacements, "begin", lambda s: (moved.append(len(s)), begin(s)))
    for window in windows(150):
        localizer.process(window)
    # the ninth takes two windows: the tenth waits for it
    assert moved == [1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 13]
    placed = len(localizer.submaps)
    assert placed == 13
    localizer.finish()
    assert moved[-1] == placed


def recalibrated(monkeypatch, per_window, n, at):
    """Final trajectory of a curved drive whose time offset changes at sub-map `at`, and for each
    window the epoch and the number of sub-maps rectified.
    """
    monkeypatch.setattr(localizer_module, "REPLACED_PER_WINDOW", per_window)
    localizer = Localizer(METRES, ScriptedBackbone(scene(curved(n))))
    rectifier, rectify = localizer._rectifier, localizer._rectifier.rectify
    rectified, counts, epochs = [], [], []

    def update(raw, landmarks, images):
        if raw.id == at:
            rectifier._offset_s = 0.02
        return raw.id == at

    monkeypatch.setattr(rectifier, "update", update)
    monkeypatch.setattr(
        rectifier,
        "rectify",
        lambda s, calibration=None: rectified.append(s.id) or rectify(s, calibration),
    )
    for window in windows(n):
        epochs.append(localizer.process(window).trajectory.epoch)
        counts.append(len(rectified))
    return localizer.finish(), epochs, np.diff(counts, prepend=0).tolist()


@pytest.mark.parametrize(("n", "moved"), [(150, [7]), (87, [])])
def test_placing_some_per_window_ends_as_placing_all_at_once(monkeypatch, n, moved):
    # the shorter drive ends before all were placed again
    at_once, early, most = recalibrated(monkeypatch, 1000, n, at=5)
    shared, late, few = recalibrated(monkeypatch, 3, n, at=5)
    assert np.flatnonzero(np.diff(early, prepend=0)).tolist() == [5]
    assert np.flatnonzero(np.diff(late, prepend=0)).tolist() == moved
    assert (max(most), max(few)) == (1 + 6, 1 + 3)
    assert np.abs(at_once.T_p_a - T_P_A).max() > 1e-4
    assert np.abs(shared.T_w_c - at_once.T_w_c).max() < 1e-9
    assert np.abs(shared.T_p_a - at_once.T_p_a).max() < 1e-9
