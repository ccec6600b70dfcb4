"""Messages on the socket, also those that are none."""

from __future__ import annotations

import io
import json
import struct

import numpy as np
import pytest

from calm_edge.live.wire import LIMIT_BYTES, Message, WireError, receive


def test_messages_come_back_one_after_the_other() -> None:
    sent = [
        Message("picture", {"t_ns": 7, "points": [[1.5, 2.0]]}, b"\xff\xd8"),
        Message("beat", {}),
    ]
    stream = io.BytesIO(b"".join(message.encoded() for message in sent))
    assert [receive(stream), receive(stream), receive(stream)] == [*sent, None]


def test_numbers_that_json_lacks_become_null() -> None:
    message = Message("kit", {"sigma": np.inf, "rows": [[float("nan"), 1.0]]})
    found = receive(io.BytesIO(message.encoded()))
    assert found is not None and found.content == {"sigma": None, "rows": [[None, 1.0]]}


def framed(text: bytes, announced: int | None = None) -> bytes:
    return struct.pack("!II", len(text) if announced is None else announced, 0) + text


@pytest.mark.parametrize(
    "data",
    [
        b"\x00\x00",
        framed(b"{}", 9),
        framed(b"not json"),
        framed(b"[1]"),
        framed(json.dumps({"kind": 3}).encode()),
        framed(b"{}"),
        framed(b"", LIMIT_BYTES + 1),
        framed(b"[" * 100_000),
    ],
)
def test_other_bytes_raise(data: bytes) -> None:
    with pytest.raises(WireError):
        receive(io.BytesIO(data))
