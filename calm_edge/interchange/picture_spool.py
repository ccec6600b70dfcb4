"""Encoded pictures of one camera in a temporary file, until their stamps are known."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calm_edge.interchange import InterchangeError
from calm_edge.types import Float


class PictureSpool:
    """File of encoded pictures in order; in memory are 24 bytes a picture.

    Raises InterchangeError if the disk cannot hold them.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise _failed(path, error) from None
        self._t_s: list[float] = []
        self._ends: list[int] = [0]

    def add(self, t_s: float, data: bytes) -> None:
        """Append an encoded picture with its stamp."""
        try:
            self._file.write(data)
        except OSError as error:
            raise _failed(self._path, error) from None
        self._t_s.append(t_s)
        self._ends.append(self._ends[-1] + len(data))

    @property
    def t_s(self) -> Float:
        """Stamps (N,) of the pictures."""
        return np.array(self._t_s, np.float64)

    def close(self) -> None:
        """End appending."""
        try:
            self._file.close()
        except OSError as error:
            raise _failed(self._path, error) from None

    def pictures(self) -> Iterator[bytes]:
        """Iterate over the pictures in order; the spool is closed."""
        try:
            with self._path.open("rb") as file:
                for size in np.diff(self._ends).tolist():
                    yield file.read(size)
        except OSError as error:
            raise _failed(self._path, error) from None


def _failed(path: Path, error: OSError) -> InterchangeError:
    return InterchangeError(
        f"{path}: cannot be used for the pictures ({error.strerror}); the disk needs room for "
        "twice the recording while it is made"
    )
