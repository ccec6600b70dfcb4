"""Conversion to messages and back, and decoding by a standard Foxglove reader."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.recording import RecordingError, schema
from calm_edge.types import PoseStatus
from device.frame import Eye, Frame
from tests.recording import samples


def unasked(eye: Eye) -> tuple[int, int]:
    raise AssertionError("records of cameras have their sizes")


def test_jpeg_bytes_are_untouched() -> None:
    frame = samples.frame(Eye.ASSISTANT, 3)
    message = schema.frame_message(frame)
    again = schema.read_frame(Eye.ASSISTANT, message.sequence, message.t_ns, message.data)
    assert again == frame
    assert message.topic == "/assistant/image"


@pytest.mark.parametrize("t_ns", [-1, 1 << 63])
def test_times_outside_the_range_of_mcap_raise(t_ns: int) -> None:
    with pytest.raises(RecordingError):
        schema.frame_message(Frame(Eye.PRIMARY, 0, t_ns, b"x"))


def test_pose_and_update_round_trip() -> None:
    for i in range(3):
        message = schema.pose_messages(samples.pose(i))[0]
        assert samples.same(schema.read_pose(message.data), samples.pose(i))
    message = schema.update_messages(samples.update(), log_depth=True)[0]
    assert samples.same(schema.read_update(message.data, unasked), samples.update())


def test_what_is_unknown_of_a_pose_is_not_published() -> None:
    def topics(**changes: object) -> list[str]:
        sample = dataclasses.replace(samples.pose(), **changes)
        return [message.topic for message in schema.pose_messages(sample)]

    nan = np.full(3, np.nan)
    lost = {"T_w_c": np.full((4, 4), np.nan), "velocity_c": nan, "turn_rate_c": nan}
    assert topics() == [schema.POSE_SAMPLE, schema.POSE_LIVE, schema.TF]
    assert topics(**lost, status=PoseStatus.LOST) == [schema.POSE_SAMPLE]
    assert topics(velocity_c=nan) == topics(turn_rate_c=nan) == [schema.POSE_SAMPLE, schema.TF]
    unknown = dataclasses.replace(samples.pose(), covariance=np.full((6, 6), np.nan))
    sent = Odometry()
    sent.ParseFromString(schema.pose_messages(unknown)[1].data)
    assert not any(sent.pose_covariance)
    # lost with a last known pose; without a metre lengths have an infinite sigma
    assert topics(status=PoseStatus.LOST) == [schema.POSE_SAMPLE]
    unscaled = dataclasses.replace(samples.pose(), scale_log_sigma=np.inf)
    sent.ParseFromString(schema.pose_messages(unscaled)[1].data)
    assert np.abs(sent.pose_covariance).max() == np.abs(sent.velocity_covariance).max() == 0


def test_depth_is_left_out_unless_requested() -> None:
    message = schema.update_messages(samples.update(), log_depth=False)[0]
    assert samples.same(schema.read_update(message.data, unasked), samples.update(depth=False))


def test_depth_beyond_half_precision_becomes_unknown() -> None:
    update = samples.update()
    depth = np.full((5, 6, 8), 10.004, np.float32)
    depth[0, 0, :3] = [1e6, np.inf, np.nan]
    prediction = dataclasses.replace(update.prediction, depth=depth)
    update = dataclasses.replace(update, prediction=prediction)
    once = schema.read_update(schema.update_messages(update, True)[0].data, unasked)
    assert once.prediction.depth is not None
    np.testing.assert_array_equal(once.prediction.depth[0, 0, :3], 0)
    np.testing.assert_allclose(once.prediction.depth[1], 10.004, rtol=2**-11)
    twice = schema.read_update(schema.update_messages(once, True)[0].data, unasked)
    assert samples.same(once, twice)


def test_a_standard_reader_decodes_every_message_to_the_same_poses(tmp_path: Path) -> None:
    samples.small_recording(tmp_path / "rec")
    seen: dict[str, list] = {}
    with (tmp_path / "rec" / "0000.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        protobuf = [t for t in schema.TOPICS if t not in ("/clock", "/status", "/health")]
        for _, channel, _, decoded in reader.iter_decoded_messages(topics=protobuf):
            seen.setdefault(channel.topic, []).append(decoded)
    # the samples do not know the focal of the assistant
    assert set(protobuf) - set(seen) == {"/log", "/assistant/calibration"}
    odometry, expected = seen["/pose/live"][4], samples.pose(4)
    q = odometry.pose.orientation
    rotated = cv2.Rodrigues(expected.T_w_c[:3, :3])[0].ravel()
    axis = np.array([q.x, q.y, q.z])
    angle = 2 * np.arctan2(np.linalg.norm(axis), q.w)
    np.testing.assert_allclose(axis / np.linalg.norm(axis) * angle, rotated, atol=1e-9)
    p = odometry.pose.position
    np.testing.assert_array_equal([p.x, p.y, p.z], expected.T_w_c[:3, 3])
    assert list(odometry.pose_covariance) == expected.with_drift()[0].ravel().tolist()
    assert odometry.timestamp.ToNanoseconds() == expected.t_ns
    assert seen["/submap"][0].DESCRIPTOR.full_name == "calm_edge.Submap"
    assert len(seen["/pose/keyframes"][0].poses) == 9
    assert seen["/primary/image"][0].format == "jpeg"


def test_the_cameras_of_a_sub_map_are_published_with_their_lenses() -> None:
    update = samples.update()
    lenses = {
        Eye.PRIMARY: (Perspective(500, 510, 320, 240, 640, 480, (-0.3, 0.1)), "plumb_bob"),
        Eye.ASSISTANT: (Fisheye(300, 310, 322, 238, 640, 480, (0.01, -0.02)), "kannala_brandt"),
    }
    cameras = tuple(lenses[Eye(view >= 3)][0] for view in range(5))
    sigma = np.array([0.03, 0.04])
    submap = dataclasses.replace(update.submap, cameras=cameras, focal_log_sigma=sigma)
    messages = schema.calibration_messages(dataclasses.replace(update, submap=submap), 7)
    assert [message.topic for message in messages] == [
        "/primary/calibration",
        "/assistant/calibration",
    ]
    for message, (eye, (camera, model)) in zip(messages, lenses.items(), strict=True):
        found = CameraCalibration.FromString(message.data)
        assert (found.frame_id, found.distortion_model) == (eye.name.lower(), model)
        assert (found.width, found.height) == (640, 480)
        assert list(found.D[: len(camera.distortion)]) == list(camera.distortion)
        assert list(found.K) == camera.matrix.ravel().tolist()
        assert len(found.D) == {"plumb_bob": 5, "kannala_brandt": 4}[model]


def test_a_frame_without_a_stamp_of_its_own_stays_marked() -> None:
    frame = dataclasses.replace(samples.frame(Eye.PRIMARY, 3), own_stamp=False)
    message = schema.frame_message(frame)
    assert schema.read_frame(Eye.PRIMARY, 3, message.t_ns, message.data) == frame
