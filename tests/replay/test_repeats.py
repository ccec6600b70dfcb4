"""Drives whose cameras repeat pictures: no pose and no keyframe of a repeat."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from calm_edge.recording.reader import Recording
from device.frame import Eye
from tests.replay.daemon_run import config_for, record


@pytest.fixture
def repeating(small_drive: Path, tmp_path: Path) -> Path:
    """Every sixth picture of both cameras is the one before."""
    folder = tmp_path / "sequence"
    shutil.copytree(small_drive, folder)
    for images in (folder / "cam0", folder / "cam1"):
        files = sorted(images.iterdir())
        for i in range(5, len(files), 6):
            shutil.copyfile(small_drive / images.name / files[i - 1].name, files[i])
    return folder


def test_repeats_get_no_pose_and_are_no_keyframes(repeating: Path, tmp_path: Path) -> None:
    config = config_for(repeating)
    result, lines = record(repeating, tmp_path / "rec", lockstep=True, config=config)
    assert result.repeated == [6, 6] and result.frames == [40, 40]
    assert [line.partition(":")[0] for line in lines if "repeats pictures" in line] == [
        "primary camera",
        "assistant camera",
    ]
    recording = Recording(tmp_path / "rec")
    first_ns = int(recording.frame_times(Eye.PRIMARY)[0])
    repeated = {first_ns + i * 100_000_000 for i in range(5, 40, 6)}
    poses = list(recording.poses())
    assert len(poses) == 34 and not repeated & {pose.t_ns for pose in poses}
    assert result.trajectory is not None and not repeated & set(result.trajectory.t_ns.tolist())
