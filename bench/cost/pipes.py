"""Traffic between the processes of `record` in bytes, and their processor time.

Records a sequence folder once in lockstep and counts what passes the pipes of the capture process,
by direction and type of message.
"""

from __future__ import annotations

import argparse
import pickle
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any
from unittest.mock import patch

from bench.cost.load import cpu_seconds
from bench.tables import OUT, Table, publish
from calm_edge import cli
from calm_edge.daemon import estimator_link, tracker_link
from calm_edge.daemon.child import Child
from calm_edge.daemon.messages import FrameIn
from calm_edge.recording.reader import Recording
from device.frame import Eye

# types of messages that contain pictures
PICTURES = ("Process", "Expect")
MB = 1e6


@dataclass(slots=True)
class Tally:
    """Traffic and processor time of one recording.

    messages, sent: number and bytes by (from, to, type of message). cpu_s: by process.
    """

    messages: defaultdict[tuple[str, str, str], int] = field(
        default_factory=lambda: defaultdict(int)
    )
    sent: defaultdict[tuple[str, str, str], int] = field(default_factory=lambda: defaultdict(int))
    cpu_s: dict[str, float] = field(default_factory=dict)

    def count(self, source: str, target: str, kind: str, size: int) -> None:
        """Count one message of `size` bytes."""
        self.messages[source, target, kind] += 1
        self.sent[source, target, kind] += size


class CountedPipe:
    """Connection that counts the messages it sends and receives in a Tally."""

    def __init__(self, pipe: Connection, child: str, tally: Tally) -> None:
        self._pipe, self._child, self._tally = pipe, child, tally

    def send(self, message: Any) -> None:
        """Count and send a message, as Connection.send does."""
        data = ForkingPickler.dumps(message)
        self._tally.count("capture", self._child, type(message).__name__, len(data))
        if isinstance(message, FrameIn):
            self._tally.count("capture", self._child, "shared memory", message.size)
        self._pipe.send_bytes(data)

    def recv(self) -> Any:
        """Receive and count a message, as Connection.recv does."""
        data = self._pipe.recv_bytes()
        message = pickle.loads(data)
        self._tally.count(self._child, "capture", type(message).__name__, len(data))
        return message


@contextmanager
def counted() -> Iterator[Tally]:
    """Context in which the pipes of new child processes are counted."""
    tally = Tally()

    class CountedChild(Child):
        @property
        def _connection(self) -> Any:
            return self._counted

        @_connection.setter
        def _connection(self, pipe: Connection) -> None:
            self._counted = CountedPipe(pipe, self.name, tally)

        def stop(self, message: Any, timeout_s: float) -> None:
            tally.cpu_s[self.name] = cpu_seconds(self.pid)
            super().stop(message, timeout_s)

    with (
        patch.object(tracker_link, "Child", CountedChild),
        patch.object(estimator_link, "Child", CountedChild),
    ):
        began_s = time.process_time()
        yield tally
        tally.cpu_s["capture"] = time.process_time() - began_s


def picture_bytes(recording: Recording) -> int:
    """Total size [bytes] of the pictures in all windows, each picture counted once."""
    held = {key for record in recording.windows() for key in record.frame_keys}
    frames = (recording.frame(Eye(eye), sequence, t_ns) for eye, sequence, t_ns in held)
    return sum(len(f.image) for f in frames if isinstance(f.image, bytes))


def table(tally: Tally, pictures: int, command: str) -> Table:
    """Table with a row for each direction and type of message, largest first, then totals."""
    kinds = sorted(tally.sent, key=lambda key: (key[:2], -tally.sent[key]))
    rows: list[tuple[Any, ...]] = [
        (*key, tally.messages[key], round(tally.sent[key] / MB, 3), None)
        for key in kinds
        if tally.sent[key] > 1e3
    ]
    piped = sum(size for key, size in tally.sent.items() if key[2] != "shared memory")
    rows.append(("all", "pipes", "", sum(tally.messages.values()), round(piped / MB, 3), None))
    rows += [(name, "", "", None, None, round(s, 1)) for name, s in sorted(tally.cpu_s.items())]
    to_estimator = sum(tally.sent["capture", "estimator", kind] for kind in PICTURES)
    notes = (
        f"{pictures / MB:.3f} MB of distinct pictures in windows; "
        f"{to_estimator / pictures:.2f} times that from capture to the estimator",
        "processor time of whole processes with start-up; capture includes reading and recording",
    )
    columns = ("from", "to", "message", "count", "MB", "CPU s")
    return Table("bench_pipes", "Bytes between processes", command, columns, tuple(rows), (), notes)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--sequence", type=Path, default=Path("demo") / "drive")
    parser.add_argument("--spacing-m", type=float, default=0.5)
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Record once, print and save the table."""
    with tempfile.TemporaryDirectory(prefix="calm-edge-pipes-") as place:
        folder = Path(place) / "recording"
        arguments = ["record", "--sequence", str(options.sequence), "--pace", "lockstep"]
        arguments += ["--out", str(folder), "--spacing-m", str(options.spacing_m)]
        for setting in options.set:
            arguments += ["--set", setting]
        with counted() as tally:
            code = cli.main(arguments)
        if code:
            return code
        pictures = picture_bytes(Recording(folder))
    return publish(table(tally, pictures, options.command), options.out)
