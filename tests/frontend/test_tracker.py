"""Live poses in front of an exact wall: accuracy, standstill, late sub-maps, loss."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.config import FrontendConfig
from calm_edge.frontend import landmark_cloud
from calm_edge.frontend.remembered import OWN_SCALE_SIGMA
from calm_edge.frontend.tracker import Tracker
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import Bytes, Float, KitBelief, Masks, Metre, PoseSample, PoseStatus
from tests.frontend.plane_world import DEPTH, HEIGHT, WIDTH, PlaneWorld, drive

PERIOD_NS = 100_000_000
WORLD = PlaneWorld()


def stamp(i: int) -> int:
    return 1_000_000_000 + i * PERIOD_NS


def seen(tracker: Tracker, t_ns: int, gray, keyframe_id: int | None = None) -> PoseSample:
    """Process one frame as the tracker process does; returns its pose."""
    sample = tracker.track(t_ns, gray)
    tracker.prepare(keyframe_id)
    return sample


def feed(tracker: Tracker, T_w_c: Float, first: int = 0, step: int = 3) -> list[PoseSample]:
    """Every `step`-th frame is a keyframe with id frame / step."""
    return [
        seen(
            tracker,
            stamp(first + i),
            WORLD.render(T),
            (first + i) // step if (first + i) % step == 0 else None,
        )
        for i, T in enumerate(T_w_c)
    ]


def error(samples: list[PoseSample], T_w_c: Float) -> float:
    """Largest relative position error against the first sample, metres."""
    mine = np.stack([s.T_w_c for s in samples])
    relative = se3.inverse(mine[0]) @ mine
    truth = se3.inverse(T_w_c[0]) @ T_w_c
    return float(np.abs(relative[:, :3, 3] - truth[:, :3, 3]).max())


def attached(poses: Float, upto: int, **options: object) -> Tracker:
    tracker = Tracker(FrontendConfig())
    feed(tracker, poses[:upto])
    ids = [0, 1, 2]
    update = WORLD.update(0, ids, [stamp(3 * i) for i in ids], poses[[0, 3, 6]], **options)  # type: ignore[arg-type]
    assert tracker.attach(update)
    return tracker


def test_before_the_first_submap_the_pose_is_lost_and_nan() -> None:
    samples = feed(Tracker(FrontendConfig()), drive(2))
    assert all(s.status is PoseStatus.LOST for s in samples)
    assert all(np.isnan(s.T_w_c).all() for s in samples)


@pytest.mark.parametrize("options", [{}, {"with_depth": True}, {"raw_scale": 3.0}])
def test_a_late_submap_is_tracked_to_the_newest_frame(
    options: dict[str, object],
) -> None:
    poses = drive(24)
    tracker = attached(poses, 12, **options)
    samples = feed(tracker, poses[12:], 12)
    assert all(s.status is PoseStatus.LIVE for s in samples)
    assert error(samples, poses[12:]) < 0.02
    np.testing.assert_allclose(samples[0].T_w_c, poses[12], atol=0.02)
    truth = poses[-1, :3, :3].T @ (poses[-1] - poses[-4])[:3, 3] / 0.3
    np.testing.assert_allclose(samples[-1].velocity_c, truth, atol=0.1)


def test_the_covariance_is_a_covariance_of_the_right_size() -> None:
    poses = drive(20)
    samples = feed(attached(poses, 10), poses[10:], 10)
    for sample, T in zip(samples, poses[10:], strict=True):
        assert np.linalg.eigvalsh(sample.covariance).min() > 0
        miss = se3.log(se3.inverse(sample.T_w_c) @ T)
        assert miss @ np.linalg.solve(sample.covariance, miss) < 200
        assert np.sqrt(sample.covariance[0, 0]) < 0.2


def test_standing_still_is_a_live_pose_without_velocity() -> None:
    poses = drive(12)
    tracker = attached(poses, 12)
    rng = np.random.default_rng(1)
    still = WORLD.render(poses[11])
    samples = []
    for i in range(30):
        noisy = np.clip(still + rng.normal(0, 3, still.shape), 0, 255).astype(np.uint8)
        samples.append(seen(tracker, stamp(12 + i), noisy))
    assert all(s.status is PoseStatus.LIVE for s in samples)
    assert np.abs(samples[-1].velocity_c).max() < 0.05
    assert np.linalg.norm(samples[-1].T_w_c[:3, 3] - samples[0].T_w_c[:3, 3]) < 0.01


def test_a_pose_that_no_car_reaches_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """All tracks of one frame jump by a period of what they are on; the next are right again."""
    poses = drive(24)
    tracker = attached(poses, 12)
    feed(tracker, poses[12:16], 12)
    right = tracker._locate

    def aliased(*arguments: object) -> object:
        fit = right(*arguments)  # type: ignore[arg-type]
        assert fit is not None
        T = fit.T_w_c.copy()
        T[:3, 3] += [0.0, 0.0, 9.0]
        return replace(fit, T_w_c=T)

    with monkeypatch.context() as context:
        context.setattr(tracker, "_locate", aliased)
        (lost,) = feed(tracker, poses[16:17], 16)
    assert lost.status is PoseStatus.LOST and np.isnan(lost.T_w_c).all()
    after = feed(tracker, poses[17:24], 17)
    assert all(s.status is PoseStatus.LIVE for s in after)
    np.testing.assert_allclose(after[-1].T_w_c[:3, 3], poses[23][:3, 3], atol=0.1)


def test_a_frame_without_a_stamp_of_its_own_has_a_pose_and_no_velocity() -> None:
    poses = drive(24)
    tracker = attached(poses, 12)
    samples = []
    for i in range(12, 24):
        # one frame is stamped 60 ms early
        own = i != 18
        t_ns = stamp(i) - (0 if own else 60_000_000)
        samples.append(tracker.track(t_ns, WORLD.render(poses[i]), own_stamp=own))
        tracker.prepare()
    marked = samples.pop(6)
    assert marked.status is PoseStatus.LIVE and np.isnan(marked.velocity_c).all()
    np.testing.assert_allclose(marked.T_w_c[:3, 3], poses[18][:3, 3], atol=0.05)
    speed = np.linalg.norm(poses[13][:3, 3] - poses[12][:3, 3]) / 0.1
    for sample in samples[3:]:
        assert sample.status is PoseStatus.LIVE
        assert abs(np.linalg.norm(sample.velocity_c) - speed) < 0.1 * speed


def test_darkness_is_lost_at_once_and_short_darkness_is_bridged() -> None:
    poses = drive(30)
    tracker = attached(poses, 10)
    good = feed(tracker, poses[10:14], 10)
    dark = np.zeros_like(WORLD.render(poses[0]))
    assert seen(tracker, stamp(14), dark).status is PoseStatus.LOST
    back = seen(tracker, stamp(15), WORLD.render(poses[15]))
    assert back.status is PoseStatus.LIVE and back.epoch == good[-1].epoch
    for i in range(16, 21):
        assert seen(tracker, stamp(i), dark).status is PoseStatus.LOST
    after = seen(tracker, stamp(21), WORLD.render(poses[21]))
    assert after.status is PoseStatus.LOST and np.isnan(after.T_w_c).all()


def test_new_points_extend_a_submap() -> None:
    poses = drive(70, step_m=0.4)
    tracker = attached(poses, 8)
    samples = feed(tracker, poses[8:], 8)
    assert all(s.status is PoseStatus.LIVE for s in samples)
    # all points of the sub-map are out of view after about 40 frames
    assert 2 * DEPTH * np.tan(np.radians(40)) < 0.4 * 62
    assert error(samples, poses[8:]) < 0.03 * 0.4 * 62


def test_a_wall_without_texture_is_lost() -> None:
    poses = drive(30)
    tracker = attached(poses, 8)
    feed(tracker, poses[8:10], 8)
    blank = np.full_like(WORLD.render(poses[0]), 128)
    assert all(seen(tracker, stamp(i), blank).status is PoseStatus.LOST for i in range(10, 16))


def test_a_displaced_submap_moves_the_map_and_not_the_pose() -> None:
    poses = drive(30)
    tracker = attached(poses, 10)
    before = feed(tracker, poses[10:18], 10)
    moved = se3.exp(np.array([2.0, -1.0, 0.5, 0.0, 0.3, 0.0]))
    update = WORLD.update(
        1, [3, 4, 5], [stamp(9), stamp(12), stamp(15)], poses[[9, 12, 15]], T_map_world=moved
    )
    assert tracker.attach(update)
    after = feed(tracker, poses[18:], 18)
    assert error(before + after, poses[10:]) < 0.03
    assert {s.epoch for s in before + after} == {0}
    np.testing.assert_allclose(tracker.T_map_odom, moved, atol=0.03)


def test_recovery_from_loss_starts_a_new_epoch() -> None:
    poses = drive(30)
    tracker = attached(poses, 10)
    feed(tracker, poses[10:12], 10)
    dark = np.zeros_like(WORLD.render(poses[0]))
    for i in range(12, 18):
        seen(tracker, stamp(i), dark)
    feed(tracker, poses[18:25], 18)
    update = WORLD.update(1, [6, 7], [stamp(18), stamp(21)], poses[[18, 21]])
    assert tracker.attach(update)
    samples = feed(tracker, poses[25:], 25)
    assert all(s.status is PoseStatus.LIVE and s.epoch == 1 for s in samples)
    np.testing.assert_allclose(samples[-1].T_w_c, poses[-1], atol=0.03)


def test_a_submap_whose_points_are_out_of_view_is_caught_up_with() -> None:
    poses = drive(75, step_m=0.4)
    tracker = Tracker(FrontendConfig())
    feed(tracker, poses[:40])
    assert tracker.attach(WORLD.update(0, [0, 1], [stamp(0), stamp(3)], poses[[0, 3]]))
    samples = feed(tracker, poses[40:], 40)
    assert all(s.status is PoseStatus.LIVE for s in samples[20:])
    assert samples[0].status is PoseStatus.LOST
    driven = 0.4 * 75
    assert np.linalg.norm(samples[-1].T_w_c[:3, 3] - poses[-1][:3, 3]) < 0.05 * driven


def test_late_submaps_do_not_restart_catching_up() -> None:
    poses = drive(75, step_m=0.4)
    tracker = Tracker(FrontendConfig())
    feed(tracker, poses[:40])
    assert tracker.attach(WORLD.update(0, [0, 1], [stamp(0), stamp(3)], poses[[0, 3]]))
    samples = feed(tracker, poses[40:48], 40)
    for k, at in enumerate((48, 52, 56)):
        # each is newer than the one before, and older than what is being tracked
        ids = [1 + k, 2 + k]
        update = WORLD.update(1 + k, ids, [stamp(3 * i) for i in ids], poses[[3 * i for i in ids]])
        assert not tracker.attach(update)
        samples += feed(tracker, poses[at : at + 4], at)
    samples += feed(tracker, poses[60:], 60)
    assert samples[0].status is PoseStatus.LOST
    assert all(s.status is PoseStatus.LIVE for s in samples[20:])


def test_a_submap_whose_keyframes_are_dropped_is_refused() -> None:
    poses = drive(10)
    tracker = Tracker(FrontendConfig())
    feed(tracker, poses)
    update = WORLD.update(0, [70, 71], [stamp(0), stamp(3)], poses[[0, 3]])
    assert not tracker.attach(update)


def test_lagging_is_reported() -> None:
    poses = drive(14)
    tracker = attached(poses, 10)
    tracker.lagging = True
    assert feed(tracker, poses[10:], 10)[0].status is PoseStatus.LAGGING


def test_at_30_hz_a_submap_may_be_as_late_as_at_10_hz() -> None:
    poses = drive(130, 0.03)
    tracker = Tracker(FrontendConfig())

    def at(i: int) -> PoseSample:
        keyframe = i // 9 if i % 9 == 0 else None
        return seen(tracker, 1_000_000_000 + i * PERIOD_NS // 3, WORLD.render(poses[i]), keyframe)

    for i in range(110):
        at(i)
    ids = [0, 1, 2]
    stamps = [1_000_000_000 + 9 * i * PERIOD_NS // 3 for i in ids]
    # three seconds after its newest keyframe
    assert tracker.attach(WORLD.update(0, ids, stamps, poses[[0, 9, 18]]))
    live = [s for s in map(at, range(110, 130)) if s.status is PoseStatus.LIVE]
    # the frames since are tracked, three per new frame
    assert len(live) >= 5
    np.testing.assert_allclose(live[-1].T_w_c, poses[129], atol=0.05)


def test_a_pose_is_not_metric_until_a_submap_is() -> None:
    """Pulling away: the first sub-map has no metre and a wrong scale, the next one has both."""
    poses = drive(50)
    tracker = Tracker(FrontendConfig())
    feed(tracker, poses[:10])
    ids, stamps = [0, 1, 2, 3], [stamp(3 * i) for i in range(4)]
    wrong = poses[:10:3].copy()
    wrong[:, :3, 3] = wrong[0, :3, 3] + 1.15 * (wrong[:, :3, 3] - wrong[0, :3, 3])
    assert tracker.attach(WORLD.update(0, ids, stamps, wrong, scale_log_sigma=0.5))
    before = feed(tracker, poses[10:24], 10)
    assert all(s.status is PoseStatus.UNSCALED and s.scale_log_sigma >= 0.5 for s in before)
    assert not any(s.drift.any() or s.scale_offset.any() for s in before)
    ids, keyframes = [4, 5, 6, 7], [12, 15, 18, 21]
    update = WORLD.update(1, ids, [stamp(i) for i in keyframes], poses[keyframes])
    assert tracker.attach(update)
    after = feed(tracker, poses[24:], 24)
    assert all(s.status is PoseStatus.LIVE for s in after)
    # the tracker's own points are less sure than those of the sub-map
    assert all(0.01 <= s.scale_log_sigma < np.hypot(0.01, OWN_SCALE_SIGMA) for s in after)
    assert after[-1].scale_log_sigma > after[0].scale_log_sigma
    # lengths of the two units are not mixed in one velocity
    step = poses[-1, :3, :3].T @ (poses[-1] - poses[-2])[:3, 3] / 0.1
    for sample in after:
        if np.isfinite(sample.velocity_c).all():
            np.testing.assert_allclose(sample.velocity_c, step, atol=0.2)
    # the error of the scale grows with the path since the first metric pose
    path = after[-1].T_w_c[:3, 3] - after[0].T_w_c[:3, 3]
    grown = after[-1].T_w_c[:3, :3] @ after[-1].scale_offset
    grown -= after[0].T_w_c[:3, :3] @ after[0].scale_offset
    stretched = np.linalg.norm(grown) / np.linalg.norm(path)
    assert after[0].scale_log_sigma <= stretched <= after[-1].scale_log_sigma
    drift = [np.trace(sample.drift) for sample in after]
    assert drift[0] == 0 and np.all(np.diff(drift) > 0)
    pose, twist = after[-1].with_drift()
    assert np.isfinite(twist).all()
    assert np.trace(pose) > drift[-1] + np.trace(after[-1].covariance)


def test_an_objection_of_the_drive_makes_a_submap_unscaled() -> None:
    poses = drive(12)
    tracker = Tracker(FrontendConfig())
    feed(tracker, poses[:10])
    update = WORLD.update(0, [0, 1, 2], [stamp(0), stamp(3), stamp(6)], poses[:9:3])
    assert tracker.attach(replace(update, metre=Metre(reason="both pictures look alike")))
    (sample, _) = feed(tracker, poses[10:], 10)
    assert sample.status is PoseStatus.UNSCALED
    assert np.isnan(sample.with_drift()[0]).all() and np.isfinite(sample.T_w_c).all()


def test_exposure_that_pumps_disturbs_neither_pose_nor_submap() -> None:
    poses = drive(40)
    tracker = attached(poses, 12)

    def pumped(i: int) -> np.ndarray:
        # by up to a factor of two from frame to frame
        gain = 0.45 + 0.55 * abs(np.sin(0.8 * i))
        return np.asarray(gain * WORLD.render(poses[i]), np.uint8)

    for i in range(12, 40):
        sample = seen(tracker, stamp(i), pumped(i), i // 3 if i % 3 == 0 else None)
        assert sample.status is PoseStatus.LIVE
        assert np.linalg.norm(sample.T_w_c[:3, 3] - poses[i][:3, 3]) < 0.05


def test_the_readout_of_a_rolling_shutter_is_corrected() -> None:
    # slowly, then a turn to the right and back to the left
    yaw = np.radians(np.concatenate([np.zeros(9), 3.0 * np.sin(np.arange(1, 25) * 0.4)]))
    poses = drive(len(yaw), step_m=0.02)
    poses[:, :3, :3] = se3.so3_exp(np.stack([0 * yaw, yaw, 0 * yaw], 1))
    t_s = np.arange(len(poses)) * PERIOD_NS * 1e-9
    readout_s, bands = 0.04, 24

    def rolling(i: int) -> Bytes:
        out = np.empty((HEIGHT, WIDTH), np.uint8)
        for rows in np.array_split(np.arange(HEIGHT), bands):
            exposed = np.array([t_s[i] + readout_s * (rows.mean() / (HEIGHT - 1) - 0.5)])
            (T,) = se3.interpolate_at(t_s, poses, np.clip(exposed, 0, t_s[-1]))
            out[rows] = WORLD.render(T)[rows]
        return out

    def largest_error_deg(kit: KitBelief | None) -> float:
        tracker = Tracker(FrontendConfig())
        pictures = [rolling(i) for i in range(len(poses))]
        for i in range(9):
            seen(tracker, stamp(i), pictures[i], i // 3 if i % 3 == 0 else None)
        update = WORLD.update(0, [0, 1, 2], [stamp(3 * i) for i in range(3)], poses[[0, 3, 6]])
        assert tracker.attach(replace(update, kit=kit))
        found = [seen(tracker, stamp(i), pictures[i]).T_w_c for i in range(9, len(poses))]
        off = se3.so3_log(np.stack(found)[:, :3, :3].swapaxes(1, 2) @ poses[9:, :3, :3])
        return float(np.degrees(np.linalg.norm(off, axis=1).max()))

    kit = layout.prior((None, None), readout_s=(readout_s, readout_s))
    # the turn rate is that before the frame
    assert largest_error_deg(kit) < 0.75 * largest_error_deg(None)


def test_points_on_the_bonnet_have_no_say() -> None:
    poses = drive(3)
    lower = Masks(np.array([[0], [1]], np.uint8), None)
    for with_depth in (False, True):
        update = WORLD.update(
            0, [0, 1, 2], [stamp(i) for i in range(3)], poses, with_depth=with_depth
        )
        gray = WORLD.render(poses[-1])
        uv = landmark_cloud.of_update(replace(update, masks=lower), 300, gray).uv
        assert len(uv) > 20 and uv[:, 1].max() < HEIGHT / 2
        assert landmark_cloud.of_update(update, 300, gray).uv[:, 1].max() > HEIGHT / 2
