"""A drive as two cameras of 1280x720 at 30 Hz would send it: JPEG, for as long as asked."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from calm_edge.frontend.sequence import SequenceFolder
from device.frame import Eye, Frame

SIZE = (1280, 720)
RATE_HZ = 30
EPOCH_NS = 5_000_000_000
_LATE_NS = (0, 17_000_000)
_QUALITY = 85
_SHOWN = 3
# what upscaling lacks: a camera's noise, and with it the bytes of its JPEG
_NOISE = 4.0


def enlarged(drive: Path, eye: Eye, folder: Path) -> list[bytes]:
    """Its pictures cropped to 16:9 and enlarged, made once and kept in `folder`."""
    kept = folder / f"cam{int(eye)}"
    if not kept.is_dir():
        partial = folder / f"cam{int(eye)}.part"
        partial.mkdir(parents=True, exist_ok=True)
        random = np.random.default_rng(int(eye))
        noise = [random.normal(0, _NOISE, (*SIZE[::-1], 1)).astype(np.float32) for _ in range(4)]
        for k, frame in enumerate(SequenceFolder(drive).frames(eye)):
            image = frame.bgr()
            height, width = image.shape[:2]
            keep = min(width, round(height * SIZE[0] / SIZE[1]))
            left = (width - keep) // 2
            large = cv2.resize(image[:, left : left + keep], SIZE, interpolation=cv2.INTER_CUBIC)
            noisy = np.clip(large + noise[k % len(noise)], 0, 255).astype(np.uint8)
            data = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
            (partial / f"{k:06d}.jpg").write_bytes(data.tobytes())
        partial.rename(kept)
    return [path.read_bytes() for path in sorted(kept.iterdir())]


def frames(pictures: list[bytes], eye: Eye, count: int) -> Iterator[Frame]:
    """So many frames at RATE_HZ from EPOCH_NS on, each picture of the 10 Hz drive shown
    three times; the drive goes to its end and backwards again.
    """
    there_and_back = [*pictures, *pictures[-2:0:-1]]
    for k in range(count):
        t_ns = EPOCH_NS + _LATE_NS[eye] + round(k * 1e9 / RATE_HZ)
        yield Frame(eye, k, t_ns, there_and_back[k // _SHOWN % len(there_and_back)])
