"""Load a method given as MODULE:FACTORY on the command line."""

from __future__ import annotations

import importlib
from typing import Any

from calm_edge.evaluation import EvaluationError


def loaded(spec: str, method: str) -> Any:
    """Import MODULE, call FACTORY without arguments and return its result.

    method: attribute that the result must have: `match`, `depth` or `describe`. Raises
    EvaluationError.
    """
    module, _, factory = spec.partition(":")
    try:
        made = getattr(importlib.import_module(module), factory)()
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise EvaluationError(f"--ours {spec}: {error}; give MODULE:FACTORY") from None
    if not hasattr(made, method):
        raise EvaluationError(f"--ours {spec}: the object it returns has no {method}()")
    return made
