"""The `calm-edge` command. Data to stdout, everything else to stderr.

Exit codes: `commands/exit_codes`.
"""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys
from collections.abc import Sequence

from calm_edge import __version__
from calm_edge.commands import examples, exit_codes
from calm_edge.commands.exit_codes import ERROR
from calm_edge.commands.parser import Parser

COMMANDS = {
    "setup": "describe two cameras in a configuration file, and check them",
    "record": "record two cameras (or replay a folder) and estimate poses live",
    "live": "serve a page that shows the running recording, for a phone in the car",
    "import": "make a recording of videos, data sets or bags",
    "map": "build a dense map, a trajectory and a report from a recording",
    "report": "write report.html of a recording",
    "compare": "list what differs between two recordings or maps",
    "eval": "compare a recording, a map or a TUM file with ground truth",
    "export": "write trajectories, pictures or clouds in the formats of other programs",
    "calibration": "write the calibration that a drive has learned, for other programs",
    "recover": "copy the intact part of a damaged recording",
    "validate": "check a recording for damage",
    "keep": "mark a recording so that it is not removed when the disk is full",
    "cameras": "list the cameras of this machine",
    "model": "list the models, or check one on this machine",
    "config": "print the configuration with comments, as TOML that record --config reads",
    "doctor": "list what is there and what is missing on this machine, with the remedies",
    "completion": "print a script with which bash or zsh completes commands and options",
}
# where it is not the command's name
MODULES = {"import": "import_source"}


def build_parser() -> argparse.ArgumentParser:
    """Build the parser of all commands without importing heavy modules."""
    parser = Parser(
        prog="calm-edge",
        description="Calibration-free SLAM with two ordinary cameras.",
        epilog="exit codes: 0 ok, 1 error, 2 usage, 3 completed with loss; COMMAND --help has them",
    )
    parser.add_argument("--version", action="version", version=f"calm-edge {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, text in COMMANDS.items():
        module = importlib.import_module(f"calm_edge.commands.{MODULES.get(name, name)}")
        command = commands.add_parser(
            name,
            help=text,
            description=text.capitalize() + ".",
            epilog=f"{examples.table(name)}\n\n{exit_codes.table(name)}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.configure(command)
        command.set_defaults(run=module.run, parser=parser)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; print a user's errors as one line."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # names of files need not be UTF-8
        sys.stdout.reconfigure(errors="surrogateescape")
    arguments = build_parser().parse_args(argv)
    # depthai reads these variables when it is imported
    os.environ.setdefault("DEPTHAI_TELEMETRY", "0")
    os.environ.setdefault("DEPTHAI_INSTALL_SIGNAL_HANDLER", "0")
    try:
        return int(arguments.run(arguments))
    except KeyboardInterrupt:
        print("calm-edge: interrupted", file=sys.stderr)
        return ERROR
    except BrokenPipeError:
        # the process reading stdout has ended: avoid a second error when Python flushes at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ERROR
    except Exception as error:
        from calm_edge.types import CalmEdgeError
        from device.errors import DeviceError

        if not isinstance(error, CalmEdgeError | DeviceError):
            raise
        print(f"calm-edge: {' '.join(str(error).split())}", file=sys.stderr)
        return ERROR


if __name__ == "__main__":
    sys.exit(main())
