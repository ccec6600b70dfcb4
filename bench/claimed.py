"""What a recording claims to know about its lengths."""

from __future__ import annotations

from collections.abc import Sequence

from calm_edge.types import LocalizerUpdate


def scale_sigma(updates: Sequence[LocalizerUpdate]) -> float | None:
    """Sigma of the drive's log scale after the last update: inf if unknown, None if not reported.

    A version that does not report it records neither a sigma nor a reason why there is none.
    """
    if not updates:
        return None
    metre = updates[-1].metre
    return metre.log_sigma if metre.metric or metre.reason else None
