"""Folder of an export: what is written there is complete or not there."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from calm_edge.interchange import InterchangeError


@contextmanager
def output_folder(out: Path, *, force: bool) -> Iterator[Path]:
    """Folder beside `out` to write to; its files are moved to `out` on success.

    On failure it is removed and `out` unchanged. force: replace files of the same names in `out`;
    others stay. Raises InterchangeError if `out` holds files and not force, or cannot be written.
    """
    if out.exists() and not out.is_dir():
        raise InterchangeError(f"{out}: is a file; give a folder")
    if out.exists() and any(out.iterdir()) and not force:
        raise InterchangeError(f"{out}: is not empty; choose another folder, or replace by --force")
    part: Path | None = None
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".part", dir=out.parent))
        part.chmod(0o777 & ~_umask())
        yield part
        for file in sorted(path for path in part.rglob("*") if path.is_file()):
            target = out / file.relative_to(part)
            target.parent.mkdir(parents=True, exist_ok=True)
            file.replace(target)
    except OSError as error:
        raise InterchangeError(
            f"{error.filename or out}: cannot be written ({error.strerror})"
        ) from None
    finally:
        if part is not None:
            shutil.rmtree(part, ignore_errors=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
