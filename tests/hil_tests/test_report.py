from __future__ import annotations

import json
from pathlib import Path

import pytest

from hil_tests.__main__ import TESTS, main
from hil_tests.report import Verdict, judged, skipped, text_of, write

ROWS = [
    judged("2 frame rate", "primary rate", True, "10.0 Hz", "10 Hz"),
    judged("2 frame rate", "assistant rate", False, "4.9 Hz", "10 Hz"),
    skipped("4 serial", "port", "pose_output.port is empty"),
]


def test_the_table_has_every_row_and_counts_them() -> None:
    lines = text_of(ROWS).splitlines()
    assert lines[-1] == "1 pass, 1 FAIL, 1 skip"
    assert [line[:4] for line in lines[-5:-2]] == ["pass", "FAIL", "skip"]
    assert "assistant rate" in lines[-4] and "4.9 Hz" in lines[-4]


def test_what_is_sent_in_is_text_and_data(tmp_path: Path) -> None:
    text, data = write(ROWS, tmp_path / "out")
    assert text.read_text().endswith("1 pass, 1 FAIL, 1 skip\n")
    kept = json.loads(data.read_text())
    assert kept["rows"][1]["verdict"] == Verdict.FAIL and kept["calm-edge"]


def test_a_wrong_question_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["9"]) == 2
    assert "there are 1 to 6" in capsys.readouterr().err


def test_every_numbered_file_is_run() -> None:
    folder = Path(__file__).resolve().parents[2] / "hil_tests"
    assert tuple(sorted(p.stem for p in folder.glob("[0-9]_*.py"))) == TESTS
