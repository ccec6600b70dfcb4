"""The outputs of live results: recording, pose output, live page. Add further ones here."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from calm_edge.config import Config
from calm_edge.daemon.fan_out import Output
from calm_edge.daemon.health import Health
from calm_edge.daemon.live_output import LiveOutput
from calm_edge.daemon.messages import Attached, Event
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.state import Standing
from calm_edge.pose_output.publisher import PosePublisher
from calm_edge.recording.health import WriterHealth
from calm_edge.recording.schema import CAMERAS_METADATA, HEALTH
from calm_edge.recording.sensors import Sample
from calm_edge.recording.window_record import WindowRecord
from calm_edge.recording.writer import RecordingWriter
from calm_edge.types import LocalizerUpdate, PoseSample
from device.frame import Frame
from device.serial_port import SerialPort
from device.udp_port import PREFIX, UdpPort


class RecordingOutput(Output):
    """Output to the recording; RecordingWriter queues the data and writes it from a thread."""

    name = "recording"
    immediate = required = True

    def __init__(self, open_writer: Callable[[], RecordingWriter]) -> None:
        self._open_writer = open_writer
        self._writer: RecordingWriter | None = None

    def open(self) -> None:
        """Open the files; earlier log lines are not recorded. Raises RecordingError."""
        self._writer = self._open_writer()

    @property
    def health(self) -> WriterHealth:
        """Status of the writer: disk space, and numbers of items written and dropped."""
        return self.writer.health

    @property
    def writer(self) -> RecordingWriter:
        assert self._writer is not None
        return self._writer

    @property
    def fault(self) -> str:
        return self.health.error

    def frame(self, frame: Frame) -> None:
        self.writer.write_frame(frame)

    def sample(self, sample: Sample) -> None:
        self.writer.write_sample(sample)

    def window(self, window: WindowRecord) -> None:
        self.writer.write_window(window)

    def pose(self, sample: PoseSample, now_ns: int) -> None:
        self.writer.write_pose(sample)

    def update(self, update: LocalizerUpdate) -> None:
        self.writer.write_update(update)

    def attached(self, attached: Attached) -> None:
        self.writer.write_odometry_frame(attached.T_map_odom)
        T_map_odom = attached.T_map_odom.ravel().tolist()
        self.writer.write_status(
            {
                "submap_id": attached.submap_id,
                "tracked": attached.taken,
                "T_map_odom": T_map_odom,
            }
        )

    def cameras(self, settings: Mapping[str, str]) -> None:
        self.writer.write_metadata(CAMERAS_METADATA, settings)

    def status(self, standing: Standing, health: Health | None) -> None:
        if health is not None:
            self.writer.write_status(health.message(), HEALTH)

    def event(self, event: Event) -> None:
        if self._writer is not None:
            self._writer.write_event(event.t_ns, event.text)

    def keep(self, kept: bool) -> None:
        if self._writer is not None:
            self._writer.keep(kept)

    def say(self, level: int, text: str, name: str) -> None:
        if self._writer is not None:
            self._writer.write_log(level, text, name)

    def close(self, result: RecordResult) -> None:
        if self._writer is None:
            return
        self._writer.write_status(result.summary())
        health = self._writer.close()
        result.unrecorded = health.dropped_images + health.dropped_others + health.unwritable
        result.error = result.error or health.error


class MavlinkOutput(Output):
    """Output of poses and state as MAVLink on a port, which sends from a thread of its own.

    name: `serial` or `udp`.
    """

    immediate = True

    def __init__(
        self,
        port: SerialPort | UdpPort,
        publisher: PosePublisher,
        now_ns: Callable[[], int],
        name: str = "serial",
    ) -> None:
        self.name = name
        self._port, self._publisher, self._now_ns = port, publisher, now_ns
        port.start(publisher.receive)

    @property
    def lost(self) -> int:
        return self._port.stats().dropped

    @property
    def fault(self) -> str:
        return self._port.error or ""

    def pose(self, sample: PoseSample, now_ns: int) -> None:
        self._publisher.publish(sample, now_ns)

    def tick(self, now_ns: int) -> None:
        self._publisher.publish(None, now_ns)

    def status(self, standing: Standing, health: Health | None) -> None:
        self._publisher.report(standing.state.value, standing.reasons)

    def close(self, result: RecordResult) -> None:
        reasons = (result.error,) if result.error else ()
        self._publisher.send_stopping(reasons, self._now_ns())
        self._port.stop()


def configured(config: Config, now_ns: Callable[[], int]) -> list[Output]:
    """Create the outputs that are configured besides the recording.

    now_ns: the clock of the frames' stamps. Raises ConfigError, UdpAddressError.
    """
    outputs: list[Output] = []
    if config.pose_output.port:
        is_udp = config.pose_output.port.startswith(PREFIX)
        port: SerialPort | UdpPort
        if is_udp:
            port = UdpPort(config.pose_output.port)
        else:
            port = SerialPort(config.pose_output.port, config.pose_output.baud)
        publisher = PosePublisher(
            port,
            config.pose_output,
            spacing_known=config.scale.spacing_m > 0,
            lost_after_ms=config.frontend.lost_after_ms,
            now_ns=now_ns,
        )
        outputs.append(MavlinkOutput(port, publisher, now_ns, "udp" if is_udp else "serial"))
    if config.live.socket:
        outputs.append(LiveOutput(config, now_ns))
    return outputs
