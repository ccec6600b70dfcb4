"""Traffic lights of exposure, focus and overlap, of the demo drive and of spoilt pictures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calm_edge.commands import view_checks
from calm_edge.commands.finding import Level
from calm_edge.types import Bytes
from device.frame import Eye
from tests.backbones.bundle.demo_pictures import picture

FIRST = 60


def gray(index: int, eye: Eye) -> Bytes:
    return np.asarray(cv2.cvtColor(picture(index, int(eye)), cv2.COLOR_BGR2GRAY), np.uint8)


def lights(pictures: list[Bytes]) -> dict[str, Level]:
    found = view_checks.picture_findings(pictures, Eye.PRIMARY)
    return {finding.name.removeprefix("primary "): finding.level for finding in found}


def test_pictures_of_a_drive_are_green() -> None:
    assert set(lights([gray(k, Eye.PRIMARY) for k in (FIRST, 200)]).values()) == {Level.GOOD}
    found = view_checks.overlap(gray(FIRST, Eye.PRIMARY), gray(FIRST, Eye.ASSISTANT))
    assert found.level is Level.GOOD and "% of the assistant's width" in found.text


@pytest.mark.parametrize("blur_px", [3, 8, 16])
def test_blur_of_any_size_is_red(blur_px: int) -> None:
    blurred = cv2.GaussianBlur(gray(FIRST, Eye.PRIMARY), (0, 0), blur_px)
    assert lights([np.asarray(blurred, np.uint8)])["focus"] is Level.BAD


def test_glare_is_yellow_and_darkness_red() -> None:
    sharp = gray(FIRST, Eye.PRIMARY)
    glare = sharp.copy()
    glare[:, : glare.shape[1] // 4] = 255
    assert lights([glare])["exposure"] is Level.NOTE
    assert lights([sharp // 16]) == {"exposure": Level.BAD}


def test_views_with_little_in_common_are_yellow_or_red() -> None:
    left, right = gray(FIRST, Eye.PRIMARY), gray(FIRST, Eye.ASSISTANT)
    assert view_checks.overlap(left, gray(300, Eye.ASSISTANT)).level is Level.BAD
    # a strip of the common scene; the rest is flat
    strip = np.full_like(right, 127)
    strip[:, -right.shape[1] // 5 :] = right[:, -right.shape[1] // 5 :]
    assert view_checks.overlap(left, strip).level is not Level.GOOD
