"""The learned model to be compared: the shipped one, or another one given by --ours."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.model.depth_makers import SweepDepth
from bench.model.described import gray_of
from bench.model.loading import loaded
from bench.model.protocols import Matches
from bench.tables import OUT
from calm_edge.backbones.base import BackboneError
from calm_edge.types import Bytes, Float

if TYPE_CHECKING:
    from calm_edge.backbones.bundle.learned import LearnedMatching
    from calm_edge.backbones.bundle.place import LearnedPlace

MODEL = "calm-geo"
OURS = "ours"


def add_arguments(parser: argparse.ArgumentParser, kind: str) -> None:
    """Add the arguments common to all comparisons of a learned method with classical ones.

    kind: of method, for the help text.
    """
    parser.add_argument("--ours", metavar="MODULE:FACTORY", help=f"the learned {kind}")
    parser.add_argument(
        "--held-out", action="store_true", help="on tracks that were not used for tuning"
    )
    parser.add_argument("--only", action="append", metavar="DRIVE")
    parser.add_argument("--out", type=Path, default=OUT)


class ModelMatcher:
    """Matcher that uses the learned matching of bundle."""

    def __init__(self, matching: LearnedMatching) -> None:
        self._matching = matching

    def match(self, image_a: Bytes, image_b: Bytes, query_uv: Float) -> Matches:
        """Find the query points in image_b, see Matcher; raises BackboneError."""
        uv = np.asarray(query_uv, np.float32)
        found = self._matching.match(gray_of(image_a), gray_of(image_b), uv)
        return Matches(found.uv.astype(np.float64), found.sure, found.sigma_px.astype(np.float64))


# Imported on demand, so that the classical methods run without ONNX Runtime.
def _matcher() -> ModelMatcher:
    from calm_edge.backbones.bundle import learned

    return ModelMatcher(learned.matcher(MODEL))


def _place() -> LearnedPlace:
    from calm_edge.backbones.bundle import learned

    return learned.place(MODEL)


# By name of the method. The model computes no depth; its backbone uses the plane sweep.
FACTORIES = {"match": _matcher, "depth": SweepDepth, "describe": _place}


def contestant(spec: str | None, method: str) -> tuple[Any, str]:
    """Load the learned method to be compared: (method, ""), or (None, reason) if it is missing.

    spec: MODULE:FACTORY, None for the shipped model. method: a key of FACTORIES. Raises
    EvaluationError.
    """
    if spec:
        return loaded(spec, method), ""
    try:
        return FACTORIES[method](), ""
    except (BackboneError, ImportError) as error:
        return None, f"ours skipped: {error}"
