"""Pose samples -> MAVLink on a serial line: what to say, how often, and how sure."""

from __future__ import annotations

import logging
from typing import Protocol

import numpy as np

from calm_edge.config import ConfigError, PoseOutputConfig
from calm_edge.pose_output.body_frame import (
    body_pose,
    local_covariance,
    mounting_rotation,
    quaternion,
)
from calm_edge.pose_output.mavlink import (
    NAN,
    UNKNOWN_COVARIANCE,
    Encoder,
    Heartbeat,
    Message,
    Odometry,
    Severity,
    StatusText,
    SystemState,
)
from calm_edge.types import PoseSample, PoseStatus

log = logging.getLogger(__name__)

NS_PER_S = 1_000_000_000
# bytes on the wire, at most
_ODOMETRY_BYTES, _HEARTBEAT_BYTES, _STATUS_TEXT_BYTES = 245, 21, 66
# a byte is ten bits with its start and stop; a tenth of the line stays free
_BITS_A_BYTE, _LINE_SHARE = 10, 0.9

_QUALITY = {PoseStatus.LIVE: 100, PoseStatus.LAGGING: 50, PoseStatus.LOST: -1}
_SEVERITY = {
    PoseStatus.LIVE: Severity.INFO,
    PoseStatus.LAGGING: Severity.NOTICE,
    PoseStatus.LOST: Severity.WARNING,
}


class Port(Protocol):
    """Where messages go; never blocks, never raises."""

    def write(self, message: bytes) -> bool:
        """False if the message was not taken."""
        ...


def check_rate(config: PoseOutputConfig) -> None:
    """Raises ConfigError when the line cannot carry the rate."""
    if not config.rate_hz > 0:
        raise ConfigError(f"pose_output.rate_hz = {config.rate_hz:g}: must be above 0")
    each_second = _HEARTBEAT_BYTES + _STATUS_TEXT_BYTES
    capacity = config.baud / _BITS_A_BYTE * _LINE_SHARE
    if config.rate_hz * _ODOMETRY_BYTES + each_second > capacity:
        most = max(0, int((capacity - each_second) / _ODOMETRY_BYTES))
        raise ConfigError(
            f"pose_output.baud = {config.baud}: carries {most} poses a second, but "
            f"pose_output.rate_hz = {config.rate_hz:g}; raise baud or lower rate_hz"
        )


class PosePublisher:
    """Owner of what the consumer was told.

    spacing_known: the world is in metres. Without it every pose is sent with quality -1, for a
    consumer that took spacings for metres would be misled, and a warning says why.
    lost_after_ms: without a new sample for so long the pose is lost.
    """

    def __init__(
        self,
        port: Port,
        config: PoseOutputConfig,
        *,
        spacing_known: bool,
        lost_after_ms: float = 300.0,
    ) -> None:
        check_rate(config)
        if len(config.mounting_rpy_deg) != 3:
            raise ConfigError(
                f"pose_output.mounting_rpy_deg = {list(config.mounting_rpy_deg)}: "
                "expected roll, pitch and yaw"
            )
        roll, pitch, yaw = config.mounting_rpy_deg
        self._R_b_c = mounting_rotation((roll, pitch, yaw))
        self._port = port
        self._encoder = Encoder()
        self._spacing_known = spacing_known
        self._lost_after_ns = round(lost_after_ms * 1e6)
        self._period_ns = round(NS_PER_S / config.rate_hz)
        self._next_pose_ns = self._next_heartbeat_ns = self._next_text_ns = 0
        self._newest: PoseSample | None = None
        self._sent_t_ns = -1
        self._heard_ns = 0
        self._reset_counter = 1
        self._told: PoseStatus | None = None

    @property
    def reset_counter(self) -> int:
        """How often the published pose has jumped, plus one."""
        return self._reset_counter

    def publish(self, sample: PoseSample | None, now_ns: int) -> None:
        """To be called every tick, with a sample if there is a new one; sends what is due."""
        if sample is not None:
            self._take(sample, now_ns)
        if now_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns = _following(self._next_heartbeat_ns, NS_PER_S, now_ns)
            self._send(Heartbeat(self._state(now_ns)))
        if self._newest is None:
            return
        status = self._status(self._newest, now_ns)
        self._tell(status, now_ns)
        if now_ns < self._next_pose_ns:
            return
        message = self._odometry(self._newest, status, now_ns)
        if message is not None:
            self._next_pose_ns = _following(self._next_pose_ns, self._period_ns, now_ns)
            self._send(message)

    def _take(self, sample: PoseSample, now_ns: int) -> None:
        if self._newest is not None:
            if sample.t_ns <= self._newest.t_ns:
                return
            # one jump, however many corrections it took
            self._reset_counter += sample.epoch != self._newest.epoch
        self._newest, self._heard_ns = sample, now_ns

    def _status(self, newest: PoseSample, now_ns: int) -> PoseStatus:
        silent = now_ns - self._heard_ns > self._lost_after_ns
        return PoseStatus.LOST if silent else newest.status

    def _state(self, now_ns: int) -> SystemState:
        if self._newest is None:
            return SystemState.BOOT
        lost = self._status(self._newest, now_ns) is PoseStatus.LOST
        return SystemState.CRITICAL if lost else SystemState.ACTIVE

    def _tell(self, status: PoseStatus, now_ns: int) -> None:
        """A status text when the state has changed, at most one a second."""
        if status is self._told or now_ns < self._next_text_ns:
            return
        self._next_text_ns = now_ns + NS_PER_S
        self._told = status
        severity, text = _SEVERITY[status], f"calm-edge: pose {status.value}"
        if not self._spacing_known:
            severity, text = Severity.WARNING, f"{text}, set scale.spacing_m"
        log.info("%s", text)
        self._send(StatusText(severity, text))

    def _odometry(self, newest: PoseSample, status: PoseStatus, now_ns: int) -> Odometry | None:
        if status is PoseStatus.LOST:
            # the moment of the loss, and no pose: an old one must not look new. Nor may the line's
            # time run backwards: a pose exposed before this moment is not sent after it
            self._sent_t_ns = max(self._sent_t_ns, now_ns)
            nothing = (NAN, NAN, NAN)
            return Odometry(
                time_usec=now_ns // 1000,
                position=nothing,
                quaternion=(NAN, *nothing),
                velocity=nothing,
                pose_covariance=UNKNOWN_COVARIANCE,
                reset_counter=self._reset_counter,
                quality=_QUALITY[status],
            )
        if newest.t_ns <= self._sent_t_ns:
            return None
        self._sent_t_ns = newest.t_ns
        position, R_l_b = body_pose(self._R_b_c, newest.T_w_c)
        known = bool(np.isfinite(newest.covariance).all())
        return Odometry(
            time_usec=newest.t_ns // 1000,
            position=tuple(position.tolist()),
            quaternion=quaternion(R_l_b),
            velocity=tuple((self._R_b_c @ newest.velocity_c).tolist()),
            pose_covariance=local_covariance(self._R_b_c, newest.T_w_c, newest.covariance)
            if known
            else UNKNOWN_COVARIANCE,
            reset_counter=self._reset_counter,
            quality=_QUALITY[status] if self._spacing_known else -1,
        )

    def _send(self, message: Message) -> None:
        self._port.write(self._encoder.encode(message))


def _following(due_ns: int, period_ns: int, now_ns: int) -> int:
    """When it is due next: a period after this due time, so that the mean rate is kept, or
    after now when that has passed, so that a pause is not made up for.
    """
    next_ns = due_ns + period_ns
    return next_ns if next_ns > now_ns else now_ns + period_ns
