from __future__ import annotations

import math
import os
import time
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as peer

from calm_edge.config import Config, ConfigError, PoseOutputConfig
from calm_edge.geometry.se3 import compose, so3_exp
from calm_edge.pose_output.publisher import PosePublisher, check_rate
from calm_edge.types import PoseSample, PoseStatus
from device.serial_port import SerialPort

MS = 1_000_000
START = 50_000 * MS


class Recorder:
    """A port that decodes what it is given."""

    def __init__(self) -> None:
        self._link = peer.MAVLink(None)
        self.bytes = 0
        self.heard: list[Any] = []

    def write(self, message: bytes) -> bool:
        self.bytes += len(message)
        self.heard += self._link.parse_buffer(message) or []
        return True

    def take(self, kind: str) -> list[Any]:
        """The messages of a kind since the last take."""
        taken = [m for m in self.heard if m.get_type() == kind]
        self.heard = [m for m in self.heard if m.get_type() != kind]
        return taken


class Bench:
    def __init__(self, spacing_known: bool = True, **changes: Any) -> None:
        self.port = Recorder()
        self.publisher = PosePublisher(
            self.port, PoseOutputConfig(**changes), spacing_known=spacing_known
        )

    def at(self, ms: float, given: PoseSample | None) -> list[Any]:
        """One tick; the odometry it sent."""
        self.publisher.publish(given, START + round(ms * MS))
        return self.port.take("ODOMETRY")


def sample(ms: float, **changes: Any) -> PoseSample:
    fields: dict[str, Any] = {
        "t_ns": START + round(ms * MS),
        "T_w_c": compose(so3_exp(np.array([0.0, 0.5, 0.0])), np.array([2.0, 0.25, 7.0])),
        "velocity_c": np.array([0.5, 0.25, 9.0]),
        "covariance": np.diag([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]),
        "epoch": 0,
        "status": PoseStatus.LIVE,
    }
    return PoseSample(**fields | changes)


def test_a_pose_arrives_in_the_local_frame_with_its_own_stamp() -> None:
    (got,) = Bench().at(80, sample(0))
    assert got.time_usec == START // 1000
    assert (got.x, got.y, got.z) == (7.0, 2.0, 0.25)
    assert np.allclose(got.q, [math.cos(0.25), 0, 0, math.sin(0.25)])
    assert (got.vx, got.vy, got.vz) == (9.0, 0.5, 0.25)
    assert got.quality == 100 and got.reset_counter == 1


def test_the_mounting_turns_velocity_and_pose() -> None:
    (got,) = Bench(mounting_rpy_deg=(0.0, 0.0, 90.0)).at(0, sample(0, T_w_c=np.eye(4)))
    assert np.allclose((got.vx, got.vy, got.vz), (-0.5, 9.0, 0.25))
    assert np.allclose(got.q, [1, 0, 0, 0], atol=1e-7)


def test_an_unknown_covariance_is_said_to_be_unknown() -> None:
    (got,) = Bench().at(0, sample(0, covariance=np.full((6, 6), np.nan)))
    assert math.isnan(got.pose_covariance[0]) and got.pose_covariance[1] == 0


def test_the_reset_counter_starts_at_one_and_grows_with_each_jump() -> None:
    bench = Bench(rate_hz=1.0)
    counters = []
    # most samples fall to the rate limit, their jumps still count
    for k, epoch in enumerate([4, 4, 5, 5, 8, 8, 9, 9, 9, 9, 9, 9]):
        counters += [m.reset_counter for m in bench.at(100 * k, sample(100 * k, epoch=epoch))]
    assert counters == [1, 4]
    assert bench.publisher.reset_counter == 4


def test_lost_has_no_pose_and_no_quality() -> None:
    bench = Bench()
    bench.at(0, sample(0))
    (got,) = bench.at(60, sample(60, status=PoseStatus.LOST))
    assert got.quality == -1
    assert all(math.isnan(v) for v in (got.x, got.y, got.z, got.vx, got.vy, got.vz, *got.q))
    assert got.time_usec == (START + 60 * MS) // 1000


def test_an_old_pose_is_never_sent_again() -> None:
    bench = Bench()
    given = sample(0)
    assert len(bench.at(0, given)) == 1
    assert bench.at(100, None) == []
    assert bench.at(200, given) == []
    assert bench.at(250, sample(-50)) == []


def test_silence_is_a_loss_that_ends_with_the_next_sample() -> None:
    bench = Bench()
    bench.at(0, sample(0))
    assert bench.at(300, None) == []
    (lost,) = bench.at(301, None)
    assert lost.quality == -1 and math.isnan(lost.x)
    (found,) = bench.at(400, sample(390))
    assert found.quality == 100 and found.x == 7.0


def test_a_repeated_or_late_sample_is_silence_too() -> None:
    bench = Bench()
    bench.at(0, sample(0))
    bench.at(150, sample(0))
    bench.at(250, sample(-50, epoch=9))
    (lost,) = bench.at(301, None)
    assert lost.quality == -1 and lost.reset_counter == 1


def test_lagging_is_worth_less_than_live_and_more_than_nothing() -> None:
    (got,) = Bench().at(0, sample(0, status=PoseStatus.LAGGING))
    assert 0 < got.quality < 100 and got.x == 7.0


@pytest.mark.parametrize(
    ("tick_hz", "rate_hz", "expected"), [(30, 20, 20), (10, 20, 10), (60, 7, 7)]
)
def test_the_mean_rate_is_the_limit_or_the_samples(
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


def test_heartbeat_once_a_second_from_the_start_with_the_state() -> None:
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


def test_changes_of_state_are_said_at_most_once_a_second() -> None:
    bench = Bench()
    states = [PoseStatus.LIVE] * 3 + [PoseStatus.LOST, PoseStatus.LAGGING] * 15
    for k, status in enumerate(states):
        bench.at(100 * k, sample(100 * k, status=status))
    said = [(m.severity, m.text) for m in bench.port.take("STATUSTEXT")]
    assert said[0] == (peer.MAV_SEVERITY_INFO, "calm-edge: pose live")
    assert 2 <= len(said) <= 4
    assert set(said[1:]) <= {
        (peer.MAV_SEVERITY_WARNING, "calm-edge: pose lost"),
        (peer.MAV_SEVERITY_NOTICE, "calm-edge: pose lagging"),
    }


def test_a_state_that_stays_is_said_once() -> None:
    bench = Bench()
    for k in range(50):
        bench.at(100 * k, sample(100 * k))
    assert len(bench.port.take("STATUSTEXT")) == 1


def test_without_metres_no_pose_is_trusted_and_the_mend_is_said() -> None:
    bench = Bench(spacing_known=False)
    (got,) = bench.at(0, sample(0))
    assert got.quality == -1 and got.x == 7.0
    (said,) = bench.port.take("STATUSTEXT")
    assert said.severity == peer.MAV_SEVERITY_WARNING and "scale.spacing_m" in said.text


def test_a_line_too_slow_for_the_rate_is_a_config_error() -> None:
    check_rate(PoseOutputConfig(baud=115_200, rate_hz=30.0))
    check_rate(Config().pose_output)
    with pytest.raises(ConfigError, match=r"baud = 57600: carries 20 poses.*rate_hz = 30"):
        check_rate(PoseOutputConfig(baud=57_600, rate_hz=30.0))
    with pytest.raises(ConfigError, match="carries 0 poses"):
        PosePublisher(Recorder(), PoseOutputConfig(baud=300), spacing_known=True)


def test_the_rate_that_just_fits_leaves_a_tenth_of_the_line_free() -> None:
    bench = Bench(baud=57_600, rate_hz=20.0)
    for k in range(1000):
        status = PoseStatus.LOST if k // 40 % 2 else PoseStatus.LIVE
        bench.at(10 * k, sample(10 * k, status=status))
    assert bench.port.bytes / 10 <= 0.9 * 57_600 / 10


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"rate_hz": 0.0}, "rate_hz = 0"), ({"mounting_rpy_deg": (0.0, 1.0)}, "mounting_rpy_deg")],
)
def test_nonsense_is_a_config_error(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        PosePublisher(Recorder(), PoseOutputConfig(**changes), spacing_known=True)


def test_over_a_real_line() -> None:
    master, slave = os.openpty()
    port = SerialPort(os.ttyname(slave), 115_200)
    port.start()
    try:
        publisher = PosePublisher(port, PoseOutputConfig(), spacing_known=True)
        for k in range(5):
            publisher.publish(sample(50 * k), START + 50 * k * MS)
        received: list[Any] = []
        link = peer.MAVLink(None)
        limit = time.monotonic() + 5
        while len(received) < 7 and time.monotonic() < limit:
            received += link.parse_buffer(os.read(master, 4096)) or []
    finally:
        port.stop()
        os.close(master)
        os.close(slave)
    assert [m.get_type() for m in received] == ["HEARTBEAT", "STATUSTEXT"] + ["ODOMETRY"] * 5
    assert [m.get_seq() for m in received] == list(range(7))


def test_time_on_the_line_never_runs_backwards_after_a_loss() -> None:
    bench = Bench()
    # the fourth pose was exposed before the loss was last told
    ticks = [
        (0, sample(0)),
        (60, sample(10, status=PoseStatus.LOST)),
        (130, None),
        (180, sample(110)),
        (280, sample(210)),
    ]
    told = [m for ms, given in ticks for m in bench.at(ms, given)]
    assert [m.quality for m in told] == [100, -1, -1, 100]
    assert [m.time_usec - START // 1000 for m in told] == [0, 60_000, 130_000, 210_000]
