"""Steps of `calm-edge setup`: each asks, checks, and adds to the changes of the configuration."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from calm_edge.commands import speed, terminal_picture, view_checks
from calm_edge.commands.config_file import write_keys
from calm_edge.commands.config_text import toml
from calm_edge.commands.configuration import SPACING_M, check
from calm_edge.commands.console import is_coloured
from calm_edge.commands.covering import covered
from calm_edge.commands.dialogue import Dialogue
from calm_edge.commands.finding import Finding, Level, bad, print_lines
from calm_edge.commands.length_text import metres_of
from calm_edge.commands.plugged_in import gps, serial, shared_hubs
from calm_edge.config import Config, merge
from calm_edge.daemon.source import Source, live, of_sequence
from calm_edge.types import Bytes, CalmEdgeError
from device.camera import FoundCamera, discover
from device.errors import CameraError
from device.frame import Eye, Frame, UnreadableImage, jpeg
from device.usb_place import place_of
from device.watching import Seen, collect, running

WHAT_TO_PLUG_IN = (
    "Plug in two USB cameras (UVC), each at a port of the computer itself, not both at one hub. "
    "Fix them so that both see the road and much of the same scene."
)
# automatic exposure and focus settle before pictures are judged
SETTLE_S, WATCH_S = 2.0, 4.0
PICTURES = 3
COVER_POLL_S, COVER_POLLS = 0.3, 200
# of the file with both pictures
PICTURE_PX = 640
MOST_COLUMNS = 70


class Wizard:
    """Collects the changes to a configuration. base: that of the file, or the defaults."""

    def __init__(self, dialogue: Dialogue, base: Config) -> None:
        self._dialogue, self._base = dialogue, base
        self._changes: dict[str, dict[str, Any]] = {}
        self._pair: list[FoundCamera] = []

    @property
    def config(self) -> Config:
        """The base with the changes."""
        return merge(self._base, self._changes)

    def choose_cameras(self, primary: str | None, assistant: str | None) -> bool:
        """Find two cameras; those given are taken as they are. False if there are not two."""
        if primary and assistant:
            self._changes["capture"] = {"primary": primary, "assistant": assistant}
            return True
        while True:
            found, errors = discover(details=False)
            usable = sorted((c for c in found if not c.by_name_only), key=lambda c: c.address)
            for line in errors:
                self._dialogue.say(line)
            for number, camera in enumerate(usable, 1):
                self._dialogue.say(f"{number}  {camera.address}  {camera.name}  {camera.path}")
            if len(usable) >= 2:
                break
            self._dialogue.say(f"{len(usable)} of 2 cameras found. {WHAT_TO_PLUG_IN}")
            if self._dialogue.silent or not self._dialogue.confirm("Look again", True):
                return False
        known = {camera.address: camera for camera in usable}
        capture = self._base.capture
        before = [known[a] for a in (capture.primary, capture.assistant) if a in known]
        self._pair = before if len(before) == 2 else usable[:2]
        if len(usable) > 2:
            proposal = " ".join(str(usable.index(camera) + 1) for camera in self._pair)
            self._pair = self._dialogue.ask(
                "Which two, primary first", proposal, lambda text: _two_of(usable, text)
            )
        for eye, address in enumerate((primary, assistant)):
            if address and address not in known:
                raise CameraError(f"{address}: not plugged in; see `calm-edge cameras`")
            if address and address != self._pair[eye].address:
                # the one that was chosen for the other eye takes its place
                self._pair[1 - eye] = self._pair[eye]
                self._pair[eye] = known[address]
        self._take(self._pair)
        return True

    def _take(self, pair: Sequence[FoundCamera]) -> None:
        primary, assistant = (camera.address for camera in pair)
        self._changes["capture"] = {"primary": primary, "assistant": assistant}

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
            source = live(self.config) if sequence is None else of_sequence(sequence, True)
            self._dialogue.say(f"opening {source.description} ...")
            with running(source.open()) as seen:
                collect(seen, source.clock, SETTLE_S)
                for each in seen:
                    each.frames.clear()
                collect(seen, source.clock, WATCH_S, pictures=PICTURES)
                self._show(seen, picture)
                again = not is_chosen and self._find_primary(seen, source, cover)
            is_chosen = True
            if again:
                continue
            found = print_lines(self._findings(seen), sys.stderr)
            fine = all(finding.level is Level.GOOD for finding in found)
            if fine or self._dialogue.silent:
                return found
            if not self._dialogue.confirm("Change something and check again", False):
                return found

    def _show(self, seen: Sequence[Seen], file: Path | None) -> None:
        """Show the newest pictures in the terminal if it has colours, and write them to a file."""
        pictures = [_decoded(each.frames[-1:], gray=False) for each in seen]
        if not all(pictures):
            return
        left, right = (each[0] for each in pictures)
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
            answer = str(covered(partial(_brightness, seen, source), COVER_POLLS) + 1)
        if answer == "2":
            self._pair.reverse()
            self._take(self._pair)
        self._dialogue.say(f"the primary is {self._pair[0].address}; uncover its lens")
        return True

    def _findings(self, seen: Sequence[Seen]) -> list[Finding]:
        """Traffic lights of both cameras; `seen` has the primary first."""
        found: list[Finding] = []
        last: list[Bytes] = []
        for each, eye in zip(seen, Eye, strict=True):
            pictures = _decoded(each.frames[-PICTURES:], gray=True)
            if not pictures:
                found.append(bad(f"{eye.name.lower()} picture", "none that can be decoded"))
                continue
            found += view_checks.picture_findings(pictures, eye)
            last.append(pictures[-1])
        if len(last) == 2:
            found.append(view_checks.overlap(last[0], last[1]))
        if self._pair or "capture" in self._changes:
            found += view_checks.rates(seen, self.config.capture.rate_hz)
        found += shared_hubs({camera.address: place_of(camera.path) for camera in self._pair})
        return found

    def spacing(self, given: float | None) -> None:
        """Ask for the distance of the lenses, unless it is given."""
        before = self._base.scale.spacing_m
        if given is None:
            given = self._dialogue.ask(
                "Distance of the lenses by tape, such as 0.52 or 52 cm (none: lengths are not in "
                "metres)",
                f"{before:g}" if before else "none",
                _spacing,
            )
        self._changes["scale"] = {"spacing_m": given}

    def serial_ports(self, port: str | None, receiver: str | None) -> None:
        """Ask for the port that poses are sent on, and for the GPS receiver, unless given."""
        if not self._dialogue.silent:
            found = [*Path("/dev/calm-edge").glob("serial-*")]
            found += [p for kind in ("ttyUSB*", "ttyACM*") for p in Path("/dev").glob(kind)]
            for path in sorted(found):
                self._dialogue.say(f"   {path}")
        if port is None:
            question = "Serial port to send poses on, as MAVLink, such as /dev/ttyUSB0"
            port = self._dialogue.ask(question, self._base.pose_output.port or "none", str)
        if receiver is None:
            question = "GPS receiver: a serial port, or gpsd"
            receiver = self._dialogue.ask(question, self._base.gps.source or "none", str)
        self._changes["pose_output"] = {"port": "" if port == "none" else port}
        self._changes["gps"] = {"source": "" if receiver == "none" else receiver}
        print_lines([serial(self.config), gps(self.config)], sys.stderr)

    def speed(self, is_recording: bool) -> None:
        """Show or measure the speed of this computer. is_recording: it is busy."""
        found = speed.stored(self.config)
        if found is None and is_recording:
            self._dialogue.say("the service records: the speed of this computer was not measured")
            return
        if found is None and self._dialogue.confirm(
            "Measure the speed of this computer, half a minute or more", True
        ):
            self._dialogue.say("solving three windows of a rendered drive ...")
            try:
                found = speed.measure(self.config)
            except CalmEdgeError as error:
                self._dialogue.say(f"not measured: {error}")
        if found is not None:
            print_lines([found.finding()], sys.stderr)

    def write(self, path: Path) -> bool:
        """Write the changes, after asking if the file exists; False if refused.

        Raises ConfigError.
        """
        if "capture" in self._changes and not self._base.backbone.kit_file:
            self._changes["backbone"] = {"kit_file": str(path.with_suffix(".json").absolute())}
        check(self.config)
        new = self._new_keys()
        for section, values in new.items():
            for key, value in values.items():
                self._dialogue.say(f"   {section}.{key} = {toml(value)}")
        if path.exists() and not self._dialogue.confirm(f"Write this to {path}", True):
            return False
        write_keys(path, new)
        self._dialogue.say(f"wrote {path}")
        return True

    def _new_keys(self) -> dict[str, dict[str, Any]]:
        """The changes without values that the base has."""
        base = self._base.to_dict()
        new = {}
        for section, values in self._changes.items():
            differing = {k: v for k, v in values.items() if v != base[section][k]}
            if differing:
                new[section] = differing
        return new


def _brightness(seen: Sequence[Seen], source: Source) -> tuple[float, float] | None:
    """Mean grey of the next pictures of both cameras; None if one gives none."""
    for each in seen:
        each.frames.clear()
    collect(seen, source.clock, COVER_POLL_S, pictures=1)
    found = [_decoded(each.frames[-1:], gray=True) for each in seen]
    return (float(found[0][0].mean()), float(found[1][0].mean())) if all(found) else None


def _decoded(frames: Sequence[Frame], *, gray: bool) -> list[Bytes]:
    """Pictures of frames, without those that cannot be decoded."""
    found = []
    for frame in frames:
        try:
            found.append(frame.gray() if gray else frame.bgr())
        except UnreadableImage:
            continue
    return found


def _two_of(cameras: Sequence[FoundCamera], text: str) -> list[FoundCamera]:
    numbers = text.split()
    valid = {str(k): camera for k, camera in enumerate(cameras, 1)}
    if len(numbers) != 2 or len({*numbers}) != 2 or not {*numbers} <= {*valid}:
        raise ValueError("give two of the numbers, such as 1 2")
    return [valid[number] for number in numbers]


def _one_of(*words: str) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in words:
            raise ValueError(f"one of {', '.join(words)}")
        return text

    return read


def _spacing(text: str) -> float:
    if text == "none":
        return 0.0
    metres = metres_of(text)
    if not SPACING_M[0] <= metres <= SPACING_M[1]:
        raise ValueError(f"{metres:g} m: {SPACING_M[0]:g} to {SPACING_M[1]:g} m can be meant")
    return metres
