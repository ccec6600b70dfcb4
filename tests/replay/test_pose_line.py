"""The poses of a run as the other end of the serial line hears them."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pymavlink.dialects.v20 import common as peer

from calm_edge.cli import main
from calm_edge.config import merge
from calm_edge.daemon.outputs import configured
from calm_edge.daemon.source import Source
from calm_edge.recording.reader import Recording
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.types import PoseStatus
from device.camera import Camera, CameraSpec, open_camera
from device.frame import Eye, Frame
from tests.manual_clock import ManualClock
from tests.replay.daemon_run import config_for, record
from tests.replay.small_drive import write_drive

N = 70
# long enough that the track is given up, and a new one begins with the next sub-map
DARK = range(28, 34)


class Listener:
    """The far end of a pty: every message that came whole."""

    def __init__(self) -> None:
        self.master, self._slave = os.openpty()
        self.port = os.ttyname(self._slave)
        self.messages: list[Any] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        link = peer.MAVLink(None)
        while True:
            try:
                data = os.read(self.master, 4096)
            except OSError:
                return
            self.messages += link.parse_buffer(data) or []

    def close(self) -> None:
        os.close(self._slave)
        self._thread.join(2.0)
        os.close(self.master)


def odometry_of(messages: list[Any]) -> list[Any]:
    return [m for m in messages if m.get_type() == "ODOMETRY"]


class FrameClock(ManualClock):
    """Shows the moment a frame was taken, and a little more, while the daemon looks at it: the line
    then hears what it would of a machine that is never late, however late this one is.
    """

    LATE_NS = 40_000_000

    def timing(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The frames; the next one is asked for before the one before it is handled."""
        before: Frame | None = None
        for frame in frames:
            if before is not None:
                self.sleep_until_ns(before.t_ns + self.LATE_NS)
            before = frame
            yield frame
        if before is not None:
            self.sleep_until_ns(before.t_ns + self.LATE_NS)


def darkened(folder: Path) -> Path:
    """A drive that is black for a while."""
    drive = write_drive(folder, N)
    images = sorted((drive / "cam0").iterdir())
    dark = np.zeros_like(cv2.imread(str(images[0])))
    for i in DARK:
        cv2.imwrite(str(images[i]), dark)
    return drive


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Any], Recording]:
    folder = tmp_path_factory.mktemp("line")
    drive = darkened(folder / "drive")
    listener = Listener()
    config = merge(config_for(drive), {"pose_output": {"port": listener.port}})
    sequence, clock = SequenceFolder(drive), FrameClock(1)

    def cameras() -> tuple[Camera, Camera]:
        primary, assistant = (
            open_camera(
                CameraSpec(eye, "replay"),
                clock,
                frames=clock.timing(sequence.frames(eye)),
                paced=False,
            )
            for eye in Eye
        )
        return primary, assistant

    source = Source(cameras, clock, True, "drive")
    serial = configured(config, clock.now_ns)
    out = folder / "rec"
    result, _ = record(drive, out, lockstep=True, config=config, source=source, outputs=serial)
    listener.close()
    assert not result.error and result.frames == [N, N] and result.output_losses == {"serial": 0}
    return listener.messages, Recording(out)


def test_every_pose_of_the_recording_leaves_once_and_in_order(
    heard: tuple[list[Any], Recording],
) -> None:
    messages, recording = heard
    odometry = odometry_of(messages)
    stamps = np.array([m.time_usec for m in odometry])
    assert (np.diff(stamps) > 0).all()
    live = [s.t_ns // 1000 for s in recording.poses() if s.status is not PoseStatus.LOST]
    assert stamps.tolist() == live
    # but for the start and the dark, one a frame
    assert N > len(live) > N - len(DARK) - 25


def test_a_pose_on_the_line_is_the_recorded_one_at_its_exposure(
    heard: tuple[list[Any], Recording],
) -> None:
    odometry, recording = odometry_of(heard[0]), heard[1]
    recorded = {s.t_ns // 1000: s for s in recording.poses() if s.status is not PoseStatus.LOST}
    assert odometry and all(m.quality > 0 for m in odometry)
    for message in odometry:
        x, y, z = recorded[message.time_usec].T_w_c[:3, 3]
        # camera x right, y down, z forward; the line speaks forward, right, down
        np.testing.assert_allclose([message.x, message.y, message.z], [z, x, y], atol=1e-4)


def test_the_reset_counter_changes_with_the_epoch_and_only_then(
    heard: tuple[list[Any], Recording],
) -> None:
    odometry, recording = odometry_of(heard[0]), heard[1]
    epochs = {s.t_ns // 1000: s.epoch for s in recording.poses()}
    seen = [(m.reset_counter, epochs[m.time_usec]) for m in odometry]
    assert {epoch for _, epoch in seen} == {0, 1}
    for (count, epoch), (next_count, next_epoch) in itertools.pairwise(seen):
        assert next_count - count == next_epoch - epoch


def test_a_run_in_real_time_tells_recorded_poses_and_the_end(tmp_path: Path) -> None:
    """How many poses there are in time depends on the machine; what they say does not."""
    drive = write_drive(tmp_path / "drive", 30)
    listener = Listener()
    settings = {
        "pose_output.port": listener.port,
        "backbone.name": f"scripted:{drive}",
        "frontend.n_max": 6,
        "frontend.n_overlap": 2,
    }
    arguments = ["record", "--sequence", str(drive), "--out", str(tmp_path / "rec")]
    for name, value in settings.items():
        arguments += ["--set", f"{name}={value}"]
    # 3: completed with loss, which a busy machine may
    assert main([*arguments, "--pace", "realtime", "--spacing-m", "0.5"]) in (0, 3)
    listener.close()
    odometry = odometry_of(listener.messages)
    recorded = {s.t_ns // 1000 for s in Recording(tmp_path / "rec").poses()}
    assert {m.time_usec for m in odometry} <= recorded
    stamps = [m.time_usec for m in odometry]
    assert stamps == sorted(set(stamps))
    beats = [m.system_status for m in listener.messages if m.get_type() == "HEARTBEAT"]
    assert beats[0] == peer.MAV_STATE_BOOT and beats[-1] == peer.MAV_STATE_POWEROFF
    texts = [m.text for m in listener.messages if m.get_type() == "STATUSTEXT"]
    assert texts[0].startswith("calm-edge starting") and "calm-edge stopping" in texts
