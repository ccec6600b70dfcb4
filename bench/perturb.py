"""Add faults to a sequence folder: latency, jitter, clock drift, lost frames, cropping.

Only the recording changes, not the ground truth. Each picture keeps the pose of its exposure under
its new stamp; `calib.txt`, which only the evaluation reads, is adapted to the crop.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.drives import pictures, read_picture
from calm_edge.recording.sequence_folder import ORIGIN_NS, SequenceFolder
from calm_edge.types import Int
from device.frame import Eye

# Minimum interval between the stamps of a stream, also with jitter.
LEAST_GAP_NS = 1_000_000
QUALITY = 95


@dataclass(frozen=True, slots=True)
class Clocks:
    """Stamp errors; pairs have one value per eye.

    latency_ms: added to all stamps. jitter_ms: sigma of Gaussian noise. drift_ppm: rate error of
    the clock.
    """

    latency_ms: tuple[float, float] = (0.0, 0.0)
    jitter_ms: float = 0.0
    drift_ppm: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Perturbation:
    """Faults to add; pairs have one value per eye.

    split: give odd frames (1, 3 ...) to the primary and even ones to the assistant. drop:
    probability that a frame is lost. crop: shift of the principal point to the left and up
    (negative: right and down), as a share of the remaining width and height. blur_px: sigma of a
    Gaussian blur. gain: factor on the brightness. seed: of jitter and lost frames.
    """

    clocks: Clocks = Clocks()
    split: bool = False
    drop: tuple[float, float] = (0.0, 0.0)
    crop: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    blur_px: float = 0.0
    gain: tuple[float, float] = (1.0, 1.0)
    seed: int = 0


def stamped(t_ns: Int, clocks: Clocks, eye: int, rng: np.random.Generator) -> Int:
    """Stamps (N,) that faulty clocks give to exposures at t_ns (N,).

    Drift starts at the first exposure. Where jitter would reverse the order, a stamp follows its
    predecessor by LEAST_GAP_NS.
    """
    elapsed = t_ns - t_ns[0]
    offset = clocks.latency_ms[eye] * 1e6 + elapsed * (clocks.drift_ppm[eye] * 1e-6)
    noise = rng.normal(0.0, clocks.jitter_ms * 1e6, len(t_ns))
    out = t_ns + np.round(offset + noise).astype(np.int64)
    steps = np.arange(len(out)) * LEAST_GAP_NS
    return np.asarray(np.maximum.accumulate(out - steps) + steps)


def survivors(n: int, eye: int, change: Perturbation, rng: np.random.Generator) -> Int:
    """Indices of the frames of an eye, out of n, that are not lost; first and last never are."""
    start, step = (1 - eye, 2) if change.split else (0, 1)
    frames = np.arange(start, n, step)
    lost = rng.random(len(frames)) < change.drop[eye]
    lost[[0, -1]] = False
    return np.asarray(frames[~lost])


def crop_window(size: tuple[int, int], crop: tuple[float, float]) -> tuple[int, int, int, int]:
    """Margins (left, top, right, bottom) px whose removal shifts the principal point by `crop`.

    crop: (x, y). Cutting 2 d off one side shifts the centre of the rest by d relative to the
    principal point, where d is `crop` times the remaining length.
    """
    cut = [
        round(2 * part * length / (1 + 2 * abs(part)))
        for part, length in zip(crop, size, strict=True)
    ]
    left, top = (max(c, 0) for c in cut)
    right, bottom = (max(-c, 0) for c in cut)
    return left, top, right, bottom


def _altered(
    image: NDArray[np.uint8], window: tuple[int, int, int, int], blur_px: float, gain: float
) -> NDArray[np.uint8]:
    left, top, right, bottom = window
    out = image[top : image.shape[0] - bottom, left : image.shape[1] - right]
    if blur_px > 0:
        out = np.asarray(cv2.GaussianBlur(out, (0, 0), blur_px), np.uint8)
    if gain != 1.0:
        out = np.asarray(cv2.convertScaleAbs(out, alpha=gain), np.uint8)
    return out


def _picture_writer(
    change: Perturbation, eye: int, window: tuple[int, int, int, int]
) -> Callable[[Path, Path], None]:
    if not any(window) and change.blur_px <= 0 and change.gain[eye] == 1.0:
        return lambda source, target: target.symlink_to(source.resolve())

    def rewrite(source: Path, target: Path) -> None:
        out = _altered(read_picture(source), window, change.blur_px, change.gain[eye])
        cv2.imwrite(str(target), out, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])

    return rewrite


def perturbed(source: Path, out: Path, change: Perturbation) -> Path:
    """Copy the sequence folder `source` with faults to the folder `out`, which is replaced.

    Pictures are links unless they are cropped, blurred or brightened; then they are encoded again,
    as JPEG of QUALITY or PNG. `poses*.txt` keep one row for each picture. Raises SequenceError,
    EvaluationError.
    """
    sequence = SequenceFolder(source)
    shutil.rmtree(out, ignore_errors=True)
    calibration = []
    rows = _lines(source / "calib.txt")
    for eye in Eye:
        # one random stream per eye, so that faults of one eye do not change those of the other
        rng = np.random.default_rng((change.seed, int(eye)))
        kept = survivors(sequence.count(eye), int(eye), change, rng)
        t_ns = stamped(sequence.t_ns(eye), change.clocks, int(eye), rng)[kept] - ORIGIN_NS
        window = crop_window(sequence.size(eye), change.crop[int(eye)])
        (out / f"cam{int(eye)}").mkdir(parents=True)
        write = _picture_writer(change, int(eye), window)
        files = pictures(source, eye)
        for k, i in enumerate(kept):
            write(files[i], out / f"cam{int(eye)}" / f"{k:06d}{files[i].suffix.lower()}")
        stamps = "".join(f"{t / 1e9:.9f}\n" for t in t_ns)
        (out / f"times{int(eye)}.txt").write_text(stamps)
        poses = _lines(source / f"poses{int(eye)}.txt")
        if poses:
            text = "".join(f"{poses[i]}\n" for i in kept)
            (out / f"poses{int(eye)}.txt").write_text(text)
        if rows:
            calibration.append(_cropped_row(rows[int(eye)], window))
    if calibration:
        (out / "calib.txt").write_text("\n".join(calibration) + "\n")
    if (source / "cloud.npy").is_file():
        (out / "cloud.npy").symlink_to((source / "cloud.npy").resolve())
    return out


def _lines(path: Path) -> list[str]:
    return [line for line in path.read_text().splitlines() if line] if path.is_file() else []


def _cropped_row(row: str, window: tuple[int, int, int, int]) -> str:
    fx, fy, cx, cy, width, height = (float(word) for word in row.split())
    left, top, right, bottom = window
    values = (fx, fy, cx - left, cy - top, width - left - right, height - top - bottom)
    return " ".join(f"{value:.9g}" for value in values)
