"""One trajectory of the pieces that updates carry."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from calm_edge.types import Trajectory


def folded(pieces: Iterable[Trajectory]) -> Trajectory | None:
    """The pieces in their order as one: of a keyframe said twice the later pose holds.

    None without a piece. T_p_a and epoch are those of the last one.
    """
    pieces = list(pieces)
    if not pieces:
        return None
    ids = np.concatenate([piece.keyframe_ids for piece in pieces])
    # the first of the reversed rows is the last said
    kept, reverse = np.unique(ids[::-1], return_index=True)
    rows = len(ids) - 1 - reverse
    return Trajectory(
        kept,
        np.concatenate([piece.t_ns for piece in pieces])[rows],
        np.concatenate([piece.T_w_c for piece in pieces])[rows],
        pieces[-1].T_p_a,
        pieces[-1].epoch,
    )
