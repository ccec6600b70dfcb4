"""Who may open the page."""

from __future__ import annotations

import socket
import stat
from pathlib import Path

import pytest

from calm_edge.config import ConfigError
from calm_edge.live.access import (
    Access,
    Address,
    new_token,
    own_addresses,
    parse_address,
    token_of,
)


@pytest.mark.parametrize(
    "text, address",
    [
        ("127.0.0.1:8600", Address("127.0.0.1", 8600)),
        ("localhost:8600", Address("127.0.0.1", 8600)),
        ("0.0.0.0:0", Address("0.0.0.0", 0)),
        ("[::1]:8600", Address("::1", 8600)),
    ],
)
def test_addresses_are_read(text: str, address: Address) -> None:
    assert parse_address(text) == address


@pytest.mark.parametrize("text", ["", "8600", "127.0.0.1", "::1:8600", "car:8600", "1.2.3.4:99999"])
def test_other_addresses_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="expected an IP address"):
        parse_address(text)


def test_an_address_knows_who_reaches_it() -> None:
    assert parse_address("127.0.0.1:1").loopback and parse_address("[::1]:1").loopback
    assert parse_address("0.0.0.0:1").any and not parse_address("0.0.0.0:1").loopback
    assert not parse_address("192.168.4.1:1").any
    assert parse_address("[::1]:80").url == "http://[::1]:80/"


def test_own_addresses_are_those_of_the_interfaces(tmp_path: Path) -> None:
    for name in ("lo", "absent0"):
        (tmp_path / name).mkdir()
    # the loopback interface is not for others, and one that is not there has no address
    assert own_addresses(tmp_path) == [] == own_addresses(tmp_path / "none")
    for text in own_addresses():
        with socket.create_server((text, 0)):
            pass


def test_with_a_token_only_that_opens_the_page() -> None:
    token = new_token()
    access = Access(token)
    assert access.knows(token) and len(token) >= 16 and new_token() != token
    assert not access.knows("") and not access.knows(token[:-1]) and not access.knows("ü" * 16)
    assert access.serves("192.168.4.1:8600") and access.serves("car.local")


def test_without_a_token_only_names_of_this_computer_are_served() -> None:
    access = Access()
    assert access.knows("") and access.knows("anything")
    for host in ("localhost:8600", "127.0.0.1:8600", "127.0.0.1", "[::1]:8600", "[::1]"):
        assert access.serves(host), host
    for host in ("evil.example", "evil.example:8600", "", "localhost.evil.example:8600"):
        assert not access.serves(host), host


def test_a_token_is_made_once_and_is_for_its_owner_alone(tmp_path: Path) -> None:
    file = tmp_path / "token"
    token = token_of(file)
    assert token_of(file) == token == file.read_text().strip()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    file.write_text("my-own-token\n")
    assert token_of(file) == "my-own-token"


@pytest.mark.parametrize(
    "content", [b"", b"short", b"with a space in it", b"semi;colon;here", b"\xff"]
)
def test_other_tokens_are_refused_with_the_remedy(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "token"
    file.write_bytes(content)
    with pytest.raises(ConfigError, match="token-file"):
        token_of(file)
    with pytest.raises(ConfigError, match="No such file"):
        token_of(tmp_path / "absent" / "token")
