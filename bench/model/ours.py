"""The shipped model as a contestant: what takes part as `ours` where nothing else is asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bench.model.depth_makers import SweepDepth
from bench.model.described import gray_of
from bench.model.loading import loaded
from bench.model.protocols import Matches
from calm_edge.backbones.base import BackboneError
from calm_edge.types import Bytes, Float

if TYPE_CHECKING:
    from calm_edge.backbones.bundle.learned import LearnedMatching
    from calm_edge.backbones.bundle.place import LearnedPlace

MODEL = "calm-geo"


class ModelMatcher:
    """A model's matching, as `learned` offers it, in the shape of a Matcher."""

    def __init__(self, matching: LearnedMatching) -> None:
        self._matching = matching

    def match(self, image_a: Bytes, image_b: Bytes, query_uv: Float) -> Matches:
        """See Matcher; raises BackboneError."""
        uv = np.asarray(query_uv, np.float32)
        found = self._matching.match(gray_of(image_a), gray_of(image_b), uv)
        return Matches(found.uv.astype(np.float64), found.sure, found.sigma_px.astype(np.float64))


# the classical methods are measured where ONNX Runtime is not there, too
def _matcher() -> ModelMatcher:
    from calm_edge.backbones.bundle import learned

    return ModelMatcher(learned.matcher(MODEL))


def _place() -> LearnedPlace:
    from calm_edge.backbones.bundle import learned

    return learned.place(MODEL)


# By what a contestant must be able to do. The model has no depth of its own: the sweep is what
# the backbone makes with it, too.
FACTORIES = {"match": _matcher, "depth": SweepDepth, "describe": _place}


def contestant(spec: str | None, method: str) -> tuple[Any, str]:
    """(what takes part as ours, "") or (None, why nothing does); raises EvaluationError.

    spec: MODULE:FACTORY as given, None for the shipped model. method: a key of FACTORIES.
    """
    if spec:
        return loaded(spec, method), ""
    try:
        return FACTORIES[method](), ""
    except (BackboneError, ImportError) as error:
        return None, f"ours skipped: {error}"
