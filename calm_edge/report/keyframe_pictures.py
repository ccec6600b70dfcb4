"""Small pictures of both cameras at keyframes, for the map's page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calm_edge.recording.reader import Recording
from calm_edge.recording.window_record import FrameKey, WindowRecord
from calm_edge.types import Bytes, CalmEdgeError, Int
from device.frame import Eye, UnreadableImage, jpeg

Change = Callable[[Bytes], Bytes]

WIDTH_PX = 360
QUALITY = 62
# pairs in a page, about 25 kB each; of a longer drive, keyframes at even distances have pictures
MAX_PAIRS = 400


@dataclass(frozen=True, slots=True)
class KeyframePictures:
    """JPEGs of both cameras at a keyframe; None where a picture is missing.

    keyframe: index in the trajectory. later_ns: the assistant's stamp minus the primary's.
    """

    keyframe: int
    primary: bytes | None
    assistant: bytes | None
    later_ns: int = 0


def even(count: int, most: int) -> Int:
    """Indices, at most `most`, evenly spread over range(count), the first and the last included."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def pairs(
    windows: Sequence[WindowRecord], stamps_ns: Int
) -> list[tuple[int, FrameKey, FrameKey | None]]:
    """For each stamp (K,) of a keyframe in a window: index, primary frame, assistant's nearest."""
    keys = {key for window in windows for key in window.frame_keys}
    primary = {key[2]: key for key in keys if key[0] == Eye.PRIMARY}
    assistant = sorted((key for key in keys if key[0] == Eye.ASSISTANT), key=lambda key: key[2])
    times = np.array([key[2] for key in assistant], np.int64)
    found: list[tuple[int, FrameKey, FrameKey | None]] = []
    for index, stamp in enumerate(stamps_ns.tolist()):
        if stamp in primary:
            near = assistant[int(np.abs(times - stamp).argmin())] if assistant else None
            found.append((index, primary[stamp], near))
    return found


def keyframe_pictures(
    recording: Recording,
    windows: Sequence[WindowRecord],
    stamps_ns: Int,
    change: Change | None = None,
    most: int = MAX_PAIRS,
) -> list[KeyframePictures]:
    """Read and reduce the pictures of at most `most` keyframes.

    stamps_ns: (K,) of the trajectory, on the recording's clock. change: applied to each picture
    (H, W, 3) BGR before it is reduced. Pictures that are lost are None.
    """
    all_pairs = pairs(windows, stamps_ns)
    chosen = [all_pairs[i] for i in even(len(all_pairs), most)] if all_pairs else []
    return [
        KeyframePictures(
            index,
            _small(recording, primary, change),
            None if assistant is None else _small(recording, assistant, change),
            0 if assistant is None else assistant[2] - primary[2],
        )
        for index, primary, assistant in chosen
    ]


def late_pictures(recording: Recording, windows: Sequence[WindowRecord]) -> list[Bytes | None]:
    """The last readable picture (H, W, 3) BGR of each eye among the windows' frames."""
    keys = sorted({key for window in windows[-3:] for key in window.frame_keys}, key=lambda k: k[2])
    found: list[Bytes | None] = [None, None]
    for eye in Eye:
        for key in reversed([key for key in keys if key[0] == eye]):
            try:
                found[eye] = recording.frame(eye, key[1], key[2]).bgr()
                break
            except (CalmEdgeError, UnreadableImage):
                continue
    return found


def _small(recording: Recording, key: FrameKey, change: Change | None) -> bytes | None:
    try:
        image = recording.frame(Eye(key[0]), key[1], key[2]).bgr()
    except (CalmEdgeError, UnreadableImage):
        return None
    if change is not None:
        image = change(image)
    height, width = image.shape[:2]
    if width > WIDTH_PX:
        size = (WIDTH_PX, max(1, round(height * WIDTH_PX / width)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    return jpeg(image, QUALITY)
