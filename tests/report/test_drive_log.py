"""Facts of a recording, its health over time, and times without a pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calm_edge.config import Config
from calm_edge.recording.reader import Recording
from calm_edge.recording.schema import HEALTH
from calm_edge.recording.time_base import TimeBase, WallClock
from calm_edge.recording.writer import RecordingWriter
from calm_edge.report.drive_log import Lost, lost_spans, read_log
from calm_edge.types import PoseSample, PoseStatus
from device.frame import Eye, Frame, jpeg

SECOND = 1_000_000_000


def sample(seconds: float, status: PoseStatus = PoseStatus.LIVE) -> PoseSample:
    unknown = np.full((6, 6), np.nan)
    return PoseSample(round(seconds * SECOND), np.eye(4), np.zeros(3), unknown, 0, status)


def test_times_without_a_pose_end_with_the_next_pose() -> None:
    lost = PoseStatus.LOST
    at = [(0.0, lost), (2.0, lost), (3.0, PoseStatus.LIVE), (4.0, lost), (4.2, PoseStatus.UNSCALED)]
    at += [(6.0, lost), (9.0, lost)]
    poses = [sample(seconds, status) for seconds, status in at]
    # the gap of 0.2 s is none; the last one ends with the drive
    assert lost_spans(poses, SECOND, None) == (Lost(-1.0, 3.0), Lost(5.0, 3.0))
    assert lost_spans([], 0, None) == ()


def health(state: str, *reasons: str, free: int | None = None) -> dict[str, object]:
    disk = {"free_bytes": free, "bytes_per_s": 2_000_000}
    drops = {"camera_drops": 1, "corrupt": 2}
    return {
        "state": state, "reasons": reasons, "disk": disk, "drops": drops, "celsius": None,
    }  # fmt: skip


def test_a_recording_gives_its_date_health_and_reasons(tmp_path: Path) -> None:
    now = [10 * SECOND]
    epoch_ns = 1_700_000_000 * SECOND
    base = TimeBase(-epoch_ns, epoch_ns, WallClock.SYNCHRONISED)
    metadata = {"source": "cameras", "pace": "realtime"}
    writer = RecordingWriter(
        tmp_path / "rec", Config(), metadata, lossless=True, time_base=base, now_ns=lambda: now[0]
    )
    picture = jpeg(np.zeros((8, 8, 3), np.uint8))
    for second in range(10, 21):
        now[0] = second * SECOND
        for eye in Eye:
            writer.write_frame(Frame(eye, second, second * SECOND, picture))
        covered = 14 <= second < 17
        reasons = ("no pose for 1 s", "primary: disconnected") if covered else ()
        writer.write_status(
            health("degraded" if covered else "running", *reasons, free=10**9), HEALTH
        )
        status = PoseStatus.LOST if covered else PoseStatus.LIVE
        writer.write_pose(sample(second, status))
    writer.write_status({"finished": True, "camera_drops": 1, "losses": ["1 frame was left out"]})
    writer.close()
    recording = Recording(tmp_path / "rec")
    log = read_log(recording, 12 * SECOND, list(recording.poses()))
    assert log.started_s == 1_700_000_010.0 and log.duration_s == 10.0 and log.frames == (11, 11)
    assert log.lost == (Lost(2.0, 3.0, "primary: disconnected"),)
    assert log.health is not None and log.health.t_s[[0, -1]].tolist() == [-2.0, 8.0]
    assert (log.health.free_gb == 1.0).all() and (log.health.lost_frames == 3).all()
    assert np.isnan(log.health.celsius).all()
    assert log.counts["losses"] == ["1 frame was left out"]
    assert log.rows["recorded from"] == "cameras" and log.rows["pace"] == "realtime"


def test_an_unfinished_recording_without_frames_has_no_date(tmp_path: Path) -> None:
    RecordingWriter(tmp_path / "rec", Config()).close()
    log = read_log(Recording(tmp_path / "rec"), None, [])
    assert log.started_s is None and log.health is None and log.counts == {} and log.lost == ()
