"""Keyframe selection: disparity, turns, standstill, darkness."""

from __future__ import annotations

import numpy as np

from calm_edge.config import FrontendConfig
from calm_edge.frontend.keyframes import KeyframeSelector, robust_mean
from calm_edge.types import Bytes, Keyframe
from device.frame import Eye, Frame
from tests.frontend.plane_world import CAMERA, DEPTH, WIDTH, PlaneWorld, drive

WORLD = PlaneWorld()
PERIOD_NS = 100_000_000
THRESHOLD_PX = 25.0 * WIDTH / 1241


def select(images: list[Bytes]) -> list[Keyframe]:
    selector = KeyframeSelector(FrontendConfig(max_keyframe_gap_s=1.0))
    chosen = []
    for i, gray in enumerate(images):
        frame = Frame(Eye.PRIMARY, i, i * PERIOD_NS, b"")
        chosen.append(selector.consider(frame, gray))
    return [k for k in chosen if k is not None]


def test_the_first_frame_is_keyframe_0() -> None:
    (only,) = select([WORLD.render(drive(1)[0])])
    assert only.id == 0 and only.frame.sequence == 0


def test_keyframes_are_selected_at_the_disparity_threshold() -> None:
    step_m = 0.05
    a_frame_px = CAMERA.fx * step_m / DEPTH
    keyframes = select([WORLD.render(T) for T in drive(40, step_m)])
    expected = int(THRESHOLD_PX / a_frame_px) + 1
    gaps = np.diff([k.frame.sequence for k in keyframes])
    assert [k.id for k in keyframes] == list(range(len(keyframes)))
    assert len(gaps) >= 3 and np.abs(gaps - expected).max() <= 1


def test_a_turn_that_loses_tracks_gives_keyframes() -> None:
    keyframes = select([WORLD.render(T) for T in drive(8, 0.05, yaw_deg=12.0)])
    assert [k.frame.sequence for k in keyframes] == list(range(8))


def test_at_standstill_passing_objects_give_no_keyframe() -> None:
    rng = np.random.default_rng(0)
    still, other = WORLD.render(drive(1)[0]), PlaneWorld(1).render(drive(1)[0])
    images = []
    for i in range(60):
        image = np.clip(still + rng.normal(0, 3, still.shape), 0, 255).astype(np.uint8)
        left = 8 * i % WIDTH
        image[80:200, left : left + 120] = other[80:200, : len(image[0, left : left + 120])]
        images.append(image)
    assert len(select(images)) == 1


def test_slow_motion_gives_a_keyframe_by_time() -> None:
    keyframes = select([WORLD.render(T) for T in drive(40, 0.01)])
    gaps = np.diff([k.frame.sequence for k in keyframes])
    assert len(gaps) and gaps.max() <= 20


def test_darkness_gives_no_keyframes_and_light_does_again() -> None:
    dark = np.zeros_like(WORLD.render(drive(1)[0]))
    images = [dark] * 10 + [WORLD.render(T) for T in drive(20, 0.1)]
    sequences = [k.frame.sequence for k in select(images)]
    assert sequences[0] == 0 and sequences[1] > 10


def test_a_tenth_of_outliers_at_either_end_does_not_move_the_mean() -> None:
    disparity = np.concatenate([np.full(80, 10.0), np.full(10, 500.0), np.zeros(10)])
    assert robust_mean(disparity) == 10.0
    assert robust_mean(np.zeros(0)) == 0.0


def test_a_camera_on_its_side_gives_the_same_keyframes() -> None:
    images = [WORLD.render(T) for T in drive(40, 0.05)]
    upright = [np.ascontiguousarray(np.rot90(image)) for image in images]
    numbers = [[k.frame.sequence for k in select(each)] for each in (images, upright)]
    assert len(numbers[0]) == len(numbers[1]) >= 4
    assert np.abs(np.subtract(*numbers)).max() <= 1


def test_exposure_changes_no_keyframe() -> None:
    images = [WORLD.render(T) for T in drive(40, 0.05)]
    pumped = [
        np.asarray((0.4 + 0.6 * abs(np.cos(0.7 * i))) * image, np.uint8)
        for i, image in enumerate(images)
    ]
    plain, found = ([k.frame.sequence for k in select(each)] for each in (images, pumped))
    assert len(plain) == len(found) and np.abs(np.subtract(plain, found)).max() <= 1
