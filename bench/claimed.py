"""What a recording claims to know about its lengths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.relative_poses import ScaleHistory
from calm_edge.types import LocalizerUpdate


def scale_history(updates: Sequence[LocalizerUpdate]) -> ScaleHistory:
    """Sigma of the log scale as each sub-map was first added, from its last stamp on."""
    first: dict[int, LocalizerUpdate] = {}
    for update in updates:
        first.setdefault(update.submap.id, update)
    t_ns = np.array([update.submap.t_ns.max() for update in first.values()], np.int64)
    claimed = [scale_sigma([update]) for update in first.values()]
    order = np.argsort(t_ns, kind="stable")
    return ScaleHistory(t_ns[order], np.array([0.0 if s is None else s for s in claimed])[order])


def scale_sigma(updates: Sequence[LocalizerUpdate]) -> float | None:
    """Sigma of the drive's log scale after the last update: inf if unknown, None if not reported.

    A version that does not report it records neither a sigma nor a reason why there is none.
    """
    if not updates:
        return None
    metre = updates[-1].metre
    return metre.log_sigma if metre.metric or metre.reason else None
