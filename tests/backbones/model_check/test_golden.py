"""Reading of golden values, and the deviation from them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calm_edge.backbones.model_check.golden import deviation, fits_of, read_cases
from calm_edge.backbones.onnx.manifest import FrameRange, ManifestError
from calm_edge.backbones.onnx.model_folder import read_manifest
from tests.backbones.painted_model import write_model


@pytest.fixture
def manifest(tmp_path):
    return read_manifest(write_model(tmp_path / "painted"))


def rewritten(manifest, change):
    """Rewrite the golden file with its arrays changed by `change`."""
    path = manifest.folder / "golden.npz"
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    np.savez(path, **change(arrays))
    return manifest


def test_pictures_become_the_input_tensor(manifest):
    cases = read_cases(manifest)
    assert [(c.role, c.name) for c in cases] == [("model", "n2"), ("model", "n4")]
    assert cases[1].inputs["image"].shape == (4, 3, 32, 64)
    assert cases[1].inputs["image"].max() <= 1 and set(cases[1].outputs) == {
        "pose",
        "depth",
        "conf",
    }


def test_tensors_may_be_given_as_they_are(manifest):
    def change(arrays):
        tensors = {}
        for name, array in arrays.items():
            if name.endswith("pictures"):
                name, array = name.replace("pictures", "in/image"), array.transpose(0, 3, 1, 2)
            tensors[name] = array
        return tensors

    case = read_cases(rewritten(manifest, change))[0]
    assert case.pictures is None and case.inputs["image"].shape == (2, 3, 32, 64)
    assert [fit.input for fit in fits_of(manifest, case)] == [(64, 32)] * 2
    flat = dataclasses.replace(case, inputs={"image": np.ones((2, 32, 64))})
    with pytest.raises(ManifestError, match="is not NCHW"):
        fits_of(manifest, flat)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda a: {k: v for k, v in a.items() if "n2" in k}, "model: 1 cases of different shapes"),
        (lambda a: {}, "model: 0 cases of different shapes"),
        (lambda a: a | {"encoder/n2/in/x": np.ones(2)}, "expected ROLE/CASE/"),
        (lambda a: a | {"model": np.ones(2)}, "model: expected ROLE/CASE/"),
        (lambda a: a | {"model/n2/pose": np.ones(2)}, "n2/pose: expected pictures, in/X or out/X"),
        (lambda a: a | {"model/n3/in/x": np.ones(2)}, "model/n3: has no input or no output"),
        (
            lambda a: a | {"model/n2/pictures": np.ones((2, 32, 64, 3))},
            r"expected \(N, H, W, 3\) uint8",
        ),
        (
            lambda a: a | {"model/n2/pictures": np.ones((2, 64, 128, 3), np.uint8)},
            "128x64 px, but the input of such pictures is 64x32",
        ),
    ],
)
def test_missing_or_malformed_cases_are_errors_of_one_line(manifest, change, line):
    with pytest.raises(ManifestError, match=line):
        read_cases(rewritten(manifest, change))


def test_one_case_is_enough_of_a_fixed_number_of_views(manifest):
    fixed = dataclasses.replace(manifest, frames=FrameRange(2, 2, False))
    rewritten(manifest, lambda a: {k: v for k, v in a.items() if "n2" in k})
    assert len(read_cases(fixed)) == 1


def test_a_file_that_is_no_archive_is_an_error(manifest):
    (manifest.folder / "golden.npz").write_bytes(b"nothing")
    with pytest.raises(ManifestError, match=r"golden\.npz: cannot be read"):
        read_cases(manifest)


def test_one_wrong_view_among_many_shows():
    expected = np.ones((10, 5, 5))
    found = expected.copy()
    found[7] += 0.5
    assert deviation(found, expected) == pytest.approx(0.5)
    assert deviation(found[None], expected[None]) == pytest.approx(0.5)
    assert deviation(expected, expected) == 0


def test_deviation_of_zeros_and_of_different_shapes():
    assert deviation(np.full((2, 3), 0.1), np.zeros((2, 3))) == pytest.approx(0.1)
    assert deviation(np.ones((2, 3)), np.ones((3, 2))) == np.inf
    assert deviation(np.full(3, np.nan), np.ones(3)) == np.inf
    assert deviation(np.full((1,), 1.1), np.ones((1,))) == pytest.approx(0.1)
