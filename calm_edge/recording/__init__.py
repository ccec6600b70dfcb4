"""Errors of recordings and of folders of pictures."""

from __future__ import annotations

from calm_edge.types import CalmEdgeError


class RecordingError(CalmEdgeError):
    """A recording cannot be opened, read or created; one line with the file and the remedy."""


class SequenceError(CalmEdgeError):
    """A folder of pictures or a file of times is incomplete or invalid."""
