"""The speed is measured by `record` on a rendered drive, stored, and put into words."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calm_edge.commands import speed, street
from calm_edge.commands.finding import Level
from calm_edge.commands.speed import Speed, SpeedError
from calm_edge.config import Config, merge
from tests.replay.small_drive import write_drive


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Config:
    """Small windows of a backbone that is fast, on a drive that it knows."""
    drive = write_drive(tmp_path / "drive", 20)
    monkeypatch.setattr(street, "write_street", lambda folder, *_: shutil.copytree(drive, folder))
    frontend = {"n_max": 4, "n_overlap": 2, "first_window": 4}
    return merge(Config(), {"backbone": {"name": f"scripted:{drive}"}, "frontend": frontend})


def test_a_measurement_is_stored_for_this_configuration(small: Config) -> None:
    assert speed.stored(small) is None
    measured = speed.measure(small)
    assert 0.001 < measured.window_s < 60 and measured.period_s == pytest.approx(0.6)
    assert speed.stored(small) == measured
    assert speed.stored(merge(small, {"capture": {"width_px": 640}})) is None
    assert speed.stored(merge(small, {"scale": {"spacing_m": 0.5}})) == measured


def test_a_drive_that_is_not_solved_is_named(
    small: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(street, "write_street", lambda folder, *_: folder.mkdir())
    with pytest.raises(SpeedError, match=r"the rendered drive: .*cam0"):
        speed.measure(small)

    run = subprocess.run

    def late(command: list[str], **options: Any) -> Any:
        # the platform's name is asked for by a command too
        if "record" not in command:
            return run(command, **options)
        raise subprocess.TimeoutExpired("record", 900)

    monkeypatch.setattr(subprocess, "run", late)
    with pytest.raises(SpeedError, match="longer than 15 minutes"):
        speed.measure(small)
    assert speed.stored(small) is None


@pytest.mark.parametrize(
    ("window_s", "load", "level", "words"),
    [
        (2.0, 0.1, Level.GOOD, "live poses keep up"),
        (3.5, 0.1, Level.NOTE, "poses lag behind at times; set backbone.name"),
        (9.0, 2.0, Level.NOTE, "load 2.0 per core): windows are left; measure again on an idle"),
    ],
)
def test_the_words_say_whether_poses_keep_up(
    window_s: float, load: float, level: Level, words: str
) -> None:
    found = Speed(window_s, 3.6, load).finding()
    assert found.level is level and words in found.line()


def test_the_street_is_seen_as_the_camera_moves(tmp_path: Path) -> None:
    street.write_street(tmp_path / "drive", 3, 5.0, (320, 180))
    seen = [
        cv2.imread(str(tmp_path / f"drive/cam{eye}/{k:06d}.jpg"), cv2.IMREAD_GRAYSCALE)
        for eye in range(2)
        for k in range(3)
    ]
    # ground truth by projection: a point of the left front, 20 m ahead, before and after a step
    focal = 160 / np.tan(np.radians(40))
    left, z = street.STREET_M[0][0], 20.0
    before = 159.5 + focal * left / z
    step_z = z - street.SPEED_M_S / 5
    turn = np.radians(street.TURN_DEG_S) / 5
    x = left * np.cos(turn) - step_z * np.sin(turn)
    after = 159.5 + focal * x / (left * np.sin(turn) + step_z * np.cos(turn))
    at = np.array([[[before, 70.0]]], np.float32)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(seen[0], seen[1], at, None, winSize=(31, 31))
    assert found[0, 0] and abs(float(moved[0, 0, 0]) - after) < 1.0
    # the assistant sees near things farther left
    shifted, found, _ = cv2.calcOpticalFlowPyrLK(seen[0], seen[3], at, None, winSize=(31, 31))
    assert found[0, 0]
    assert abs(float(shifted[0, 0, 0]) - (before - focal * street.SPACING_M / z)) < 1.0
