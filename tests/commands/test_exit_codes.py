"""One table of exit codes: complete, printed by --help, and true of what `record` reports.

What other commands return is in tests/test_cli.py and tests/replay/test_no_metre.py.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from calm_edge.cli import COMMANDS, main
from calm_edge.commands.exit_codes import ERROR, GENERAL, LOSS, OF_COMMAND, OK, table
from calm_edge.commands.record import report
from calm_edge.daemon.result import RecordResult
from calm_edge.frontend.diagnosis import Cause, Kind
from calm_edge.recording.recovery import Outcome
from calm_edge.types import Metre

STILL = (Cause(Kind.STILL, "the pictures do not move: the car stood still"),)
DARK = (Cause(Kind.EXPOSURE, "primary camera: too dark (mean grey 4 of 255)"),)


def whole(spacing_m: float = 0.5) -> RecordResult:
    """A drive of which nothing is missing."""
    result = RecordResult(frames=[90, 90], windows=3, submaps=3, keyframes=40, finished=True)
    result.spacing_m, result.metre = spacing_m, Metre(0.01)
    return result


def changed(**values: object) -> Callable[[], RecordResult]:
    def make() -> RecordResult:
        result = whole()
        for name, value in values.items():
            setattr(result, name, value)
        return result

    return make


NONE = {"windows": 0, "submaps": 0, "finished": False, "metre": Metre()}


@pytest.mark.parametrize(
    ("made", "code", "words"),
    [
        (whole, OK, ""),
        (lambda: whole(spacing_m=0.0), OK, ""),
        # parked: all there is was recorded
        (changed(**NONE, no_window=STILL), OK, "the car stood still"),
        (changed(**NONE, no_window=STILL, spacing_m=0.0), OK, ""),
        (changed(clamped_stamps=4, host_stamped=2), OK, ""),
        (changed(repeated=[3, 0]), OK, ""),
        (changed(**NONE, no_window=DARK, spacing_m=0.0), LOSS, "too dark (mean grey 4 of 255)"),
        (changed(frames=[0, 90], **NONE), LOSS, "no frame of the primary camera"),
        (changed(frames=[90, 0], **NONE), LOSS, "no frame of the assistant camera"),
        (changed(unsolved_windows=[2]), LOSS, "windows [2] could not be solved"),
        (changed(lost_windows=[2]), LOSS, "windows [2] were not solved"),
        (changed(windows_left_to_map=[1, 2]), LOSS, "2 windows were skipped"),
        (changed(finished=False), LOSS, "before all poses were optimised"),
        (changed(metre=Metre(reason="the car stood still")), LOSS, "no metre"),
        (changed(camera_drops=5), LOSS, "5 frames were left out by the cameras"),
        (changed(corrupt=6), LOSS, "6 frames came corrupt"),
        (changed(unreadable=7), LOSS, "7 frames were not readable"),
        (changed(unrecorded=8), LOSS, "8 items could not be recorded"),
        (changed(estimator_restarts=1), LOSS, "the estimator was restarted"),
        (changed(output_faults=["/dev/no: cannot be opened"]), LOSS, "/dev/no: cannot be opened"),
        (changed(error="rec: the disk is full"), ERROR, "the disk is full"),
    ],
)
def test_what_record_returns(
    made: Callable[[], RecordResult],
    code: int,
    words: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert report(Path("rec"), made()) == code
    printed = capsys.readouterr()
    assert words in printed.err
    assert bool(printed.err) == bool(words)


def test_changed_stamps_are_in_the_closing_lines(capsys: pytest.CaptureFixture[str]) -> None:
    report(Path("rec"), changed(clamped_stamps=4, host_stamped=2)())
    assert "stamps      4 moved" in capsys.readouterr().out


def test_every_command_has_its_codes_and_prints_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(OF_COMMAND) == set(COMMANDS)
    assert all(set(own) <= set(GENERAL) for own in OF_COMMAND.values())
    for command in COMMANDS:
        with pytest.raises(SystemExit):
            main([command, "--help"])
        assert table(command) in capsys.readouterr().out
    assert "\n  3  " in table("map") and "\n  3  " not in table("doctor")


def test_recover_and_validate_have_the_same_codes() -> None:
    assert (OK, ERROR, LOSS) == (Outcome.ALL, Outcome.FAILED, Outcome.WITH_LOSS)
