"""A recording in the standard MCAP reader, and the layout for Foxglove that shows it."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from google.protobuf.message import Message
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from calm_edge.recording import json_schemas, schema, time_base
from calm_edge.recording.writer import RecordingWriter
from device.frame import Eye
from tests.recording import samples

LAYOUT = Path(__file__).parents[2] / "deploy" / "foxglove" / "calm-edge.json"
JSON_TOPICS = {
    schema.CLOCK: json_schemas.CLOCK,
    schema.HEALTH: json_schemas.HEALTH,
    schema.KIT: json_schemas.KIT,
    schema.EVENT: json_schemas.EVENT,
}


def numbers(message: Message) -> Iterator[float]:
    """All floating-point numbers in a message and those nested in it."""
    for field, value in message.ListFields():
        for item in value if field.is_repeated else [value]:
            if isinstance(item, Message):
                yield from numbers(item)
            elif isinstance(item, float):
                yield item


def recorded(folder: Path) -> Path:
    base = time_base.of_stamps(10**9, samples.T0_NS, lockstep=True)
    settings = samples.config(chunk_bytes=8192)
    with RecordingWriter(folder, settings, lossless=True, time_base=base) as writer:
        for k in range(12):
            for eye in Eye:
                writer.write_frame(samples.frame(eye, k))
            writer.write_pose(samples.pose(k))
            writer.write_log(20, "line")
        writer.write_update(samples.update(2))
        # of a window that was solved again
        writer.write_update(samples.update(1))
        writer.write_status({"pose_age_ms": math.nan, "tick": {"p50_ms": 1.0}}, schema.HEALTH)
        writer.write_event(samples.T0_NS, "here")
    return folder / "0000.mcap"


def test_every_message_decodes_in_order_of_log_time_and_holds_no_nan(tmp_path: Path) -> None:
    seen: dict[str, int] = {}
    with recorded(tmp_path).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        previous_ns = time_base.DATED_NS
        published: dict[str, int] = {}
        for kind, channel, message in reader.iter_messages(log_time_order=False):
            assert kind is not None and message.log_time >= previous_ns
            previous_ns = message.log_time
            # viewers that sort by it must not have to: rerun's check requires that
            assert message.publish_time >= published.get(channel.topic, 0), channel.topic
            published[channel.topic] = message.publish_time
            seen[channel.topic] = seen.get(channel.topic, 0) + 1
            if kind.encoding == "jsonschema":
                json.loads(kind.data)
                json.loads(message.data, parse_constant=lambda text: 1 / 0)
        foxglove = [t for t in seen if schema.topic_schema(t).name.startswith("foxglove.")]
        for _, channel, _, decoded in reader.iter_decoded_messages(topics=foxglove):
            assert all(map(math.isfinite, numbers(decoded))), channel.topic
    assert {schema.TF, schema.POSE_LIVE, schema.PATH, schema.CLOUD, schema.KIT, schema.LOG} <= set(
        seen
    )


def texts(value: Any) -> Iterator[str]:
    """All texts and keys in a JSON value."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield key
            yield from texts(item)
    elif isinstance(value, list):
        for item in value:
            yield from texts(item)
    elif isinstance(value, str):
        yield value


def test_the_layout_shows_topics_and_numbers_that_are_recorded() -> None:
    layout = json.loads(LAYOUT.read_text())
    named = {text for text in texts(layout) if text.startswith("/")}
    plotted = {text for text in named if "." in text}
    assert named - plotted <= set(schema.TOPICS)
    assert {*schema.IMAGE_TOPICS.values(), schema.PATH, schema.CLOUD} <= named
    assert len(plotted) == 9
    for text in plotted:
        topic, *names = text.split(".")
        node = JSON_TOPICS[topic]
        for name in names:
            node = (
                node["properties"][name] if "properties" in node else node["additionalProperties"]
            )
        assert "number" in node["type"], text


def test_the_panels_of_the_layout_are_configured_once() -> None:
    layout = json.loads(LAYOUT.read_text())
    placed = re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"]))
    assert sorted(placed) == sorted(layout["configById"])
