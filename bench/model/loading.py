"""A contestant given as MODULE:FACTORY on the command line."""

from __future__ import annotations

import importlib
from typing import Any

from calm_edge.evaluation.errors import EvaluationError


def loaded(spec: str, method: str) -> Any:
    """What the factory makes, called without arguments; raises EvaluationError.

    method: what it must be able to do: `match`, `depth` or `describe`.
    """
    module, _, factory = spec.partition(":")
    try:
        made = getattr(importlib.import_module(module), factory)()
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise EvaluationError(f"--ours {spec}: {error}; expected MODULE:FACTORY") from None
    if not hasattr(made, method):
        raise EvaluationError(f"--ours {spec}: what it makes has no {method}()")
    return made
