"""Where a recording offers its live results: a Unix socket that only its user may open."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from calm_edge.config import ConfigError

NAME = "live.sock"
# sockaddr_un holds 108 bytes with a zero at the end
LONGEST_BYTES = 107


def default_socket() -> Path:
    """The socket in this user's folder for such, which is made if it is not there.

    That of systemd ($RUNTIME_DIRECTORY, $XDG_RUNTIME_DIR), else one in the folder for temporary
    files. Raises ConfigError if that belongs to somebody else.
    """
    if of_unit := os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]:
        return Path(of_unit) / NAME
    of_user = os.environ.get("XDG_RUNTIME_DIR", "")
    if of_user and Path(of_user).is_dir():
        folder = Path(of_user) / "calm-edge"
    else:
        folder = Path(tempfile.gettempdir()) / f"calm-edge-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        raise ConfigError(f"{folder}: {error.strerror}; give live.socket another path") from None
    if found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise ConfigError(
            f"{folder}: others have access to it; remove it, or give live.socket another path"
        )
    return folder / NAME


def check_length(path: Path) -> None:
    """Raise ConfigError for a path that is too long for a socket."""
    if len(os.fsencode(path)) > LONGEST_BYTES:
        raise ConfigError(
            f"live.socket = {path}: longer than the {LONGEST_BYTES} bytes of a socket's path; "
            "choose a shorter one"
        )
