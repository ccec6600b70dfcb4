import numpy as np
import pytest

from calm_edge.mapping.spool import Spool
from calm_edge.mapping.views import MappingError

RNG = np.random.default_rng(0)
DEPTH = RNG.uniform(1, 50, (2, 12, 20)).astype(np.float32)
CONFIDENCE = RNG.uniform(0, 1, (2, 12, 20)).astype(np.float32)


def images():
    blue = np.zeros((24, 40, 3), np.uint8)
    blue[..., 0] = 200
    red = np.zeros((48, 60, 3), np.uint8)
    red[..., 2] = 100
    return [blue, red]


def test_depth_confidence_and_colour_are_read_back(tmp_path):
    spool = Spool(tmp_path / "new" / "folder")
    spool.write(3, DEPTH, CONFIDENCE, images())
    spooled = spool.depth(3)
    np.testing.assert_array_equal(spooled.depth, DEPTH)
    np.testing.assert_allclose(spooled.confidence / 255, CONFIDENCE, atol=1 / 255)
    assert spooled.image_size.tolist() == [[40, 24], [60, 48]]
    color = spool.color(3)
    assert color.shape == (2, 12, 20, 3)
    assert (color[0] == [0, 0, 200]).all() and (color[1] == [100, 0, 0]).all()


def test_a_view_without_picture_is_black(tmp_path):
    spool = Spool(tmp_path)
    spool.write(0, DEPTH, CONFIDENCE, [None, images()[1]])
    assert not spool.color(0)[0].any() and (spool.color(0)[1] == [100, 0, 0]).all()
    assert spool.depth(0).image_size.tolist() == [[20, 12], [60, 48]]


def test_confidence_is_never_rounded_up_and_bytes_survive(tmp_path):
    spool = Spool(tmp_path)
    half = np.full_like(DEPTH, 0.5)
    spool.write(0, DEPTH, half, images())
    assert not (spool.depth(0).confidence > 0.5 * 255).any()
    every = (np.arange(480).reshape(2, 12, 20) % 256).astype(np.uint8)
    spool.write(1, DEPTH, (every / 255).astype(np.float32), images())
    np.testing.assert_array_equal(spool.depth(1).confidence, every)


def test_mismatches_and_missing_files_are_named(tmp_path):
    spool = Spool(tmp_path)
    with pytest.raises(MappingError, match="2 depth maps but 1 images"):
        spool.write(0, DEPTH, CONFIDENCE, images()[:1])
    with pytest.raises(MappingError, match="submap000007"):
        spool.depth(7)
