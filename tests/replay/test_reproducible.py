"""Two lockstep recordings of the same replay hold the same messages, but for durations."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from calm_edge.cli import main
from calm_edge.recording import record as encoding
from calm_edge.recording import schema
from calm_edge.recording.reader import Recording
from tests.replay.small_drive import write_drive

# durations of the stages: what differs
TIMINGS = "stage_ms"


def messages(folder: Path) -> list[list[Any]]:
    """(topic, times, sequence, content) of all messages of a recording, in order."""
    recording, found = Recording(folder), []
    for index in recording._segments:
        for topic in schema.TOPICS:
            logged = [t for _, rows in index.topic_rows(topic) for t in rows.log_time]
            read = list(recording._messages(topic))
            assert len(read) == len(logged)
            for (place, data), t_ns in zip(read, logged, strict=True):
                content: Any = data
                if topic == schema.SUBMAP:
                    header, arrays = encoding.decode("Submap", data)
                    assert header.pop(TIMINGS) is not None
                    content = json.dumps(header), {k: v.tobytes() for k, v in arrays.items()}
                where = (place.segment, place.chunk, place.offset)
                found.append((where, topic, place.t_ns, t_ns, place.sequence, content))
    return [message for _, *message in sorted(found, key=lambda message: message[0])]


def test_all_but_durations_is_reproducible(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drive", 24)
    runs = []
    for name in ("first", "second"):
        arguments = ["record", "--sequence", str(drive), "--out", str(tmp_path / name)]
        arguments += ["--pace", "lockstep", "--spacing-m", "0.5", "--set", "frontend.n_max=4"]
        arguments += ["--set", f"backbone.name=scripted:{drive}", "--set", "frontend.n_overlap=2"]
        assert main(arguments) == 0
        runs.append(messages(tmp_path / name))
    first, second = runs
    topics = {topic for topic, *_ in first}
    assert {"/submap", "/window", "/pose/sample", "/tf", "/status"} <= topics
    assert len(first) == len(second)
    for one, other in zip(first, second, strict=True):
        assert one == other
    sessions = [Recording(tmp_path / name).metadata for name in ("first", "second")]
    assert sessions[0] == sessions[1] and sessions[0]["boot_id"] == ""
