"""The learned place descriptor with the encoder of the shipped calm-geo."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from calm_edge.backbones.bundle import place as learned_place
from calm_edge.backbones.bundle.backbone import BundleBackbone
from calm_edge.backbones.bundle.features import FeatureNet
from calm_edge.backbones.bundle.place import LearnedPlace
from calm_edge.backbones.onnx.model_folder import find_model, read_manifest
from calm_edge.config import BackboneConfig, Config, ConfigError, merge
from calm_edge.estimator.localizer import Localizer
from calm_edge.loops.descriptor import GradientLayout, descriptor_of
from tests.backbones.bundle.demo_pictures import picture

PLACES = tuple(range(0, 72, 6))


@pytest.fixture(scope="module")
def place():
    return LearnedPlace(FeatureNet(read_manifest(find_model("calm-geo")), "fp32"))


@pytest.fixture(scope="module")
def known(place):
    return np.stack([place.describe(picture(k)) for k in PLACES])


def test_a_descriptor_is_a_unit_vector(known, place):
    assert known.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(known, axis=1), 1, atol=1e-4)
    blank = place.describe(np.zeros((48, 640, 3), np.uint8))
    assert blank.shape == known[0].shape and np.isfinite(blank).all()


def test_a_place_is_more_similar_to_itself_from_nearby_than_to_another(known, place):
    likeness = place.similarity(np.stack([place.describe(picture(k + 1)) for k in PLACES]), known)
    assert (likeness.argmax(1) == np.arange(len(PLACES))).all()
    assert likeness.diagonal().min() > place.min_similarity > np.median(likeness)
    np.testing.assert_allclose(place.similarity(known, known).diagonal(), 1, atol=1e-4)


def test_a_place_at_night_is_similar_to_itself(known, place):
    rng = np.random.default_rng(0)
    for number, k in enumerate(PLACES[::3]):
        dark = 0.4 * picture(k) + 6 * rng.standard_normal(picture(k).shape)
        query = place.describe(np.clip(dark, 0, 255).astype(np.uint8))
        assert place.similarity(query[None], known)[0].argmax() == 3 * number


def test_the_layout_depends_on_position_and_the_global_descriptor_does_not(place):
    """The same things elsewhere in the picture are another place, but not by their word alone."""
    word = slice(0, -learned_place.ROWS * learned_place.COLUMNS * learned_place.CHANNELS)
    image = picture(20)
    swapped = np.roll(image, image.shape[1] // 2, axis=1)
    as_it_is, moved = place.describe(image), place.describe(swapped)
    same_word = as_it_is[word] @ moved[word] / np.linalg.norm(as_it_is[word]) ** 2
    rest = slice(word.stop, None)
    same_layout = as_it_is[rest] @ moved[rest] / np.linalg.norm(as_it_is[rest]) ** 2
    assert same_word > same_layout + 0.05


def test_the_picture_of_a_place_is_not_encoded_again_for_matching(monkeypatch):
    net = FeatureNet(read_manifest(find_model("calm-geo")), "fp32")
    runs = []
    encoded = FeatureNet._encoded
    monkeypatch.setattr(
        FeatureNet, "_encoded", lambda self, gray: runs.append(1) or encoded(self, gray)
    )
    LearnedPlace(net).describe(picture(3))
    net.of([cv2.cvtColor(picture(3), cv2.COLOR_BGR2GRAY)])
    assert len(runs) == 1


def test_loops_use_the_backbones_network_by_default(place):
    own = BundleBackbone(BackboneConfig(), places=place)
    bare = BundleBackbone(BackboneConfig())
    assert descriptor_of(own, "auto") is place and descriptor_of(own, "learned") is place
    for backbone, name in ((own, "gradients"), (bare, "auto"), (SimpleNamespace(), "auto")):
        assert isinstance(descriptor_of(backbone, name), GradientLayout)
    with pytest.raises(ConfigError, match=r"loops\.descriptor=learned"):
        descriptor_of(bare, "learned")


def test_the_localizer_uses_the_configured_descriptor(place):
    learned, gradients = Config(), merge(Config(), {"loops": {"descriptor": "gradients"}})
    own = BundleBackbone(BackboneConfig(), places=place)
    assert Localizer(learned, own)._loops._finder._descriptor is place
    assert isinstance(Localizer(gradients, own)._loops._finder._descriptor, GradientLayout)
    with pytest.raises(ConfigError, match=r"loops\.descriptor"):
        Localizer(
            merge(Config(), {"loops": {"descriptor": "learned"}}), BundleBackbone(BackboneConfig())
        )
