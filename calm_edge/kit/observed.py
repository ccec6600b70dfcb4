"""The part of a belief that motion has determined: only that is worth remembering."""

from __future__ import annotations

import numpy as np

from calm_edge.kit import layout
from calm_edge.kit.belief import gaussian
from calm_edge.kit.change import bounded, marginal
from calm_edge.types import Float, KitBelief

# Largest sigmas at which a part counts as observed: log focal; rotation of the assistant; angle of
# its direction.
MAX_LOG_FOCAL_SIGMA = 0.05
MAX_ROTATION_SIGMA_RAD = 0.05
MAX_DIRECTION_SIGMA_RAD = 0.1


def observed_part(belief: KitBelief) -> KitBelief | None:
    """Marginalise out unobserved focals, rotation and direction; None if none is observed.

    Their information becomes zero, and their mean that of the prior.
    """
    belief = gaussian(belief)
    known, axes = bounded(belief), np.eye(layout.SIZE)
    direction = belief.mean[layout.RIG_CENTRE]
    sideways = axes[:, layout.RIG_CENTRE] @ np.linalg.svd(direction[None])[2][1:].T
    terms = np.arange(layout.SIZE)
    parts = [(terms[[index]], axes[:, [index]], MAX_LOG_FOCAL_SIGMA) for index in layout.LOG_FOCAL]
    parts += [
        (terms[layout.RIG_ROTATION], axes[:, layout.RIG_ROTATION], MAX_ROTATION_SIGMA_RAD),
        (terms[layout.RIG_CENTRE], sideways, MAX_DIRECTION_SIGMA_RAD),
    ]
    unknown = [part for part, along, most in parts if _sigma(known.information, along) > most]
    if len(unknown) == len(parts):
        return None
    kept = np.setdiff1d(terms, np.concatenate([terms[:0], *unknown]))
    mean = layout.prior((None, None), families=layout.families(belief.mean)).mean
    information = np.zeros((layout.SIZE, layout.SIZE))
    mean[kept] = belief.mean[kept]
    information[np.ix_(kept, kept)] = marginal(belief.information, axes[:, kept])
    return KitBelief(mean, (information + information.T) / 2)


def _sigma(information: Float, axes: Float) -> float:
    """Largest sigma along a combination of orthonormal `axes` (D, k); inf where undetermined."""
    least = float(np.linalg.eigvalsh(marginal(information, axes))[0])
    return least**-0.5 if least > 0 else np.inf
