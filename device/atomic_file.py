"""Replace files atomically: after a power cut the old or the new content is complete."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from stat import S_IMODE


def replace_text(path: Path, text: str) -> None:
    """Write text to a file atomically and sync it to disk; an existing file keeps its mode.

    Raises OSError; an existing file is then unchanged.
    """
    part = path.with_name(path.name + ".part")
    try:
        with part.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if path.exists():
            part.chmod(S_IMODE(path.stat().st_mode))
        part.replace(path)
        sync_folder(path.parent)
    except OSError:
        with suppress(OSError):
            part.unlink()
        raise


def sync_folder(folder: Path) -> None:
    """Sync a folder to disk: files created, renamed or removed in it; raises OSError."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
