"""A run that is stopped twice leaves the rest to `map`, and keeps the poses."""

from __future__ import annotations

import itertools
import os
import signal
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path
from unittest.mock import patch

import pytest

from calm_edge.cli import main
from calm_edge.config import Config
from calm_edge.daemon import estimator_link
from calm_edge.daemon.estimator_process import EstimatorWork, run
from calm_edge.daemon.hub import Hub
from calm_edge.daemon.messages import Processed
from calm_edge.recording.reader import Recording
from calm_edge.recording.recovery import Outcome, validate
from calm_edge.types import LocalizerUpdate, SubmapWindow

SOLVED = 2


def run_stuck(connection: Connection, config: Config, lockstep: bool) -> None:
    """Main function of an estimator that solves some windows, and then none."""
    number, solve = itertools.count(), EstimatorWork._process

    def process(work: EstimatorWork, window: SubmapWindow) -> Processed:
        if next(number) >= SOLVED:
            time.sleep(60)
        return solve(work, window)

    with patch.object(EstimatorWork, "_process", process):
        run(connection, config, lockstep)


def stop_twice() -> None:
    """Send two signals to this process, as a user who is in a hurry."""
    for number in (signal.SIGINT, signal.SIGTERM):
        os.kill(os.getpid(), number)
        time.sleep(0.2)


def test_a_second_stop_leaves_windows_to_map_and_keeps_the_poses(
    small_drive: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given, give = list[LocalizerUpdate](), Hub.give_update

    def counted(hub: Hub, update: LocalizerUpdate) -> None:
        give(hub, update)
        given.append(update)
        if len(given) == SOLVED:
            # a while later, when the next window is waited for
            threading.Timer(1.0, stop_twice).start()

    monkeypatch.setattr(Hub, "give_update", counted)
    monkeypatch.setattr(estimator_link, "run_estimator", run_stuck)
    rec, before = tmp_path / "rec", signal.getsignal(signal.SIGINT)
    arguments = ["record", "--sequence", str(small_drive), "--out", str(rec), "--pace", "lockstep"]
    arguments += ["--set", f"backbone.name=scripted:{small_drive}", "--set", "frontend.n_max=6"]
    assert main([*arguments, "--set", "frontend.n_overlap=2", "--spacing-m", "0.5"]) == 3
    assert signal.getsignal(signal.SIGINT) == before
    printed = capsys.readouterr()
    assert "windows [2] were not solved; run calm-edge map" in printed.err
    assert "stopped before all poses were optimised" in printed.err
    poses = (rec / "record_trajectory.tum").read_text().splitlines()
    assert len(poses) == 10 and "10 keyframes placed" in printed.out
    assert validate(rec).outcome is Outcome.ALL
    *_, status = (s for s in Recording(rec).json_messages("/status") if "finished" in s)
    assert not status["finished"] and status["lost_windows"] == [2]
