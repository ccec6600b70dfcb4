"""Files of other programs: formats that are read and written."""

from __future__ import annotations

from calm_edge.types import CalmEdgeError


class InterchangeError(CalmEdgeError):
    """A foreign file cannot be read or used; one line with the file, the reason and the remedy."""
