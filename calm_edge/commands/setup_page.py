"""`calm-edge setup --page`: the choices are made on a page while both cameras are watched."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calm_edge.commands import service_start, setup_choices, setup_views, speed
from calm_edge.commands.covering import CoveringError, covered
from calm_edge.commands.finding import Finding
from calm_edge.commands.setup_choices import NONE, Choices
from calm_edge.commands.setup_state import SetupState, Stage
from calm_edge.daemon.source import live, of_sequence
from calm_edge.live.board import Board
from calm_edge.live.wire import Message
from calm_edge.types import CalmEdgeError
from device.camera import discover
from device.camera_thread import CameraState
from device.clock import Clock
from device.errors import DeviceError
from device.watching import Seen, collect, running

if TYPE_CHECKING:
    from collections.abc import Iterator

# between two looks for cameras; two pictures of each; two judgements
LOOK_S, PICTURE_S, CHECK_S = 2.0, 0.5, 3.0
COVER_POLLS = 200
LONGEST_TEXT = 200


class SetupError(CalmEdgeError):
    """A request of the page that cannot be met."""


class SetupPage:
    """Watches the cameras in the caller's thread; takes the page's requests from others.

    path: the file to write. sequence: a folder in place of cameras. given: addresses of primary and
    assistant, or None. startable: the file is that of the installed service. board: what the page
    shows.
    """

    def __init__(
        self,
        choices: Choices,
        path: Path,
        board: Board[Message],
        *,
        sequence: Path | None = None,
        given: tuple[str | None, str | None] = (None, None),
        startable: bool = False,
    ) -> None:
        self._choices, self._board = choices, board
        self._sequence, self._given = sequence, given
        # of the choices and the state, which the threads of the server change too
        self._lock = threading.Lock()
        self._state = SetupState(path, startable)
        self._again, self._ended = threading.Event(), threading.Event()
        self._job = ""
        self.written = False
        self.requests: dict[str, Callable[[Mapping[str, Any]], None]] = {
            "pair": self._take_pair,
            "cover": lambda content: self._begin("cover"),
            "spacing": self._take_spacing,
            "ports": self._take_ports,
            "speed": lambda content: self._begin("speed"),
            "write": self._write,
            "start": lambda content: self._begin("start"),
            "finish": lambda content: self._finish(),
        }
        with self._shown():
            self._state.speed = _speed_finding(speed.stored(choices.config))

    @property
    def findings(self) -> Sequence[Finding]:
        """The newest traffic lights of the cameras."""
        return self._state.lights

    def ask(self, kind: str, content: Mapping[str, Any]) -> bool:
        """Meet a request of the page; raises CalmEdgeError with why it cannot be met."""
        with self._shown():
            self._state.notice = ""
            try:
                self.requests[kind](content)
            except DeviceError as error:
                raise SetupError(str(error)) from None
        return True

    def run(self, stopped: threading.Event) -> None:
        """Watch until the page finishes or `stopped` is set."""
        while not (stopped.is_set() or self._ended.is_set()):
            self._again.clear()
            try:
                if self._job == "speed":
                    self._measure_speed()
                elif self._job == "start":
                    self._start()
                elif not self._find():
                    self._pause(stopped, LOOK_S)
                else:
                    self._watch(stopped)
            except (CalmEdgeError, DeviceError) as error:
                self._stage(Stage.FAULT, str(error))
                self._pause(stopped, LOOK_S)
        self._stage(Stage.ENDED)

    @contextmanager
    def _shown(self) -> Iterator[None]:
        """Change choices or state, then show them."""
        with self._lock:
            yield
            self._board.put("setup", Message("setup", self._state.content(self._choices)))

    def _stage(self, stage: Stage, text: str = "") -> None:
        with self._shown():
            self._state.stage, self._state.text = stage, text

    def _pause(self, stopped: threading.Event, seconds: float) -> None:
        """Wait until something is asked for, at most some seconds."""
        end = time.monotonic() + seconds
        while not (stopped.is_set() or self._again.is_set()) and time.monotonic() < end:
            self._again.wait(min(0.1, seconds))

    # requests, in threads of the server, with the lock held

    def _begin(self, job: str) -> None:
        """Have the watching thread do what takes long."""
        if self._job:
            raise SetupError(f"{self._job} has not ended yet; wait for it")
        if job == "cover" and not self._choices.pair:
            raise SetupError("there are not two cameras that could be covered")
        if job == "start" and not (self.written and self._state.startable):
            raise SetupError("write the configuration of the installed service first")
        self._job = job
        if job != "cover":
            self._again.set()

    def _take_pair(self, content: Mapping[str, Any]) -> None:
        addresses = _text(content, "primary"), _text(content, "assistant")
        pair = self._choices.pair
        if not pair:
            raise SetupError("there are not two cameras to choose from")
        if addresses[0] == addresses[1]:
            raise SetupError(f"{addresses[0]}: choose two different cameras")
        self._choices.take(setup_choices.arranged(pair, self._state.cameras, *addresses))
        self._again.set()

    def _take_spacing(self, content: Mapping[str, Any]) -> None:
        text = _text(content, "text") or NONE
        try:
            self._choices.set_spacing(setup_choices.spacing_of(text))
        except ValueError as error:
            raise SetupError(str(error)) from None

    def _take_ports(self, content: Mapping[str, Any]) -> None:
        self._choices.set_ports(_text(content, "port") or NONE, _text(content, "gps") or NONE)

    def _write(self, content: Mapping[str, Any]) -> None:
        if not self._choices.has_cameras and self._sequence is None:
            raise SetupError("two cameras are needed first")
        self._choices.write(self._state.path)
        self.written = self._state.written = True

    def _finish(self) -> None:
        self._ended.set()
        self._again.set()

    # in the watching thread

    def _find(self) -> bool:
        """Find two cameras, or keep those chosen; False if there are not two."""
        if self._sequence is not None:
            return True
        if all(self._given):
            with self._shown():
                self._choices.take_addresses(*(address or "" for address in self._given))
            return True
        cameras = setup_choices.usable(discover(details=False)[0])
        with self._shown():
            self._state.cameras = cameras
            kept = [camera for camera in self._choices.pair if camera in cameras]
            if len(cameras) < 2:
                self._state.stage, self._state.text = Stage.FEW, ""
            elif len(kept) < 2:
                pair = setup_choices.proposed(cameras, self._choices.base.capture)
                self._choices.take(setup_choices.arranged(pair, cameras, *self._given))
        return len(cameras) >= 2

    def _watch(self, stopped: threading.Event) -> None:
        """Show and judge the pictures until something else is to be done. Raises CameraError."""
        with self._lock:
            config = self._choices.config
        source = live(config) if self._sequence is None else of_sequence(self._sequence, True)
        self._stage(Stage.OPENING, source.description)
        with running(source.open()) as seen:
            self._stage(Stage.SETTLING)
            judge_s = time.monotonic() + setup_views.SETTLE_S
            settled = False
            while not (stopped.is_set() or self._again.is_set() or self._ended.is_set()):
                collect(seen, source.clock, PICTURE_S, pictures=setup_views.PICTURES)
                self._show(seen)
                if self._job == "cover":
                    self._cover(seen, source.clock, stopped)
                elif time.monotonic() >= judge_s:
                    if settled:
                        self._judge(seen)
                    for each in seen:
                        each.frames.clear()
                    settled = True
                    judge_s = time.monotonic() + CHECK_S
                if not any(each.thread.state is CameraState.RUNNING for each in seen):
                    # a replay begins anew; cameras that failed are opened again
                    if self._sequence is None:
                        self._judge(seen)
                        self._pause(stopped, LOOK_S)
                    return

    def _show(self, seen: Sequence[Seen]) -> None:
        for eye, each in zip(("primary", "assistant"), seen, strict=True):
            picture = setup_views.newest(each)
            if picture is not None:
                self._board.put(eye, Message(eye, {}, setup_views.small_jpeg(picture)))

    def _judge(self, seen: Sequence[Seen]) -> None:
        found = setup_views.findings(seen, self._choices)
        with self._shown():
            self._state.lights = found
            self._state.stage, self._state.text = Stage.JUDGED, ""

    def _cover(self, seen: Sequence[Seen], clock: Clock, stopped: threading.Event) -> None:
        """Make the camera whose lens is covered the primary."""
        self._stage(Stage.COVERING)

        def grey() -> tuple[float, float] | None:
            if stopped.is_set() or self._ended.is_set():
                raise CoveringError("ended before a lens was covered")
            found = setup_views.brightness(seen, clock)
            self._show(seen)
            return found

        try:
            index = covered(grey, COVER_POLLS)
        except CoveringError as error:
            self._end_job(str(error))
            return
        with self._shown():
            if index:
                self._choices.swap()
            self._state.stage = Stage.COVERED
        self._end_job()
        self._pause(stopped, LOOK_S)
        self._again.set()

    def _measure_speed(self) -> None:
        self._stage(Stage.MEASURING)
        try:
            found = speed.measure(self._choices.config)
        except CalmEdgeError as error:
            self._end_job(f"the speed was not measured: {error}")
            return
        with self._shown():
            self._state.speed = _speed_finding(found)
        self._end_job()

    def _start(self) -> None:
        """Start the service, which needs the cameras, and end."""
        self._stage(Stage.STARTING)
        self._state.started = service_start.run_as_root(service_start.COMMAND, ask=False)
        if self._state.started:
            self._finish()
        self._end_job("" if self._state.started else f"not started; type: {service_start.BY_HAND}")

    def _end_job(self, notice: str = "") -> None:
        with self._shown():
            self._job, self._state.notice = "", notice


def _speed_finding(found: speed.Speed | None) -> Finding | None:
    return None if found is None else found.finding()


def _text(content: Mapping[str, Any], key: str) -> str:
    """A text of a request; raises SetupError for anything else."""
    value = content.get(key)
    if not isinstance(value, str) or len(value) > LONGEST_TEXT:
        raise SetupError(f"{key}: expected a text of at most {LONGEST_TEXT} characters")
    return value.strip()
