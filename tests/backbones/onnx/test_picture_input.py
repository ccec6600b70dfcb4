"""Preprocessing of images: input size, intrinsics, padding, normalisation."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calm_edge.backbones.onnx.manifest import InputSpec
from calm_edge.backbones.onnx.picture_input import fit_pictures, input_tensor
from calm_edge.geometry.camera import Perspective

SPEC = InputSpec("x", "NCHW", "rgb", "width", size_px=56, multiple=14)


@pytest.mark.parametrize(
    ("changes", "sizes", "expected"),
    [
        ({}, [(112, 60)], (56, 28)),
        ({"multiple_by": "crop"}, [(112, 60)], (56, 28)),
        ({"multiple_by": "pad"}, [(112, 60)], (56, 42)),
        ({"multiple_by": "pad"}, [(112, 56)], (56, 28)),
        ({"resize": "longest"}, [(60, 112)], (28, 56)),
        ({"resize": "keep", "size_px": 0, "multiple_by": "crop"}, [(75, 45)], (70, 42)),
        ({"height_px": 42}, [(112, 60)], (56, 42)),
        ({"height_px": 14, "multiple_by": "crop"}, [(112, 60)], (56, 14)),
        ({}, [(112, 60), (112, 84)], (56, 42)),
        ({"common_by": "crop"}, [(112, 60), (112, 84)], (56, 28)),
        ({}, [(112, 4)], (56, 14)),
    ],
)
def test_the_input_size_follows_the_manifest(changes, sizes, expected):
    spec = replace(SPEC, **changes)
    fits = fit_pictures(spec, sizes)
    assert [fit.input for fit in fits] == [expected] * len(sizes)
    images = [np.zeros((h, w, 3), np.uint8) for w, h in sizes]
    assert input_tensor(spec, images, fits).shape == (len(sizes), 3, *expected[::-1])


def smooth(width: int, height: int):
    """Image with 4 u in blue and 4 v in green: resizing is exact away from borders."""
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    return np.stack([4 * u, 4 * v, u + v], -1).astype(np.uint8)


@pytest.mark.parametrize("multiple_by", ["stretch", "crop", "pad"])
@pytest.mark.parametrize("size_px", [28, 42, 210])
def test_intrinsics_follow_a_pixel_into_the_input_and_back(multiple_by, size_px):
    """In a linear image, an input pixel's value is the position it was sampled from."""
    spec = replace(SPEC, size_px=size_px, multiple_by=multiple_by, interpolation="bilinear")
    width, height = 63, 50
    fit = fit_pictures(spec, [(width, height)])[0]
    tensor = input_tensor(spec, [smooth(width, height)], [fit])[0] * 255 / 4
    off = []
    top, left = max(0, fit.offset[1]), max(0, fit.offset[0])
    for row, column in zip(range(top + 4, top + 14), range(left + 4, left + 14), strict=True):
        # a camera with its principal point at that input pixel
        camera = fit.camera(Perspective(50.0, 60.0, column, row, *fit.input))
        assert (camera.width, camera.height) == fit.picture
        off.append((camera.cx, camera.cy) - tensor[[2, 1], row, column])
    # grey levels are in quarter pixels, and resizing rounds down
    assert np.abs(np.mean(off, 0)).max() < 0.15
    sx, sy = fit.scale
    assert camera.fx == pytest.approx(50 / sx) and camera.fy == pytest.approx(60 / sy)


def test_the_image_centre_maps_to_the_input_centre():
    """The pixel centre convention holds at any scale: no shift by half a pixel."""
    for width in (42, 84, 168):
        fit = fit_pictures(replace(SPEC, size_px=width), [(84, 42)])[0]
        middle = (np.array(fit.input) - 1) / 2
        camera = fit.camera(Perspective(9.0, 9.0, *middle, *fit.input))
        assert (camera.cx, camera.cy) == pytest.approx((41.5, 20.5))


def test_positions_agree_with_a_resized_map():
    """At its resized size, the pixels of a padded image are at its offset."""
    fit = fit_pictures(replace(SPEC, multiple_by="pad"), [(112, 60)])[0]
    assert fit.offset == (0, 6) and fit.resized == (56, 30)
    assert fit.positions(1, 30, 42) == pytest.approx(np.arange(30) + 6)
    # a map of half the size: its pixel centres are between two input pixels
    assert fit.positions(1, 15, 21) == pytest.approx(np.arange(15) + 3)
    assert fit.positions(0, 56, 56) == pytest.approx(np.arange(56))


@pytest.mark.parametrize(
    ("channels", "expected"), [("bgr", [30, 60, 90]), ("rgb", [90, 60, 30]), ("gray", [66])]
)
@pytest.mark.parametrize("layout", ["NCHW", "NHWC", "BNCHW", "BNHWC"])
def test_channels_layout_and_normalisation(channels, layout, expected):
    image = np.full((28, 56, 3), (30, 60, 90), np.uint8)
    mean = tuple(0.1 * (i + 1) for i in range(len(expected)))
    spec = replace(SPEC, channels=channels, layout=layout, mean=mean, std=(0.5,))
    tensor = input_tensor(spec, [image] * 2, fit_pictures(spec, [(56, 28)] * 2))
    assert tensor.dtype == np.float32
    if layout.startswith("B"):
        assert tensor.shape[0] == 1
        tensor = tensor[0]
    if layout.endswith("CHW"):
        tensor = tensor.transpose(0, 2, 3, 1)
    assert tensor.shape == (2, 28, 56, len(expected))
    wanted = (np.array(expected) / 255 - np.array(mean)) / 0.5
    assert tensor[1, 5, 7] == pytest.approx(wanted, abs=1e-6)


def test_padding_and_cropping_keep_the_image_centred():
    image = np.full((60, 112, 3), 255, np.uint8)
    spec = replace(SPEC, multiple_by="pad", pad_value=0.5)
    tensor = input_tensor(spec, [image], fit_pictures(spec, [(112, 60)]))[0, 0]
    assert (tensor[:6] == 0.5).all() and (tensor[36:] == 0.5).all() and (tensor[6:36] == 1).all()
    image[:2] = 0
    spec = replace(SPEC, multiple_by="crop")
    tensor = input_tensor(spec, [image], fit_pictures(spec, [(112, 60)]))[0, 0]
    assert (tensor == 1).all()


def test_shrinking_by_area_averages():
    image = np.zeros((56, 112, 3), np.uint8)
    image[:, ::2] = 200
    tensor = input_tensor(SPEC, [image], fit_pictures(SPEC, [(112, 56)]))
    assert tensor[0] == pytest.approx(np.full((3, 28, 56), 100 / 255), abs=1e-6)
    nearest = cv2.resize(image, (56, 28), interpolation=cv2.INTER_LINEAR)
    assert nearest.mean() == pytest.approx(100)
