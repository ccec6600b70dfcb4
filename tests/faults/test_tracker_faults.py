"""The tracker is killed: recording goes on, it comes back, and so do windows and poses."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from calm_edge.cli import main
from calm_edge.daemon.hub import Hub
from calm_edge.recording.reader import Recording
from calm_edge.types import PoseStatus
from device.frame import Eye
from tests.replay.daemon_run import record
from tests.replay.small_drive import write_drive

N = 70


def test_a_killed_tracker_is_restarted_and_no_frame_is_lost(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drive", N)
    killed: list[int] = []

    def kill_once(hub: Hub, _: str) -> None:
        if not killed and hub.result.poses >= 3 and hub.result.submaps:
            killed.append(hub.tracker.child.pid)
            os.kill(killed[0], signal.SIGKILL)

    out = tmp_path / "rec"
    result, lines = record(drive, out, lockstep=False, during=kill_once)
    assert killed and result.tracker_restarts == 1
    assert any("tracker died" in line and "restarted" in line for line in lines)
    assert any("tracker was restarted" in line for line in result.losses())
    assert result.frames == [N, N] and result.unrecorded == 0
    recording = Recording(out)
    assert [recording.count(f"/{e.name.lower()}/image") for e in Eye] == [N, N]

    windows = list(recording.windows())
    assert [w.submap_id for w in windows] == list(range(len(windows))) and len(windows) > 2
    # ids start anew: only the first window of each tracker has no overlap
    assert [w.n_overlap == 0 for w in windows].count(True) == 2
    epochs = [s.epoch for s in recording.poses() if s.status is not PoseStatus.LOST]
    assert epochs == sorted(epochs) and set(epochs) == {0, 1}
    assert result.trajectory is not None and len(result.trajectory.t_ns) == result.keyframes
    assert main(["map", str(out), "--out", str(tmp_path / "map")]) in (0, 3)
    rows = (tmp_path / "map" / "trajectory.tum").read_text().splitlines()
    assert len(rows) == result.keyframes


def test_a_tracker_that_always_dies_is_not_restarted_and_recording_goes_on(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drive", 30)

    def kill_each(hub: Hub, _: str) -> None:
        if hub.result.frames[0] > 2 and hub.tracker.child.alive:
            os.kill(hub.tracker.child.pid, signal.SIGKILL)

    out = tmp_path / "rec"
    result, lines = record(drive, out, lockstep=False, during=kill_each)
    assert any("tracker died" in line and "not restarted" in line for line in lines)
    assert result.frames == [30, 30] and result.unrecorded == 0 and result.untracked > 0
    assert result.losses()
    assert Recording(out).count("/primary/image") == 30
