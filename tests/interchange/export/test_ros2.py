"""Exported ROS 2 bags, read by rosbags and by our importer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.interchange.base import ImportOptions
from calm_edge.interchange.export.base import ExportOptions
from calm_edge.interchange.export.drive import read_drive
from calm_edge.interchange.export.level import level
from calm_edge.interchange.export.ros2 import Ros2
from calm_edge.interchange.registry import importer
from calm_edge.interchange.ros_bag import RosBag
from calm_edge.mapping.cloud_file import CloudWriter
from calm_edge.types import Float, MapTile
from device.frame import Eye
from tests.interchange.export.drives import (
    FRAMES,
    LENSES,
    MARKERS,
    ORIGIN_NS,
    T_P_A,
    live_poses,
    true_poses,
    true_times,
    with_map,
    write_recording,
)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ros")
    made = with_map(write_recording(folder / "rec", live=live_poses(1.1, exact=True)), folder / "m")
    with CloudWriter(made / "map.ply") as cloud:
        cloud.write(MapTile(MARKERS.astype(np.float32), np.full((4, 3), [9, 8, 7], np.uint8)))
    (folder / "out").mkdir()
    Ros2().write(read_drive(made), folder / "out", ExportOptions())
    return folder / "out" / "bag"


def read(bag: Path, *topics: str) -> list[Any]:
    return [message for _, _, message in RosBag((bag,)).messages(topics)]


def matrix(transform: Any) -> Float:
    t, q = transform.translation, transform.rotation
    return se3.compose(se3.rotations(np.array([q.x, q.y, q.z, q.w])), np.array([t.x, t.y, t.z]))


def test_our_importer_reads_its_pictures_with_their_stamps(bag: Path, tmp_path: Path) -> None:
    options = ImportOptions(
        topics=("/primary/image_raw/compressed", "/assistant/image_raw/compressed")
    )
    imported = importer((bag,)).open((bag,), options, tmp_path, lambda text: None)
    stored = read_drive(bag.parents[1] / "rec").recording
    for eye in Eye:
        frames = list(imported.frames(eye))
        assert [f.t_ns for f in frames] == true_times().tolist()
        assert [f.image for f in frames] == [f.image for f in stored.frames(eye)]
    assert imported.calibration is not None
    cameras = [each.camera for each in imported.calibration.cameras]
    assert [c.fx for c in cameras] == [lens.fx for lens in LENSES]
    assert cameras[0].distortion[:2] == LENSES[0].distortion


def test_transforms_lead_from_the_levelled_map_to_both_cameras(bag: Path) -> None:
    tree = {
        (t.header.frame_id, t.child_frame_id): matrix(t.transform)
        # one message: a later one would replace it for nodes that subscribe late
        for t in read(bag, "/tf_static")[0].transforms
    }
    assert set(tree) == {("base_link", "primary"), ("primary", "assistant")}
    assert tree["primary", "assistant"] == pytest.approx(T_P_A, abs=1e-9)
    made = [t for message in read(bag, "/tf") for t in message.transforms]
    assert len(made) == FRAMES
    drive = read_drive(bag.parents[1] / "m")
    R = level(drive.keyframes.T_w_c, 0.5).R_l_w
    for each, T_w_p in zip(made, true_poses(), strict=True):
        assert (each.header.frame_id, each.child_frame_id) == ("map", "base_link")
        T_map_p = matrix(each.transform) @ tree["base_link", "primary"]
        # the map of the fixture is 1.1 times the drive
        assert T_map_p[:3, 3] == pytest.approx(1.1 * R @ T_w_p[:3, 3], abs=0.05)
        assert T_map_p[:3, :3] == pytest.approx(R @ T_w_p[:3, :3], abs=1e-3)
        # base_link: x ahead, z up
        assert matrix(each.transform)[2, 2] > 0.9


def test_odometry_path_and_cloud(bag: Path) -> None:
    moving = read(bag, "/odometry")
    assert len(moving) == FRAMES - 2
    # about a metre a frame, ten frames a second, 1.1 times
    assert all(8 < each.twist.twist.linear.x < 14 for each in moving)
    assert all(abs(each.twist.twist.linear.y) < 2 for each in moving)
    (path,) = read(bag, "/path")
    stamps = [p.header.stamp.sec * 10**9 + p.header.stamp.nanosec for p in path.poses]
    assert stamps == (true_times() - ORIGIN_NS).tolist()
    (cloud,) = read(bag, "/cloud")
    points = np.frombuffer(cloud.data.tobytes(), np.dtype([("p", "<f4", 3), ("rgb", "<u4")]))
    R = level(read_drive(bag.parents[1] / "m").keyframes.T_w_c, 0.5).R_l_w
    assert points["p"] @ R == pytest.approx(MARKERS, abs=1e-4)
    assert points["rgb"].tolist() == [0x090807] * 4 and cloud.header.frame_id == "map"
