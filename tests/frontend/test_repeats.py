"""Pictures repeated under a new stamp: exactly, coded anew, and what only looks like it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calm_edge.frontend.repeats import RepeatCheck, eighth
from calm_edge.types import Bytes
from tests.frontend.plane_world import PlaneWorld, drive

MS = 1_000_000
WORLD = PlaneWorld()
RNG = np.random.default_rng(0)


def jpeg(gray: Bytes, quality: int = 92) -> bytes:
    return bytes(cv2.imencode(".jpg", gray, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def repeats(pictures: list[bytes], period_ms: int = 100) -> list[bool]:
    """Which of the pictures the check takes for repeats, as the tracker calls it."""
    check = RepeatCheck()
    found = []
    for i, data in enumerate(pictures):
        gray = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
        found.append(check.is_repeat(i * period_ms * MS, data, eighth(gray)))
    return found


def moving(n: int, step_m: float = 0.15) -> list[Bytes]:
    return [WORLD.render(T) for T in drive(n, step_m)]


def noisy(gray: Bytes) -> Bytes:
    return np.clip(gray + RNG.normal(0, 2, gray.shape), 0, 255).astype(np.uint8)


def test_a_moving_car_repeats_nothing() -> None:
    assert not any(repeats([jpeg(noisy(gray)) for gray in moving(12)]))


@pytest.mark.parametrize("quality", [92, 80])
def test_a_picture_sent_again_is_a_repeat_also_coded_anew(quality: int) -> None:
    pictures = moving(12)
    sent = [
        jpeg(pictures[i - 1], quality) if i % 6 == 5 else jpeg(p) for i, p in enumerate(pictures)
    ]
    assert [i for i, repeat in enumerate(repeats(sent)) if repeat] == [5, 11]


def test_ten_pictures_a_second_sent_at_thirty_are_ten() -> None:
    sent = [jpeg(gray, q) for gray in moving(6) for q in (92, 85, 92)]
    # the first of all has no motion before it that would show a new coding
    assert repeats(sent, 33)[3:] == [False, True, True] * 5


def test_a_frozen_camera_repeats_for_ever() -> None:
    still = jpeg(WORLD.render(drive(1)[0]))
    assert repeats([still] * 60) == [False] + [True] * 59


def test_a_parked_car_is_exposed_anew_each_time() -> None:
    still = WORLD.render(drive(1)[0])
    assert not any(repeats([jpeg(noisy(still)) for _ in range(30)]))


def test_a_car_that_brakes_by_3_m_s2_is_no_repeat() -> None:
    speed_m = np.maximum(0.0, 0.15 - 0.03 * np.arange(12))
    along = np.cumsum(speed_m)
    T = drive(1)[0]
    sent = []
    for x in along:
        T_w_c = T.copy()
        T_w_c[0, 3] += x
        sent.append(jpeg(noisy(WORLD.render(T_w_c))))
    assert not any(repeats(sent))


def test_an_abrupt_stop_costs_a_quarter_of_a_second() -> None:
    pictures = moving(6)
    sent = [jpeg(noisy(p)) for p in [*pictures, *[pictures[-1]] * 8]]
    assert sum(repeats(sent)) <= 2


def test_darkness_is_no_repeat() -> None:
    assert not any(repeats([jpeg(np.zeros((240, 480), np.uint8))] * 5))


def test_another_size_is_no_repeat() -> None:
    gray = WORLD.render(drive(1)[0])
    assert repeats([jpeg(gray), jpeg(cv2.resize(gray, (320, 160)))]) == [False, False]
