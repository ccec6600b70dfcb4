"""A recording as the rest of calm-edge sees it: frames, poses, updates, windows, configuration.

Finished, unfinished and cut files open alike; `losses` says what is gone.
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
from calm_edge.recording import schema
from calm_edge.recording.errors import RecordingError
from calm_edge.recording.losses import describe
from calm_edge.recording.scan import DamageError, SegmentIndex, plain_chunk, scan
from calm_edge.recording.segment import recording_files
from calm_edge.recording.window_record import WindowRecord, rebuild
from calm_edge.types import Int, LocalizerUpdate, PoseSample, SubmapWindow
from device.frame import Eye, Frame

# a window's keyframes reach over many chunks, and neighbouring windows share them
_CACHE_BYTES = 32 << 20


class _Place(NamedTuple):
    """Where one message lies."""

    segment: int
    chunk: int
    offset: int
    size: int
    sequence: int
    log_time: int


class Recording:
    """A recording folder or a single MCAP file, read lazily and in bounded memory.

    Raises RecordingError when there is nothing to read. `losses`: one line for each thing that
    is missing; reading may add lines when a damaged chunk is met.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.losses: list[str] = []
        self._segments: list[SegmentIndex] = []
        self._cache: OrderedDict[tuple[int, int], bytes] = OrderedDict()
        self._damaged: set[tuple[int, int]] = set()
        self._sorted: dict[Eye, Int] = {}
        files = recording_files(path)
        for file in files:
            try:
                index = scan(file)
            except RecordingError as error:
                if len(files) == 1:
                    raise
                self.losses.append(str(error))
                continue
            self._segments.append(index)
            self.losses += describe(index)
        if not self._segments:
            raise RecordingError(f"{path}: none of its {len(files)} files can be read")

    @property
    def metadata(self) -> dict[str, str]:
        """What was said of the session: version, backbone, boot_id, cameras ..."""
        return self._metadata(schema.SESSION_METADATA)

    def cameras(self, eye: Eye) -> dict[str, Any]:
        """What the camera of an eye settled on at last, or nothing."""
        text = self._metadata(schema.CAMERAS_METADATA, last=True).get(eye.name.lower(), "{}")
        try:
            found = json.loads(text)
        except (ValueError, RecursionError):
            return {}
        return found if isinstance(found, dict) else {}

    @property
    def config(self) -> Config:
        """The effective configuration of the recording; raises RecordingError."""
        text = self._metadata(schema.CONFIG_METADATA).get("json")
        if text is None:
            raise RecordingError(f"{self.path}: holds no configuration; was calm-edge its writer?")
        try:
            return merge(Config(), json.loads(text))
        except (ConfigError, ValueError) as error:
            raise RecordingError(f"{self.path}: configuration not understood: {error}") from None

    def count(self, topic: str) -> int:
        """How many messages of a topic there are."""
        return sum(len(rows) for index in self._segments for _, rows in index.topic_rows(topic))

    def frames(self, eye: Eye | None = None) -> Iterator[Frame]:
        """Frames of one eye in the order written, or of both merged by t_ns; lazily."""
        if eye is None:
            both = [self.frames(e) for e in Eye]
            yield from heapq.merge(*both, key=lambda frame: frame.t_ns)
            return
        for place, data in self._messages(schema.IMAGE_TOPICS[eye]):
            yield schema.read_frame(eye, place.sequence, place.log_time, data)

    def frame_times(self, eye: Eye) -> Int:
        """(n,) t_ns of an eye's frames in the order written, without reading pixels."""
        places = self._places(schema.IMAGE_TOPICS[eye])
        return np.fromiter((p.log_time for p in places), np.int64)

    def frame(self, eye: Eye, sequence: int, t_ns: int | None = None) -> Frame:
        """One frame; t_ns tells apart frames of a camera that began to count anew.

        Raises RecordingError when it is not in the recording.
        """
        if eye not in self._sorted:
            table = np.array(list(self._places(schema.IMAGE_TOPICS[eye])), np.int64).reshape(-1, 6)
            self._sorted[eye] = table[np.argsort(table[:, 4], kind="stable")]
        table = self._sorted[eye]
        first, last = np.searchsorted(table[:, 4], [sequence, sequence + 1])
        for row in table[first:last].tolist():
            place = _Place(*row)
            if t_ns is None or place.log_time == t_ns:
                data = self._read(place)
                if data is not None:
                    return schema.read_frame(eye, sequence, place.log_time, data)
        raise RecordingError(
            f"{self.path}: {eye.name.lower()} frame {sequence} is not in the recording"
        )

    def poses(self) -> Iterator[PoseSample]:
        """The live poses in the order written."""
        for _, data in self._messages(schema.POSE_SAMPLE):
            yield schema.read_pose(data)

    def updates(self) -> Iterator[LocalizerUpdate]:
        """What each window changed, in the order written."""
        for _, data in self._messages(schema.SUBMAP):
            yield schema.read_update(data)

    def windows(self) -> Iterator[WindowRecord]:
        """Which frames each window held, in the order written."""
        for _, data in self._messages(schema.WINDOW):
            yield schema.read_window(data)

    def window(self, record: WindowRecord) -> SubmapWindow:
        """A window with its pixels; raises RecordingError when a frame of it is lost."""
        return rebuild(record, self.frame)

    def json_messages(self, topic: str) -> Iterator[dict[str, Any]]:
        """The objects on /clock or /status, in the order written."""
        for _, data in self._messages(topic):
            yield json.loads(data)

    def _metadata(self, name: str, *, last: bool = False) -> dict[str, str]:
        named = [m for index in self._segments for m in index.metadata if m.name == name]
        return dict(named[-1 if last else 0].metadata) if named else {}

    def _places(self, topic: str) -> Iterator[_Place]:
        expected = schema.topic_schema(topic).name
        for number, index in enumerate(self._segments):
            for channel, rows in index.topic_rows(topic):
                found = index.schemas.get(channel.schema_id)
                if found is None or found.name != expected:
                    name = found.name if found else "no schema"
                    raise RecordingError(f"{index.path}: {topic} holds {name}, not {expected}")
                columns = zip(
                    rows.chunk, rows.offset, rows.size, rows.sequence, rows.log_time, strict=True
                )
                yield from (_Place(number, *row) for row in columns)

    def _messages(self, topic: str) -> Iterator[tuple[_Place, bytes]]:
        for place in self._places(topic):
            data = self._read(place)
            if data is not None:
                yield place, data

    def _read(self, place: _Place) -> bytes | None:
        """A message's bytes, None (and a line in `losses`) when its chunk is damaged."""
        key = (place.segment, place.chunk)
        if key in self._damaged:
            return None
        if key in self._cache:
            self._cache.move_to_end(key)
        else:
            index = self._segments[place.segment]
            ref = index.chunks[place.chunk]
            try:
                with index.path.open("rb", buffering=0) as file:
                    file.seek(ref.offset)
                    self._cache[key] = plain_chunk(file.read(ref.size) or b"")
            except (DamageError, OSError) as error:
                self._damaged.add(key)
                seconds = (ref.end_ns - ref.start_ns) / 1e9
                self.losses.append(
                    f"{index.path}: a damaged piece of {seconds:.1f} s from t = "
                    f"{ref.start_ns / 1e9:.3f} s is left out ({error})"
                )
                return None
            while len(self._cache) > 1 and sum(map(len, self._cache.values())) > _CACHE_BYTES:
                self._cache.popitem(last=False)
        return self._cache[key][place.offset : place.offset + place.size]
