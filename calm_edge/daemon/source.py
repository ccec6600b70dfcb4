"""Sources of frames: two cameras on one clock, live or replayed."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from calm_edge.config import Config, ConfigError, GpsConfig
from calm_edge.daemon.sensor import Sensor, StoredSamples
from calm_edge.recording import RecordingError, time_base
from calm_edge.recording.reader import Recording
from calm_edge.recording.schema import GPS, IMU
from calm_edge.recording.sensors import Sample
from calm_edge.recording.sequence_folder import ORIGIN_NS, SequenceFolder
from calm_edge.recording.stamp_order import check_common_time
from calm_edge.recording.time_base import TimeBase, WallClock
from calm_edge.types import CalmEdgeError
from device.camera import (
    SAME_DEVICE,
    Camera,
    CameraControls,
    CameraSpec,
    open_camera,
    parse_address,
)
from device.clock import Clock, SystemClock
from device.errors import CameraError
from device.frame import Eye, Frame, Unusable
from device.gps.gps import is_receiver, receiver
from device.gps.gps_file import read_gps_file

# delay of the first frame after the start of a replay, so that no frame is late from the start
LEAD_NS = 50_000_000


class TimelineClock:
    """System clock with an offset, for replays: now_ns is epoch_ns when the first frame is due."""

    def __init__(self, epoch_ns: int) -> None:
        self._system = SystemClock()
        self._epoch_ns = epoch_ns
        self.restart()

    def restart(self) -> None:
        """Set the time to LEAD_NS before the stamp of the first frame."""
        self._origin_ns = self._system.now_ns() + LEAD_NS

    def now_ns(self) -> int:
        return self._epoch_ns + self._system.now_ns() - self._origin_ns

    def sleep_until_ns(self, t_ns: int) -> None:
        self._system.sleep_until_ns(t_ns - self._epoch_ns + self._origin_ns)


class StampClock:
    """Clock of a replay as fast as it is read: the stamp of the newest frame that was read."""

    def __init__(self, epoch_ns: int) -> None:
        self._now_ns = epoch_ns

    def restart(self) -> None:
        """Nothing to do: no frame was read yet."""

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_until_ns(self, t_ns: int) -> None:
        self._now_ns = max(self._now_ns, t_ns)

    def following(self, frames: Iterable[Frame | Unusable]) -> Iterator[Frame | Unusable]:
        """Yield the frames, at the time of their stamps."""
        for frame in frames:
            if isinstance(frame, Frame):
                self.sleep_until_ns(frame.t_ns)
            yield frame


@dataclass(frozen=True, slots=True)
class Source:
    """Source of frames of both cameras.

    open: returns the primary and the assistant camera, not yet started; called once, when both
    child processes are ready. clock: of the frames' stamps. is_replay: stored frames, which end.
    time_base: of the frames' stamps.
    sensors: beside the cameras, not yet started.
    notes: lines for the user on how the frames are read. name_of: where a stored frame is, or "".
    """

    open: Callable[[], tuple[Camera, Camera]]
    clock: Clock
    is_replay: bool
    description: str
    time_base: TimeBase = field(default_factory=TimeBase)
    notes: Sequence[str] = ()
    name_of: Callable[[Frame], str] = lambda frame: ""
    sensors: tuple[Sensor, ...] = ()


def replayed(
    frames: Callable[[Eye], Iterable[Frame | Unusable]],
    epoch_ns: int,
    paced: bool,
    description: str,
    origin_ns: int = 0,
    notes: Sequence[str] = (),
    name_of: Callable[[Frame], str] = lambda frame: "",
) -> Source:
    """Source that replays stored frames of both cameras with their original stamps.

    epoch_ns: stamp of the first frame. paced: True for real time, False for as fast as they are
    read. origin_ns: what was added to the stamps that the user knows. notes, name_of: as of
    `Source`. If the first stamp is not positive, all are shifted: no clock of a live run is
    negative, and the stamps of ODOMETRY are unsigned.
    """
    shift_ns = time_base.lift_ns(epoch_ns)
    epoch_ns += shift_ns
    clock: TimelineClock | StampClock = TimelineClock(epoch_ns) if paced else StampClock(epoch_ns)

    def stored(eye: Eye) -> Iterator[Frame | Unusable]:
        found = _later(_as_camera(frames(eye)), shift_ns)
        return clock.following(found) if isinstance(clock, StampClock) else found

    def cameras() -> tuple[Camera, Camera]:
        clock.restart()
        primary, assistant = (
            open_camera(
                CameraSpec(eye, "replay", description),
                clock,
                frames=stored(eye),
                paced=paced,
            )
            for eye in Eye
        )
        return primary, assistant

    base = time_base.of_stamps(origin_ns + shift_ns, epoch_ns, lockstep=not paced)
    return Source(cameras, clock, True, description, base, notes, name_of)


def _as_camera(frames: Iterable[Frame | Unusable]) -> Iterator[Frame | Unusable]:
    """Yield the frames; an unreadable file raises CameraError, as a camera does."""
    try:
        yield from frames
    except CalmEdgeError as error:
        raise CameraError(str(error)) from error


def _later(frames: Iterator[Frame | Unusable], shift_ns: int) -> Iterator[Frame | Unusable]:
    if not shift_ns:
        return frames
    return (
        replace(frame, t_ns=frame.t_ns + shift_ns) if isinstance(frame, Frame) else frame
        for frame in frames
    )


def of_sequence(folder: Path, paced: bool) -> Source:
    """Source that replays the images of a sequence folder; raises CalmEdgeError."""
    sequence = SequenceFolder(folder)
    epoch_ns = min(int(sequence.t_ns(eye)[0]) for eye in Eye)
    return replayed(
        sequence.stream,
        epoch_ns,
        paced,
        str(folder),
        ORIGIN_NS,
        sequence.notes,
        lambda frame: str(sequence.file(frame.eye, frame.sequence)),
    )


def of_recording(recording: Recording, paced: bool) -> Source:
    """Source that replays the frames of a recording; raises RecordingError, SequenceError."""
    path = recording.path
    recording.check_cameras()
    stamps = [recording.frame_times(eye) for eye in Eye]
    if not all(len(t) for t in stamps):
        raise RecordingError(f"{path}: holds no pictures; choose another recording")
    epoch_ns = min(int(t.min()) for t in stamps)
    check_common_time(path, [eye.name.lower() for eye in Eye], stamps)
    # damage that was found on opening
    notes = tuple(recording.losses)
    found = replayed(recording.frames, epoch_ns, paced, str(path), recording.origin_ns, notes)
    if not any(recording.count(topic) for topic in (GPS, IMU)):
        return found
    # opened again: the threads of the cameras read the other one
    again = Recording(path)
    kinds: tuple[Iterator[Sample], ...] = again.fixes(), again.imu()
    samples = heapq.merge(*kinds, key=lambda sample: sample.t_ns)
    return replace(found, sensors=(StoredSamples(samples),))


def with_gps(source: Source, config: GpsConfig) -> Source:
    """The source with the GPS fixes of gps.source, if there is one.

    Fixes of a file replace those of a recording that is replayed. Raises ConfigError, GpsError.
    """
    name = config.source
    if not name:
        return source
    if is_receiver(name):
        if source.is_replay:
            note = f"gps.source = {name}: not read in a replay; a file is (GPX, NMEA)"
            return replace(source, notes=(*source.notes, note))
        return replace(source, sensors=(receiver(name, config.baud, source.clock.now_ns),))
    if not source.is_replay:
        raise ConfigError(
            f"gps.source = {name}: files are for replays; give a serial device (/dev/...) or gpsd"
        )
    if source.time_base.clock is not WallClock.SOURCE:
        raise ConfigError(
            f"gps.source = {name}: the fixes have dates, and the stamps of {source.description} "
            "have none; give stamps in Unix time"
        )
    fixes = read_gps_file(Path(name))
    stored = [fix.at(fix.t_ns - source.time_base.epoch_ns) for fix in fixes]
    note = f"{name}: {len(fixes)} fixes"
    return replace(source, sensors=(StoredSamples(stored),), notes=(*source.notes, note))


def live(config: Config) -> Source:
    """Source of the configured cameras; raises CameraError for an unknown driver or control."""
    clock, capture = SystemClock(), config.capture

    controls = CameraControls(
        capture.exposure_us, capture.gain, capture.white_balance_k, capture.focus
    )

    def spec(eye: Eye, text: str) -> CameraSpec:
        size = capture.width_px, capture.height_px
        return CameraSpec(eye, *parse_address(text), *size, capture.rate_hz, controls)

    if capture.primary == capture.assistant and not capture.primary.endswith(":"):
        raise CameraError(f"camera {capture.primary}: {SAME_DEVICE}")
    specs = spec(Eye.PRIMARY, capture.primary), spec(Eye.ASSISTANT, capture.assistant)

    def cameras() -> tuple[Camera, Camera]:
        return open_camera(specs[0], clock), open_camera(specs[1], clock)

    return Source(cameras, clock, False, f"{capture.primary} {capture.assistant}", time_base.live())
