"""Read frames, poses, updates, windows and configuration from a recording.

Finished, unfinished and truncated files are all accepted; `losses` lists the missing parts.
"""

from __future__ import annotations

import heapq
import json
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calm_edge.config import Config, ConfigError, merge
from calm_edge.recording import RecordingError, schema, sensors
from calm_edge.recording.scan import DamageError, SegmentIndex, plain_chunk, scan
from calm_edge.recording.segment import missing_segments, recording_files
from calm_edge.recording.time_base import CLOCK_KEY, ORIGIN_KEY, WallClock, integer
from calm_edge.recording.window_record import WindowRecord, rebuild
from calm_edge.types import Int, LocalizerUpdate, PoseSample, SubmapWindow
from device.frame import Eye, Frame
from device.gps.fix import Fix

# cache of decoded chunks: a window's keyframes are in many chunks, shared by adjacent windows
_CACHE_BYTES = 32 << 20


class _Location(NamedTuple):
    """Position of one message in the files, with its sequence number and time."""

    segment: int
    chunk: int
    offset: int
    size: int
    sequence: int
    t_ns: int


class Recording:
    """A recording folder or a single MCAP file, read lazily with bounded memory.

    losses: one line for each missing part; reading may add lines for damaged chunks. Raises
    RecordingError if no file can be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.losses: list[str] = []
        self._segments: list[SegmentIndex] = []
        self._cache: OrderedDict[tuple[int, int], bytes] = OrderedDict()
        self._damaged: set[tuple[int, int]] = set()
        self._sorted: dict[Eye, Int] = {}
        self._sizes: dict[Eye, tuple[int, int]] = {}
        files = recording_files(path)
        if path.is_dir():
            self.losses += missing_segments(files)
        for file in files:
            try:
                index = scan(file)
            except RecordingError as error:
                if len(files) == 1:
                    raise
                self.losses.append(str(error))
                continue
            self._segments.append(index)
            self.losses += index.losses()
            if path.is_dir() and file == files[-1]:
                self.losses += index.missing_end()
        if not self._segments:
            raise RecordingError(
                f"{path}: none of its {len(files)} files can be read; {self.losses[-1]}"
            )

    @property
    def metadata(self) -> dict[str, str]:
        """Metadata of the session: version, backbone, boot_id, cameras ..."""
        return self._metadata(schema.SESSION_METADATA)

    @property
    def import_facts(self) -> dict[str, str]:
        """What `import` took, dropped and assumed, or {} of another recording."""
        return self._metadata(schema.IMPORT_METADATA)

    @property
    def origin_ns(self) -> int:
        """What was added to the stamps of the source: subtract it from stamps given to users.

        Of a live drive, minus its Unix time at t_ns 0; if its clock was not synchronised, from the
        newest reading of it once it was, else from GPS.
        """
        metadata = self.metadata
        origin_ns = integer(metadata, ORIGIN_KEY) or 0
        if metadata.get(CLOCK_KEY) == WallClock.UNSYNCHRONISED.value:
            set_later = [
                reading["monotonic_ns"] - reading["realtime_ns"]
                for reading in self.json_messages(schema.CLOCK)
                if reading.get("synchronised")
            ]
            by_gps = () if set_later else self.fixes()
            dated = [fix.t_ns - fix.utc_ns for fix in by_gps if fix.utc_ns is not None]
            if set_later:
                origin_ns = set_later[-1]
            elif dated:
                # a fix arrives some tenths of a second after its time
                origin_ns = sorted(dated)[len(dated) // 2]
        return origin_ns

    def cameras(self, eye: Eye) -> dict[str, Any]:
        """Camera settings of an eye as last recorded, or {}."""
        text = self._metadata(schema.CAMERAS_METADATA, last=True).get(eye.name.lower(), "{}")
        try:
            found = json.loads(text)
        except (ValueError, RecursionError):
            return {}
        return found if isinstance(found, dict) else {}

    @property
    def config(self) -> Config:
        """Configuration with which the recording was made; raises RecordingError."""
        text = self._metadata(schema.CONFIG_METADATA).get("json")
        if text is None:
            raise RecordingError(
                f"{self.path}: contains no configuration; open a recording of calm-edge"
            )
        try:
            return merge(Config(), json.loads(text))
        except (ConfigError, ValueError) as error:
            raise RecordingError(f"{self.path}: invalid configuration: {error}") from None

    def count(self, topic: str) -> int:
        """Number of messages of a topic."""
        return sum(len(rows) for index in self._segments for _, rows in index.topic_rows(topic))

    def check_cameras(self) -> None:
        """Raise RecordingError, with what is possible, if one camera alone has frames."""
        eyes = [eye for eye in Eye if self.count(schema.IMAGE_TOPICS[eye])]
        if len(eyes) == 1:
            raise RecordingError(
                f"{self.path}: holds pictures of the {eyes[0].name.lower()} camera alone; poses "
                "and maps need two. Export its pictures (calm-edge export --to pictures), or "
                "import or record both cameras"
            )

    def frames(self, eye: Eye | None = None) -> Iterator[Frame]:
        """Iterate over the frames of one eye in the order written, or of both merged by t_ns."""
        if eye is None:
            both = [self.frames(e) for e in Eye]
            yield from heapq.merge(*both, key=lambda frame: frame.t_ns)
            return
        for location, data in self._messages(schema.IMAGE_TOPICS[eye]):
            try:
                yield schema.read_frame(eye, location.sequence, location.t_ns, data)
            except RecordingError as error:
                self.losses.append(f"{self.path}: {error}")

    def frame_times(self, eye: Eye) -> Int:
        """Stamps t_ns (N,) of an eye's frames in the order written, without reading pixels."""
        places = self._locations(schema.IMAGE_TOPICS[eye])
        return np.fromiter((p.t_ns for p in places), np.int64)

    def frame(self, eye: Eye, sequence: int, t_ns: int | None = None) -> Frame:
        """Read one frame; raises RecordingError if it is not in the recording.

        t_ns: distinguishes frames of equal sequence after a camera restarted its counter.
        """
        if eye not in self._sorted:
            table = np.array(list(self._locations(schema.IMAGE_TOPICS[eye])), np.int64).reshape(
                -1, 6
            )
            self._sorted[eye] = table[np.argsort(table[:, 4], kind="stable")]
        table = self._sorted[eye]
        first, last = np.searchsorted(table[:, 4], [sequence, sequence + 1])
        for row in table[first:last].tolist():
            location = _Location(*row)
            if t_ns is None or location.t_ns == t_ns:
                data = self._read(location)
                if data is not None:
                    return schema.read_frame(eye, sequence, location.t_ns, data)
        raise RecordingError(
            f"{self.path}: {eye.name.lower()} frame {sequence} is not in the recording"
        )

    def fixes(self) -> Iterator[Fix]:
        """Iterate over the GPS fixes that have a position, in the order written."""
        quality = {
            place.t_ns: json.loads(data) for place, data in self._messages(schema.GPS_QUALITY)
        }
        for place, data in self._messages(schema.GPS):
            yield sensors.read_fix(place.t_ns, data, quality.get(place.t_ns))

    def imu(self) -> Iterator[sensors.ImuSample]:
        """Iterate over the samples of an IMU in the order written."""
        for place, data in self._messages(schema.IMU):
            yield sensors.read_imu(place.t_ns, json.loads(data))

    def poses(self) -> Iterator[PoseSample]:
        """Iterate over the live poses in the order written."""
        for _, data in self._messages(schema.POSE_SAMPLE):
            yield schema.read_pose(data)

    def picture_size(self, eye: Eye) -> tuple[int, int]:
        """Width and height [px] of an eye's images, from the first; raises RecordingError."""
        if eye not in self._sizes:
            frame = next(self.frames(eye), None)
            if frame is None:
                raise RecordingError(f"{self.path}: no image of the {eye.name.lower()} camera")
            height, width = frame.gray().shape
            self._sizes[eye] = width, height
        return self._sizes[eye]

    def updates(self) -> Iterator[LocalizerUpdate]:
        """Iterate over the localizer's updates, one per window, in the order written."""
        for _, data in self._messages(schema.SUBMAP):
            yield schema.read_update(data, self.picture_size)

    def windows(self) -> Iterator[WindowRecord]:
        """Iterate over the window records in the order written."""
        for _, data in self._messages(schema.WINDOW):
            yield schema.read_window(data)

    def window(self, record: WindowRecord) -> SubmapWindow:
        """Rebuild a window with its images; raises RecordingError if one of them is lost."""
        return rebuild(record, self.frame)

    def json_messages(self, topic: str) -> Iterator[dict[str, Any]]:
        """Iterate over the JSON objects on /clock, /status or /health in the order written."""
        return (value for _, value in self.timed_json_messages(topic))

    def timed_json_messages(self, topic: str) -> Iterator[tuple[int, dict[str, Any]]]:
        """Iterate over t_ns of writing and JSON object, as `json_messages`."""
        for location, data in self._messages(topic):
            yield location.t_ns, json.loads(data)

    def events(self) -> Iterator[tuple[int, str]]:
        """Iterate over the moments that somebody marked: t_ns and text, in the order written."""
        for location, data in self._messages(schema.EVENT):
            yield location.t_ns, str(json.loads(data).get("text", ""))

    def _metadata(self, name: str, *, last: bool = False) -> dict[str, str]:
        named = [m for index in self._segments for m in index.metadata if m.name == name]
        return dict(named[-1 if last else 0].metadata) if named else {}

    def _locations(self, topic: str) -> Iterator[_Location]:
        expected = schema.topic_schema(topic).name
        for number, index in enumerate(self._segments):
            for channel, rows in index.topic_rows(topic):
                found = index.schemas.get(channel.schema_id)
                if found is None or found.name != expected:
                    name = found.name if found else "none"
                    raise RecordingError(
                        f"{index.path}: topic {topic} has schema {name}, expected {expected}; "
                        "open a recording of calm-edge"
                    )
                times = index.t_ns(rows)
                columns = zip(rows.chunk, rows.offset, rows.size, rows.sequence, times, strict=True)
                yield from (_Location(number, *row) for row in columns)

    def _messages(self, topic: str) -> Iterator[tuple[_Location, bytes]]:
        for location in self._locations(topic):
            data = self._read(location)
            if data is not None:
                yield location, data

    def _read(self, location: _Location) -> bytes | None:
        """Read a message's bytes; None, with a line in `losses`, if its chunk is damaged."""
        key = (location.segment, location.chunk)
        if key in self._damaged:
            return None
        if key in self._cache:
            self._cache.move_to_end(key)
        else:
            index = self._segments[location.segment]
            ref = index.chunks[location.chunk]
            try:
                with index.path.open("rb", buffering=0) as file:
                    file.seek(ref.offset)
                    self._cache[key] = plain_chunk(file.read(ref.size) or b"")
            except (DamageError, OSError) as error:
                self._damaged.add(key)
                seconds = (ref.end_ns - ref.start_ns) / 1e9
                self.losses.append(
                    f"{index.path}: a damaged chunk of {seconds:.1f} s from t = "
                    f"{(ref.start_ns - (index.epoch_ns or 0)) / 1e9:.3f} s left out ({error})"
                )
                return None
            while len(self._cache) > 1 and sum(map(len, self._cache.values())) > _CACHE_BYTES:
                self._cache.popitem(last=False)
        return self._cache[key][location.offset : location.offset + location.size]
