"""Read MCAP files with Foxglove messages (protobuf, JSON) or ROS messages (CDR, ROS 1)."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap_protobuf.decoder import DecoderFactory

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.bag_topics import Topic
from calm_edge.interchange.ros_bag import require_rosbags

ENCODINGS = ("protobuf", "json", "cdr", "ros1")
Decode = Callable[[bytes], Any]


class McapBag:
    """One MCAP file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._decoders: dict[int, Decode] = {}

    def topics(self) -> list[Topic]:
        """Topics whose encoding can be decoded, by the file's summary."""
        try:
            with self._path.open("rb") as file:
                summary = make_reader(file).get_summary()
        except (McapError, OSError, EOFError) as error:
            raise self._damaged(error) from None
        if summary is None or summary.statistics is None:
            raise InterchangeError(f"{self._path}: has no summary; repair it (mcap recover)")
        counts = summary.statistics.channel_message_counts
        found: dict[str, Topic] = {}
        for channel in summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            if schema is None or channel.message_encoding not in (
                "protobuf",
                "json",
                "cdr",
                "ros1",
            ):
                continue
            earlier = found.get(channel.topic)
            count = counts.get(channel.id, 0) + (earlier.count if earlier else 0)
            found[channel.topic] = Topic(channel.topic, _kind(schema.name), count)
        return sorted(found.values(), key=lambda t: t.name)

    def messages(self, names: tuple[str, ...]) -> Iterator[tuple[str, int, Any]]:
        """Yield topic, log time [ns] and decoded message in order of log time."""
        try:
            with self._path.open("rb") as file:
                for schema, channel, message in make_reader(file).iter_messages(topics=names):
                    if schema is not None:
                        decoded = self._decode(schema, channel, message.data)
                        yield channel.topic, message.log_time, decoded
        except (McapError, OSError, EOFError, DecodeError) as error:
            raise self._damaged(error) from None

    def _decode(self, schema: Schema, channel: Channel, data: bytes) -> Any:
        decoder = self._decoders.get(channel.id)
        if decoder is None:
            decoder = _decoder(schema, channel)
            self._decoders[channel.id] = decoder
        return decoder(data)

    def _damaged(self, error: Exception) -> InterchangeError:
        reason = " ".join(str(error).split()) or type(error).__name__
        return InterchangeError(
            f"{self._path}: cannot be read ({reason}); repair it (mcap recover)"
        )


def _kind(name: str) -> str:
    """Message type with the `/msg/` that ROS 1 leaves out."""
    package, _, kind = name.partition("/")
    return name if not kind or kind.startswith("msg/") else f"{package}/msg/{kind}"


def _decoder(schema: Schema, channel: Channel) -> Decode:
    if channel.message_encoding == "protobuf":
        made = DecoderFactory().decoder_for("protobuf", schema)
        assert made is not None
        return made
    if channel.message_encoding == "json":
        return _json
    return _ros(schema, channel.message_encoding == "ros1")


def _json(data: bytes) -> Any:
    """A Foxglove message in JSON: bytes are base64, times have sec and nsec."""

    def named(value: dict[str, Any]) -> Any:
        if isinstance(value.get("data"), str):
            value["data"] = base64.b64decode(value["data"])
        if set(value) == {"sec", "nsec"}:
            return SimpleNamespace(sec=value["sec"], nanosec=value["nsec"])
        return SimpleNamespace(**value)

    try:
        return json.loads(data, object_hook=named)
    except ValueError as error:
        raise DecodeError(str(error)) from None


def _ros(schema: Schema, is_ros1: bool) -> Decode:
    typesys = require_rosbags().typesys
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    name, text = _kind(schema.name), schema.data.decode()
    if schema.encoding == "ros2idl":
        store.register(typesys.get_types_from_idl(text))
    else:
        store.register(typesys.get_types_from_msg(text, name))
    deserialize = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr

    def decode(data: bytes) -> Any:
        return deserialize(data, name)

    return decode
