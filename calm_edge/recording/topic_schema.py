"""Schema of a topic."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TopicSchema:
    """Schema and encoding of a topic, as in MCAP's Schema and Channel records."""

    name: str
    encoding: str
    data: bytes
    message_encoding: str
