"""Errors of the evaluation."""

from __future__ import annotations

from calm_edge.types import CalmEdgeError


class EvaluationError(CalmEdgeError):
    """An input of the evaluation cannot be read or compared."""
