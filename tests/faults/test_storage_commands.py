"""Command line: recording under a root, free space, marks to keep, recovery."""

from __future__ import annotations

from pathlib import Path

import pytest

from calm_edge.cli import main
from calm_edge.daemon.source import Source, of_sequence
from calm_edge.recording.reader import Recording
from calm_edge.recording.retention import KEEP_FLAG
from device.camera import Camera, CameraSpec
from device.drivers.replay import ReplayCamera
from device.errors import CameraError
from device.frame import Eye
from tests.replay.daemon_run import config_for, record
from tests.replay.small_drive import write_drive


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("storage") / "sequence", 12)


def start(drive: Path, *more: str) -> int:
    arguments = ["record", "--sequence", str(drive), "--pace", "lockstep", "--spacing-m", "0.5"]
    arguments += ["--set", f"backbone.name=scripted:{drive}", "--set", "frontend.n_max=4"]
    return main([*arguments, "--set", "frontend.n_overlap=2", *more])


def test_drives_under_a_root_get_new_names_and_can_be_kept(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "calm-edge"
    assert [start(drive, "--root", str(root)) for _ in range(2)] == [0, 0]
    first, second = sorted(root.iterdir())
    assert first.name.startswith("000001-") and second.name.startswith("000002-")
    assert first.name[7:] == second.name[7:]
    assert all(Recording(path).count("/primary/image") == 12 for path in (first, second))
    assert main(["keep", str(first)]) == 0 and (first / KEEP_FLAG).exists()
    assert Recording(first).count("/primary/image") == 12
    assert main(["keep", "--release", str(first)]) == 0 and not (first / KEEP_FLAG).exists()
    assert str(first) in capsys.readouterr().out
    assert main(["keep", str(root)]) == 1
    assert "holds no recording" in capsys.readouterr().err


def test_too_little_disk_space_is_an_error_and_leaves_nothing(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for target in (["--root", str(tmp_path / "root")], ["--out", str(tmp_path / "rec")]):
        assert start(drive, *target, "--set", "recording.keep_free_gib=1000000") == 1
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert "have to stay free" in line and "keep_free_gib" in line
    assert list(tmp_path.iterdir()) == []


def test_recover_writes_to_a_default_target(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small = "--set", "recording.chunk_bytes=65536"
    assert start(drive, *small, "--out", str(tmp_path / "rec")) == 0
    segment = tmp_path / "rec" / "0000.mcap"
    before = segment.read_bytes()
    segment.write_bytes(before[: len(before) // 2])
    assert main(["recover", str(tmp_path / "rec")]) == 3
    assert segment.read_bytes() == before[: len(before) // 2]
    assert main(["validate", str(tmp_path / "rec-recovered")]) == 0
    capsys.readouterr()
    assert main(["recover", str(tmp_path / "rec")]) == 1
    assert "exists already" in capsys.readouterr().err


def test_a_camera_that_does_not_open_leaves_no_drive(drive: Path, tmp_path: Path) -> None:
    config = config_for(drive)
    source = of_sequence(drive, True)

    class Absent(ReplayCamera):
        def start(self) -> None:
            raise CameraError("primary camera: not found")

    def cameras() -> tuple[Camera, Camera]:
        clock = source.clock
        spec = CameraSpec(Eye.PRIMARY, "replay")
        return Absent(spec, clock, frames=()), source.open()[1]

    absent = Source(cameras, source.clock, False, "absent")
    with pytest.raises(CameraError, match="not found"):
        record(drive, tmp_path / "rec", lockstep=False, config=config, source=absent)
    assert not (tmp_path / "rec").exists()


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("recording.flush_s=0", "recording.flush_s"),
        ("recording.segment_s=-1", "recording.segment_s"),
        ("recording.chunk_bytes=0", "recording.chunk_bytes"),
        ("recording.jpeg_quality=200", "recording.jpeg_quality"),
        ("recording.keep_free_gib=-1", "recording.keep_free_gib"),
        ("recording.keep_free_percent=nan", "keep_free_percent"),
        ("degrade.cool_c=90", "degrade.cool_c"),
        ("degrade.step_s=0", "degrade.step_s"),
    ],
)
def test_an_invalid_setting_gives_one_line_and_leaves_nothing(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], setting: str, key: str
) -> None:
    assert start(drive, "--root", str(tmp_path / "root"), "--set", setting) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert key in line
    assert list(tmp_path.iterdir()) == []
