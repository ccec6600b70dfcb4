"""Sub-maps of a recording, with the configuration they are measured under."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from calm_edge.config import Config, merge, parse_assignment
from calm_edge.offline.densify import densified
from calm_edge.offline.drive import Drive
from calm_edge.offline.submaps import gather
from calm_edge.recording.reader import Recording
from calm_edge.types import Bytes, Float32, Submap

# A sub-map, its depth and confidence (N, h, w) in the raw unit, and its pictures (H, W, 3) BGR, in
# batch order.
Dense = tuple[Submap, Float32, Float32, list[Bytes]]


class Recorded(NamedTuple):
    """A recording and its placed windows; those that `record` left unsolved are solved."""

    path: Path
    recording: Recording
    config: Config
    drive: Drive


def read(path: Path, assignments: Sequence[str] = ()) -> Recorded:
    """Read a recording and solve its pending windows.

    assignments: SECTION.KEY=VALUE over the configuration of the recording.
    """
    recording = Recording(path)
    config = recording.config
    for text in assignments:
        config = merge(config, parse_assignment(text))
    drive = gather(recording, config, lambda text: print(text, file=sys.stderr))
    return Recorded(path, recording, config, drive)


def dense(recorded: Recorded) -> Iterator[Dense | str]:
    """Yield each window's sub-map with depth, or the reason why it has no depth."""
    path, recording, config, drive = recorded
    depths = densified(path, config, drive.windows, drive.updates)
    for record, update, depth in zip(drive.windows, drive.updates, depths, strict=True):
        if isinstance(depth, str):
            yield depth
            continue
        images = [keyframe.frame.bgr() for keyframe in recording.window(record).keyframes()]
        print(f"depth: sub-map {update.submap.id}", file=sys.stderr, flush=True)
        yield (update.submap, *depth, images)
