"""No depth is used where a picture shows the car; pictures are decoded where there is depth."""

from __future__ import annotations

import numpy as np

from calm_edge.offline.densify import pictures, used_depth
from calm_edge.types import Keyframe, Masks, SubmapWindow
from device.frame import Eye, Frame, jpeg


def test_depth_is_unknown_in_the_masked_part_of_its_eye_alone() -> None:
    depth = np.full((3, 20, 40), 7, np.float32)
    masks = Masks(np.array([[0], [1]], np.uint8), None)
    used = used_depth(depth, masks, np.array([0, 1, 0]))
    assert (used[[0, 2], :10] == 7).all() and (used[[0, 2], 10:] == 0).all()
    assert (used[1] == 7).all() and (depth == 7).all()
    assert (used_depth(depth, None, np.array([0, 1, 0])) == 7).all()


def test_pictures_are_decoded_of_views_with_depth_alone() -> None:
    good, broken = jpeg(np.full((16, 24, 3), 90, np.uint8), 95), b"no picture"
    frames = [Frame(eye, 0, 0, data) for eye, data in zip(Eye, (good, broken), strict=True)]
    primary, assistant = ((Keyframe(0, frame),) for frame in frames)
    depth = np.zeros((2, 4, 6), np.float32)
    depth[0, 2, 3] = 5
    first, second = pictures(SubmapWindow(0, primary, assistant, 0), depth)
    assert first is not None and first.shape == (16, 24, 3) and second is None
