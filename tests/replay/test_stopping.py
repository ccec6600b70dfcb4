"""A run that is stopped twice leaves the rest to `map`, and keeps the poses."""

from __future__ import annotations

import itertools
import os
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path
from unittest.mock import patch

import pytest

from calm_edge.cli import main
from calm_edge.config import Config
from calm_edge.daemon import estimator_link
from calm_edge.daemon.estimator_process import EstimatorWork, run
from calm_edge.daemon.messages import Processed
from calm_edge.recording.reader import Recording
from calm_edge.recording.recovery import Outcome, validate
from calm_edge.types import SubmapWindow
from device import service
from device.service import NullNotifier

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


def test_a_second_stop_leaves_windows_to_map_and_keeps_the_poses(
    small_drive: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Impatient(NullNotifier):
        """Sends two signals to the process when it begins to finish."""

        def stopping(self) -> None:
            for number in (signal.SIGINT, signal.SIGTERM):
                os.kill(os.getpid(), number)

    monkeypatch.setattr(service, "open_notifier", Impatient)
    monkeypatch.setattr(estimator_link, "run_estimator", run_stuck)
    rec, started_s = tmp_path / "rec", time.monotonic()
    arguments = ["record", "--sequence", str(small_drive), "--out", str(rec), "--spacing-m", "0.5"]
    arguments += ["--set", f"backbone.name=scripted:{small_drive}", "--set", "frontend.n_max=6"]
    before = signal.getsignal(signal.SIGINT)
    assert main([*arguments, "--set", "frontend.n_overlap=2"]) == 3
    assert time.monotonic() - started_s < 40
    assert signal.getsignal(signal.SIGINT) == before
    printed = capsys.readouterr()
    assert "were not solved; run calm-edge map" in printed.err
    assert "stopped before all poses were optimised" in printed.err
    poses = (rec / "record_trajectory.tum").read_text().splitlines()
    assert len(poses) >= 6 and f"{len(poses)} keyframes placed" in printed.out
    assert validate(rec).outcome is Outcome.ALL
    *_, status = (s for s in Recording(rec).json_messages("/status") if "finished" in s)
    assert not status["finished"] and status["lost_windows"]
