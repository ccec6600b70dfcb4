"""Send poses, state and clock replies as MAVLink messages to a serial or UDP port."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from calm_edge.config import ConfigError, PoseOutputConfig
from calm_edge.geometry import body_frame, se3
from calm_edge.pose_output.jump import jumped
from calm_edge.pose_output.line_budget import ANSWERS_HZ, check_rate
from calm_edge.pose_output.mavlink import (
    COMPONENT_VISUAL_ODOMETRY,
    UNKNOWN_COVARIANCE,
    Encoder,
    Heartbeat,
    Message,
    Odometry,
    Severity,
    SystemState,
    Timesync,
    status_texts,
)
from calm_edge.pose_output.mavlink_parser import MavlinkParser
from calm_edge.pose_output.quality import quality
from calm_edge.types import PoseSample, PoseStatus
from device.udp_port import PREFIX

log = logging.getLogger(__name__)

NS_PER_S = 1_000_000_000
# least time between status texts if the state has changed, and if only its reasons have
_TEXT_PERIOD_NS, _REASONS_PERIOD_NS = NS_PER_S, 10 * NS_PER_S

_STATES = {
    "STARTING": (SystemState.BOOT, Severity.INFO),
    "RUNNING": (SystemState.ACTIVE, Severity.INFO),
    "LAGGING": (SystemState.ACTIVE, Severity.NOTICE),
    "DEGRADED": (SystemState.ACTIVE, Severity.WARNING),
    "LOST": (SystemState.CRITICAL, Severity.WARNING),
    "STOPPING": (SystemState.POWEROFF, Severity.NOTICE),
}
_STATE_OF_POSE = {
    PoseStatus.LIVE: "RUNNING",
    PoseStatus.LAGGING: "LAGGING",
    PoseStatus.UNSCALED: "DEGRADED",
    PoseStatus.LOST: "LOST",
}


class Port(Protocol):
    """Output of messages; never blocks, never raises."""

    def write(self, message: bytes) -> bool:
        """Queue a message; False if it was rejected."""
        ...


class PosePublisher:
    """Publisher of poses and state to an autopilot.

    spacing_known: True if the world unit is metres. If not, a warning text gives the remedy.
    lost_after_ms: time without a new sample after which the pose is
    lost. now_ns: clock of the samples' stamps, used to answer TIMESYNC. `receive` may be called in
    another thread.

    No ODOMETRY is sent while the pose is lost, nor for a first pose without velocity: an old pose
    must not look new, and NaN would persist in some receivers (ArduPilot aligns the pose after a
    reset to the last one received). None is sent either in lengths that are not metric.
    """

    def __init__(
        self,
        port: Port,
        config: PoseOutputConfig,
        *,
        spacing_known: bool,
        lost_after_ms: float = 300.0,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        check_rate(config, limited=not config.port.startswith(PREFIX))
        self._T_b_c = _mounting(config)
        self._address = config.system_id, COMPONENT_VISUAL_ODOMETRY
        self._port = port
        self._sending = threading.Lock()
        self._encoder = Encoder(*self._address)
        self._parser = MavlinkParser((Timesync,))
        self._clock = now_ns
        self._spacing_known = spacing_known
        self._lost_after_ns = round(lost_after_ms * 1e6)
        self._period_ns = round(NS_PER_S / config.rate_hz)
        self._next_pose_ns = self._next_heartbeat_ns = self._next_answer_ns = 0
        self._newest: PoseSample | None = None
        self._newest_pose: PoseSample | None = None
        self._was_unscaled = False
        self._sent_t_ns = -1
        self._last_sample_ns = 0
        self._reset_counter = 1
        self._reported: tuple[str, tuple[str, ...]] | None = None
        self._sent_state: tuple[str, tuple[str, ...]] = ("", ())
        self._sent_state_ns = -_REASONS_PERIOD_NS
        self._texts = 0

    @property
    def reset_counter(self) -> int:
        """Value of ODOMETRY's reset_counter: 1, plus one for each jump of the pose so far."""
        return self._reset_counter

    def report(self, state: str, reasons: tuple[str, ...] = ()) -> None:
        """Set the daemon's state and its reasons; until the first call the pose's state is sent."""
        self._reported = state, reasons

    def send_stopping(self, reasons: tuple[str, ...], now_ns: int) -> None:
        """Send a heartbeat and a text with the state STOPPING and its reasons; call it last."""
        self.report("STOPPING", reasons)
        self._next_heartbeat_ns = now_ns
        self.publish(None, now_ns)

    def publish(self, sample: PoseSample | None, now_ns: int) -> None:
        """Send the messages that are due; call it every tick, with the new sample if any."""
        if sample is not None:
            self._take(sample, now_ns)
        if now_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns = _following(self._next_heartbeat_ns, NS_PER_S, now_ns)
            self._send(Heartbeat(self._system_state(now_ns)))
        self._send_state(now_ns)
        if self._newest is None or now_ns < self._next_pose_ns:
            return
        newest, status = self._newest, self._status(self._newest, now_ns)
        if not (self._spacing_known and status.usable) or newest.t_ns <= self._sent_t_ns:
            return
        if not np.isfinite([newest.velocity_c, newest.turn_rate_c]).all():
            return
        self._sent_t_ns = newest.t_ns
        self._next_pose_ns = _following(self._next_pose_ns, self._period_ns, now_ns)
        self._send(self._odometry(newest, status))

    def receive(self, data: bytes) -> None:
        """Parse received bytes and answer TIMESYNC requests at once."""
        # read the clock first: any delay would appear as a clock offset
        now_ns = self._clock()
        for message in self._parser.feed(data):
            request = Timesync.from_payload(message.payload)
            system, component = request.target
            for_us = system in (0, self._address[0]) and component in (0, self._address[1])
            if request.tc1_ns == 0 and for_us and now_ns >= self._next_answer_ns:
                self._next_answer_ns = now_ns + NS_PER_S // ANSWERS_HZ
                sender = message.system_id, message.component_id
                self._send(Timesync(now_ns, request.ts1_ns, sender))

    def _take(self, sample: PoseSample, now_ns: int) -> None:
        if self._newest is not None and sample.t_ns <= self._newest.t_ns:
            return
        self._last_sample_ns, self._newest = now_ns, sample
        self._was_unscaled |= sample.status is PoseStatus.UNSCALED
        if not sample.status.usable:
            return
        before, self._newest_pose = self._newest_pose, sample
        if before is not None:
            # several reasons in the same sample count once; the way without a metre is unknown
            moved = self._spacing_known and jumped(before, sample)
            self._reset_counter += moved or sample.epoch != before.epoch or self._was_unscaled
        self._was_unscaled = False

    def _status(self, newest: PoseSample, now_ns: int) -> PoseStatus:
        timed_out = now_ns - self._last_sample_ns > self._lost_after_ns
        return PoseStatus.LOST if timed_out else newest.status

    def _state(self, now_ns: int) -> tuple[str, tuple[str, ...]]:
        if self._reported is not None:
            return self._reported
        if self._newest is None:
            return "STARTING", ()
        return _STATE_OF_POSE[self._status(self._newest, now_ns)], ()

    def _system_state(self, now_ns: int) -> SystemState:
        state = _STATES.get(self._state(now_ns)[0], (SystemState.ACTIVE,))[0]
        newest = self._newest
        if state is not SystemState.ACTIVE or newest is None:
            return state
        sent = self._spacing_known and self._status(newest, now_ns).usable
        return state if sent else SystemState.CRITICAL

    def _send_state(self, now_ns: int) -> None:
        """Send a status text if the state or its reasons have changed, at a limited rate.

        STOPPING is sent at once.
        """
        state, reasons = current = self._state(now_ns)
        period = _TEXT_PERIOD_NS if state != self._sent_state[0] else _REASONS_PERIOD_NS
        too_soon = now_ns < self._sent_state_ns + period and state != "STOPPING"
        if current == self._sent_state or too_soon:
            return
        self._sent_state, self._sent_state_ns = current, now_ns
        _, severity = _STATES.get(state, (SystemState.ACTIVE, Severity.NOTICE))
        if not self._spacing_known:
            severity, reasons = Severity.WARNING, ("set scale.spacing_m", *reasons)
        text = f"calm-edge {state.lower()}" + (f": {'; '.join(reasons)}" if reasons else "")
        log.info("%s", text)
        self._texts = self._texts % 0xFFFF + 1
        for message in status_texts(severity, text, self._texts):
            self._send(message)

    def _odometry(self, newest: PoseSample, status: PoseStatus) -> Odometry:
        T_b_c = self._T_b_c
        T_l_b = body_frame.body_pose(T_b_c, newest.T_w_c)
        twist = body_frame.body_twist(T_b_c, newest.velocity_c, newest.turn_rate_c)
        pose_covariance = velocity_covariance = UNKNOWN_COVARIANCE
        covariance, twist_covariance = newest.with_drift()
        if np.isfinite(covariance).all():
            pose_covariance = body_frame.local_covariance(T_b_c, T_l_b, covariance)
        if np.isfinite(twist_covariance).all():
            velocity_covariance = body_frame.body_covariance(T_b_c, twist_covariance)
        return Odometry(
            time_usec=newest.t_ns // 1000,
            position=tuple(T_l_b[:3, 3].tolist()),
            quaternion=tuple(np.roll(se3.quaternions(T_l_b[:3, :3]), 1).tolist()),
            velocity=tuple(twist[0].tolist()),
            turn_rate=tuple(twist[1].tolist()),
            pose_covariance=pose_covariance,
            velocity_covariance=velocity_covariance,
            reset_counter=self._reset_counter,
            quality=quality(newest.covariance, newest.scale_log_sigma, status),
        )

    def _send(self, message: Message) -> None:
        # two threads send; sequence numbers must follow the order of sending
        with self._sending:
            self._port.write(self._encoder.encode(message))


def _mounting(config: PoseOutputConfig) -> np.ndarray:
    """Return T_b_c (4, 4) of the configured mounting; raises ConfigError for invalid values."""
    for key, what in (("mounting_rpy_deg", "roll, pitch and yaw"), ("mounting_xyz_m", "x, y, z")):
        values = getattr(config, key)
        if len(values) != 3 or not np.isfinite(values).all():
            raise ConfigError(f"pose_output.{key} = {list(values)}: expected {what}")
    if not 1 <= config.system_id <= 255:
        raise ConfigError(f"pose_output.system_id = {config.system_id}: expected 1 to 255")
    return body_frame.mounting(config.mounting_rpy_deg, config.mounting_xyz_m)


def _following(due_ns: int, period_ns: int, now_ns: int) -> int:
    """Return the next due time: one period after due_ns, or after now_ns if that has passed."""
    next_ns = due_ns + period_ns
    return next_ns if next_ns > now_ns else now_ns + period_ns
