"""Videos of two cameras that turn together before a wide picture, written by PyAV."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.types import Float

SIZE = (160, 96)
Picture = NDArray[np.uint8]
Turn = Callable[[Float], Float]


@cache
def panorama(seed: int = 3) -> Picture:
    """A wide picture with structure of all sizes, (400, 1000) grey."""
    rng = np.random.default_rng(seed)
    out = np.zeros((400, 1000))
    for scale in (2.0, 4.0, 9.0, 20.0):
        noise = rng.standard_normal(out.shape)
        blurred = cv2.GaussianBlur(noise, (0, 0), scale)
        out += blurred / blurred.std()
    return np.clip(128 + 40 * out, 0, 255).astype(np.uint8)


def turn(t: Float) -> Float:
    """Direction (N, 2) [px of the panorama] of the car at t [s]: curves and shaking."""
    curve, bend = 0.5 * t + 0.7 * np.sin(0.23 * t), 2.1 * t + 2 * np.sin(0.6 * t)
    right = 80 * np.sin(curve) + 20 * np.sin(bend)
    slow = np.stack([right, 4 * np.sin(1.9 * t + np.sin(0.7 * t))], axis=1)
    return slow + shaking(t)


def shaking(t: Float) -> Float:
    """The part of `turn` that the road causes."""
    return np.stack([1.2 * np.sin(15 * t + np.sin(3 * t)), 2.5 * np.sin(19 * t + 2 * np.sin(t))], 1)


def pictures(
    t: Float, turn: Turn = turn, zoom: float = 1.0, roll_deg: float = 0.0
) -> list[Picture]:
    """What a camera sees at times t [s] on the car's clock: SIZE, grey. zoom: of all or each."""
    wide = panorama()
    zooms = np.broadcast_to(zoom, t.shape)
    out = []
    for (x, y), z in zip(turn(t), zooms, strict=True):
        M = cv2.getRotationMatrix2D((500 + x, 200 + y), roll_deg, z)
        M[:, 2] += np.array(SIZE) / 2 - np.array([500 + x, 200 + y])
        out.append(np.asarray(cv2.warpAffine(wide, M, SIZE, flags=cv2.INTER_LINEAR), np.uint8))
    return out


def write_video(
    path: Path,
    t_s: Float,
    shown: list[Picture],
    codec: str = "mpeg4",
    rotation: int = 0,
    sound: Float | None = None,
) -> Path:
    """Encode pictures with their stamps t_s; sound: samples at 8 kHz from the first stamp."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.width, stream.height = shown[0].shape[1], shown[0].shape[0]
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.bit_rate = 3_000_000
        stream.codec_context.time_base = Fraction(1, 1000)
        if rotation:
            stream.set_display_rotation(rotation)
        heard = None
        if sound is not None:
            heard = container.add_stream("aac", rate=8000, layout="mono")
        for t, picture in zip(t_s, shown, strict=True):
            frame = av.VideoFrame.from_ndarray(picture, format="gray").reformat(
                format=stream.pix_fmt
            )
            frame.pts, frame.time_base = round(1000 * t), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
        if heard is not None and sound is not None:
            for at, block in blocks(sound):
                frame = av.AudioFrame.from_ndarray(block[None], format="fltp", layout="mono")
                frame.sample_rate, frame.pts, frame.time_base = 8000, at, Fraction(1, 8000)
                container.mux(heard.encode(frame))
            container.mux(heard.encode(None))
    return path


def blocks(sound: Float) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Samples in blocks of 1024, with the index of the first."""
    for at in range(0, len(sound) - 1023, 1024):
        yield at, sound[at : at + 1024].astype(np.float32)


def uneven(rate_hz: float, seconds: float, seed: int) -> Float:
    """Stamps of a phone: irregular by milliseconds, every tenth picture missing; in whole ms."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds, 1 / rate_hz)
    t += rng.uniform(0, 0.004, t.shape)
    keep = rng.uniform(size=t.shape) > 0.1
    t = np.round(t[keep], 3)
    return np.asarray(t - t[0], np.float64)
