"""The parser against pymavlink's encoder, and on arbitrary bytes."""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v10 import common as peer_1
from pymavlink.dialects.v20 import common as peer

from calm_edge.pose_output import mavlink_parser
from calm_edge.pose_output.mavlink import Encoder, Heartbeat, SystemState, Timesync, checksum
from calm_edge.pose_output.mavlink_parser import MavlinkParser, Received


def link(dialect: Any = peer) -> Any:
    return dialect.MAVLink(None, srcSystem=9, srcComponent=1)


def request(ts1: int, dialect: Any = peer) -> bytes:
    return bytes(dialect.MAVLink_timesync_message(0, ts1).pack(link(dialect)))


def other() -> bytes:
    return bytes(peer.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(link()))


def parser() -> MavlinkParser:
    return MavlinkParser((Timesync,))


def times(messages: list[Received]) -> list[int]:
    return [Timesync.from_payload(m.payload).ts1_ns for m in messages]


@pytest.mark.parametrize("dialect", [peer, peer_1])
def test_a_request_is_parsed_with_its_sender(dialect: Any) -> None:
    (got,) = parser().feed(request(123_456_789_012_345, dialect))
    assert (got.system_id, got.component_id, got.message_id) == (9, 1, Timesync.ID)
    assert Timesync.from_payload(got.payload) == Timesync(0, 123_456_789_012_345)


def test_the_target_is_parsed() -> None:
    asked = Timesync(0, 77, (1, 197))
    (got,) = parser().feed(Encoder().encode(asked))
    assert Timesync.from_payload(got.payload) == asked


def test_a_signed_message_and_the_one_after_it_are_parsed() -> None:
    sender = link()
    sender.signing.secret_key = bytes(32)
    sender.signing.sign_outgoing = True
    signed = bytes(peer.MAVLink_timesync_message(0, 5).pack(sender))
    assert len(signed) > len(request(5)) + 12
    assert times(parser().feed(signed + request(6))) == [5, 6]


def test_messages_with_unknown_flags_are_dropped() -> None:
    data = bytearray(request(5))
    data[2] = 0x02
    assert parser().feed(bytes(data)) == []


def test_feeding_single_bytes_gives_the_same_messages() -> None:
    data = b"\xfd\xfe" + request(1) + other() + request(2, peer_1) + b"\xfd"
    by_byte = parser()
    got = [m for k in range(len(data)) for m in by_byte.feed(data[k : k + 1])]
    assert got == parser().feed(data)
    assert times(got) == [1, 2]


def test_a_false_header_hides_no_message() -> None:
    # headers that announce 255 bytes: of an unknown type, and of the known one
    unknown = b"\xfd\xff\x00\x00\x00\x01\x01\x00\x00\x00"
    known = b"\xfd\xff\x00\x00\x00\x01\x01\x6f\x00\x00"
    one = parser()
    assert times(one.feed(unknown + request(3))) == [3]
    got = one.feed(known + request(4))
    # the parser waits for the announced bytes, and no longer
    got += one.feed(bytes(260))
    assert times(got) == [4]


@given(st.lists(st.integers(0, 2**62), max_size=5), st.data())
@settings(deadline=None)
def test_every_request_is_found_among_other_messages_in_any_pieces(
    asked: list[int], data: st.DataObject
) -> None:
    stream = b"".join(other() + request(t) for t in asked)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    one = parser()
    got: list[Received] = []
    for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        got += one.feed(stream[a:b])
    assert times(got) == asked


SOUND = b"".join(
    [
        request(2**40 + 17),
        Encoder().encode(Heartbeat(SystemState.ACTIVE)),
        request(99, peer_1),
        Encoder().encode(Timesync(5, 6, (1, 197))),
    ]
)


def mutated(rng: random.Random) -> bytes:
    """A valid stream with bytes flipped, removed, repeated or inserted."""
    data = bytearray(SOUND)
    for _ in range(rng.randint(1, 6)):
        at = rng.randint(0, max(0, len(data) - 1))
        match rng.randint(0, 3):
            case 0 if data:
                data[at] = rng.choice([0, 1, 0x6F, 0xFD, 0xFE, 0xFF])
            case 1:
                del data[at : at + rng.randint(1, 30)]
            case 2:
                data[at:at] = data[at : at + rng.randint(1, 60)]
            case _:
                data[at:at] = rng.randbytes(rng.randint(0, 40))
    return bytes(data)


# one parser for all examples, so that bytes left over from one precede the next
_hardened = MavlinkParser((Timesync, Heartbeat))


def test_arbitrary_bytes_do_not_harm_the_parser() -> None:
    # not by hypothesis, whose bookkeeping takes ten times as long as 10,000 examples do
    rng = random.Random(0)
    parsed = 0
    for _ in range(10_000):
        data = mutated(rng)
        for message in _hardened.feed(data):
            assert message.message_id in (Timesync.ID, Heartbeat.ID), data.hex()
            Timesync.from_payload(message.payload)
            parsed += 1
        assert len(_hardened._pending) < 300, data.hex()
    # most of the streams have a message left whole
    assert parsed > 10_000


def test_the_parser_still_works_after_arbitrary_bytes() -> None:
    # enough bytes to complete any false header
    _hardened.feed(bytes(300))
    assert times(_hardened.feed(request(7))) == [7]


def test_checksum_work_per_byte_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    checked = 0

    def counting(data: bytes) -> int:
        nonlocal checked
        checked += len(data)
        return checksum(data)

    monkeypatch.setattr(mavlink_parser, "checksum", counting)
    # every tenth byte starts a valid header of a message with a wrong checksum
    liar = b"\xfd\xff\x00\x00\x00\x01\x01\x6f\x00\x00"
    assert parser().feed(liar * 1000) == []
    # each byte is summed once for every header that covers it
    assert 0 < checked <= 28 * len(liar) * 1000
