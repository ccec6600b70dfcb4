"""Each cause is named, with what was measured; good pictures have none."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from calm_edge.frontend.diagnosis import Cause, Kind, causes, of_frames
from calm_edge.types import Bytes
from device.frame import Eye, Frame

DRIVE = Path(__file__).resolve().parents[2] / "demo" / "drive"
FIRST, COUNT, STEP_NS = 60, 5, 100_000_000
Pictures = list[Bytes]


def pictures(eye: int, first: int = FIRST) -> Pictures:
    files = sorted((DRIVE / f"cam{eye}").iterdir())[first : first + COUNT]
    return [np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), np.uint8) for file in files]


@pytest.fixture(scope="module")
def both() -> tuple[Pictures, Pictures]:
    return pictures(0), pictures(1)


def found(primary: Pictures, assistant: Pictures, late_ns: int = 0) -> tuple[Cause, ...]:
    def timed(views: Pictures, late_ns: int = 0) -> list[tuple[int, Callable[[], Bytes]]]:
        return [(k * STEP_NS + late_ns, lambda p=p: p) for k, p in enumerate(views)]

    return causes(timed(primary), timed(assistant, late_ns))


def dark(picture: Bytes) -> Bytes:
    return (picture // 16).astype(np.uint8)


def glare(picture: Bytes) -> Bytes:
    return np.maximum(picture, 250)


def covered(picture: Bytes) -> Bytes:
    return np.full_like(picture, 90)


def blurred(picture: Bytes) -> Bytes:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 3), np.uint8)


def out_of_focus(picture: Bytes) -> Bytes:
    """Blurred so much that the noise of the JPEG is sharper than the scene."""
    soft = cv2.GaussianBlur(picture, (0, 0), 16)
    stored = cv2.imencode(".jpg", soft, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
    return np.asarray(cv2.imdecode(stored, cv2.IMREAD_GRAYSCALE), np.uint8)


def test_good_pictures_have_no_cause(both: tuple[Pictures, Pictures]) -> None:
    assert found(*both) == ()


@pytest.mark.parametrize(
    ("spoil", "kind", "words"),
    [
        (dark, Kind.EXPOSURE, r"too dark \(mean grey \d+ of 255\)"),
        (glare, Kind.EXPOSURE, r"too bright \(mean grey 25\d of 255\)"),
        (covered, Kind.EXPOSURE, r"no structure \(grey 90 \+- 0\.0\): is the lens covered\?"),
        (blurred, Kind.BLURRED, r"blurred \(sharpness 0\.0\d\d, at least 0\.06 is needed\)"),
        (out_of_focus, Kind.BLURRED, r"blurred \(sharpness 0\.0\d\d, at least 0\.06 is needed\)"),
    ],
)
def test_a_fault_of_one_camera_is_named_with_it(
    both: tuple[Pictures, Pictures], spoil: Callable[[Bytes], Bytes], kind: Kind, words: str
) -> None:
    primary, assistant = both
    for eye, name in enumerate(("primary", "assistant")):
        views = [primary, assistant]
        views[eye] = [spoil(picture) for picture in views[eye]]
        (cause,) = found(*views)
        assert cause.kind is kind and cause.text.startswith(f"{name} camera: ")
        assert re.search(words, cause.text), cause.text


def test_a_missing_camera_and_clocks_apart(both: tuple[Pictures, Pictures]) -> None:
    primary, assistant = both
    (cause,) = found(primary, [])
    assert cause == (Kind.MISSING, "no picture of the assistant camera")
    assert found([], [])[0].text == "no picture of the primary and of the assistant camera"
    (cause,) = found(primary, assistant, late_ns=64 * 10**9)
    assert cause.kind is Kind.CLOCKS
    assert "primary 0.0 to 0.4 s, assistant 64.0 to 64.4 s" in cause.text


def test_standing_and_mostly_static_pictures(both: tuple[Pictures, Pictures]) -> None:
    primary, assistant = both
    noise = np.random.default_rng(0)
    still = [
        np.clip(primary[0] + noise.normal(0, 2, primary[0].shape), 0, 255).astype(np.uint8)
        for _ in primary
    ]
    (cause,) = found(still, assistant)
    assert cause.kind is Kind.STILL and "median flow 0." in cause.text
    bonnet = [picture.copy() for picture in primary]
    for picture in bonnet:
        picture[len(picture) // 4 :] = primary[0][len(picture) // 4 :]
    (cause,) = found(bonnet, assistant)
    assert cause.kind is Kind.STATIC and "bonnet" in cause.text


def test_an_odd_order_and_pictures_without_anything_in_common(
    both: tuple[Pictures, Pictures],
) -> None:
    primary, assistant = both
    (cause,) = found([primary[k] for k in (0, 3, 1, 4, 2)], assistant)
    assert cause.kind is Kind.ORDER
    jumps = [pictures(0, first)[0] for first in (0, 90, 180, 270, 360)]
    (cause,) = found(jumps, assistant)
    assert cause.kind is Kind.GAPS


def test_cameras_that_see_different_things(both: tuple[Pictures, Pictures]) -> None:
    (cause,) = found(both[0], pictures(1, FIRST + 200))
    assert cause.kind is Kind.APART and "points in common" in cause.text


def test_frames_that_cannot_be_decoded_have_no_cause() -> None:
    frames = [Frame(Eye.PRIMARY, k, k * STEP_NS, b"no picture") for k in range(2)]
    assert of_frames(frames, frames) == ()
