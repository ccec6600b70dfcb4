"""`record` writes report.html, and so does `report`, of any recording."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from calm_edge.cli import main
from calm_edge.commands import report
from calm_edge.commands.record import write_page
from calm_edge.recording.reader import Recording
from calm_edge.recording.retention import REPORT_FILE
from device.frame import Eye
from tests.replay.small_drive import write_drive


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the recording `rec` of a short scripted drive, and its `sequence`."""
    folder = tmp_path_factory.mktemp("report")
    sequence = write_drive(folder / "sequence", 16)
    arguments = ["record", "--sequence", str(sequence), "--out", str(folder / "rec")]
    arguments += ["--pace", "lockstep", "--set", f"backbone.name=scripted:{sequence}"]
    arguments += ["--set", "frontend.n_max=4", "--set", "frontend.n_overlap=2"]
    assert main([*arguments, "--spacing-m", "0.5"]) == 0
    return folder


def test_record_writes_it_and_report_writes_it_again(recorded: Path) -> None:
    out, sequence = recorded / "rec", recorded / "sequence"
    page = out / REPORT_FILE
    text = page.read_text()
    assert "in 0:01 min, no loop closed." in text and "16 + 16 frames recorded, none lost." in text
    assert 'href="0000.mcap"' in text and 'href="record_trajectory.tum"' in text
    assert main(["report", str(out), "--truth", str(sequence)]) == 0
    assert "trajectory error" not in text and "trajectory error" in page.read_text()
    assert main(["report", str(out / "0000.mcap")]) == 0
    assert (out / "0000.report.html").is_file()


def test_what_was_marked_is_in_the_report(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = Recording(recorded / "rec")
    marked = [(int(recording.frame_times(Eye.PRIMARY)[9]), "tram crosses")]
    monkeypatch.setattr(Recording, "events", lambda self: iter(marked))
    page = tmp_path / "page.html"
    assert main(["report", str(recorded / "rec"), "--out", str(page)]) == 0
    text = page.read_text()
    assert "1 event was marked: at 0:00." in text and "tram crosses" in text


def test_the_truth_of_another_drive_is_no_error(recorded: Path, tmp_path: Path) -> None:
    other = shutil.copytree(recorded / "sequence", tmp_path / "other")
    times = (other / "times0.txt").read_text().split()
    (other / "times0.txt").write_text("\n".join(str(7 * float(t)) for t in times))
    page = tmp_path / "page.html"
    arguments = ["report", str(recorded / "rec"), "--truth", str(other), "--out", str(page)]
    assert main(arguments) == 0
    assert "not compared with the truth" in page.read_text()


def test_a_page_that_fails_is_said_and_is_no_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> list[str]:
        raise ValueError("a bug")

    monkeypatch.setattr(report, "write_report", fails)
    write_page(tmp_path)
    assert f"(a bug): calm-edge report {tmp_path}" in capsys.readouterr().err


def test_what_is_no_recording_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "trajectory.tum").touch()
    assert main(["report", str(tmp_path)]) == 1
    assert "is a map" in capsys.readouterr().err
    assert main(["report", str(tmp_path / "none")]) == 1
    assert "no such recording" in capsys.readouterr().err


def test_a_page_that_cannot_be_written_is_one_line(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "none" / "page.html"
    assert main(["report", str(recorded / "rec"), "--out", str(page)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "page.html: cannot be written" in line
