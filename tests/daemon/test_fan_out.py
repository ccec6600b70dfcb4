"""A slow or failing output loses only its own messages, which are counted, and delays no other."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import pytest

from calm_edge.daemon import fan_out
from calm_edge.daemon.fan_out import FanOut, Output
from calm_edge.daemon.messages import Event, Keep
from calm_edge.daemon.result import RecordResult
from device.frame import Eye, Frame


class Kept(Output):
    """Output that keeps every line."""

    name, immediate = "kept", True

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.ticks: list[int] = []
        self.closed: RecordResult | None = None

    def say(self, level: int, text: str, name: str) -> None:
        self.lines.append(text)

    def tick(self, now_ns: int) -> None:
        self.ticks.append(now_ns)

    def close(self, result: RecordResult) -> None:
        self.closed = result
        # the losses of the other outputs have been counted by now
        self.losses_when_closed = dict(result.output_losses)


class Queued(Kept):
    """The same output with a queue and a thread of its own."""

    name, immediate = "queued", False


class Blocking(Queued):
    """Blocks in its first line until `go` is set."""

    name, queue_bytes = "blocking", 4 * fan_out.MESSAGE_BYTES

    def __init__(self) -> None:
        super().__init__()
        self.busy, self.go = threading.Event(), threading.Event()

    def say(self, level: int, text: str, name: str) -> None:
        self.busy.set()
        self.go.wait(60)
        super().say(level, text, name)


class Raising(Kept):
    """Raises on every other line."""

    name = "raising"

    def say(self, level: int, text: str, name: str) -> None:
        if int(text) % 2:
            raise ValueError(text)
        super().say(level, text, name)


class RaisingQueued(Raising):
    name, immediate = "raising queued", False


def say(outputs: FanOut, count: int, start: int = 0) -> list[str]:
    texts = [str(i) for i in range(start, start + count)]
    for text in texts:
        outputs.give(lambda output, text=text: output.say(0, text, ""))  # type: ignore[misc]
    return texts


def test_every_output_receives_every_message_in_order() -> None:
    first, second = Kept(), Queued()
    outputs = FanOut([first, second])
    texts, result = say(outputs, 50), RecordResult()
    outputs.close(result)
    assert first.lines == second.lines == texts
    assert first.closed is second.closed is result
    assert result.output_losses == {"kept": 0, "queued": 0}
    assert not list(outputs.faults())


def test_a_blocking_output_delays_no_other_and_loses_the_oldest_messages(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(fan_out, "CLOSE_S", 10.0)
    other, blocking = Kept(), Blocking()
    outputs = FanOut([other, blocking])
    texts = say(outputs, 1)
    assert blocking.busy.wait(10)
    start_s = time.monotonic()
    texts += say(outputs, 1000, 1)
    assert time.monotonic() - start_s < 1.0
    assert other.lines == texts
    # one being processed, four in the queue
    assert outputs.lost() == {"kept": 0, "blocking": 996}
    blocking.go.set()
    outputs.close(RecordResult())
    assert blocking.lines == [texts[0], *texts[-4:]]
    assert blocking.closed is not None and outputs.lost()["blocking"] == 996


def test_close_does_not_wait_for_a_blocking_output(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fan_out, "CLOSE_S", 0.2)
    other, blocking = Kept(), Blocking()
    outputs = FanOut([other, blocking])
    texts, result = say(outputs, 1), RecordResult()
    assert blocking.busy.wait(10)
    texts += say(outputs, 3, 1)
    start_s = time.monotonic()
    outputs.close(result)
    assert time.monotonic() - start_s < 2.0
    assert other.lines == texts and other.closed is result
    # four lines and the close; the first output is closed last and receives the count
    assert result.output_losses["blocking"] == 5
    assert other.losses_when_closed["blocking"] == 5
    blocking.go.set()


@pytest.mark.parametrize("make", [Raising, RaisingQueued])
def test_an_exception_loses_its_message_and_is_a_fault_for_a_time(
    make: Callable[[], Raising], monkeypatch: pytest.MonkeyPatch
) -> None:
    raising, other = make(), Kept()
    outputs = FanOut([raising, other])
    texts = say(outputs, 10)
    end_s = time.monotonic() + 10
    while outputs.lost()[raising.name] < 5 and time.monotonic() < end_s:
        time.sleep(0.01)
    assert list(outputs.faults()) == [f"{raising.name}: ValueError('9')"]
    texts += say(outputs, 1, 10)
    outputs.close(RecordResult())
    assert raising.lines == [*texts[:10:2], "10"] and other.lines == texts
    assert outputs.lost() == {raising.name: 5, "kept": 0}
    monkeypatch.setattr(fan_out, "FAULT_S", 0.0)
    assert not list(outputs.faults())


def test_an_exception_of_a_required_output_ends_the_run() -> None:
    class Required(Raising):
        required = True

    outputs = FanOut([Required()])
    with pytest.raises(ValueError, match="1"):
        say(outputs, 2)
    assert outputs.lost() == {}


def test_what_people_ask_for_is_collected_from_every_output() -> None:
    class Asking(Kept):
        def __init__(self, *requests: Event | Keep) -> None:
            super().__init__()
            self.pending = requests

        def requests(self) -> Sequence[Event | Keep]:
            taken, self.pending = self.pending, ()
            return taken

    class AskingQueued(Asking):
        name, immediate = "asking queued", False

    event, keep = Event(7, "here"), Keep(True)
    outputs = FanOut([Kept(), Asking(event), AskingQueued(keep)])
    assert list(outputs.requests()) == [event, keep]
    assert list(outputs.requests()) == []
    outputs.close(RecordResult())


def test_frames_go_to_the_outputs_that_want_them() -> None:
    class Framed(Kept):
        def __init__(self, wanted: bool) -> None:
            super().__init__()
            self.wants_frames = wanted
            self.frames: list[Frame] = []

        def frame(self, frame: Frame) -> None:
            self.frames.append(frame)

    wanting, other = Framed(True), Framed(False)
    outputs = FanOut([wanting, other])
    frame = Frame(Eye.PRIMARY, 0, 7, b"jpeg")
    outputs.frame(frame)
    outputs.close(RecordResult())
    assert wanting.frames == [frame] and other.frames == []


def test_ticks_go_to_immediate_outputs_only() -> None:
    first, second = Kept(), Queued()
    outputs = FanOut([first, second])
    outputs.tick(7)
    outputs.close(RecordResult())
    assert first.ticks == [7] and second.ticks == []
