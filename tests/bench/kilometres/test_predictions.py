import dataclasses

import numpy as np
import pytest

from bench.kilometres import drives, predictions
from bench.kilometres.streams import Streams
from bench.scripted import ScriptedErrors
from calm_edge.config import Config
from tests.bench.scripted.street_drive import batch, street

DIALS = ScriptedErrors(coupled=True, focal_log_sigma=0.05, match_sigma_px=0.4)


@pytest.fixture(scope="module")
def drive():
    return drives.cut("street", street(60), Config(), Streams(), 0)


def test_a_prediction_read_is_the_one_written(drive, tmp_path):
    first = predictions.cached(drive, DIALS, tmp_path)
    said = first.infer([], batch())
    assert len(list(tmp_path.glob("*/*.npz"))) == 1
    again = predictions.cached(drive, DIALS, tmp_path)
    read = again.infer([], batch())
    assert said.cameras == read.cameras and np.array_equal(said.T_s_c, read.T_s_c)
    for name in ("points_s", "index", "view", "uv"):
        a, b = getattr(said.landmarks, name), getattr(read.landmarks, name)
        assert np.array_equal(a, b) and a.dtype == b.dtype
    assert said.landmarks.sigma_px is None and read.landmarks.sigma_px is None
    assert read.focal_log_sigma is None and read.loop_found


def test_other_dials_and_other_stamps_are_other_predictions(drive, tmp_path):
    backbone = predictions.cached(drive, DIALS, tmp_path)
    other = predictions.cached(drive, dataclasses.replace(DIALS, seed=1), tmp_path)
    asked = (backbone, batch()), (other, batch()), (backbone, batch(25))
    focals = [b.infer([], h).cameras[0].fx for b, h in asked]
    assert abs(focals[0] - focals[1]) > 1e-3 and abs(focals[0] - focals[2]) > 1e-3
    assert len(list(tmp_path.glob("*"))) == 2 and len(list(tmp_path.glob("*/*.npz"))) == 3
    assert not list(tmp_path.glob("*/*.part"))


def test_depth_is_the_backbones(drive, tmp_path):
    backbone = predictions.cached(drive, DIALS, tmp_path)
    dense = backbone.densify([], batch(), backbone.infer([], batch()))
    some, confidence = backbone.depth(batch(), np.array([4]))
    assert np.array_equal(dense.depth[[4]], some) and np.array_equal(
        dense.confidence[[4]], confidence
    )
