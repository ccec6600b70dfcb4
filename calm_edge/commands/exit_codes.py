"""Exit codes of the commands: the table that `--help` prints."""

from __future__ import annotations

import textwrap

# LOSS: what can be had was written, but something is missing. argparse exits with USAGE
OK, ERROR, USAGE, LOSS = 0, 1, 2, 3

INDENT = 5 * " "

GENERAL = {
    OK: "ok",
    ERROR: "error: one line on stderr says what is wrong and the remedy",
    USAGE: "wrong usage",
    LOSS: "completed with loss: lines on stderr say what is missing",
}
# where a command's codes mean something particular
OF_COMMAND: dict[str, dict[int, str]] = {
    "setup": {
        OK: "the file was written",
        ERROR: "nothing was written: there are not two cameras, or it was refused",
        LOSS: "the file was written, but a check failed",
    },
    "record": {
        OK: "all is recorded and placed; also of a car that stood still",
        ERROR: "nothing more can be recorded, or it could not start; a replay leaves no recording",
        LOSS: "frames were lost or a camera sent none; windows are without a sub-map, or were left "
        "to map; poses are not optimised; the spacing was given and no metre found; the pose "
        "output did not work",
    },
    "live": {OK: "served until it was stopped", ERROR: "the page cannot be served there"},
    "import": {OK: "the recording is complete", ERROR: "no recording was made"},
    "map": {
        OK: "the map of the whole drive was written",
        ERROR: "no map was written, or it was interrupted: what was computed is kept",
        LOSS: "nothing can be mapped (the car stood still, no window can be solved); the map has "
        "no points; windows could not be solved; parts of the recording are damaged; the spacing "
        "was given and no metre found; the truth could not be compared",
    },
    "report": {
        OK: "written",
        ERROR: "nothing was written",
        LOSS: "written, of a recording that is damaged",
    },
    "compare": {
        OK: "compared",
        LOSS: "compared; a recording is damaged, or the truth is not of it",
    },
    "eval": {
        OK: "compared",
        LOSS: "there are no poses to compare; the spacing was given and no metre found",
    },
    "export": {
        OK: "written",
        ERROR: "nothing was written",
        LOSS: "written, of a recording that is damaged",
    },
    "calibration": {OK: "written", LOSS: "written, of a recording that is damaged"},
    "recover": {
        OK: "all was copied",
        ERROR: "nothing can be read",
        LOSS: "the intact part was copied",
    },
    "validate": {OK: "undamaged", ERROR: "nothing can be read", LOSS: "parts are damaged"},
    "keep": {},
    "cameras": {OK: "cameras were found", ERROR: "no camera was found"},
    "model": {ERROR: "the model was refused"},
    "completion": {},
    "config": {ERROR: "the configuration is invalid"},
    "doctor": {
        OK: "a run with this configuration works; there may be notes",
        ERROR: "a run with this configuration does not work",
    },
}


def table(command: str) -> str:
    """The codes of a command, a line each. Codes it does not return are left out."""
    own = OF_COMMAND[command]
    codes = GENERAL if LOSS in own else {k: v for k, v in GENERAL.items() if k != LOSS}
    lines = (
        textwrap.fill(
            own.get(code, text), 88, initial_indent=f"  {code}  ", subsequent_indent=INDENT
        )
        for code, text in codes.items()
    )
    return "exit codes:\n" + "\n".join(lines)
