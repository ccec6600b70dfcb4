"""Faces and plates in pictures become coarse blocks; without detectors there is a remedy."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from calm_edge.report.blur import CASCADES, FOLDERS, Blur, BlurError
from calm_edge.types import Bytes

HERE = any(all((folder / name).is_file() for name in CASCADES) for folder in FOLDERS)
needs_cascades = pytest.mark.skipif(not HERE, reason="no cascades: apt install opencv-data")


def plate(picture: Bytes, x: int, y: int, width: int) -> None:
    """Draw a number plate on a red car."""
    height = round(0.22 * width)
    cv2.rectangle(picture, (x - 60, y - 80), (x + width + 60, y + height + 40), (40, 30, 120), -1)
    cv2.rectangle(picture, (x, y), (x + width, y + height), (245, 245, 245), -1)
    cv2.rectangle(picture, (x, y), (x + width, y + height), (10, 10, 10), 2)
    size, thick = height / 39, max(2, width // 70)
    at = x + 6, y + height - 8
    cv2.putText(picture, "A123BC 77", at, cv2.FONT_HERSHEY_SIMPLEX, size, (10, 10, 10), thick)


def face(picture: Bytes, x: int, y: int, r: int) -> None:
    """Draw a face of radius r about (x, y)."""
    cv2.ellipse(picture, (x, y), (int(0.75 * r), r), 0, 0, 360, (150, 180, 220), -1)
    for side in (-1, 1):
        eye, white = (x + int(side * 0.3 * r), y - int(0.2 * r)), (250, 250, 250)
        cv2.ellipse(picture, eye, (int(0.16 * r), int(0.08 * r)), 0, 0, 360, white, -1)
        cv2.circle(picture, eye, int(0.07 * r), (30, 30, 30), -1)
        brow = eye[0], y - int(0.36 * r)
        cv2.ellipse(picture, brow, (int(0.2 * r), int(0.05 * r)), 0, 0, 360, (50, 60, 80), -1)
    nose, mouth, hair = (y + int(part * r) for part in (0.1, 0.5, -0.75))
    cv2.ellipse(picture, (x, nose), (r // 10, r // 5), 0, 0, 360, (130, 160, 200), -1)
    cv2.ellipse(picture, (x, mouth), (int(0.3 * r), int(0.07 * r)), 0, 0, 360, (80, 80, 160), -1)
    cv2.ellipse(picture, (x, hair), (int(0.75 * r), int(0.4 * r)), 0, 180, 360, (30, 40, 50), -1)


def street() -> Bytes:
    return np.full((540, 960, 3), 120, np.uint8)


def blocks(picture: Bytes) -> float:
    """Share of neighbouring pixels that are equal, along both axes."""
    across, down = np.diff(picture, axis=1).any(-1), np.diff(picture, axis=0).any(-1)
    return 1 - float((across.mean() + down.mean()) / 2)


@needs_cascades
def test_a_face_and_a_plate_are_found_and_nothing_else_is_changed() -> None:
    picture = street()
    plate(picture, 600, 350, 200)
    face(picture, 250, 250, 110)
    noise = np.random.default_rng(0).normal(0, 4, picture.shape)
    picture = cv2.GaussianBlur(np.clip(picture + noise, 0, 255).astype(np.uint8), (3, 3), 0)
    blur = Blur()
    found = blur(picture)
    for area in (np.s_[200:320, 190:310], np.s_[355:390, 620:780]):
        assert blocks(picture[area]) < 0.7 and blocks(found[area]) > 0.9
    assert np.array_equal(found[:60, 450:], picture[:60, 450:])
    assert blur.pictures == 1 and blur.places >= 2 and "best effort" in str(blur)


@needs_cascades
def test_a_place_at_the_edge_of_a_large_picture_is_covered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    picture = np.random.default_rng(0).integers(0, 255, (90, 160, 3)).astype(np.uint8)
    monkeypatch.setattr(Blur, "_found", lambda *_: iter([(140, 70, 20, 20)]))
    found = Blur()(picture)
    assert blocks(found[67:, 137:]) > 0.8 and np.array_equal(found[:60], picture[:60])


def test_without_detectors_the_remedy_is_named(tmp_path: Path) -> None:
    with pytest.raises(BlurError, match="apt install opencv-data"):
        Blur(tmp_path)
    for name in CASCADES:
        (tmp_path / name).write_text("<opencv_storage></opencv_storage>")
    with pytest.raises(BlurError, match="cannot be read"):
        Blur(tmp_path)
