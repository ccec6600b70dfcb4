"""JPEG streams of two 1280x720 cameras at 30 Hz, of any duration, made from a short drive."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.types import Bytes, Float, Int
from device.frame import Eye, Frame, jpeg

SIZE = (1280, 720)
RATE_HZ = 30
EPOCH_NS = 5_000_000_000
# number of frames of the drive that are played, forwards and backwards
MOST = 200
_QUALITY = 85
# sigma of noise added, in grey levels, so that JPEG files are as large as a camera's
_NOISE = 3.0


def enlarged(drive: Path, eye: Eye, folder: Path, most: int = MOST) -> list[Path]:
    """Crop pictures of a drive to 16:9, enlarge them and interpolate to RATE_HZ by optical flow.

    most: number of pictures of the drive used. Both eyes are interpolated to the same times: the
    pictures are also played backwards, where an offset between the eyes would change its sign. The
    files are made once and kept in `folder`.
    """
    kept = folder / f"cam{int(eye)}"
    if not kept.is_dir():
        partial = folder / f"cam{int(eye)}.part"
        partial.mkdir(parents=True, exist_ok=True)
        sequence = SequenceFolder(drive)
        moments = [sequence.t_ns(each)[:most] for each in Eye]
        times = np.arange(
            max(t[0] for t in moments), min(t[-1] for t in moments), round(1e9 / RATE_HZ)
        )
        images = [frame.bgr() for frame in islice(sequence.frames(eye), most)]
        random = np.random.default_rng(int(eye))
        noise = [random.normal(0, _NOISE, (*SIZE[::-1], 1)).astype(np.float32) for _ in range(4)]
        for k, image in enumerate(_between(images, moments[eye], times)):
            noisy = np.clip(_camera_sized(image) + noise[k % len(noise)], 0, 255).astype(np.uint8)
            (partial / f"{k:06d}.jpg").write_bytes(jpeg(noisy, _QUALITY))
        partial.rename(kept)
    return sorted(kept.iterdir())


def frames(pictures: Sequence[Path], eye: Eye, count: int) -> Iterator[Frame]:
    """Yield `count` frames at RATE_HZ from EPOCH_NS on, the drive played forwards and backwards."""
    there_and_back = [*pictures, *pictures[-2:0:-1]]
    for k in range(count):
        t_ns = EPOCH_NS + round(k * 1e9 / RATE_HZ)
        yield Frame(eye, k, t_ns, there_and_back[k % len(there_and_back)].read_bytes())


def _between(images: Sequence[Bytes], taken_ns: Int, times_ns: Int) -> Iterator[Bytes]:
    """Interpolate pictures (H, W, 3), taken at taken_ns, to the times times_ns."""
    estimator = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    flow: Float | None = None
    at = -1
    for t in times_ns:
        before = min(int(np.searchsorted(taken_ns, t, "right")) - 1, len(images) - 2)
        if before != at:
            at = before
            pair = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in images[at : at + 2]]
            start = np.zeros((*pair[0].shape, 2), np.float32)
            flow = np.asarray(estimator.calc(pair[0], pair[1], start))
        assert flow is not None
        share = (t - taken_ns[at]) / (taken_ns[at + 1] - taken_ns[at])
        grid = np.stack(np.meshgrid(*map(np.arange, flow.shape[1::-1])), -1).astype(np.float32)
        across, down = np.moveaxis(np.asarray(grid - share * flow, np.float32), -1, 0)
        yield np.asarray(
            cv2.remap(images[at], across, down, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE),
            np.uint8,
        )


def _camera_sized(image: Bytes) -> Bytes:
    height, width = image.shape[:2]
    keep = min(width, round(height * SIZE[0] / SIZE[1]))
    left = (width - keep) // 2
    large = cv2.resize(image[:, left : left + keep], SIZE, interpolation=cv2.INTER_CUBIC)
    return np.asarray(large, np.uint8)
