"""Who may open the live page: on which address it is served, to which names, with which token."""

from __future__ import annotations

import fcntl
import hmac
import ipaddress
import re
import secrets
import socket
import struct
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from calm_edge.config import ConfigError
from device.atomic_file import replace_text

# may stand in an address and in a cookie as it is
_TOKEN = re.compile(r"[A-Za-z0-9_-]{8,}")
_SIOCGIFADDR = 0x8915
_LOOPBACK_NAMES = {"localhost", "127.0.0.1", "[::1]"}


@dataclass(frozen=True, slots=True)
class Address:
    """An IP address of this computer and a TCP port; port 0: a free one."""

    host: str
    port: int

    @property
    def loopback(self) -> bool:
        """Whether only this computer reaches it."""
        return ipaddress.ip_address(self.host).is_loopback

    @property
    def any(self) -> bool:
        """Whether it stands for all addresses of this computer."""
        return ipaddress.ip_address(self.host).is_unspecified

    @property
    def url(self) -> str:
        return url(self.host, self.port)


def url(host: str, port: int) -> str:
    """Address of the page in a browser, without the token."""
    return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"


def parse_address(text: str) -> Address:
    """Read `HOST:PORT`, the host an IP address (of IPv6 in brackets); raises ConfigError."""
    host, colon, port = text.rpartition(":")
    bare = "127.0.0.1" if host == "localhost" else host.removeprefix("[").removesuffix("]")
    with suppress(ValueError):
        in_brackets = ipaddress.ip_address(bare).version == 6
        valid = colon and port.isdecimal() and int(port) < 1 << 16
        if valid and host.startswith("[") == in_brackets:
            return Address(bare, int(port))
    raise ConfigError(
        f"--address {text}: expected an IP address of this computer and a port, e.g. "
        "127.0.0.1:8600, 192.168.4.1:8600, or 0.0.0.0:8600 for all its addresses"
    )


def own_addresses(interfaces: Path = Path("/sys/class/net")) -> list[str]:
    """IPv4 addresses of this computer's network interfaces, without the loopback one.

    By ioctl, which needs neither a name server nor a route, as on a hotspot, nor netlink.
    """
    found = []
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for name in sorted(path.name for path in interfaces.iterdir()):
            # an interface without an address raises
            with suppress(OSError):
                request = struct.pack("256s", name.encode()[:15])
                answer = fcntl.ioctl(probe.fileno(), _SIOCGIFADDR, request)
                found.append(socket.inet_ntoa(answer[20:24]))
    return [text for text in found if not ipaddress.ip_address(text).is_loopback]


def new_token() -> str:
    """A token that nobody can guess."""
    return secrets.token_urlsafe(12)


def token_of(file: Path) -> str:
    """Token in a file; a new one is written there if the file is missing. Raises ConfigError."""
    try:
        if not file.exists():
            file.touch(mode=0o600)
            replace_text(file, new_token() + "\n")
        token = file.read_text("utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no text"
        raise ConfigError(f"--token-file {file}: {reason}; name a file of yours") from None
    if not _TOKEN.fullmatch(token):
        raise ConfigError(
            f"--token-file {file}: a token has at least 8 letters, digits, - and _; remove the "
            "file for a new one"
        )
    return token


@dataclass(frozen=True, slots=True)
class Access:
    """Rules for requests. token: empty on loopback, if none was chosen."""

    token: str = ""

    def knows(self, offered: str) -> bool:
        """Whether a token offered is the right one; anything is, if there is none."""
        return not self.token or hmac.compare_digest(offered.encode(), self.token.encode())

    def serves(self, host: str) -> bool:
        """Whether to answer a request for this `Host`.

        Without a token only this computer's own names are: another site that has its name point
        to the loopback address could use the page otherwise.
        """
        if self.token:
            return True
        name = host if host.endswith("]") else host.rpartition(":")[0] or host
        return name.lower() in _LOOPBACK_NAMES
