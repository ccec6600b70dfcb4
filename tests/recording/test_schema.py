"""Conversion to messages and back, and decoding by a standard Foxglove reader."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from calm_edge.recording import RecordingError, schema
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
        message = schema.pose_message(samples.pose(i))
        assert samples.same(schema.read_pose(message.data), samples.pose(i))
    message = schema.update_message(samples.update(), log_depth=True, t_ns=0)
    assert samples.same(schema.read_update(message.data, unasked), samples.update())


def test_depth_is_left_out_unless_requested() -> None:
    message = schema.update_message(samples.update(), log_depth=False, t_ns=0)
    assert samples.same(schema.read_update(message.data, unasked), samples.update(depth=False))


def test_depth_beyond_half_precision_becomes_unknown() -> None:
    update = samples.update()
    depth = np.full((5, 6, 8), 10.004, np.float32)
    depth[0, 0, :3] = [1e6, np.inf, np.nan]
    prediction = dataclasses.replace(update.prediction, depth=depth)
    update = dataclasses.replace(update, prediction=prediction)
    once = schema.read_update(schema.update_message(update, True, 0).data, unasked)
    assert once.prediction.depth is not None
    np.testing.assert_array_equal(once.prediction.depth[0, 0, :3], 0)
    np.testing.assert_allclose(once.prediction.depth[1], 10.004, rtol=2**-11)
    twice = schema.read_update(schema.update_message(once, True, 0).data, unasked)
    assert samples.same(once, twice)


def test_a_standard_reader_decodes_every_message_to_the_same_poses(tmp_path: Path) -> None:
    samples.small_recording(tmp_path / "rec")
    seen: dict[str, list] = {}
    with (tmp_path / "rec" / "0000.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        protobuf = [t for t in schema.TOPICS if schema.topic_schema(t).encoding == "protobuf"]
        for _, channel, _, decoded in reader.iter_decoded_messages(topics=protobuf):
            seen.setdefault(channel.topic, []).append(decoded)
    # the samples have no GPS and do not know the focal of the assistant
    assert set(protobuf) - set(seen) == {"/log", "/gps", "/assistant/calibration"}
    odometry, expected = seen["/pose/live"][4], samples.pose(4)
    assert odometry.timestamp.ToNanoseconds() == expected.t_ns
    frames = {(t.parent_frame_id, t.child_frame_id) for t in seen["/tf"][-1].transforms}
    assert {("map", "odom"), ("odom", "base_link"), ("base_link", "primary")} <= frames
    assert seen["/submap"][0].DESCRIPTOR.full_name == "calm_edge.Submap"
    assert len(seen["/pose/path"][0].poses) == 9
    assert seen["/primary/image"][0].format == "jpeg"


def test_a_frame_without_a_stamp_of_its_own_stays_marked() -> None:
    frame = dataclasses.replace(samples.frame(Eye.PRIMARY, 3), own_stamp=False)
    message = schema.frame_message(frame)
    assert schema.read_frame(Eye.PRIMARY, 3, message.t_ns, message.data) == frame
