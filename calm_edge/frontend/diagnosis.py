"""Why pictures give no reconstruction, in words with the measured values.

Called after a failure only, so that it may take half a second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from typing import NamedTuple

import cv2
import numpy as np

from calm_edge.geometry import flow, sift
from calm_edge.types import Bytes, Float32, Int
from device.frame import Frame, UnreadableImage

# Pictures are reduced to this width.
WIDTH_PX = 640
# Grey levels of 255.
DARK, BRIGHT, LEAST_CONTRAST = 18.0, 240.0, 3.0
# Least `sharpness`; clips of KITTI, Karlsruhe and EuRoC have 0.11 to 0.5, and 0.05 at most if they
# are blurred by 3 to 16 px of 1280.
BLURRED = 0.06
CORNERS, MIN_CORNERS = 300, 25
# Flow in px of the reduced picture: below STILL a point does not move, above MOVES the scene does.
STILL_PX, MOVES_PX = 0.3, 2.0
# Share of the corners that are static while others move: a bonnet or a dirty screen.
STATIC_SHARE = 0.5
# Share of the corners that can be followed to the next picture.
FOLLOWED = 0.15
PAIRS = 4
# The flow to the next but one picture over that to the next: 2 at constant speed.
SHORTER = 0.8
MIN_COMMON, FEATURES = 15, 1500
NEVER_S = 1.0

Picture = tuple[int, Callable[[], Bytes]]
EYES = ("primary", "assistant")


class Kind(StrEnum):
    """What is wrong with pictures."""

    MISSING = "missing"
    CLOCKS = "clocks"
    EXPOSURE = "exposure"
    BLURRED = "blurred"
    STILL = "still"
    STATIC = "static"
    ORDER = "order"
    GAPS = "gaps"
    FEW = "few"
    APART = "apart"


class Cause(NamedTuple):
    """A cause, and a sentence with what was measured."""

    kind: Kind
    text: str


def causes(primary: Sequence[Picture], assistant: Sequence[Picture]) -> tuple[Cause, ...]:
    """What is wrong with the pictures of both cameras; empty if nothing is found.

    Pictures: (t_ns, function that decodes it to (H, W) grey), each camera's in order.
    """
    views = (primary, assistant)
    missing = [name for name, seen in zip(EYES, views, strict=True) if not seen]
    if missing:
        return (Cause(Kind.MISSING, f"no picture of the {' and of the '.join(missing)} camera"),)
    apart = _clocks_apart(primary, assistant)
    decoded = [[reduced(gray()) for _, gray in seen] for seen in views]
    found = [apart] if apart else []
    for name, pictures in zip(EYES, decoded, strict=True):
        fault = exposure(pictures)
        if fault is not None:
            found.append(Cause(fault.kind, f"{name} camera: {fault.text}"))
    if found:
        return tuple(found)
    single = _motion(np.array([t_ns for t_ns, _ in primary], np.int64), decoded[0])
    single = single or _eyes(primary, assistant, decoded)
    return (single,) if single else ()


def of_frames(primary: Iterable[Frame], assistant: Iterable[Frame]) -> tuple[Cause, ...]:
    """`causes` of encoded frames; empty if one cannot be decoded."""
    try:
        return causes(*([(f.t_ns, f.gray) for f in frames] for frames in (primary, assistant)))
    except UnreadableImage:
        return ()


def reduced(gray: Bytes) -> Bytes:
    height, width = gray.shape
    if width <= WIDTH_PX:
        return gray
    size = WIDTH_PX, max(2, round(height * WIDTH_PX / width))
    return np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), np.uint8)


def _clocks_apart(primary: Sequence[Picture], assistant: Sequence[Picture]) -> Cause | None:
    """A cause if the times of both cameras have nothing in common."""
    (first, last), (begin, end) = ((seen[0][0], seen[-1][0]) for seen in (primary, assistant))
    gap_s = max(begin - last, first - end) / 1e9
    if gap_s < NEVER_S:
        return None
    ranges = [f"{a / 1e9:.1f} to {b / 1e9:.1f} s" for a, b in ((first, last), (begin, end))]
    return Cause(Kind.CLOCKS, f"the clocks are apart: primary {ranges[0]}, assistant {ranges[1]}")


def exposure(pictures: Sequence[Bytes]) -> Cause | None:
    """A fault of single pictures: too dark, too bright, without structure, blurred."""
    mean = float(np.median([p.mean() for p in pictures]))
    if not DARK <= mean <= BRIGHT:
        text = f"too {'dark' if mean < DARK else 'bright'} (mean grey {mean:.0f} of 255)"
        return Cause(Kind.EXPOSURE, text)
    contrast = float(np.median([p.std() for p in pictures]))
    if contrast < LEAST_CONTRAST:
        text = f"no structure (grey {mean:.0f} +- {contrast:.1f}): is the lens covered?"
        return Cause(Kind.EXPOSURE, text)
    sharp = float(np.median([sharpness(p) for p in pictures]))
    if sharp < BLURRED:
        return Cause(
            Kind.BLURRED, f"blurred (sharpness {sharp:.3f}, at least {BLURRED:g} is needed)"
        )
    return None


def sharpness(gray: Bytes) -> float:
    """Energy of the Laplacian at full size over that at a quarter of the size.

    Or that ratio of the picture at a quarter of the size, if it is smaller: in strong blur, what is
    left at full size is noise of the JPEG.
    """
    quarter, sixteenth = (
        cv2.resize(gray, None, fx=f, fy=f, interpolation=cv2.INTER_AREA) for f in (1 / 4, 1 / 16)
    )
    fine, coarse, coarsest = (
        float(cv2.Laplacian(p, cv2.CV_32F).var()) for p in (gray, quarter, sixteenth)
    )
    return min(fine / max(coarse, 1e-6), coarse / max(coarsest, 1e-6))


def _motion(t_ns: Int, pictures: Sequence[Bytes]) -> Cause | None:
    """A fault of the sequence: still, much of it static, neighbours with little in common."""
    pairs = _neighbours(t_ns)
    if not len(pairs):
        return Cause(Kind.FEW, "a single picture")
    found = [_followed(pictures[k], pictures[k + 1]) for k in pairs]
    share = float(np.median([share for share, _ in found]))
    lengths = np.concatenate([length for _, length in found])
    middle, most = np.percentile(lengths, [50, 95]) if len(lengths) else (0.0, 0.0)
    if len(lengths) >= MIN_CORNERS and most < MOVES_PX and middle < STILL_PX:
        return Cause(
            Kind.STILL,
            f"the pictures do not move (median flow {middle:.2f} px): the car stood still",
        )
    skipped = [_followed(pictures[k], pictures[k + 2]) for k in pairs if k + 1 in pairs]
    if skipped:
        farther = np.concatenate([length for _, length in skipped])
        shorter = middle > MOVES_PX and len(farther) and np.median(farther) < SHORTER * middle
        if shorter or np.median([s for s, _ in skipped]) > max(2 * share, FOLLOWED):
            return Cause(
                Kind.ORDER,
                "the order of the pictures is odd: the next but one is nearer than the next",
            )
    if share < FOLLOWED:
        return Cause(
            Kind.GAPS,
            f"neighbouring pictures have little in common: {100 * share:.0f} % of their corners "
            "are found again (too fast, or pictures are missing)",
        )
    if len(lengths) < MIN_CORNERS:
        return Cause(Kind.FEW, f"only {len(lengths)} corners in the pictures")
    static = float((lengths < STILL_PX).mean())
    if static > STATIC_SHARE:
        return Cause(
            Kind.STATIC,
            f"{100 * static:.0f} % of the corners do not move with the scene: does the bonnet or "
            "dirt fill the picture?",
        )
    return None


def _neighbours(t_ns: Int) -> list[int]:
    """Indices k of some pictures that the next one follows soon, spread over all."""
    step = np.diff(t_ns)
    if not len(step):
        return []
    soon = np.flatnonzero(step <= 2 * step.min())
    spread = np.unique(np.linspace(0, len(soon) - 1, PAIRS).astype(int))
    # with the next one, so that next-but-one pictures can be compared
    return sorted({int(k) for i in spread for k in soon[i : i + 2]})


def _followed(source: Bytes, target: Bytes) -> tuple[float, Float32]:
    """Share of the corners that are followed to the target, and the lengths (M,) of their flow."""
    corners = cv2.goodFeaturesToTrack(source, CORNERS, 0.01, 8)
    if corners is None or source.shape != target.shape:
        return 0.0, np.zeros(0, np.float32)
    uv = np.asarray(corners[:, 0], np.float32)
    ahead, good = flow.follow(source, target, uv)
    lengths = np.linalg.norm(ahead[good] - uv[good], axis=1)
    return float(good.mean()), np.asarray(lengths, np.float32)


def _eyes(
    primary: Sequence[Picture], assistant: Sequence[Picture], decoded: Sequence[Sequence[Bytes]]
) -> Cause | None:
    """A cause if pictures of both cameras at about the same time have too little in common."""
    t = np.array([t_ns for t_ns, _ in assistant], np.int64)
    common = 0
    for i in {0, len(primary) // 2}:
        j = int(np.abs(t - primary[i][0]).argmin())
        a, b = (sift.detect(p, FEATURES) for p in (decoded[0][i], decoded[1][j]))
        common = max(common, len(sift.consistent(a, b, 1.5)))
    if common >= MIN_COMMON:
        return None
    return Cause(Kind.APART, f"the cameras see different things: {common} points in common")
