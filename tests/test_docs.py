"""README and docs: every command works, every message quoted is in the source, every link leads on.

Commands run in one folder, in the order of the pages, on a short scripted drive that has the names
of the examples. What needs cameras, videos, data sets or minutes is parsed only, with the reason.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import re
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bench.__main__ import COMMANDS as MEASUREMENTS
from calm_edge.cli import build_parser, main
from tests.replay.small_drive import write_drive

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PAGES += [ROOT / "models" / "README.md", ROOT / "hil_tests" / "README.md"]
# commands that are parsed and not run: words of the line -> why
PARSED = {
    "cameras": "needs cameras",
    "--config kit.toml": "needs cameras",
    "import": "needs videos or a data set; tests/interchange imports both",
    "drives/tuesday": "needs the imported drive",
    "drives/v101": "needs EuRoC",
    "drives/solved": "needs the imported drive",
    "calibration": "a scripted drive learns none; tests/commands/test_calibration.py",
    "camchain.yaml": "needs a calibration",
    "--gps": "needs fixes; tests/test_cli.py",
    "doctor": "measures this computer; tests/commands/test_doctor.py",
    "gps.source=track.nmea": "needs fixes; tests/replay",
    "--dask": "needs a cluster; tests of the command",
    "maps/place": "needs two drives of one place; tests of the command",
    "geojson": "needs fixes; tests/contract/test_exporters.py",
    "ros2": "needs the extra import; tests/contract/test_exporters.py",
    "colmap": "writes every picture; tests/contract/test_exporters.py",
    "drives/000007-2a43c899": "a drive of a service",
    "backbone.name=NAME": "a placeholder",
    "maps/again": "needs a model",
    "model check": "takes a minute; tests/backbones/model_check",
    "NAME": "a placeholder",
    "live": "serves until it is stopped; tests/live",
    "setup": "asks; tests of the command",
    "--root": "needs cameras",
    "--blur": "needs opencv-data; tests/report/test_blur.py",
    "build/demo/recording": "needs make demo; the same with drives/monday is run",
    "DRIVE": "a placeholder",
    "REC": "a placeholder",
    "FORMAT": "a placeholder",
}
NAMED = re.compile(r"`((?:docs|tests|calm_edge|device|models|bench|deploy)/[\w./-]+\.\w+)`")
BLOCK = re.compile(r"^ *```(\w*)\n(.*?)^ *```", re.S | re.M)
INLINE = re.compile(r"`((?:(?:\.venv|~/calm-edge)/bin/)?(?:calm-edge|make|python -m bench) [^`]+)`")
START = re.compile(r"(?:\$ )?(?:sudo (?:-u \S+ )?)?(?:\S*/bin/)?(calm-edge|make|python) (.*)")


@dataclass(frozen=True)
class Command:
    """A command of a page: its program, `calm-edge`, `make` or `bench`, and its arguments."""

    page: str
    line: int
    program: str
    arguments: tuple[str, ...]
    block: bool

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.program} {' '.join(self.arguments)}"


def commands(page: Path) -> Iterator[Command]:
    """All commands of a page: of its blocks without a language, a line each, and in its text."""
    text = page.read_text("utf-8")
    found = []
    for match in BLOCK.finditer(text):
        if match[1]:
            continue
        offset = match.start(2)
        for line in match[2].splitlines(keepends=True):
            found.append((offset, line.strip(), True))
            offset += len(line)
    plain = BLOCK.sub(lambda m: re.sub(r"[^\n]", " ", m[0]), text)
    found += [(m.start(), m[1].replace("\n", " "), False) for m in INLINE.finditer(plain)]
    for offset, line, block in sorted(found):
        match = START.match(line)
        if match is None:
            continue
        words = tuple(shlex.split(match[2].split(" > ")[0], comments=True))
        program = match[1]
        if program == "python":
            if words[:2] != ("-m", "bench"):
                continue
            program, words = "bench", words[2:]
        number = text.count("\n", 0, offset) + 1
        yield Command(page.relative_to(ROOT).as_posix(), number, program, words, block)


ALL = [command for page in PAGES for command in commands(page)]
OURS = [command for command in ALL if command.program == "calm-edge"]


def why_not_run(command: Command) -> str:
    """Why a command is parsed only; empty if it is run."""
    text = f" {' '.join(command.arguments)} "
    if not command.block:
        return "in the text, where it is short of arguments"
    return next((why for words, why in PARSED.items() if f" {words} " in text), "")


PARSER = cache(build_parser)


def parsed(arguments: tuple[str, ...]) -> None:
    """Parse the arguments of calm-edge; raises SystemExit."""
    PARSER().parse_args(list(arguments))


@cache
def options(command: str) -> frozenset[str]:
    """All options of a command and of its actions; raises KeyError if there is none."""
    parsers = [_subparsers(PARSER())[command]]
    parsers += _subparsers(parsers[0]).values()
    return frozenset(o for p in parsers for a in p._actions for o in a.option_strings)


def _subparsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    found: dict[str, argparse.ArgumentParser] = {}
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            found.update(action.choices)
    return found


def test_the_pages_have_commands() -> None:
    assert len(OURS) > 40 and len([c for c in OURS if not why_not_run(c)]) > 10


@pytest.mark.parametrize("command", [c for c in OURS if c.block], ids=str)
def test_every_command_of_a_block_can_be_parsed(command: Command) -> None:
    words = [word for word in command.arguments if word != "..."]
    if "..." in command.arguments:
        words += ["--out", "drive"]
    parsed(tuple(words))


def test_commands_in_the_text_name_commands_and_options_that_exist() -> None:
    for command in OURS:
        name = command.arguments[0]
        if name.startswith("--"):
            assert name in PARSER().format_help(), command
            continue
        assert name in _subparsers(PARSER()), command
        given = {word.partition("=")[0] for word in command.arguments[1:] if word[:2] == "--"}
        assert given <= options(name), f"{command}: {given - options(name)}"


def test_targets_of_make_and_measurements_exist() -> None:
    makefile = (ROOT / "Makefile").read_text()
    for command in ALL:
        if command.program == "make":
            targets = [w for w in command.arguments if "=" not in w]
            assert all(re.search(rf"^{re.escape(t)}:", makefile, re.M) for t in targets), command
        if command.program == "bench" and command.arguments[0].islower():
            assert command.arguments[0] in MEASUREMENTS, command


def test_the_commands_that_need_no_hardware_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In order of the pages; what an example needs and no other one makes is here beforehand."""
    monkeypatch.chdir(tmp_path)
    drive = write_drive(tmp_path / "demo" / "drive", 16)
    # solved in a second, by the poses of the drive
    scripted = ["--set", f"backbone.name=scripted:{drive}", "--set", "frontend.n_max=4"]
    scripted += ["--set", "frontend.n_overlap=2"]
    (tmp_path / "build").mkdir()
    made: dict[tuple[str, ...], Path] = {}
    for command in OURS:
        if why_not_run(command):
            continue
        arguments, out = list(command.arguments), Path("none")
        if "--out" in arguments:
            out = Path(arguments[arguments.index("--out") + 1])
            # of an earlier page
            shutil.rmtree(out, ignore_errors=True)
        same = tuple(word for word in arguments if word != str(out))
        if same in made:
            if made[same].is_dir():
                shutil.copytree(made[same], out)
            continue
        more = scripted if arguments[0] == "record" else []
        assert main([*arguments, *more]) == 0, f"{command}\n{capsys.readouterr().err}"
        made[same] = tmp_path / "made" / str(len(made))
        if out.is_dir():
            shutil.copytree(out, made[same])
        if arguments[0] == "record":
            # the drive that the examples record with cameras
            shutil.copytree("drives/demo", "drives/monday", dirs_exist_ok=True)
        if str(out) == "maps/demo":
            shutil.copytree(out, "maps/monday", dirs_exist_ok=True)
    assert {arguments[0] for arguments in made} >= {"record", "map", "eval", "report", "compare"}


@cache
def sources() -> str:
    """All text constants of the program, those of f-strings with … for what is filled in."""
    texts = []
    for folder in ("calm_edge", "device"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(file.read_text("utf-8"))):
                if isinstance(node, ast.JoinedStr):
                    parts = (v.value if isinstance(v, ast.Constant) else "…" for v in node.values)
                    texts.append("".join(map(str, parts)))
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    texts.append(node.value)
    return "\n".join(texts)


def test_every_message_is_in_the_source() -> None:
    rows = re.findall(r"^\| (`.+?`) \|", (ROOT / "docs" / "messages.md").read_text("utf-8"), re.M)
    messages = [m for row in rows for m in re.findall(r"`([^`]+)`", row)]
    assert len(messages) > 30
    for message in messages:
        pieces = [piece for piece in re.split(r"\s*…\s*", message) if piece]
        missing = [piece for piece in pieces if piece not in sources()]
        assert not missing, f"docs/messages.md: {message!r}: {missing} is in no message"


def test_links_and_files_exist() -> None:
    for page in PAGES:
        text = page.read_text("utf-8")
        links = [page.parent / link for link in re.findall(r"\]\((?!https?:)([^)#]+)", text)]
        links += [ROOT / name for name in NAMED.findall(text)]
        missing = [str(link) for link in links if not link.exists()]
        assert not missing, f"{page.name}: {missing}"


def test_the_tables_of_the_kit_page_are_those_of_its_script() -> None:
    module = importlib.import_module("docs.kit_tables")
    truth = module.read_truth(ROOT / "demo" / "drive")
    text = (ROOT / "docs" / "kit.md").read_text("utf-8")
    chosen = truth.T_w_c[np.linspace(0, len(truth.T_w_c) - 1, module.POSES).astype(int)]
    # a tenth of the points
    points = truth.cloud[::10].astype(float)
    shared, parallax, _ = module.seen_by_both(points, chosen, 70, 0.5, 10)
    row = next(line for line in text.splitlines() if line.startswith("| 10 degrees"))
    stated = [float(n) for n in re.findall(r"([\d.]+) (?:%|px)", row)]
    assert abs(100 * shared - stated[0]) < 1 and abs(parallax - stated[1]) < 0.3
