"""Cameras in records: every model comes back exactly; matrices of version 0.1.0 become pinholes."""

from __future__ import annotations

import json

import numpy as np
import pytest

from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.through_lens import ThroughLens
from calm_edge.recording import RecordingError, camera_record
from device.frame import Eye

SIZES = {Eye.PRIMARY: (640, 480), Eye.ASSISTANT: (320, 200)}
PLAIN = Perspective(500.0, 501.0, 319.5, 239.5, 640, 480)


@pytest.mark.parametrize(
    "camera",
    [
        PLAIN,
        Perspective(500 / 3, 501.0, 319.5, 0.1, 640, 480, (0.1, -1 / 3, 1e-9)),
        Fisheye(300.0, 301.0, 319.5, 239.5, 640, 480, (0.01, 1 / 7)),
        ThroughLens(
            290.0,
            1 / 3,
            320.0,
            239.5,
            640,
            480,
            lens=Fisheye(300.0, 301.0, 319.5, 239.5, 640, 480, (0.01, 1 / 7)),
        ),
    ],
)
def test_json_and_back_is_the_same_camera(camera):
    again = camera_record.decode(json.loads(json.dumps(camera_record.encode(camera))))
    assert again == camera and type(again) is type(camera)


@pytest.mark.parametrize(
    "change", [{"model": "pinhole"}, {"model": None}, {"fov": 3.0}, {"distortion": None}]
)
def test_what_is_no_camera_is_refused(change):
    with pytest.raises(RecordingError, match="not a valid camera record"):
        camera_record.decode(camera_record.encode(PLAIN) | change)
    with pytest.raises(RecordingError, match="not a valid camera record"):
        camera_record.decode(3)


def test_matrices_get_the_size_of_their_eyes_pictures():
    K = np.stack([np.array([[f, 0, 9], [0, f + 1, 8], [0, 0, 1.0]]) for f in (100, 200, 300, 400)])
    header = {"submap.primary_ids": [4, 5], "submap.assistant_ids": [4]}
    arrays = {
        "prediction.K": K,
        "submap.K_raw": K * 2,
        "submap.K": K * 3,
        "submap.T_w_s": np.eye(4),
    }
    camera_record.replace_matrices(header, arrays, SIZES.__getitem__)
    assert list(arrays) == ["submap.T_w_s"]
    for field, factor in (
        ("prediction.cameras", 1),
        ("submap.cameras_raw", 2),
        ("submap.cameras", 3),
    ):
        cameras = [camera_record.decode(value) for value in header[field]]
        # the last view is a loop keyframe, which is a primary one
        sizes = [(640, 480), (640, 480), (320, 200), (640, 480)]
        assert [(camera.width, camera.height) for camera in cameras] == sizes
        assert [camera.fx for camera in cameras] == [f * factor for f in (100, 200, 300, 400)]
        assert cameras[1].fy == 201 * factor and cameras[1].cx == 9 * factor
        assert all(camera.is_pinhole for camera in cameras)
