"""Steps of `calm-edge setup` in a terminal: each asks, checks, and adds to the choices."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from calm_edge.commands import setup_choices, setup_views, speed, terminal_picture
from calm_edge.commands.config_text import toml
from calm_edge.commands.console import is_coloured
from calm_edge.commands.covering import covered
from calm_edge.commands.dialogue import Dialogue
from calm_edge.commands.finding import Finding, Level, print_lines
from calm_edge.commands.plugged_in import gps, serial
from calm_edge.commands.setup_choices import NONE, WHAT_TO_PLUG_IN, Choices
from calm_edge.daemon.source import Source, live, of_sequence
from calm_edge.types import CalmEdgeError
from device.camera import discover
from device.frame import jpeg
from device.watching import Seen, collect, running

WATCH_S = 4.0
COVER_POLLS = 200
# of the file with both pictures
PICTURE_PX = 640
MOST_COLUMNS = 70


class Wizard:
    """Asks for the choices, one after the other."""

    def __init__(self, dialogue: Dialogue, choices: Choices) -> None:
        self._dialogue, self._choices = dialogue, choices

    def choose_cameras(self, primary: str | None, assistant: str | None) -> bool:
        """Find two cameras; those given are taken as they are. False if there are not two."""
        if primary and assistant:
            self._choices.take_addresses(primary, assistant)
            return True
        while True:
            found, errors = discover(details=False)
            cameras = setup_choices.usable(found)
            for line in errors:
                self._dialogue.say(line)
            for number, camera in enumerate(cameras, 1):
                self._dialogue.say(f"{number}  {camera.address}  {camera.name}  {camera.path}")
            if len(cameras) >= 2:
                break
            self._dialogue.say(f"{len(cameras)} of 2 cameras found. {WHAT_TO_PLUG_IN}")
            if self._dialogue.silent or not self._dialogue.confirm("Look again", True):
                return False
        pair = setup_choices.proposed(cameras, self._choices.base.capture)
        if len(cameras) > 2:
            proposal = " ".join(str(cameras.index(camera) + 1) for camera in pair)
            pair = self._dialogue.ask(
                "Which two, primary first",
                proposal,
                lambda text: setup_choices.two_of(cameras, text),
            )
        self._choices.take(setup_choices.arranged(pair, cameras, primary, assistant))
        return True

    def look(
        self, sequence: Path | None, *, is_chosen: bool, cover: bool, picture: Path | None
    ) -> list[Finding]:
        """Show both pictures, ask which is the primary, check the views; returns the findings.

        sequence: a folder in place of cameras. is_chosen: which is the primary is known already.
        cover: find it by covering its lens. picture: file for both pictures. Raises CameraError,
        SequenceError, CoveringError.
        """
        is_chosen = is_chosen or sequence is not None
        while True:
            config = self._choices.config
            source = live(config) if sequence is None else of_sequence(sequence, True)
            self._dialogue.say(f"opening {source.description} ...")
            with running(source.open()) as seen:
                collect(seen, source.clock, setup_views.SETTLE_S)
                for each in seen:
                    each.frames.clear()
                collect(seen, source.clock, WATCH_S, pictures=setup_views.PICTURES)
                self._show(seen, picture)
                again = not is_chosen and self._find_primary(seen, source, cover)
            is_chosen = True
            if again:
                continue
            found = print_lines(setup_views.findings(seen, self._choices), sys.stderr)
            fine = all(finding.level is Level.GOOD for finding in found)
            if fine or self._dialogue.silent:
                return found
            if not self._dialogue.confirm("Change something and check again", False):
                return found

    def _show(self, seen: Sequence[Seen], file: Path | None) -> None:
        """Show the newest pictures in the terminal if it has colours, and write them to a file."""
        left, right = (setup_views.newest(each) for each in seen)
        if left is None or right is None:
            return
        if is_coloured(sys.stderr) and not self._dialogue.silent:
            columns = min(MOST_COLUMNS, shutil.get_terminal_size().columns // 2 - 2)
            small = terminal_picture.side_by_side(left, right, max(8, columns))
            self._dialogue.say(
                "\n".join(["1" + columns * " " + " 2", *terminal_picture.lines(small)])
            )
        if file is not None:
            file.write_bytes(jpeg(terminal_picture.side_by_side(left, right, PICTURE_PX)))
            self._dialogue.say(f"{file}: both pictures")

    def _find_primary(self, seen: Sequence[Seen], source: Source, cover: bool) -> bool:
        """Ask which camera is the primary, or find it by covering its lens.

        True if the pictures are no longer to be judged: of swapped cameras, or of a hand.
        """
        if not cover:
            question = "Which is the primary, whose path is the trajectory (c: cover its lens)"
            answer = self._dialogue.ask(question, "1", _one_of("1", "2", "c"))
            if answer == "1":
                return False
        if cover or answer == "c":
            self._dialogue.say("cover the lens of the primary with your hand ...")
            grey = partial(setup_views.brightness, seen, source.clock)
            answer = str(covered(grey, COVER_POLLS) + 1)
        if answer == "2":
            self._choices.swap()
        self._dialogue.say(
            f"the primary is {self._choices.config.capture.primary}; uncover its lens"
        )
        return True

    def spacing(self, given: float | None) -> None:
        """Ask for the distance of the lenses, unless it is given."""
        before = self._choices.base.scale.spacing_m
        if given is None:
            given = self._dialogue.ask(
                "Distance of the lenses by tape, such as 0.52 or 52 cm (none: lengths are not in "
                "metres)",
                f"{before:g}" if before else NONE,
                setup_choices.spacing_of,
            )
        self._choices.set_spacing(given)

    def serial_ports(self, port: str | None, receiver: str | None) -> None:
        """Ask for the port that poses are sent on, and for the GPS receiver, unless given."""
        base = self._choices.base
        if not self._dialogue.silent:
            for device in setup_choices.serial_devices():
                self._dialogue.say(f"   {device}")
        if port is None:
            question = "Serial port to send poses on, as MAVLink, such as /dev/ttyUSB0"
            port = self._dialogue.ask(question, base.pose_output.port or NONE, str)
        if receiver is None:
            question = "GPS receiver: a serial port, or gpsd"
            receiver = self._dialogue.ask(question, base.gps.source or NONE, str)
        self._choices.set_ports(port, receiver)
        config = self._choices.config
        print_lines([serial(config), gps(config)], sys.stderr)

    def speed(self, is_recording: bool) -> None:
        """Show or measure the speed of this computer. is_recording: it is busy."""
        config = self._choices.config
        found = speed.stored(config)
        if found is None and is_recording:
            self._dialogue.say("the service records: the speed of this computer was not measured")
            return
        if found is None and self._dialogue.confirm(
            "Measure the speed of this computer, half a minute or more", True
        ):
            self._dialogue.say("solving three windows of a rendered drive ...")
            try:
                found = speed.measure(config)
            except CalmEdgeError as error:
                self._dialogue.say(f"not measured: {error}")
        if found is not None:
            print_lines([found.finding()], sys.stderr)

    def write(self, path: Path) -> bool:
        """Write the changes, after asking if the file exists; False if refused.

        Raises ConfigError.
        """
        for section, values in self._choices.new_keys(path).items():
            for key, value in values.items():
                self._dialogue.say(f"   {section}.{key} = {toml(value)}")
        if path.exists() and not self._dialogue.confirm(f"Write this to {path}", True):
            return False
        self._choices.write(path)
        self._dialogue.say(f"wrote {path}")
        return True


def _one_of(*words: str) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in words:
            raise ValueError(f"one of {', '.join(words)}")
        return text

    return read
