"""Errors of recordings."""

from __future__ import annotations

from calm_edge.types import CalmEdgeError


class RecordingError(CalmEdgeError):
    """A recording cannot be opened, read or created; one line with the file and the remedy."""
