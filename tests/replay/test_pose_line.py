"""The poses of a real-time run as the other end of the serial line hears them."""

from __future__ import annotations

import itertools
import math
import os
import threading
from typing import Any

import cv2
import numpy as np
import pytest
from pymavlink.dialects.v20 import common as peer

from calm_edge.cli import main
from calm_edge.recording.reader import Recording
from calm_edge.types import PoseStatus
from device.frame import Eye
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


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Any], Recording]:
    folder = tmp_path_factory.mktemp("line")
    drive = write_drive(folder / "drive", N)
    images = sorted((drive / "cam0").iterdir())
    dark = np.zeros_like(cv2.imread(str(images[0])))
    for i in DARK:
        cv2.imwrite(str(images[i]), dark)
    listener = Listener()
    settings = {
        "pose_output.port": listener.port,
        "backbone.name": f"scripted:{drive}",
        "frontend.n_max": 6,
        "frontend.n_overlap": 2,
    }
    arguments = ["record", "--sequence", str(drive), "--out", str(folder / "rec")]
    for name, value in settings.items():
        arguments += ["--set", f"{name}={value}"]
    code = main([*arguments, "--pace", "realtime", "--spacing-m", "0.5"])
    listener.close()
    assert code == 0
    return [m for m in listener.messages if m.get_type() == "ODOMETRY"], Recording(folder / "rec")


def test_poses_come_ten_times_a_second_with_rising_stamps(
    heard: tuple[list[Any], Recording],
) -> None:
    odometry, recording = heard
    stamps = np.array([m.time_usec for m in odometry])
    assert (np.diff(stamps) > 0).all()
    # after the last frame the tail is solved, and nothing is said but the loss
    driving = stamps[stamps <= recording.frame_times(Eye.PRIMARY).max() // 1000]
    assert len(driving) - 1 >= 0.95 * 10 * (driving[-1] - driving[0]) / 1e6 > 50
    assert np.diff(driving).max() < 300_000


def test_a_pose_on_the_line_is_the_recorded_one_at_its_exposure(
    heard: tuple[list[Any], Recording],
) -> None:
    odometry, recording = heard
    recorded = {s.t_ns // 1000: s for s in recording.poses() if s.status is not PoseStatus.LOST}
    told = [m for m in odometry if m.quality > 0]
    assert len(told) >= 0.9 * len(recorded) > 25
    for message in told:
        x, y, z = recorded[message.time_usec].T_w_c[:3, 3]
        # camera x right, y down, z forward; the line speaks forward, right, down
        np.testing.assert_allclose([message.x, message.y, message.z], [z, x, y], atol=1e-4)
    lost = [m for m in odometry if m.quality <= 0]
    assert lost and all(math.isnan(m.x) for m in lost)


def test_the_reset_counter_changes_with_the_epoch_and_only_then(
    heard: tuple[list[Any], Recording],
) -> None:
    odometry, recording = heard
    epochs = {s.t_ns // 1000: s.epoch for s in recording.poses()}
    told = [m for m in odometry if m.quality > 0]
    seen = [(m.reset_counter, epochs[m.time_usec]) for m in told]
    assert {epoch for _, epoch in seen} == {0, 1}
    for (count, epoch), (next_count, next_epoch) in itertools.pairwise(seen):
        assert next_count - count == next_epoch - epoch
