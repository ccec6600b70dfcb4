from __future__ import annotations

import math
import os
import time
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as peer

from calm_edge.config import ConfigError, PoseOutputConfig
from calm_edge.geometry.se3 import compose, so3_exp
from calm_edge.pose_output.line_budget import bytes_per_second
from calm_edge.pose_output.mavlink import Encoder, Timesync
from calm_edge.pose_output.publisher import PosePublisher
from calm_edge.types import PoseSample, PoseStatus
from device.serial_port import SerialPort

MS = 1_000_000
START = 50_000 * MS


class Recorder:
    """A port that decodes the messages written to it."""

    def __init__(self) -> None:
        self._link = peer.MAVLink(None)
        self.bytes = 0
        self.messages: list[Any] = []

    def write(self, message: bytes) -> bool:
        self.bytes += len(message)
        self.messages += self._link.parse_buffer(message) or []
        return True

    def take(self, kind: str) -> list[Any]:
        """Return the messages of a type since the last call."""
        taken = [m for m in self.messages if m.get_type() == kind]
        self.messages = [m for m in self.messages if m.get_type() != kind]
        return taken


class Bench:
    def __init__(self, spacing_known: bool = True, **changes: Any) -> None:
        self.port = Recorder()
        self.now_ns = START
        self.publisher = PosePublisher(
            self.port,
            PoseOutputConfig(**{"rate_hz": 20.0, **changes}),
            spacing_known=spacing_known,
            now_ns=lambda: self.now_ns,
        )

    def at(self, ms: float, given: PoseSample | None) -> list[Any]:
        """Run one tick and return the ODOMETRY messages it sent."""
        self.now_ns = START + round(ms * MS)
        self.publisher.publish(given, self.now_ns)
        return self.port.take("ODOMETRY")


def sample(ms: float, **changes: Any) -> PoseSample:
    fields: dict[str, Any] = {
        "t_ns": START + round(ms * MS),
        "T_w_c": compose(so3_exp(np.array([0.0, 0.5, 0.0])), np.array([2.0, 0.25, 7.0])),
        # the same pose each time, with a small velocity
        "velocity_c": np.array([0.5, 0.25, 2.0]),
        "turn_rate_c": np.array([0.125, 0.5, 0.25]),
        "covariance": np.diag([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]) * 1e-7,
        "twist_covariance": np.diag([4.0, 5.0, 6.0, 7.0, 8.0, 9.0]),
        "epoch": 0,
        "status": PoseStatus.LIVE,
        "scale_log_sigma": 1e-6,
    }
    return PoseSample(**fields | changes)


def test_a_pose_is_sent_in_the_local_frame_with_its_stamp() -> None:
    (got,) = Bench().at(80, sample(0))
    assert got.time_usec == START // 1000
    assert (got.x, got.y, got.z) == (7.0, 2.0, 0.25)
    assert np.allclose(got.q, [math.cos(0.25), 0, 0, math.sin(0.25)])
    assert (got.vx, got.vy, got.vz) == (2.0, 0.5, 0.25)
    assert (got.rollspeed, got.pitchspeed, got.yawspeed) == (0.25, 0.125, 0.5)
    assert got.quality == 100 and got.reset_counter == 1
    diagonal = [0, 6, 11, 15, 18, 20]
    # body forward, right, down are the camera's z, x, y
    assert np.allclose(np.array(got.velocity_covariance)[diagonal], [6, 4, 5, 9, 7, 8])
    assert got.pose_covariance[20] * 1e7 == pytest.approx(0.2)
    assert got.pose_covariance[0] < 3e-7


def test_the_mounting_rotates_velocity_and_pose() -> None:
    (got,) = Bench(mounting_rpy_deg=(0.0, 0.0, 90.0)).at(0, sample(0, T_w_c=np.eye(4)))
    assert np.allclose((got.vx, got.vy, got.vz), (-0.5, 2.0, 0.25))
    assert np.allclose(got.q, [1, 0, 0, 0], atol=1e-7)


def test_a_lever_arm_moves_pose_and_velocity_to_the_body() -> None:
    bench = Bench(mounting_xyz_m=(2.0, 0.0, -1.0))
    # the car has turned right by half a radian about its origin
    turned = so3_exp(np.array([0.0, 0.5, 0.0]))
    T_w_c = compose(turned, turned @ [0, 0, 2.0] - [0, 0, 2.0])
    spin = {"velocity_c": np.array([0.6, 0, 0]), "turn_rate_c": np.array([0, 0.3, 0])}
    (got,) = bench.at(0, sample(0, T_w_c=T_w_c, **spin))
    assert np.allclose((got.x, got.y, got.z, got.vx, got.vy, got.vz), 0, atol=1e-6)
    assert got.yawspeed == pytest.approx(0.3)


@pytest.mark.parametrize("name", ["covariance", "twist_covariance"])
def test_an_unknown_covariance_is_sent_as_nan(name: str) -> None:
    (got,) = Bench().at(0, sample(0, **{name: np.full((6, 6), np.nan)}))
    others = {"covariance": got.pose_covariance, "twist_covariance": got.velocity_covariance}
    unknown = others.pop(name)
    assert math.isnan(unknown[0]) and unknown[1] == 0
    assert all(np.isfinite(other).all() for other in others.values())
    assert got.quality == (0 if name == "covariance" else 100)


def test_the_reset_counter_starts_at_one_and_counts_jumps() -> None:
    bench = Bench(rate_hz=1.0)
    counters = []
    # most samples are dropped by the rate limit, but their jumps count
    for k, epoch in enumerate([4, 4, 5, 5, 8, 8, 9, 9, 9, 9, 9, 9]):
        counters += [m.reset_counter for m in bench.at(100 * k, sample(100 * k, epoch=epoch))]
    assert counters == [1, 4]
    assert bench.publisher.reset_counter == 4


def test_a_jump_without_a_new_epoch_is_a_reset() -> None:
    bench = Bench()
    leap = compose(so3_exp(np.array([0.0, 0.5, 0.0])), np.array([2.0, 0.25, 8.5]))
    ticks = [sample(0), sample(100), sample(200, T_w_c=leap), sample(300, T_w_c=leap)]
    sent = [m.reset_counter for k, s in enumerate(ticks) for m in bench.at(100 * k, s)]
    assert sent == [1, 1, 2, 2]


def test_a_jump_after_a_loss_with_a_new_epoch_is_one_reset() -> None:
    bench = Bench()
    leap = compose(np.eye(3), np.array([90.0, 0, 8.5]))
    lost = {"T_w_c": np.full((4, 4), np.nan), "status": PoseStatus.LOST}
    ticks = [sample(0), sample(100, **lost), sample(200, epoch=1, **lost)]
    ticks += [sample(300, T_w_c=leap, epoch=1), sample(400, T_w_c=leap, epoch=1)]
    sent = [m.reset_counter for k, s in enumerate(ticks) for m in bench.at(100 * k, s)]
    assert sent[0] == 1 and sent[-2:] == [2, 2]


def test_no_odometry_is_sent_while_lost_and_none_holds_nan() -> None:
    bench = Bench()
    lost = {"T_w_c": np.full((4, 4), np.nan), "status": PoseStatus.LOST}
    ticks = [sample(100 * k, **(lost if 3 <= k < 9 else {})) for k in range(12)]
    sent = [m for k, given in enumerate(ticks) for m in bench.at(100 * k, given)]
    # a receiver may keep the last message while the pose is lost
    assert all(np.isfinite([m.x, m.y, m.z, *m.q]).all() and m.quality > 0 for m in sent)
    at_ms = [(m.time_usec - START // 1000) // 1000 for m in sent]
    assert at_ms == [0, 100, 200, 900, 1000, 1100]


def test_a_pose_without_velocity_is_not_sent() -> None:
    bench = Bench()
    assert bench.at(0, sample(0, velocity_c=np.full(3, np.nan))) == []
    assert bench.at(100, sample(100, turn_rate_c=np.full(3, np.nan))) == []
    assert len(bench.at(200, sample(200))) == 1


def test_a_pose_is_not_sent_twice() -> None:
    bench = Bench()
    given = sample(0)
    assert len(bench.at(0, given)) == 1
    assert bench.at(100, None) == []
    assert bench.at(200, given) == []
    assert bench.at(250, sample(-50)) == []


def test_missing_samples_mean_lost_until_the_next_sample() -> None:
    bench = Bench()
    bench.at(0, sample(0))
    assert bench.at(301, None) == []
    # a LOST sample is not sent, although its stamp is new
    assert bench.at(650, sample(301, status=PoseStatus.LOST)) == []
    (found,) = bench.at(700, sample(690))
    assert found.quality == 100 and found.x == 7.0


def test_repeated_or_old_samples_do_not_end_a_loss() -> None:
    bench = Bench()
    bench.at(0, sample(0))
    bench.at(150, sample(0))
    bench.at(250, sample(-50, epoch=9))
    assert bench.publisher.reset_counter == 1
    bench.at(1000, None)
    assert bench.port.take("HEARTBEAT")[-1].system_status == peer.MAV_STATE_CRITICAL


def test_quality_while_lagging_is_between_live_and_zero() -> None:
    (got,) = Bench().at(0, sample(0, status=PoseStatus.LAGGING))
    assert 0 < got.quality < 100 and got.x == 7.0


@pytest.mark.parametrize(
    ("tick_hz", "rate_hz", "expected"), [(30, 20, 20), (10, 20, 10), (60, 7, 7)]
)
def test_the_mean_rate_is_that_of_the_samples_up_to_the_limit(
    tick_hz: int, rate_hz: int, expected: int
) -> None:
    bench = Bench(rate_hz=float(rate_hz))
    sent = sum(
        len(bench.at(1000 * k / tick_hz, sample(1000 * k / tick_hz))) for k in range(10 * tick_hz)
    )
    assert abs(sent - 10 * expected) <= 1


def test_a_pause_is_not_followed_by_a_burst() -> None:
    bench = Bench(rate_hz=10.0)
    bench.at(0, sample(0))
    sent = [len(bench.at(t, sample(t))) for t in range(5000, 5200, 10)]
    assert sum(sent) == 2


def test_heartbeats_with_the_state_are_sent_every_second() -> None:
    bench = Bench()
    for k in range(31):
        bench.at(100 * k, sample(100 * k) if 10 < k <= 15 else None)
    beats = [m.system_status for m in bench.port.take("HEARTBEAT")]
    assert beats == [
        peer.MAV_STATE_BOOT,
        peer.MAV_STATE_BOOT,
        peer.MAV_STATE_CRITICAL,
        peer.MAV_STATE_CRITICAL,
    ]
    bench.at(4000, sample(4000))
    assert bench.port.take("HEARTBEAT")[0].system_status == peer.MAV_STATE_ACTIVE


def test_state_texts_are_limited_to_one_per_second() -> None:
    bench = Bench()
    states = [PoseStatus.LIVE] * 3 + [PoseStatus.LOST, PoseStatus.LAGGING] * 15
    for k, status in enumerate(states):
        bench.at(100 * k, sample(100 * k, status=status))
    texts = [(m.severity, m.text) for m in bench.port.take("STATUSTEXT")]
    assert texts[0] == (peer.MAV_SEVERITY_INFO, "calm-edge running")
    assert 2 <= len(texts) <= 4
    assert set(texts[1:]) <= {
        (peer.MAV_SEVERITY_WARNING, "calm-edge lost"),
        (peer.MAV_SEVERITY_NOTICE, "calm-edge lagging"),
    }


def test_the_state_of_the_daemon_takes_precedence_over_that_of_the_pose() -> None:
    bench = Bench()
    reports = {
        0: ("STARTING", ()),
        2_000: ("RUNNING", ()),
        4_000: ("DEGRADED", ("assistant camera silent for 3 s", "recording stopped: disk full")),
        # a change of reasons alone has a longer period
        5_000: ("DEGRADED", ("recording stopped: disk full",)),
        20_000: ("STOPPING", ()),
    }
    for ms in range(0, 20_100, 100):
        if ms in reports:
            bench.publisher.report(*reports[ms])
        bench.at(ms, sample(ms) if ms > 1_000 else None)
    texts = [(m.severity, m.text, m.id, m.chunk_seq) for m in bench.port.take("STATUSTEXT")]
    long = "calm-edge degraded: assistant camera silent for 3 s; recording stopped: disk full"
    assert texts == [
        (peer.MAV_SEVERITY_INFO, "calm-edge starting", 0, 0),
        (peer.MAV_SEVERITY_INFO, "calm-edge running", 0, 0),
        (peer.MAV_SEVERITY_WARNING, long[:50], 3, 0),
        (peer.MAV_SEVERITY_WARNING, long[50:], 3, 1),
        (peer.MAV_SEVERITY_WARNING, "calm-edge degraded: recording stopped: disk full", 0, 0),
        (peer.MAV_SEVERITY_NOTICE, "calm-edge stopping", 0, 0),
    ]
    beats = [m.system_status for m in bench.port.take("HEARTBEAT")]
    assert beats[0] == peer.MAV_STATE_BOOT and beats[10] == peer.MAV_STATE_ACTIVE
    assert beats[-1] == peer.MAV_STATE_POWEROFF and len(beats) == 21


def test_a_lost_pose_is_critical_in_every_state_of_the_daemon() -> None:
    bench = Bench()
    bench.publisher.report("RUNNING")
    for k in range(20):
        bench.at(100 * k, sample(100 * k) if k < 3 else None)
    assert bench.port.take("HEARTBEAT")[-1].system_status == peer.MAV_STATE_CRITICAL


def test_the_stopping_state_is_sent_at_once() -> None:
    bench = Bench()
    bench.at(0, sample(0))
    bench.publisher.report("STOPPING")
    bench.at(10, None)
    assert [m.text for m in bench.port.take("STATUSTEXT")] == [
        "calm-edge running",
        "calm-edge stopping",
    ]


def test_the_stopping_state_is_sent_with_its_reasons() -> None:
    bench = Bench()
    bench.publisher.report("RUNNING")
    bench.at(0, None)
    bench.publisher.send_stopping(("camera x: no such camera",), START + 10 * MS)
    states = [m.system_status for m in bench.port.take("HEARTBEAT")]
    assert states == [peer.MAV_STATE_ACTIVE, peer.MAV_STATE_POWEROFF]
    text = bench.port.take("STATUSTEXT")[-1].text
    assert text == "calm-edge stopping: camera x: no such camera"


def timesync_request(ts1: int, **changes: Any) -> bytes:
    """The bytes of an autopilot's TIMESYNC request."""
    request = Timesync(**{"tc1_ns": 0, "ts1_ns": ts1, **changes})
    return Encoder(system_id=1, component_id=1).encode(request)


def test_a_timesync_request_is_answered_with_the_clock_of_the_poses() -> None:
    bench = Bench()
    (pose,) = bench.at(40, sample(40))
    bench.publisher.receive(timesync_request(987)[:9])
    assert bench.port.take("TIMESYNC") == []
    bench.publisher.receive(timesync_request(987)[9:])
    (answer,) = bench.port.take("TIMESYNC")
    assert (answer.tc1 // 1000, answer.ts1) == (pose.time_usec, 987)
    target = answer.get_msgbuf()[-4:-2]
    assert bytes(target) == bytes([1, 1])


@pytest.mark.parametrize(
    ("request_", "answers"),
    [
        (timesync_request(5, target=(1, 197)), 1),
        (timesync_request(5, target=(1, 0)), 1),
        (timesync_request(5, target=(2, 197)), 0),
        (timesync_request(5, target=(1, 100)), 0),
        # a reply between two others
        (timesync_request(5, tc1_ns=77), 0),
        (b"\xfd" * 300 + timesync_request(5), 1),
    ],
)
def test_only_timesync_requests_for_this_component_are_answered(
    request_: bytes, answers: int
) -> None:
    bench = Bench()
    bench.publisher.receive(request_)
    assert len(bench.port.take("TIMESYNC")) == answers


def test_timesync_replies_are_rate_limited() -> None:
    bench = Bench()
    for ms in range(1000):
        bench.now_ns = START + ms * MS
        bench.publisher.receive(timesync_request(ms))
    assert len(bench.port.take("TIMESYNC")) == 20


def test_an_unchanged_state_is_sent_once() -> None:
    bench = Bench()
    for k in range(50):
        bench.at(100 * k, sample(100 * k))
    assert len(bench.port.take("STATUSTEXT")) == 1


def test_without_a_spacing_no_pose_is_sent_and_the_text_names_the_remedy() -> None:
    bench = Bench(spacing_known=False)
    assert bench.at(0, sample(0)) == []
    (beat,) = bench.port.take("HEARTBEAT")
    assert beat.system_status == peer.MAV_STATE_CRITICAL
    (text,) = bench.port.take("STATUSTEXT")
    assert text.severity == peer.MAV_SEVERITY_WARNING and "scale.spacing_m" in text.text


def test_poses_without_a_metre_are_not_sent_and_the_reason_is() -> None:
    bench = Bench()
    reason = "no metre: both pictures look alike"
    sent = []
    for k in range(40):
        unscaled = k < 12 or 20 <= k < 30
        bench.publisher.report(*(("DEGRADED", (reason,)) if unscaled else ("RUNNING",)))
        status = PoseStatus.UNSCALED if unscaled else PoseStatus.LIVE
        sent += bench.at(100 * k, sample(100 * k, status=status))
    at_ms = [(m.time_usec - START // 1000) // 1000 for m in sent]
    assert at_ms == [*range(1200, 2000, 100), *range(3000, 4000, 100)]
    # a new start, since nothing is known of the way without a metre
    assert [m.reset_counter for m in sent] == [1] * 8 + [2] * 10
    critical, active = peer.MAV_STATE_CRITICAL, peer.MAV_STATE_ACTIVE
    beats = [m.system_status for m in bench.port.take("HEARTBEAT")]
    assert beats == [critical, critical, critical, active]
    texts = [(m.severity, m.text) for m in bench.port.take("STATUSTEXT")]
    assert texts[0] == (peer.MAV_SEVERITY_WARNING, f"calm-edge degraded: {reason}"[:50])
    assert texts[2] == (peer.MAV_SEVERITY_INFO, "calm-edge running")


def test_the_covariance_of_the_pose_holds_its_drift() -> None:
    given = {"T_w_c": np.eye(4), "covariance": 1e-4 * np.eye(6)}
    drift, bent = np.diag([0.04, 0.01, 0.09, 1e-4, 4e-4, 9e-4]), np.array([0.5, 0, 0, 0, 0.02, 0])
    (got,) = Bench().at(0, sample(0, **given, drift=drift, focal_offset=bent))
    # body axes are the camera's z, x, y
    expected = [0.0901, 0.2901, 0.0101, 1e-3, 2e-4, 9e-4]
    assert np.allclose(np.array(got.pose_covariance)[[0, 6, 11, 15, 18, 20]], expected)
    # not of the distance from the start, but of the sub-map
    near = sample(0, **given)
    assert got.quality == Bench().at(0, near)[0].quality


def test_covariances_hold_the_error_of_the_scale() -> None:
    # body axes are the camera's z, x, y
    T_w_c = compose(np.eye(3), np.array([0.0, 0.0, 100.0]))
    offset = np.array([0.0, 0.0, 2.0])
    given = {"T_w_c": T_w_c, "covariance": 1e-4 * np.eye(6), "twist_covariance": 1e-4 * np.eye(6)}
    velocity = {"velocity_c": np.array([0.0, 0.0, 10.0])}
    scaled = sample(0, **given, **velocity, scale_log_sigma=0.02, scale_offset=offset)
    (got,) = Bench().at(0, scaled)
    diagonal = [0, 6, 11]
    assert np.allclose(np.array(got.pose_covariance)[diagonal], [4.0001, 1e-4, 1e-4])
    assert np.allclose(np.array(got.velocity_covariance)[diagonal], [0.0401, 1e-4, 1e-4])
    # not of the distance from the start, but of the present sigma
    assert got.quality == round(100 / (1 + 0.2**2 + (0.01 / math.radians(0.25)) ** 2 + 0.4**2))


def test_the_busiest_second_leaves_a_tenth_of_the_line_free() -> None:
    bench = Bench(baud=57_600, rate_hz=17.0)
    for k in range(1000):
        status = PoseStatus.LAGGING if k // 40 % 2 else PoseStatus.LIVE
        bench.publisher.report("LOST" if k // 100 % 2 else "DEGRADED", ("x" * 300,))
        bench.at(10 * k, sample(10 * k, status=status))
        bench.publisher.receive(timesync_request(k))
    sent = bench.port.bytes / 10
    assert 0.8 * bytes_per_second(17.0) < sent <= bytes_per_second(17.0) <= 0.9 * 57_600 / 10


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rate_hz": 0.0}, "rate_hz = 0"),
        ({"mounting_rpy_deg": (0.0, 1.0)}, "mounting_rpy_deg"),
        ({"mounting_xyz_m": (0.0, 1.0, math.inf)}, "mounting_xyz_m"),
        ({"system_id": 256}, "system_id"),
        ({"baud": 57_600, "rate_hz": 30.0}, "carries 17 poses"),
    ],
)
def test_invalid_settings_raise_a_config_error(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        PosePublisher(Recorder(), PoseOutputConfig(**changes), spacing_known=True)


def test_over_a_pseudo_terminal() -> None:
    master, slave = os.openpty()
    port = SerialPort(os.ttyname(slave), 115_200)
    publisher = PosePublisher(port, PoseOutputConfig(), spacing_known=True)
    port.start(publisher.receive)
    autopilot = peer.MAVLink(None, srcSystem=1, srcComponent=1)
    received: list[Any] = []

    def read_until(count: int) -> None:
        limit = time.monotonic() + 5
        while len(received) < count and time.monotonic() < limit:
            received.extend(autopilot.parse_buffer(os.read(master, 4096)) or [])

    try:
        for k in range(5):
            publisher.publish(sample(50 * k), START + 50 * k * MS)
        read_until(7)
        before = time.monotonic_ns()
        # noise as from plugging in, then the request
        os.write(master, bytes(range(256)))
        os.write(master, peer.MAVLink_timesync_message(0, 4711).pack(autopilot))
        read_until(8)
        after = time.monotonic_ns()
    finally:
        port.stop()
        os.close(master)
        os.close(slave)
    kinds = ["HEARTBEAT", "STATUSTEXT"] + ["ODOMETRY"] * 5 + ["TIMESYNC"]
    assert [m.get_type() for m in received] == kinds
    assert [m.get_seq() for m in received] == list(range(8))
    assert received[-1].ts1 == 4711 and before < received[-1].tc1 < after


def test_stamps_sent_increase_across_a_loss() -> None:
    bench = Bench()
    # the fourth was exposed before the loss was detected
    ticks = [
        (0, sample(0)),
        (60, sample(10, status=PoseStatus.LOST)),
        (130, None),
        (180, sample(110)),
        (280, sample(210)),
    ]
    sent = [m for ms, given in ticks for m in bench.at(ms, given)]
    assert [m.time_usec - START // 1000 for m in sent] == [0, 110_000, 210_000]
