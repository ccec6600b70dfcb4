"""Templates decode the outputs of their networks for a known scene.

Raw outputs are computed from the authors' definitions: DA3's camera decoder gives camera to world,
VGGT world to camera, Pi3 nine numbers with a nearest rotation, MapAnything unit rays and the
distance along them.
"""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from onnx import TensorProto, helper, save_model

from calm_edge.backbones.feedforward.decode.decoder import decode
from calm_edge.backbones.onnx.manifest import Manifest, ManifestError
from calm_edge.backbones.onnx.model_folder import EXPORTED, find_model, read_manifest, verify
from calm_edge.backbones.onnx.picture_input import fit_pictures, input_tensor
from tests.backbones.feedforward.decode.test_decoder import raw_outputs
from tests.backbones.raw_scene import make_scene, matrices

NAMES = ["da3", "vggt", "pi3", "mapanything"]
SIZES = [(160, 96), (160, 96), (120, 72)]
INPUT_SIZE = (84, 56)


def as_the_network_gives_it(name: str, raw: dict) -> dict:
    """Add the batch axis, and the channel axis of maps if the network has one."""
    one = {key: value[None] for key, value in raw.items()}
    if name == "da3":
        return {"pose_enc": one["c2w_9"], "depth": one["z"], "depth_conf": one["expp1"]}
    if name == "vggt":
        depth = one["z"][..., None]
        return {"pose_enc": one["w2c_9"], "depth": depth, "depth_conf": one["expp1"]}
    if name == "pi3":
        poses = one["c2w_34"].copy()
        poses[..., :3] = poses[..., :3] @ np.diag([0.4, 1.3, 0.9])
        conf = one["logit"][..., None]
        return {"local_points": one["points"], "camera_poses": poses, "conf": conf}
    along, conf = one["along"][..., None], one["expp1"][..., None]
    return {"poses": one["c2w_xyzw"], "rays": one["rays"], "depth_along_ray": along, "conf": conf}


def exported(name: str, folder) -> Manifest:
    """A folder as written by export.py, around an arbitrary graph."""
    from exporting import folder as text

    (folder / "LICENSE").write_text("none")
    np.savez(folder / "golden.npz", a=np.zeros(1))
    value = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1])
    graph = helper.make_graph([helper.make_node("Abs", ["x"], ["y"])], "g", [value], [])
    save_model(helper.make_model(graph), folder / "model.onnx")
    template = (EXPORTED / name / "template.toml").read_text()
    (folder / "manifest.toml").write_text(text.filled(template, INPUT_SIZE, 12, "MIT", True))
    text.set_golden(folder)
    text.set_variant(folder, "fp32", folder / "model.onnx")
    return read_manifest(folder)


@pytest.mark.parametrize("name", NAMES)
def test_a_filled_template_is_a_valid_manifest(name, tmp_path):
    manifest = exported(name, tmp_path)
    assert verify(manifest) == 2
    assert (manifest.frames.min, manifest.frames.max, manifest.frames.dynamic) == (2, 12, True)
    assert manifest.golden.scene
    fits = fit_pictures(manifest.input, SIZES)
    images = [np.zeros((h, w, 3), np.uint8) for w, h in SIZES]
    assert input_tensor(manifest.input, images, fits).shape == (1, 3, 3, 56, 84)


@pytest.mark.parametrize("name", NAMES)
def test_the_error_of_a_model_not_exported_names_its_readme(name, tmp_path, monkeypatch):
    (tmp_path / name).mkdir()
    (tmp_path / name / "export.py").touch()
    monkeypatch.setattr("calm_edge.backbones.onnx.model_folder.search_path", lambda: [tmp_path])
    with pytest.raises(ManifestError, match="not exported yet"):
        find_model(name)


@pytest.mark.parametrize("name", NAMES)
def test_known_geometry_is_decoded(name, tmp_path):
    outputs = exported(name, tmp_path).output
    fits = fit_pictures(read_manifest(tmp_path).input, SIZES)
    scene = make_scene(SIZES)
    raw = as_the_network_gives_it(name, raw_outputs(scene, fits))
    assert set(raw) == set(outputs.names())
    out = decode(outputs, raw, fits)
    assert out.T_s_c == pytest.approx(scene.T_s_c(), abs=1e-5)
    assert pytest.approx(scene.K, rel=1e-4, abs=1e-2) == matrices(out.cameras)
    truth = raw_outputs(scene, fits)["z"]
    assert np.abs(out.depth / truth - 1).max() < 1e-4
    order = np.argsort(raw_outputs(scene, fits)["logit"].ravel())
    assert (np.diff(out.strength.ravel()[order]) >= 0).all()


def test_a_variant_replaces_its_line_and_names_weight_files(tmp_path):
    from exporting import folder as text

    exported("vggt", tmp_path)
    weights = tmp_path / "int8.data"
    weights.write_bytes(bytes(16))
    tensor = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[4])
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", weights.name
    graph = helper.make_graph([helper.make_node("Identity", ["w"], ["y"])], "g", [], [], [tensor])
    (tmp_path / "int8.onnx").write_bytes(helper.make_model(graph).SerializeToString())
    for _ in range(2):
        text.set_variant(tmp_path, "int8", tmp_path / "int8.onnx")
    model = read_manifest(tmp_path).graphs["model"]
    assert model.fp32.file == "model.onnx"
    assert model.int8.external == {weights.name: hashlib.sha256(bytes(16)).hexdigest()}
    assert (tmp_path / "manifest.toml").read_text().count("int8 = ") == 1
