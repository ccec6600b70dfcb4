"""Drives whose metre is unknown, or becomes known: messages, sentence and exit code."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as peer

from calm_edge.cli import main
from calm_edge.commands.record import report
from calm_edge.config import merge
from calm_edge.daemon.outputs import configured
from calm_edge.recording import schema
from calm_edge.recording.reader import Recording
from calm_edge.types import PoseStatus
from tests.replay.daemon_run import config_for, record
from tests.replay.small_drive import poses, write_drive
from tests.replay.test_pose_line import Listener, odometry_of, timed_source

N = 60
# The cameras are farther apart than the car drives: no length is known.
STANDING_M = 20.0
# The car has driven this far only after some windows.
PULLING_AWAY_M = 3.0
SENTENCE = "calm-edge: no metre: the car stood still; lengths have an unknown scale"


@dataclass
class Run:
    """A recorded drive. code: exit code of `record`. out, last: its stdout and last error line."""

    folder: Path
    drive: Path
    code: int
    out: str
    last: str
    messages: list[Any]

    @property
    def recording(self) -> Recording:
        return Recording(self.folder)

    def summary(self) -> dict[str, Any]:
        return [s for s in self.recording.json_messages(schema.STATUS) if "finished" in s][-1]

    def sent(self, kind: str) -> list[Any]:
        return [m for m in self.messages if m.get_type() == kind]


def run(
    place: Path, capsys: pytest.CaptureFixture[str], spacing_m: float, given: bool = True
) -> Run:
    """Record a drive with the cameras spacing_m apart; given: `scale.spacing_m` is set."""
    drive = write_drive(place / "drive", N, spacing_m)
    listener = Listener()
    options = {
        "pose_output": {"port": listener.port},
        "scale": {"spacing_m": spacing_m if given else 0.0},
    }
    config = merge(config_for(drive), options)
    source = timed_source(drive)
    result, _ = record(
        drive,
        place / "rec",
        lockstep=True,
        config=config,
        source=source,
        outputs=configured(config, source.clock.now_ns),
    )
    listener.close()
    code = report(place / "rec", result)
    printed = capsys.readouterr()
    last = printed.err.splitlines()[-1] if printed.err else ""
    return Run(place / "rec", drive, code, printed.out, last, listener.messages)


def test_without_a_metre_no_pose_is_sent_and_the_last_line_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = run(tmp_path, capsys, STANDING_M)
    assert made.code == 3 and made.last == SENTENCE
    assert odometry_of(made.messages) == []
    beats = [m.system_status for m in made.sent("HEARTBEAT")]
    assert len(beats) >= N // 10 and beats[0] == peer.MAV_STATE_BOOT
    assert peer.MAV_STATE_CRITICAL in beats and peer.MAV_STATE_ACTIVE not in beats
    statuses = {s.status for s in made.recording.poses()}
    assert statuses == {PoseStatus.LOST, PoseStatus.UNSCALED}
    assert made.summary()["metre"] == {"sigma_percent": None, "reason": "the car stood still"}
    assert made.summary()["poses"] == 0 < made.summary()["unscaled_poses"]

    assert main(["map", str(made.folder), "--out", str(tmp_path / "map")]) == 3
    assert capsys.readouterr().err.splitlines()[-1] == SENTENCE
    summary = json.loads((tmp_path / "map" / "summary.json").read_text())
    assert summary["metre"] == {"sigma_percent": None, "reason": "the car stood still"}
    for target in (made.folder, tmp_path / "map"):
        assert main(["eval", str(target), "--truth", str(made.drive), "--json"]) == 3
        printed = capsys.readouterr()
        figures = json.loads(printed.out)
        assert figures["metre"]["reason"] == "the car stood still" and figures["align"] == "sim3"
        assert printed.err.splitlines()[-1] == SENTENCE


def test_a_parked_car_has_no_metre(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = write_drive(tmp_path / "drive", 12)
    for eye in (0, 1):
        first, *others = sorted((drive / f"cam{eye}").iterdir())
        for picture in others:
            picture.write_bytes(first.read_bytes())
    result, _ = record(drive, tmp_path / "rec", lockstep=True)
    # all there is was recorded
    assert result.windows == 0 and report(tmp_path / "rec", result) == 0
    sentence = "the pictures do not move (median flow 0.00 px): the car stood still"
    assert f"no metre: {sentence}" in capsys.readouterr().err.splitlines()[-1]
    assert main(["map", str(tmp_path / "rec"), "--out", str(tmp_path / "map")]) == 3
    assert f"nothing to map ({sentence})" in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "map").exists()
    assert main(["eval", str(tmp_path / "rec"), "--truth", str(drive)]) == 3
    assert sentence in capsys.readouterr().err.splitlines()[-1]


def test_a_spacing_that_was_not_given_is_no_loss(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = run(tmp_path, capsys, STANDING_M, given=False)
    assert made.code == 0 and "no metre" not in made.last
    assert "lengths     in camera spacings" in made.out
    assert odometry_of(made.messages) == [] and made.sent("HEARTBEAT")
    texts = [m.text for m in made.sent("STATUSTEXT")]
    assert texts and all("set scale.spacing_m" in text for text in texts)
    assert main(["map", str(made.folder), "--out", str(tmp_path / "map")]) == 0
    assert main(["eval", str(made.folder), "--truth", str(made.drive)]) == 0


def test_poses_are_sent_from_the_first_metric_submap_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = run(tmp_path, capsys, PULLING_AWAY_M)
    assert made.code == 0 and "lengths     in metres, sigma" in made.out
    samples = [s for s in made.recording.poses() if s.status is not PoseStatus.LOST]
    statuses = [s.status for s in samples]
    first = statuses.index(PoseStatus.LIVE)
    assert first > 3
    assert statuses == [PoseStatus.UNSCALED] * first + [PoseStatus.LIVE] * (len(samples) - first)
    sent = [m.time_usec for m in odometry_of(made.messages)]
    assert sent == [s.t_ns // 1000 for s in samples[first:] if np.isfinite(s.velocity_c).all()]
    assert len(sent) > 5
    beats = [m.system_status for m in made.sent("HEARTBEAT")]
    assert peer.MAV_STATE_CRITICAL in beats[: beats.index(peer.MAV_STATE_ACTIVE)]
    # in the end the whole drive is metric, its first sub-maps as well
    *_, last = made.recording.updates()
    t_ns, T_w_c = last.trajectory.t_ns, last.trajectory.T_w_c
    truth = poses(N)[(t_ns - 1_000_000_000) // 100_000_000]
    np.testing.assert_allclose(T_w_c, truth, atol=1e-3)
