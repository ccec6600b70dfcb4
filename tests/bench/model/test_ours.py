import numpy as np
import pytest

from bench.model import ours
from bench.model.depth_makers import SweepDepth
from bench.model.ours import ModelMatcher, contestant
from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle.matching import Matches
from calm_edge.evaluation import EvaluationError


class Shifts:
    """Model whose matches are one pixel to the right, the first one uncertain."""

    def match(self, a, b, uv):
        assert a.ndim == b.ndim == 2 and uv.dtype == np.float32
        sure = np.arange(len(uv)) > 0
        return Matches(uv + np.float32([1, 0]), sure, np.full(len(uv), 0.4, np.float32), sure)


def test_a_model_s_matches_come_in_the_shape_of_the_others():
    image = np.zeros((40, 60, 3), np.uint8)
    uv = np.array([[3.0, 4.0], [20.0, 30.0]])
    found = ModelMatcher(Shifts()).match(image, image, uv)
    assert np.allclose(found.uv_b, uv + np.array([1, 0]))
    assert found.found.tolist() == [False, True]
    assert found.sigma_px == pytest.approx([0.4, 0.4])


def test_a_refused_model_takes_no_part_and_says_why(monkeypatch):
    def refused():
        raise BackboneError("calm-geo: its hash is another")

    monkeypatch.setitem(ours.FACTORIES, "match", refused)
    made, why = contestant(None, "match")
    assert made is None and why == "ours skipped: calm-geo: its hash is another"


def test_what_is_asked_for_by_name_comes_before_the_shipped_model():
    spec = "bench.model.depth_makers:SgbmDepth"
    made, why = contestant(spec, "depth")
    assert type(made).__name__ == "SgbmDepth" and not why
    assert isinstance(contestant(None, "depth")[0], SweepDepth)
    with pytest.raises(EvaluationError, match="no match"):
        contestant(spec, "match")
