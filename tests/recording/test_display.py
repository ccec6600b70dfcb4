"""What viewers show: frames with Z up, odometry, path, clouds, cameras and the kit as numbers."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame

from calm_edge.config import PoseOutputConfig
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.recording import display, json_schemas, schema
from calm_edge.recording.display import Display
from calm_edge.types import Float, Landmarks, LocalizerUpdate, PoseSample, PoseStatus, Trajectory
from device.frame import Eye
from tests.recording import samples

LEVEL = PoseOutputConfig()


def pose_at(x: float, y: float, z: float, **changes: object) -> PoseSample:
    """Live pose of a camera that has moved by x (right), y (down), z (forward)."""
    T = se3.compose(np.eye(3), np.array([x, y, z]))
    base = dataclasses.replace(samples.pose(), T_w_c=T, status=PoseStatus.LIVE)
    return dataclasses.replace(base, **changes)


def matrices(message: schema.LogMessage) -> dict[str, tuple[str, Float]]:
    """Child frame -> (parent frame, T_parent_child) of a message on /tf."""
    found = {}
    for t in FrameTransforms.FromString(message.data).transforms:
        q = np.array([[t.rotation.x, t.rotation.y, t.rotation.z, t.rotation.w]])
        p = np.array([t.translation.x, t.translation.y, t.translation.z])
        found[t.child_frame_id] = t.parent_frame_id, se3.compose(se3.rotations(q)[0], p)
    return found


def test_the_chain_of_frames_ends_at_the_cameras_with_z_up() -> None:
    shown = Display(LEVEL)
    shown.T_map_odom = se3.exp(np.array([3.0, 0, -1, 0, 0.2, 0]))
    update = samples.update()
    T_p_a = se3.compose(np.eye(3), np.array([0.5, 0, 0]))
    trajectory = dataclasses.replace(update.trajectory, T_p_a=T_p_a)
    shown.update(dataclasses.replace(update, trajectory=trajectory))
    frames = matrices(shown.pose(pose_at(1.0, -2.0, 10.0))[0])
    assert {c: p for c, (p, _) in frames.items()} == {
        "odom": "map", "base_link": "odom", "primary": "base_link", "assistant": "base_link",
    }  # fmt: skip
    T_m_b = frames["odom"][1] @ frames["base_link"][1]
    T_o_b = frames["base_link"][1]
    # in odom forward 10, right 1, up 2
    np.testing.assert_allclose(T_o_b[:3, 3], [10, -1, 2], atol=1e-9)
    T_o_p = T_o_b @ frames["primary"][1]
    np.testing.assert_allclose(T_o_p[:3, 2], [1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(T_o_p[:3, 1], [0, 0, -1], atol=1e-9)
    T_o_a = T_o_b @ frames["assistant"][1]
    np.testing.assert_allclose(T_o_a[:3, 3], [10, -1.5, 2], atol=1e-9)
    # in the map as on the path: of the first camera, x right, y down, z forward
    p_w = (shown.T_map_odom @ [1.0, -2.0, 10.0, 1.0])[:3]
    T_m_b = frames["odom"][1] @ T_o_b
    np.testing.assert_allclose(T_m_b[:3, 3], [p_w[2], -p_w[0], -p_w[1]], atol=1e-9)


def test_a_configured_mounting_keeps_z_up() -> None:
    pitched = PoseOutputConfig(mounting_rpy_deg=(0.0, -20.0, 0.0))
    # the camera looks down by 20 degrees and moves forward along the road
    a = np.radians(20)
    frames = matrices(Display(pitched).pose(pose_at(0, -5 * np.sin(a), 5 * np.cos(a)))[0])
    np.testing.assert_allclose(frames["base_link"][1][:3, 3], [5, 0, 0], atol=1e-9)


def test_what_is_unknown_of_a_pose_is_not_published() -> None:
    def topics(**changes: object) -> list[str]:
        return [m.topic for m in Display(LEVEL).pose(pose_at(1, 0, 0, **changes))]

    nan = np.full(3, np.nan)
    assert topics() == [schema.TF, schema.POSE_LIVE]
    assert topics(T_w_c=np.full((4, 4), np.nan)) == topics(status=PoseStatus.LOST) == []
    assert topics(velocity_c=nan) == topics(turn_rate_c=nan) == [schema.TF]
    for unknown in ({"covariance": np.full((6, 6), np.nan)}, {"scale_log_sigma": np.inf}):
        sent = Odometry.FromString(Display(LEVEL).pose(pose_at(1, 0, 0, **unknown))[1].data)
        assert not any(sent.pose_covariance)
    assert not any(sent.velocity_covariance)


def test_odometry_is_of_the_body_in_odom() -> None:
    covariance = np.diag([1.0, 2, 3, 4, 5, 6])
    shown = Display(LEVEL, origin_ns=5)
    shown.T_map_odom = se3.exp(np.array([0, 0, 7.0, 0, 0, 0]))
    sample = pose_at(
        0, 0, 9, velocity_c=np.array([0, 0, 4.0]), turn_rate_c=np.array([0, 0.1, 0]),
        covariance=covariance, scale_log_sigma=0.0, drift=np.zeros((6, 6)),
        focal_offset=np.zeros(6), scale_offset=np.zeros(3), twist_covariance=covariance,
    )  # fmt: skip
    sent = Odometry.FromString(shown.pose(sample)[1].data)
    assert (sent.frame_id, sent.body_frame_id) == ("odom", "base_link")
    assert sent.timestamp.ToNanoseconds() == sample.t_ns - 5
    p, v, w = sent.pose.position, sent.linear_velocity, sent.angular_velocity
    # where the map has moved to meanwhile does not matter
    np.testing.assert_allclose([p.x, p.y, p.z], [9, 0, 0], atol=1e-9)
    np.testing.assert_allclose([v.x, v.y, v.z], [4, 0, 0], atol=1e-9)
    # a turn to the right is negative about z
    np.testing.assert_allclose([w.x, w.y, w.z], [0, 0, -0.1], atol=1e-9)
    for sent_covariance in (sent.pose_covariance, sent.velocity_covariance):
        found = np.array(sent_covariance).reshape(6, 6)
        np.testing.assert_allclose(np.diag(found), [3, 1, 2, 6, 4, 5], atol=1e-9)


def moved(ids: range, t_s: float, n: int = 3) -> LocalizerUpdate:
    """Update of keyframes `ids` at t_s."""
    base = samples.update()
    T = se3.exp(np.linspace(0, 1, len(ids))[:, None] * np.ones(6))
    submap = dataclasses.replace(base.submap, t_ns=np.full(n, round(t_s * 1e9), np.int64))
    trajectory = Trajectory(np.array(ids), np.zeros(len(ids), np.int64), T, np.eye(4), 0)
    return dataclasses.replace(base, submap=submap, trajectory=trajectory)


def test_the_path_comes_every_ten_seconds_with_at_most_500_poses() -> None:
    shown = Display(LEVEL)
    counts = []
    for k in range(25):
        messages = shown.update(moved(range(60 * k, 60 * k + 70), 1.0 + k))
        paths = [m for m in messages if m.topic == schema.PATH]
        counts += [len(PosesInFrame.FromString(m.data).poses) for m in paths]
    assert counts[0] == 70 and len(counts) == 3 and max(counts) <= 500
    # the optimum at the end, which moves all keyframes
    *_, last = (m for m in shown.update(moved(range(60 * 24 + 70), 26.0)) if m.topic == schema.PATH)
    assert 250 < len(PosesInFrame.FromString(last.data).poses) <= 500


def test_the_cloud_of_a_sub_map_is_bounded_and_where_the_landmarks_are() -> None:
    base = samples.update()
    camera = Perspective(500, 500, 320, 240, 640, 480)
    rng = np.random.default_rng(0)
    points = rng.uniform([-5, -3, 4], [5, 3, 60], (5000, 3))
    n = len(points)
    uv = points[:, :2] / points[:, 2:] * 500 + [320, 240]
    marks = Landmarks(points, np.arange(n), np.zeros(n, np.int64), uv.astype(np.float32))
    T = np.tile(np.eye(4), (5, 1, 1))
    submap = dataclasses.replace(
        base.submap, T_s_c=T, T_s_c_raw=T, T_w_s=np.eye(4), scale=2.0, cameras=(camera,) * 5
    )
    prediction = dataclasses.replace(base.prediction, landmarks=marks)
    update = dataclasses.replace(base, submap=submap, prediction=prediction)
    p_w = display.landmarks(update)
    assert 1000 < len(p_w) <= display.CLOUD_POINTS
    np.testing.assert_allclose(p_w[0], 2 * points[0], atol=1e-4)
    shown = Display(LEVEL)
    (cloud,) = (m for m in shown.update(update) if m.topic == schema.CLOUD)
    sent = PointCloud.FromString(cloud.data)
    first = np.frombuffer(sent.data[:12], "<f4")
    np.testing.assert_allclose(first, [p_w[0, 2], -p_w[0, 0], -p_w[0, 1]], rtol=1e-6)
    assert sent.frame_id == "map" and len(sent.data) == sent.point_stride * len(p_w)
    # the same second, and a later update without landmarks: none
    assert schema.CLOUD not in [m.topic for m in shown.update(update)]
    bare = dataclasses.replace(base.prediction, landmarks=None)
    assert schema.CLOUD not in [
        m.topic for m in Display(LEVEL).update(dataclasses.replace(base, prediction=bare))
    ]


def test_the_cameras_of_a_sub_map_are_published_with_their_lenses() -> None:
    update = samples.update()
    lenses = {
        Eye.PRIMARY: (Perspective(500, 510, 320, 240, 640, 480, (-0.3, 0.1)), "plumb_bob"),
        Eye.ASSISTANT: (Fisheye(300, 310, 322, 238, 640, 480, (0.01, -0.02)), "kannala_brandt"),
    }
    cameras = tuple(lenses[Eye(view >= 3)][0] for view in range(5))
    sigma = np.array([0.03, 0.04])
    submap = dataclasses.replace(update.submap, cameras=cameras, focal_log_sigma=sigma)
    messages = Display(LEVEL).update(dataclasses.replace(update, submap=submap))[:2]
    assert [m.topic for m in messages] == ["/primary/calibration", "/assistant/calibration"]
    for message, (eye, (camera, model)) in zip(messages, lenses.items(), strict=True):
        found = CameraCalibration.FromString(message.data)
        assert (found.frame_id, found.distortion_model) == (eye.name.lower(), model)
        assert (found.width, found.height) == (640, 480)
        assert list(found.D[: len(camera.distortion)]) == list(camera.distortion)
        assert list(found.K) == camera.matrix.ravel().tolist()
        assert len(found.D) == {"plumb_bob": 5, "kannala_brandt": 4}[model]


def test_the_kit_is_json_numbers_named_in_its_schema() -> None:
    # the sigma of the assistant is infinite, which JSON does not have
    (message,) = (m for m in Display(LEVEL).update(samples.update()) if m.topic == schema.KIT)
    sent = json.loads(message.data, parse_constant=lambda text: pytest.fail(text))
    assert set(sent) == set(json_schemas.KIT["properties"])
    assert set(sent["primary"]) == set(json_schemas.KIT["properties"]["primary"]["properties"])
    primary, assistant = sent["primary"], sent["assistant"]
    assert primary["focal_low_px"] < primary["focal_px"] < primary["focal_high_px"]
    assert assistant["focal_sigma_percent"] is assistant["focal_high_px"] is None


def test_the_line_of_the_path_has_points_at_equal_distances() -> None:
    corner = np.array([[0.0, 0, 0], [3, 0, 0], [3, 1, 0]])
    p = display.line(corner)
    np.testing.assert_allclose(np.linalg.norm(np.diff(p[:10], axis=0), axis=1), display.LINE_STEP)
    np.testing.assert_allclose(p[[0, 15, -1]], corner, atol=1e-12)
    assert len(display.line(1e4 * corner)) == display.LINE_POINTS
    assert np.isfinite(display.line(corner[:1])).all()


def test_the_line_is_published_with_the_path_in_one_colour() -> None:
    sent = {m.topic: m for m in Display(LEVEL).update(samples.update())}
    cloud = PointCloud.FromString(sent[schema.LINE].data)
    path = PosesInFrame.FromString(sent[schema.PATH].data)
    points = np.frombuffer(cloud.data, [("xyz", "<f4", 3), ("rgba", "u1", 4)])
    ends = [[q.position.x, q.position.y, q.position.z] for q in (path.poses[0], path.poses[-1])]
    np.testing.assert_allclose(points["xyz"][[0, -1]], ends, atol=1e-5)
    assert (points["rgba"] == [*display.LINE_RGB, 255]).all()
    names = [(f.name, f.offset) for f in cloud.fields]
    assert names[3:] == [("red", 12), ("green", 13), ("blue", 14), ("alpha", 15)]
