"""What a drive has learned of its cameras so far, with sigmas, for people to look at."""

from __future__ import annotations

from typing import Any

import numpy as np

from calm_edge.kit import layout
from calm_edge.kit.belief import product, sigmas
from calm_edge.kit.estimated import picture_sizes
from calm_edge.kit.observed import MAX_LOG_FOCAL_SIGMA
from calm_edge.recording import display
from calm_edge.types import LocalizerUpdate

HISTORY = 200
EYES = "primary", "assistant"


class KitContent:
    """The kit after each sub-map, and how its focal lengths got there."""

    def __init__(self) -> None:
        self._history: list[tuple[float, ...]] = []
        self._start_ns: int | None = None
        self._every = self._count = 0

    def update(self, update: LocalizerUpdate) -> dict[str, Any]:
        """Take an update; return the kit as in `display.kit`, with lenses and the history.

        history: rows of time since the first sub-map [s], and for each eye focal length [px] and
        its sigma [%]; thinned to HISTORY rows.
        """
        content = display.kit(update)
        for eye, (name, lens) in enumerate(zip(EYES, lenses(update), strict=False)):
            if name in content:
                observed = bool(update.submap.focal_log_sigma[eye] <= MAX_LOG_FOCAL_SIGMA)
                content[name] |= {"observed": observed, "lens": lens}
        newest_ns = int(update.submap.t_ns.max())
        if self._start_ns is None:
            self._start_ns = newest_ns
        self._add(self._row((newest_ns - self._start_ns) / 1e9, content))
        return content | {"history": [list(row) for row in self._history]}

    def _row(self, t_s: float, content: dict[str, Any]) -> tuple[float, ...]:
        row = [t_s]
        for name in EYES:
            eye = content.get(name, {})
            row += [eye.get("focal_px", np.nan), eye.get("focal_sigma_percent", np.nan)]
        return tuple(round(float(v), 3) for v in row)

    def _add(self, row: tuple[float, ...]) -> None:
        """Add a row; when there are too many every second one goes, and fewer are taken."""
        if self._count % max(1, self._every) == 0:
            self._history.append(row)
        else:
            self._history[-1] = row
        self._count += 1
        if len(self._history) > HISTORY:
            self._history = self._history[::2]
            self._every, self._count = 2 * max(1, self._every), 1


def lenses(update: LocalizerUpdate) -> list[dict[str, Any] | None]:
    """Lens of each eye: `family`, terms `k` and their `sigma`; None if it is not estimated."""
    kit = update.kit
    if kit is None or kit.mean.shape != (layout.SIZE,) or not update.submap.assistant_ids:
        return [None, None]
    families = layout.families(kit.mean)
    prior = layout.prior((None, None), picture_sizes(update.submap), families=families)
    belief = product([prior, kit])
    assert belief is not None
    sigma = sigmas(belief)
    return [
        {
            "family": families[eye].name.lower(),
            "k": belief.mean[layout.DISTORTION[eye]].round(4).tolist(),
            "sigma": sigma[layout.DISTORTION[eye]].round(4).tolist(),
        }
        for eye in range(2)
    ]


def summary(content: dict[str, Any]) -> list[str]:
    """A line for each eye: focal length with its sigma, and the lens with those of its terms."""
    return [f"{name}: {_eye(content[name])}" for name in EYES if name in content]


def _eye(eye: dict[str, Any]) -> str:
    sigma = eye["focal_sigma_percent"]
    text = f"focal {eye['focal_px']:.0f} px"
    text += f" ± {sigma:.1f} %" if np.isfinite(sigma) else ", sigma unknown"
    if not eye.get("observed"):
        text += ", not observed"
    if lens := eye.get("lens"):
        terms = zip(lens["k"], lens["sigma"], strict=True)
        text += "; " + ", ".join(f"k{n} {k:+.3f} ± {s:.3f}" for n, (k, s) in enumerate(terms, 1))
    return text
