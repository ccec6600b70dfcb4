"""A child process that hangs is killed and restarted while recording goes on."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from calm_edge.daemon import estimator_link, tracker_link
from calm_edge.daemon.hub import Hub
from tests.replay.daemon_run import record
from tests.replay.small_drive import write_drive


def test_a_hung_tracker_is_killed_and_restarted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tracker_link, "HUNG_S", 1.0)
    drive = write_drive(tmp_path / "drive", 40)
    hung: list[int] = []

    def hang_once(hub: Hub, _: str) -> None:
        if not hung and hub.result.frames[0] > 5:
            hung.append(hub.tracker.child.pid)
            os.kill(hung[0], signal.SIGSTOP)

    result, lines = record(drive, tmp_path / "rec", lockstep=False, during=hang_once)
    assert hung and result.tracker_restarts == 1
    assert any("has not answered for 1 s" in line for line in lines)
    assert result.frames == [40, 40] and result.unrecorded == 0


def test_a_hung_estimator_is_killed_and_restarted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # long enough for a window on a busy computer
    monkeypatch.setattr(estimator_link, "HUNG_S", 3.0)
    drive = write_drive(tmp_path / "drive", 40)
    hung: list[int] = []

    def hang_once(hub: Hub, _: str) -> None:
        if not hung and hub.result.frames[0] > 5:
            hung.append(hub.estimator.child.pid)
            os.kill(hung[0], signal.SIGSTOP)

    result, lines = record(drive, tmp_path / "rec", lockstep=False, during=hang_once)
    assert hung and result.estimator_restarts == 1
    assert any("has not answered for 3 s" in line for line in lines)
    assert result.frames == [40, 40] and len(result.lost_windows) == 1
