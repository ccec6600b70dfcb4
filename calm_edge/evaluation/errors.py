"""What can go wrong in an evaluation."""

from __future__ import annotations

from calm_edge.types import CalmEdgeError


class EvaluationError(CalmEdgeError):
    """Something given to the evaluation cannot be read or compared."""
