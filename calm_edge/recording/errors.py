"""What can go wrong with a recording that the user can mend."""

from __future__ import annotations

from calm_edge.types import CalmEdgeError


class RecordingError(CalmEdgeError):
    """A recording that cannot be opened, read or created; one line naming the file and the mend."""
