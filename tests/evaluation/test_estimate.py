"""Estimates loaded from recordings and map folders."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calm_edge.config import Config, merge
from calm_edge.evaluation.estimate import from_recording, read_estimate
from calm_edge.mapping.cloud_file import CloudWriter
from calm_edge.recording import RecordingError
from calm_edge.recording.writer import RecordingWriter
from calm_edge.trajectories import TrajectoryError
from calm_edge.types import MapTile, PoseSample, PoseStatus
from device.frame import Eye, Frame
from tests.evaluation.worlds import curve, stamps, update


def _record(folder: Path, status: bool) -> Path:
    picture = bytes(cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes())
    T, t = curve(30), stamps(30)
    config = merge(Config(), {"scale": {"spacing_m": 0.5}})
    with RecordingWriter(folder, config, lossless=True) as writer:
        for i in range(30):
            # the first two frames of the camera were lost
            writer.write_frame(Frame(Eye.PRIMARY, i + 2, int(t[i]), picture))
            writer.write_frame(Frame(Eye.ASSISTANT, i, int(t[i]), picture))
        sample = PoseSample(int(t[3]), T[3], np.zeros(3), np.eye(6), 0, PoseStatus.LIVE)
        writer.write_pose(sample)
        writer.write_update(update(T[:20:2], t[:20:2], submap_id=0, stage_ms={"infer": 10.0}))
        writer.write_update(update(T[::2], t[::2], submap_id=1, stage_ms={"infer": 30.0}))
        if status:
            writer.write_status({"pose_age_ms": None})
            writer.write_status({"pose_age_ms": {"p50": 18.0, "p99": 44.0}})
    return folder


def test_everything_eval_needs_comes_from_the_recording(tmp_path: Path) -> None:
    estimate = read_estimate(_record(tmp_path / "rec", status=True))
    assert (estimate.frames, estimate.keyframes, estimate.submaps) == (30, 15, 2)
    assert estimate.spacing_m == 0.5
    assert np.array_equal(estimate.T_w_c, curve(30)[::2])
    assert estimate.first_frame == (2, int(stamps(30)[0]))
    assert estimate.stage_ms == {"infer": 20.0}
    assert estimate.focal_px == (500.0, 600.0)
    assert estimate.pose_age_ms == {"p50": 18.0, "p99": 44.0}


def test_lockstep_stamps_give_no_age_and_one_segment_reads_alone(tmp_path: Path) -> None:
    _record(tmp_path / "rec", status=False)
    (segment,) = (tmp_path / "rec").glob("*.mcap")
    assert read_estimate(segment).pose_age_ms is None


def test_a_missing_recording_is_an_error_of_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="holds no recording"):
        from_recording(tmp_path)
    (tmp_path / "a.tum").write_text("hello\n")
    with pytest.raises(TrajectoryError, match="TUM rows have 8"):
        read_estimate(tmp_path / "a.tum")


def test_a_map_folder_includes_its_points(tmp_path: Path) -> None:
    (tmp_path / "trajectory.tum").write_text("1 0 0 0 0 0 0 1\n")
    (tmp_path / "summary.json").write_text('{"spacing_m": null, "first_frame": [2, 77]}')
    points = np.float32([[1, 2, 3], [4, 5, 6]])
    with CloudWriter(tmp_path / "map.ply") as cloud:
        cloud.write(MapTile(points, np.zeros((2, 3), np.uint8)))
    estimate = read_estimate(tmp_path)
    assert estimate.points_w is not None and np.array_equal(estimate.points_w, points)
    assert estimate.spacing_m is None and estimate.first_frame == (2, 77)
    assert estimate.focal_px is None and estimate.stage_ms == {}
