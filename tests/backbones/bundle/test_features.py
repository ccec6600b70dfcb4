"""The encoder of the shipped calm-geo."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calm_edge.backbones.bundle import features
from calm_edge.backbones.bundle.features import FeatureNet
from calm_edge.backbones.onnx.manifest import ManifestError
from calm_edge.backbones.onnx.model_folder import find_model, read_manifest
from tests.backbones.bundle.demo_pictures import picture


@pytest.fixture(scope="module")
def net():
    return FeatureNet(read_manifest(find_model("calm-geo")), "fp32")


def test_maps_have_the_shape_of_the_input(net):
    (of,) = net.of([picture(0)])
    width, height = of.fit.input
    assert width % 16 == 0 and height % 16 == 0
    assert of.coarse.shape == (height // 8, width // 8, 64)
    assert of.reliability.shape == (height // 8, width // 8)
    assert of.fine.shape == (height // 4, width // 4, 32)
    np.testing.assert_allclose(np.linalg.norm(of.coarse, axis=2), 1, atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(of.fine, axis=2), 1, atol=1e-3)
    assert of.reliability.min() >= 0 and of.reliability.max() <= 1


def test_pixels_go_to_the_input_and_back(net):
    (of,) = net.of([picture(0)])
    uv = np.array([[0.0, 0.0], [100.25, 60.5]], np.float32)
    np.testing.assert_allclose(of.to_picture(of.to_input(uv)), uv, atol=1e-4)


def test_a_picture_is_encoded_once(net):
    first, again, grey = net.of(
        [picture(0), picture(0), cv2.cvtColor(picture(0), cv2.COLOR_BGR2GRAY)]
    )
    assert again is first and grey is first
    for k in range(1, features.KEPT + 1):
        net.of([np.full((32, 64), k, np.uint8)])
    (anew,) = net.of([picture(0)])
    assert anew is not first
    np.testing.assert_array_equal(anew.coarse, first.coarse)


def test_a_model_without_the_graphs_is_refused():
    manifest = read_manifest(find_model("calm-geo"))
    bare = replace(manifest, graphs={"encoder": manifest.graphs["encoder"]})
    with pytest.raises(ManifestError, match="bundle needs the graph refine"):
        FeatureNet(bare, "fp32")
