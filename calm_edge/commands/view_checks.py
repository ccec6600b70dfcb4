"""Findings on the pictures of two cameras: exposure, focus, overlap of the views, frame rate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calm_edge.commands.finding import Finding, bad, good, note
from calm_edge.frontend.diagnosis import (
    BLURRED,
    FEATURES,
    MIN_COMMON,
    Kind,
    exposure,
    reduced,
    sharpness,
)
from calm_edge.geometry import sift
from calm_edge.types import Bytes
from device.frame import Eye
from device.watching import Seen

# share of the pixels that may be black or white: 0 to 0.11 in clips of KITTI, Karlsruhe and EuRoC
CLIPPED = 0.15
BLACK, WHITE = 5, 250
# sharpness of these clips: 0.11 to 0.54; of one in fog and rain: 0.06 to 0.09
SOFT = 0.1
# points in common of these clips: 327 and more; of the one in fog and rain: 9 to 24
FEW_COMMON = 40
# px of the reduced pictures
THRESHOLD_PX = 1.5
# shares of the requested rate, and of lost frames
RATE, HALF_RATE, MOST_LOST = 0.9, 0.5, 0.001


def picture_findings(pictures: Sequence[Bytes], eye: Eye) -> Iterator[Finding]:
    """Yield exposure and focus of grey pictures (H, W) of one camera; the worst of them counts."""
    name = eye.name.lower()
    small = [reduced(picture) for picture in pictures]
    fault = exposure(small)
    grey = float(np.median([picture.mean() for picture in small]))
    clipped = float(np.median([_clipped(picture) for picture in small]))
    if fault is not None and fault.kind is Kind.EXPOSURE:
        yield bad(f"{name} exposure", fault.text, "uncover the lens, or change the light")
        return
    text = f"mean grey {grey:.0f} of 255, {100 * clipped:.0f} % black or white"
    if clipped > CLIPPED:
        remedy = "turn the camera away from the light, or set capture.exposure_us"
        yield note(f"{name} exposure", text, remedy)
    else:
        yield good(f"{name} exposure", text)
    sharp = float(np.median([sharpness(picture) for picture in small]))
    text = f"sharpness {sharp:.2f}"
    remedy = "clean the lens and its window, turn the focus ring, or set capture.focus"
    if sharp < BLURRED:
        yield bad(f"{name} focus", f"{text}, at least {BLURRED:g} is needed", remedy)
    elif sharp < SOFT:
        yield note(f"{name} focus", f"{text}, sharp pictures have {SOFT:g} and more", remedy)
    else:
        yield good(f"{name} focus", text)


def _clipped(picture: Bytes) -> float:
    return float(((picture <= BLACK) | (picture >= WHITE)).mean())


def overlap(primary: Bytes, assistant: Bytes) -> Finding:
    """Whether the views of two grey pictures (H, W), taken at about the same time, overlap.

    Without a common field of view there is no scale.
    """
    small = reduced(primary), reduced(assistant)
    features = [sift.detect(picture, FEATURES) for picture in small]
    pairs = sift.consistent(features[0], features[1], THRESHOLD_PX)
    remedy = "turn the cameras towards each other, or wait for a scene with more structure"
    if len(pairs) < MIN_COMMON:
        return bad("overlap", f"{len(pairs)} points in common, {MIN_COMMON} are needed", remedy)
    spans, spread = [], True
    for side, eye in enumerate(Eye):
        uv = features[side].uv[pairs[:, side]]
        height, width = small[side].shape
        low, high = 100 * np.percentile(uv[:, 0], [2, 98]) / width
        spans.append(f"{low:.0f} to {high:.0f} % of the {eye.name.lower()}'s width")
        spread &= sift.well_spread(uv, np.array([width, height]))
    text = f"{len(pairs)} points in common, at {' and '.join(spans)}"
    if len(pairs) < FEW_COMMON or not spread:
        return note("overlap", f"{text}: little for the scale", remedy)
    return good("overlap", text)


def rates(seen: Sequence[Seen], wanted_hz: float) -> Iterator[Finding]:
    """Yield rate and losses of both cameras while they run together, hence of the USB bus."""
    for each in seen:
        camera, stats = each.thread.camera, each.thread.camera.stats()
        name = f"{camera.spec.eye.name.lower()} rate"
        lost = stats.drops + stats.corrupt + each.thread.overflow
        text = f"{each.rate_hz:.1f} Hz of {wanted_hz:g}, {lost} of {stats.frames + lost} lost"
        remedy = "plug the cameras into ports of different buses, lower capture.width_px or "
        remedy += "rate_hz; in the dark set capture.exposure_us"
        if each.thread.error:
            yield bad(name, each.thread.error)
        elif each.rate_hz < HALF_RATE * wanted_hz:
            yield bad(name, text, remedy)
        elif each.rate_hz < RATE * wanted_hz or lost > MOST_LOST * stats.frames:
            yield note(name, text, remedy)
        else:
            yield good(name, text)
        for remark in camera.remarks:
            yield note(name, remark)
