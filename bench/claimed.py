"""What a recording claims to know about its lengths, and about the axes of its poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calm_edge.kit import layout
from calm_edge.kit.belief import sigmas
from calm_edge.types import LocalizerUpdate


def scale_sigma(updates: Sequence[LocalizerUpdate]) -> float | None:
    """Sigma of the drive's log scale after the last update: inf if unknown, None if not reported.

    A version that does not report it records neither a sigma nor a reason why there is none.
    """
    if not updates:
        return None
    metre = updates[-1].metre
    return metre.log_sigma if metre.metric or metre.reason else None


def axes_sigma(updates: Sequence[LocalizerUpdate]) -> tuple[float, float] | None:
    """Sigmas of the primary's axes about x and y [rad] after the last update; None without a kit.

    Its principal point, which defines them, is known as well as the kit.
    """
    kit = updates[-1].kit if updates else None
    if kit is None:
        return None
    x, y = sigmas(kit)[layout.PRINCIPAL_POINT[0]] / np.exp(kit.mean[layout.LOG_FOCAL[0]])
    return float(y), float(x)
