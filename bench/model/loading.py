"""Load a method given as MODULE:FACTORY on the command line."""

from __future__ import annotations

import importlib
from typing import Any

from calm_edge.evaluation.errors import EvaluationError


def loaded(spec: str, method: str) -> Any:
    """Return the factory's result, called without arguments; raises EvaluationError.

    method: method that the result must have: `match`, `depth` or `describe`.
    """
    module, _, factory = spec.partition(":")
    try:
        made = getattr(importlib.import_module(module), factory)()
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise EvaluationError(f"--ours {spec}: {error}; expected MODULE:FACTORY") from None
    if not hasattr(made, method):
        raise EvaluationError(f"--ours {spec}: its result has no {method}()")
    return made
