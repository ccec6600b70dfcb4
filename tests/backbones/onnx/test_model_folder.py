"""Reading of manifests, errors of one line, search of model folders, file hashes."""

from __future__ import annotations

import copy
import hashlib
import json

import pytest

from calm_edge.backbones.onnx import model_folder
from calm_edge.backbones.onnx.manifest import ManifestError
from calm_edge.backbones.onnx.model_folder import find_model, model_names, read_manifest, verify

DIGEST = hashlib.sha256(b"weights").hexdigest()
FEEDFORWARD = {
    "format": 1,
    "name": "small",
    "kind": "feedforward",
    "license": "Apache-2.0",
    "graphs": {
        "model": {
            "fp32": {"file": "a.onnx", "sha256": DIGEST, "external": {"a.data": DIGEST}},
            "int8": {"file": "b.onnx", "sha256": DIGEST},
        }
    },
    "input": {
        "name": "images",
        "layout": "BNCHW",
        "channels": "rgb",
        "resize": "width",
        "size_px": 28,
        "multiple": 14,
        "mean": [0.5, 0.5, 0.5],
        "std": 0.5,
    },
    "frames": {"min": 1, "max": 8, "dynamic": True},
    "golden": {"sha256": DIGEST},
    "output": {
        "pose": {"name": "p", "encoding": "mat3x4", "direction": "world_to_camera"},
        "intrinsics": {"encoding": "pixels", "name": "k"},
        "geometry": {"encoding": "z_depth", "name": "d"},
        "confidence": {"encoding": "expp1", "name": "c"},
    },
}
BUNDLE = {k: v for k, v in FEEDFORWARD.items() if k != "output"} | {
    "kind": "bundle",
    "graphs": {"encoder": {"int8": {"file": "a.onnx", "sha256": DIGEST}, "outputs": ["f"]}},
}


def toml(table: dict, where: str = "") -> str:
    """TOML text of a nested dict."""
    plain = [
        f"{json.dumps(k)} = {json.dumps(v)}" for k, v in table.items() if not isinstance(v, dict)
    ]
    text = "\n".join(plain) + "\n"
    for key, value in table.items():
        if isinstance(value, dict):
            name = f"{where}.{json.dumps(key)}" if where else json.dumps(key)
            text += f"[{name}]\n{toml(value, name)}"
    return text


def folder_of(tmp_path, table: dict):
    """Write a model folder with this manifest and all files it names."""
    (tmp_path / "manifest.toml").write_text(toml(table))
    (tmp_path / "LICENSE").write_text("free\n")
    for name in ("a.onnx", "a.data", "b.onnx", "golden.npz"):
        (tmp_path / name).write_bytes(b"weights")
    return tmp_path


def changed(table: dict, key: str, value) -> dict:
    """A deep copy with key `a.b.c` set, or removed if the value is None."""
    copied = copy.deepcopy(table)
    *parents, last = key.split(".")
    part = copied
    for name in parents:
        part = part.setdefault(name, {})
    if value is None:
        del part[last]
    else:
        part[last] = value
    return copied


def test_a_feedforward_manifest_is_read_with_its_defaults(tmp_path):
    m = read_manifest(folder_of(tmp_path, FEEDFORWARD))
    assert m.precisions() == ("fp32", "int8")
    assert m.graph_path("model", "int8") == tmp_path / "b.onnx"
    assert m.input.std == (0.5,) and m.input.multiple_by == "stretch"
    assert m.output is not None and m.output.names() == ("p", "k", "d", "c")
    assert m.golden.tolerance("fp32") == 1e-3 and m.golden.scene
    content = (tmp_path / "manifest.toml").read_bytes()
    assert m.folder == tmp_path and m.digest == hashlib.sha256(content).hexdigest()
    assert verify(m) == 4


def test_a_bundle_may_have_some_roles(tmp_path):
    m = read_manifest(folder_of(tmp_path, BUNDLE))
    assert m.output is None
    assert m.graphs["encoder"].outputs == ("f",) and m.precisions() == ("int8",)
    with pytest.raises(ManifestError, match=r"encoder has no fp32 graph; it has: int8"):
        m.graph_path("encoder", "fp32")
    with pytest.raises(ManifestError, match=r"depth has no int8 graph; it has: none"):
        m.graph_path("depth", "int8")


@pytest.mark.parametrize(
    ("key", "value", "line"),
    [
        ("colour", 1, "colour: no such key"),
        ("digest", "0", "digest: no such key"),
        ("name", None, "name: missing"),
        ("format", 2, "format = 2: this calm-edge reads 1"),
        ("kind", "magic", "kind = 'magic': expected one of feedforward, bundle"),
        ("graphs", {}, "graphs: none; kind feedforward has model"),
        ("graphs.encoder", {}, "graphs.encoder: no such role; kind feedforward has model"),
        ("graphs.model", {}, "graphs.model: names no file"),
        ("graphs.model.fp32.sha256", "12", "expected 64 hexadecimal digits"),
        ("graphs.model.fp32.file", "../a.onnx", "must be a file inside the model's folder"),
        ("graphs.model.fp32.file", "/a.onnx", "must be a file inside the model's folder"),
        ("input.layout", "NHCW", "input.layout = 'NHCW': expected one of"),
        ("input.mean", [0.1, 0.2], "input.mean: expected 1 or 3 numbers, got 2"),
        ("input.std", [0.1, 0.0, 1.0], "input.std: must be above 0"),
        ("input.resize", "keep", "input.size_px: needed for resize width and longest"),
        ("input.size_px", 0, "input.size_px: needed for resize width and longest"),
        ("input.size_px", 30, "input.size_px = 30: not a multiple of 14"),
        ("input.height_px", 20, "input.height_px = 20: not a multiple of 14"),
        ("input.multiple", 0, "multiple at least 1"),
        ("frames.min", 0, "frames: expected 1 <= min <= max, got 0 and 8"),
        ("frames.dynamic", False, "min and max must be equal"),
        ("golden.int8", 0, "golden: a tolerance must be above 0"),
        ("output", None, "output: missing"),
        ("output.intrinsics", {"encoding": "pixels"}, "output.intrinsics.name: missing"),
        ("output.intrinsics", {"encoding": "fov"}, "output.intrinsics.name: needed for fov"),
        ("output.intrinsics", {"encoding": "solved"}, "solved needs a point_map, or ray_depth"),
        ("output.geometry.rays", "r", "output.geometry.rays: only allowed for ray_depth"),
        ("output.confidence.encoding", "exp", "output.confidence.encoding = 'exp'"),
    ],
)
def test_an_invalid_table_raises_one_line_with_the_key(tmp_path, key, value, line):
    folder_of(tmp_path, changed(FEEDFORWARD, key, value))
    with pytest.raises(ManifestError) as caught:
        read_manifest(tmp_path)
    text = str(caught.value)
    assert text.startswith(f"{tmp_path / 'manifest.toml'}: ") and line in text
    assert "\n" not in text


def test_all_graphs_must_share_a_precision(tmp_path):
    depth = {"fp32": {"file": "b.onnx", "sha256": DIGEST}}
    folder_of(tmp_path, changed(BUNDLE, "graphs.depth", depth))
    with pytest.raises(ManifestError, match="there is no precision that all of them have"):
        read_manifest(tmp_path)


def test_unmeasured_must_be_a_precision_of_the_model(tmp_path):
    folder_of(tmp_path, BUNDLE | {"unmeasured": "fp16"})
    with pytest.raises(ManifestError, match="unmeasured = fp16: not all graphs have it"):
        read_manifest(tmp_path)


def test_bundle_must_not_have_outputs(tmp_path):
    folder_of(tmp_path, BUNDLE | {"output": FEEDFORWARD["output"]})
    with pytest.raises(ManifestError, match="output: only allowed for kind feedforward"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("name", ["a.onnx", "a.data", "b.onnx", "golden.npz"])
def test_a_changed_or_missing_file_is_an_error(tmp_path, name):
    m = read_manifest(folder_of(tmp_path, FEEDFORWARD))
    (tmp_path / name).write_bytes(b"weighty")
    with pytest.raises(ManifestError, match=rf"{name}: sha256 is [0-9a-f]+\.\.\., the manifest"):
        verify(m)
    (tmp_path / name).unlink()
    with pytest.raises(ManifestError, match=rf"{name}: cannot be read"):
        verify(m)


def test_files_of_another_precision_are_not_verified(tmp_path):
    m = read_manifest(folder_of(tmp_path, FEEDFORWARD))
    (tmp_path / "b.onnx").unlink()
    assert verify(m, ["fp32"]) == 3


def test_a_missing_licence_is_an_error(tmp_path):
    m = read_manifest(folder_of(tmp_path, FEEDFORWARD))
    (tmp_path / "LICENSE").unlink()
    with pytest.raises(ManifestError, match="LICENSE: missing"):
        verify(m)


def test_invalid_toml_is_an_error(tmp_path):
    (tmp_path / "manifest.toml").write_text("name = \n")
    with pytest.raises(ManifestError, match="not valid TOML"):
        read_manifest(tmp_path)


def test_models_are_found_by_name_and_by_path(tmp_path, monkeypatch):
    monkeypatch.setattr(model_folder, "search_path", lambda: [tmp_path])
    inside = tmp_path / "small"
    inside.mkdir()
    folder_of(inside, FEEDFORWARD)
    assert model_names() == ["small"]
    assert find_model("small") == inside and find_model(str(inside)) == inside
    for name in ("none", ""):
        with pytest.raises(ManifestError, match=r"neither a known name \(small\) nor a folder"):
            find_model(name)


def test_shipped_exported_and_data_folders_are_searched_in_this_order(tmp_path, monkeypatch):
    monkeypatch.setattr(model_folder, "SHIPPED", tmp_path / "checkout/calm_edge/models")
    monkeypatch.setattr(model_folder, "EXPORTED", tmp_path / "checkout/models")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_DATA_DIRS", f"{tmp_path / 'local'}:{tmp_path / 'usr'}")
    roots = ["checkout/calm_edge/models", "checkout/models"]
    roots += [f"{data}/calm-edge/models" for data in ("home", "local", "usr")]
    folders = [tmp_path / root / "small" for root in roots]
    for folder in folders:
        folder.mkdir(parents=True)
        folder_of(folder, FEEDFORWARD)
    (tmp_path / "checkout/pyproject.toml").touch()
    for folder in folders:
        assert find_model("small") == folder and model_names() == ["small"]
        (folder / "manifest.toml").unlink()
    assert model_names() == []


def test_a_models_folder_beside_an_installed_package_is_not_searched(tmp_path, monkeypatch):
    beside = tmp_path / "site-packages/models/small"
    beside.mkdir(parents=True)
    folder_of(beside, FEEDFORWARD)
    monkeypatch.setattr(model_folder, "EXPORTED", beside.parent)
    assert "small" not in model_names()


def test_the_shipped_model_is_complete():
    manifest = read_manifest(find_model("calm-geo"))
    assert manifest.folder == model_folder.SHIPPED / "calm-geo"
    assert verify(manifest) == 4
