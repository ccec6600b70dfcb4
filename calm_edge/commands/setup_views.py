"""Pictures of two running cameras, and what `calm-edge setup` finds in them."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from calm_edge.commands import view_checks
from calm_edge.commands.finding import Finding, bad
from calm_edge.commands.plugged_in import shared_hubs
from calm_edge.commands.setup_choices import Choices
from calm_edge.types import Bytes
from device.clock import Clock
from device.frame import Eye, Frame, UnreadableImage, jpeg
from device.usb_place import place_of
from device.watching import Seen, collect

# of each camera are judged
PICTURES = 3
# automatic exposure and focus settle before that
SETTLE_S = 2.0
COVER_POLL_S = 0.3
# of a picture on the page
WIDTH_PX = 640


def newest(each: Seen) -> Bytes | None:
    """The newest picture (H, W, 3) of a camera; None if there is none that can be decoded."""
    found = _decoded(each.frames[-1:], gray=False)
    return found[0] if found else None


def small_jpeg(picture: Bytes) -> bytes:
    """A picture (H, W, 3) as JPEG, at most WIDTH_PX wide."""
    share = min(1.0, WIDTH_PX / picture.shape[1])
    small = cv2.resize(picture, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    return jpeg(np.asarray(small, np.uint8))


def findings(seen: Sequence[Seen], choices: Choices) -> list[Finding]:
    """Traffic lights of both cameras; `seen` has the primary first."""
    found: list[Finding] = []
    last: list[Bytes] = []
    for each, eye in zip(seen, Eye, strict=True):
        pictures = _decoded(each.frames[-PICTURES:], gray=True)
        if not pictures:
            found.append(bad(f"{eye.name.lower()} picture", "none that can be decoded"))
            continue
        found += view_checks.picture_findings(pictures, eye)
        last.append(pictures[-1])
    if len(last) == 2:
        found.append(view_checks.overlap(last[0], last[1]))
    if choices.has_cameras:
        found += view_checks.rates(seen, choices.config.capture.rate_hz)
    found += shared_hubs({camera.address: place_of(camera.path) for camera in choices.pair})
    return found


def brightness(seen: Sequence[Seen], clock: Clock) -> tuple[float, float] | None:
    """Mean grey of the next pictures of both cameras; None if one gives none."""
    for each in seen:
        each.frames.clear()
    collect(seen, clock, COVER_POLL_S, pictures=1)
    found = [_decoded(each.frames[-1:], gray=True) for each in seen]
    return (float(found[0][0].mean()), float(found[1][0].mean())) if all(found) else None


def _decoded(frames: Sequence[Frame], *, gray: bool) -> list[Bytes]:
    """Pictures of frames, without those that cannot be decoded."""
    found = []
    for frame in frames:
        try:
            found.append(frame.gray() if gray else frame.bgr())
        except UnreadableImage:
            continue
    return found
