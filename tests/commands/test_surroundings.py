"""Findings on disk, clock, heat, service and unfinished drives."""

from __future__ import annotations

import os
from collections import namedtuple
from pathlib import Path

import pytest

from calm_edge.commands import surroundings
from calm_edge.commands.finding import Finding, Level
from calm_edge.commands.surroundings import Service
from calm_edge.config import Config, merge
from calm_edge.recording import time_base
from calm_edge.recording.writer import RecordingWriter
from device.frame import Eye, Frame, jpeg
from tests.frontend.plane_world import texture

PICTURE = jpeg(texture()[:48, :64, None].repeat(3, 2))
Disk = namedtuple("Disk", "f_blocks f_frsize f_bavail")


def record(folder: Path, seconds: int) -> None:
    """A recording of one frame a second."""
    writer = RecordingWriter(folder, Config())
    for k in range(seconds + 1):
        for eye in Eye:
            writer.write_frame(Frame(eye, k, k * 10**9, PICTURE))
    writer.close()


def disk(out: Path, free: int, monkeypatch: pytest.MonkeyPatch) -> Finding:
    monkeypatch.setattr(os, "statvfs", lambda _: Disk(1 << 24, 4096, free // 4096))
    (found,) = surroundings.disk(Config(), out)
    return found


def test_minutes_left_are_those_at_the_rate_of_the_newest_drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = disk(tmp_path, 60 << 30, monkeypatch)
    assert found.level is Level.GOOD and "usual for 1280x720" in found.text
    record(tmp_path / "000001-abc", 4)
    (file,) = (tmp_path / "000001-abc").glob("*.mcap")
    rate = file.stat().st_size / 4
    # 64 GiB, of which 2 % are kept free
    left = (60 << 30) - (64 << 30) * 0.02
    assert f" {left / rate / 60:.0f} minutes left" in disk(tmp_path, 60 << 30, monkeypatch).text
    assert disk(tmp_path, 1 << 30, monkeypatch).level is Level.BAD


def test_little_space_and_a_folder_that_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = disk(tmp_path, 5 << 30, monkeypatch)
    assert found.level is Level.NOTE and "delete files" in found.remedy
    (tmp_path / "file").touch()
    assert disk(tmp_path / "file", 5 << 30, monkeypatch).level is Level.BAD
    assert "no such folder" in disk(tmp_path / "none", 5 << 30, monkeypatch).text


def test_a_drive_that_was_not_closed_and_an_interrupted_map_are_named(tmp_path: Path) -> None:
    record(tmp_path / "000001-abc", 2)
    record(tmp_path / "000002-abc", 2)
    (found,) = surroundings.unfinished(tmp_path)
    assert found.level is Level.GOOD and "2 in" in found.text
    (file,) = (tmp_path / "000002-abc").glob("*.mcap")
    part = file.rename(f"{file}.part")
    (tmp_path / "map" / "unfinished").mkdir(parents=True)
    (tmp_path / "map" / "unfinished" / "plan.json").touch()
    drive, mapped = surroundings.unfinished(tmp_path)
    assert "000002-abc was not closed" in drive.text and "recover" in drive.remedy
    assert f"--out {tmp_path / 'map'} --resume" in mapped.remedy
    with part.open("rb"):
        recorded, *_ = surroundings.unfinished(tmp_path)
    assert recorded.level is Level.GOOD and "being recorded" in recorded.text


def test_heat_is_that_of_the_configured_sensors(tmp_path: Path) -> None:
    config = merge(Config(), {"degrade": {"thermal_root": str(tmp_path)}})
    assert surroundings.heat(config).level is Level.GOOD
    (tmp_path / "thermal_zone0").mkdir()
    for millidegrees, level in ((60_000, Level.GOOD), (90_000, Level.NOTE)):
        (tmp_path / "thermal_zone0" / "temp").write_text(str(millidegrees))
        found = surroundings.heat(config)
        assert found.level is level and f"{millidegrees // 1000} °C" in found.text


@pytest.mark.parametrize(("is_set", "level"), [(True, Level.GOOD), (False, Level.NOTE)])
def test_an_unsynchronised_clock_is_a_note(
    is_set: bool, level: Level, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time_base, "synchronised", lambda: is_set)
    assert surroundings.clock().level is level


SYSTEMCTL = """#!/bin/sh
echo "LoadState=$STATE"
echo "ActiveState=failed"
echo "UnitFileState=enabled"
echo "StatusText=FAILED: camera = gone"
"""


def test_the_state_of_the_service_is_that_of_systemd(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert not surroundings.service_state().installed
    (tmp_path / "systemctl").write_text(SYSTEMCTL.replace("#!/bin/sh", "#!/bin/sh -f"))
    (tmp_path / "systemctl").chmod(0o755)
    monkeypatch.setenv("STATE", "not-found")
    assert not surroundings.service_state().installed
    monkeypatch.setenv("STATE", "loaded")
    state = surroundings.service_state()
    assert state == Service("failed", "enabled", "FAILED: camera = gone")
    assert "journalctl" in surroundings.service(state).remedy


@pytest.mark.parametrize(
    ("state", "level"),
    [
        (Service(), Level.GOOD),
        (Service("active", "enabled", "RUNNING"), Level.GOOD),
        (Service("inactive", "enabled"), Level.NOTE),
        (Service("active", "disabled"), Level.NOTE),
    ],
)
def test_a_service_that_does_not_run_is_a_note(state: Service, level: Level) -> None:
    assert surroundings.service(state).level is level


def test_marked_events_of_the_newest_drive_that_has_some(tmp_path: Path) -> None:
    for number, texts in (("000001-a", ["x"]), ("000002-b", ["tram", ""]), ("000003-c", [])):
        writer = RecordingWriter(tmp_path / number, Config())
        for k, text in enumerate(texts):
            writer.write_event(k, text)
        writer.close()
    (found,) = surroundings.events(tmp_path)
    assert found.level is Level.GOOD and "2 events were marked" in found.text
    assert f"calm-edge report {tmp_path / '000002-b'}" in found.text
    (tmp_path / "000002-b" / "report.html").touch()
    found = next(iter(surroundings.unfinished(tmp_path)))
    assert str(tmp_path / "000002-b" / "report.html") in found.text
