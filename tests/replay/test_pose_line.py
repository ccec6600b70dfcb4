"""Poses of a run as received at the other end of the serial line."""

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
# long enough that tracking is lost, and restarts with the next sub-map
DARK = range(28, 34)


class Listener:
    """The far end of a pseudo-terminal, which collects all valid messages."""

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
    """A clock that follows the frames' stamps with a constant delay.

    The messages are then those of a computer that is always fast enough, whatever the load.
    """

    LATE_NS = 40_000_000

    def timing(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Yield the frames and set the clock; each is requested before its predecessor is used."""
        before: Frame | None = None
        for frame in frames:
            if before is not None:
                self.sleep_until_ns(before.t_ns + self.LATE_NS)
            before = frame
            yield frame
        if before is not None:
            self.sleep_until_ns(before.t_ns + self.LATE_NS)


def darkened(folder: Path) -> Path:
    """A drive with black primary images for a while."""
    drive = write_drive(folder, N)
    images = sorted((drive / "cam0").iterdir())
    dark = np.zeros_like(cv2.imread(str(images[0])))
    for i in DARK:
        cv2.imwrite(str(images[i]), dark)
    return drive


def timed_source(drive: Path) -> Source:
    """A replay whose clock follows the frames."""
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

    return Source(cameras, clock, True, "drive")


@pytest.fixture(scope="module")
def received(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Any], Recording]:
    folder = tmp_path_factory.mktemp("line")
    drive = darkened(folder / "drive")
    listener = Listener()
    config = merge(config_for(drive), {"pose_output": {"port": listener.port}})
    source = timed_source(drive)
    serial = configured(config, source.clock.now_ns)
    out = folder / "rec"
    result, _ = record(drive, out, lockstep=True, config=config, source=source, outputs=serial)
    listener.close()
    assert not result.error and result.frames == [N, N] and result.output_losses == {"serial": 0}
    return listener.messages, Recording(out)


def test_every_recorded_pose_is_sent_once_in_order(
    received: tuple[list[Any], Recording],
) -> None:
    messages, recording = received
    odometry = odometry_of(messages)
    stamps = np.array([m.time_usec for m in odometry])
    assert (np.diff(stamps) > 0).all()
    live = [s.t_ns // 1000 for s in recording.poses() if s.status is not PoseStatus.LOST]
    assert stamps.tolist() == live
    # one pose per frame, except at the start and in the dark
    assert N > len(live) > N - len(DARK) - 25


def test_sent_poses_equal_the_recorded_ones(
    received: tuple[list[Any], Recording],
) -> None:
    odometry, recording = odometry_of(received[0]), received[1]
    recorded = {s.t_ns // 1000: s for s in recording.poses() if s.status is not PoseStatus.LOST}
    assert odometry and all(m.quality > 0 for m in odometry)
    for message in odometry:
        x, y, z = recorded[message.time_usec].T_w_c[:3, 3]
        # camera axes are right, down, forward; MAVLink's are forward, right, down
        np.testing.assert_allclose([message.x, message.y, message.z], [z, x, y], atol=1e-4)


def test_the_reset_counter_changes_exactly_with_the_epoch(
    received: tuple[list[Any], Recording],
) -> None:
    odometry, recording = odometry_of(received[0]), received[1]
    epochs = {s.t_ns // 1000: s.epoch for s in recording.poses()}
    seen = [(m.reset_counter, epochs[m.time_usec]) for m in odometry]
    assert {epoch for _, epoch in seen} == {0, 1}
    for (count, epoch), (next_count, next_epoch) in itertools.pairwise(seen):
        assert next_count - count == next_epoch - epoch


def test_a_real_time_run_sends_recorded_poses_and_the_final_state(tmp_path: Path) -> None:
    """The number of poses in time depends on the computer, their content does not."""
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
    # 3: completed with loss, possible on a busy computer
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
