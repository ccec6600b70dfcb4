"""The estimator is killed: recording goes on, it is restarted, and map computes what was lost."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from calm_edge.cli import main
from calm_edge.daemon.hub import Hub
from calm_edge.recording.reader import Recording
from device.frame import Eye
from tests.replay.daemon_run import record
from tests.replay.small_drive import write_drive

N = 40


class Killer:
    """Kills the estimator once, when it has solved `after` windows."""

    def __init__(self, after: int) -> None:
        self.after = after
        self.killed = 0
        self.first_to_go = 0

    def __call__(self, hub: Hub, _: str) -> None:
        if not self.killed and hub.result.submaps >= self.after:
            self.killed = hub.estimator.child.pid
            adjusted = Path(f"/proc/{self.killed}/oom_score_adj")
            self.first_to_go = int(adjusted.read_text(encoding="ascii"))
            # as if it died while solving a window
            os.kill(self.killed, signal.SIGKILL)


def test_a_killed_estimator_loses_no_frame_and_map_computes_the_rest(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drive", N)
    killer = Killer(after=1)
    out = tmp_path / "rec"
    result, lines = record(drive, out, lockstep=False, during=killer)
    assert killer.killed and result.estimator_restarts == 1
    own = int(Path("/proc/self/oom_score_adj").read_text(encoding="ascii"))
    assert killer.first_to_go == 500 > own
    assert any("estimator died" in line and "recording continues" in line for line in lines)
    assert result.frames == [N, N] and result.unrecorded == 0
    assert any("incomplete; run calm-edge map" in line for line in result.losses())
    recording = Recording(out)
    assert not recording.losses
    assert [recording.count(f"/{e.name.lower()}/image") for e in Eye] == [N, N]
    assert result.windows == len(list(recording.windows())) > 2
    assert main(["map", str(out), "--out", str(tmp_path / "map")]) == 0
    rows = (tmp_path / "map" / "trajectory.tum").read_text().splitlines()
    assert len(rows) == result.keyframes


def test_an_estimator_that_always_dies_is_not_restarted_and_recording_goes_on(
    tmp_path: Path,
) -> None:
    drive = write_drive(tmp_path / "drive", N)

    def kill_each(hub: Hub, _: str) -> None:
        if hub.result.frames[0] > 2 and hub.estimator.child.alive:
            os.kill(hub.estimator.child.pid, signal.SIGKILL)

    out = tmp_path / "rec"
    result, lines = record(drive, out, lockstep=False, during=kill_each)
    assert result.frames == [N, N] and result.submaps == 0
    assert any("not restarted" in line for line in lines)
    assert result.losses()
    recording = Recording(out)
    assert recording.count("/primary/image") == N and not recording.losses
