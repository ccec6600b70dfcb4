"""The real daemon on a small drive: deterministic in lockstep, complete in real time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from calm_edge.daemon.result import RecordResult
from calm_edge.recording.reader import Recording
from calm_edge.trajectories import tum_text
from calm_edge.types import PoseStatus
from device.frame import Eye
from tests.replay.daemon_run import config_for, record
from tests.replay.small_drive import poses

N = 40


@pytest.fixture(scope="module")
def lockstep(
    small_drive: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, RecordResult]:
    out = tmp_path_factory.mktemp("lockstep") / "rec"
    return out, record(small_drive, out, lockstep=True)[0]


def text_of(result: RecordResult) -> str:
    assert result.trajectory is not None
    return tum_text(result.trajectory.t_ns, result.trajectory.T_w_c)


def test_lockstep_places_every_keyframe_at_its_stamp(
    lockstep: tuple[Path, RecordResult],
) -> None:
    _, result = lockstep
    assert result.trajectory is not None and not result.losses()
    assert len(result.trajectory.t_ns) == result.keyframes > 8
    frame = (result.trajectory.t_ns - 1_000_000_000) // 100_000_000
    np.testing.assert_array_equal(result.trajectory.t_ns, 1_000_000_000 + frame * 100_000_000)
    np.testing.assert_allclose(result.trajectory.T_w_c, poses(N)[frame], atol=1e-3)


def test_lockstep_is_reproducible_to_the_byte(
    lockstep: tuple[Path, RecordResult], small_drive: Path, tmp_path: Path
) -> None:
    _, first = lockstep
    second, _ = record(small_drive, tmp_path / "rec", lockstep=True)
    assert text_of(first) == text_of(second)


def test_the_recording_holds_every_frame_unchanged_and_the_final_trajectory(
    lockstep: tuple[Path, RecordResult], small_drive: Path
) -> None:
    out, result = lockstep
    recording = Recording(out)
    assert not recording.losses
    for eye in Eye:
        files = sorted((small_drive / f"cam{int(eye)}").iterdir())
        frames = list(recording.frames(eye))
        assert [f.image for f in frames] == [p.read_bytes() for p in files]
    *_, last = recording.updates()
    assert result.trajectory is not None
    np.testing.assert_array_equal(last.trajectory.T_w_c, result.trajectory.T_w_c)
    assert len(list(recording.windows())) == result.windows == result.submaps


def test_live_poses_follow_the_drive(lockstep: tuple[Path, RecordResult]) -> None:
    out, _ = lockstep
    samples = list(Recording(out).poses())
    assert len(samples) == N
    live = [s for s in samples if s.status is PoseStatus.LIVE]
    assert len(live) >= 3
    truth = poses(N)[[(s.t_ns - 1_000_000_000) // 100_000_000 for s in live]]
    assert all(s.t_ns % 100_000_000 == 0 for s in live)
    assert np.isfinite(np.stack([s.T_w_c for s in live])).all() and len(truth) == len(live)


def test_replaying_a_recording_gives_the_same_trajectory(
    lockstep: tuple[Path, RecordResult], small_drive: Path, tmp_path: Path
) -> None:
    from calm_edge.cli import main

    out, result = lockstep
    arguments = ["record", "--replay", str(out), "--out", str(tmp_path / "again")]
    arguments += ["--pace", "lockstep", "--set", f"backbone.name=scripted:{small_drive}"]
    arguments += ["--set", "frontend.n_max=6", "--set", "frontend.n_overlap=2"]
    assert main([*arguments, "--spacing-m", "0.5"]) == 0
    assert (tmp_path / "again" / "record_trajectory.tum").read_text() == text_of(result)


def test_real_time_records_every_frame_and_reports_every_second(
    small_drive: Path, tmp_path: Path
) -> None:
    out = tmp_path / "rec"
    texts: list[str] = []
    result, _ = record(small_drive, out, lockstep=False, during=lambda _, text: texts.append(text))
    assert result.frames == [N, N] and result.unrecorded == 0
    assert result.trajectory is not None
    recording = Recording(out)
    assert [recording.count(f"/{e.name.lower()}/image") for e in Eye] == [N, N]

    seconds = list(recording.json_messages("/health"))
    assert len(seconds) >= 3
    assert seconds[0]["state"] in ("STARTING", "RUNNING")
    assert sum(second["tick"]["ticks"] for second in seconds) > 100
    assert all(0 <= s["tick"]["p50_ms"] <= s["tick"]["max_ms"] for s in seconds)
    assert seconds[-1]["counts"]["primary_frames"] >= N // 2
    assert {"images_not_recorded", "not_tracked", "windows_left_to_map"} <= set(seconds[0]["drops"])
    assert {"estimator_windows", "recording_fill"} <= set(seconds[0]["queues"])
    assert "loop_frames" in seconds[0]["stage_ms"] and seconds[-1]["disk"]["free_bytes"] > 0
    lines = [text for text in texts if text != "watchdog"]
    assert lines[0] == "STARTING" and lines[-1] == "STOPPING"
    assert any("frames, none lost" in line for line in lines[1:-1])


def test_capture_imports_no_solver() -> None:
    code = (
        "import sys, calm_edge.daemon.capture, calm_edge.daemon.hub, "
        "calm_edge.daemon.run\n"
        "print([m for m in ('gtsam', 'calm_edge.estimator.localizer', "
        "'calm_edge.posegraph.joint_graph', 'calm_edge.frontend.tracker', "
        "'onnxruntime') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_an_invalid_configuration_leaves_no_recording(small_drive: Path, tmp_path: Path) -> None:
    from calm_edge.types import CalmEdgeError

    config = config_for(small_drive, n_overlap=9)
    with pytest.raises(CalmEdgeError, match="n_overlap"):
        record(small_drive, tmp_path / "rec", lockstep=True, config=config)
    assert not (tmp_path / "rec").exists()
