"""Quantisation converts only layers that exchange information between views, and reports the rest.

The graph is small and has the parts of published ones: a product with weights and one of two
activations in the backbone, and a Gemm in the camera decoder, with the exporter's scopes as names.
"""

from __future__ import annotations

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper, shape_inference

from calm_edge.backbones.onnx.model_folder import EXPORTED, read_manifest, verify
from calm_edge.backbones.onnx.session import Session

SIZE = (28, 28)


def scoped(op: str, inputs, output: str, scope: str, **attributes):
    node = helper.make_node(op, inputs, [output], name=f"node_{output}", **attributes)
    parts = ["", "net", scope, f"{scope}.0"]
    node.metadata_props.add(key="pkg.torch.onnx.name_scopes", value=str(parts))
    return node


def backbone_and_camera() -> onnx.ModelProto:
    rng = np.random.default_rng(0)
    weights = {
        "w": rng.normal(size=(3, 64)).astype(np.float32),
        "camera": 0.1 * rng.normal(size=(64, 9)).astype(np.float32),
        "far": np.full(1, 1e6, np.float32),
        "first": np.zeros(1, np.int64),
        "maps": np.array([3, 4]),
    }
    inside, camera = "net.backbone", "net.cam_dec"
    nodes = [
        scoped("ReduceMean", ["images", "maps"], "mean", inside, keepdims=0),
        scoped("MatMul", ["mean", "w"], "tokens", inside),
        scoped("Transpose", ["tokens"], "turned", inside, perm=[0, 2, 1]),
        scoped("MatMul", ["tokens", "turned"], "likeness", inside),
        scoped("Softmax", ["likeness"], "share", inside),
        scoped("MatMul", ["share", "tokens"], "mixed", inside),
        scoped("Squeeze", ["mixed", "first"], "rows", camera),
        scoped("Gemm", ["rows", "camera"], "poses", camera),
        scoped("Mul", ["poses", "far"], "long", camera),
        scoped("Unsqueeze", ["long", "first"], "pose_enc", camera),
    ]
    views = helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, "views", 3, *SIZE])
    poses = helper.make_tensor_value_info("pose_enc", TensorProto.FLOAT, [1, "views", 9])
    tensors = [numpy_helper.from_array(value, name) for name, value in weights.items()]
    graph = helper.make_graph(nodes, "g", [views], [poses], tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    return shape_inference.infer_shapes(model)


@pytest.fixture
def folder(tmp_path):
    """A model folder as written by export.py, with images for calibration beside it."""
    from exporting import folder as text
    from exporting import runtime
    from exporting.pictures import normalised, pictures

    onnx.save(backbone_and_camera(), tmp_path / "model.onnx")
    (tmp_path / "LICENSE").write_text("none")
    template = (EXPORTED / "da3" / "template.toml").read_text()
    (tmp_path / "manifest.toml").write_text(text.filled(template, SIZE, 12, "MIT", False))
    shown = pictures(None, SIZE, 8)
    (tmp_path / "pictures").mkdir()
    for index, image in enumerate(shown):
        cv2.imwrite(str(tmp_path / "pictures" / f"{index}.png"), image)
    golden = {}
    spec = read_spec(tmp_path)
    for n in (2, 3):
        found = runtime.run(runtime.session(tmp_path / "model.onnx"), normalised(shown[:n], spec))
        golden |= {f"model/n{n}/pictures": shown[:n], f"model/n{n}/out/pose_enc": found["pose_enc"]}
    np.savez(tmp_path / "golden.npz", **golden)
    text.set_golden(tmp_path)
    text.set_variant(tmp_path, "fp32", tmp_path / "model.onnx")
    return tmp_path


def read_spec(folder):
    import tomllib

    return tomllib.loads((folder / "manifest.toml").read_text())["input"]


def products(path) -> dict[str, int]:
    """Number of nodes per type; a product with dequantised weights counts as int8."""
    model = onnx.load(path)
    int8 = {out for n in model.graph.node if n.op_type == "DequantizeLinear" for out in n.output}
    kinds: dict[str, int] = {}
    for node in model.graph.node:
        if node.op_type in ("MatMul", "Gemm", "MatMulInteger"):
            static = node.op_type != "MatMulInteger" and int8.issuperset(node.input[:2])
            kind = "static" if static else node.op_type
            kinds[kind] = kinds.get(kind, 0) + 1
    return kinds


def drift(out: str) -> list[float]:
    return [float(line.split()[-4]) for line in out.splitlines() if "RMS error" in line]


@pytest.mark.parametrize(
    ("how", "wanted"),
    [
        (["dynamic"], {"MatMulInteger": 1, "MatMul": 3}),
        (["static", "--windows", "2"], {"static": 1, "MatMul": 2, "Gemm": 1}),
    ],
)
def test_int8_converts_the_weights_of_the_backbone_only(folder, capsys, how, wanted):
    """Dynamic quantisation turns the camera's Gemm into a MatMul, which stays float."""
    import quantize

    quantize.main([str(folder), "--int8", *how, "--pictures", str(folder / "pictures")])
    assert products(folder / "model.int8.onnx") == wanted
    out = capsys.readouterr().out
    left = "int8: 3 of 4 multiplications stay float: net.backbone 2, net.cam_dec 1"
    assert out.splitlines()[0] == left
    assert len(drift(out)) == 2 and 0 < max(drift(out)) < 0.05
    assert verify(read_manifest(folder)) == 3


def test_fp16_converts_the_backbone_but_not_the_camera(folder, capsys):
    import quantize

    quantize.main([str(folder), "--fp16"])
    model = onnx.load(folder / "model.fp16.onnx")
    kinds = {t.name: t.data_type for t in model.graph.initializer}
    assert kinds["w"] == TensorProto.FLOAT16 and kinds["camera"] == TensorProto.FLOAT
    session = Session(folder / "model.fp16.onnx", threads=1)
    assert session.inputs["images"].dtype == session.outputs["pose_enc"].dtype == np.float32
    out = capsys.readouterr().out
    assert out.startswith("fp16: 1 of 4 multiplications stay float: net.cam_dec 1\n")
    # above the range of float16
    with np.load(folder / "golden.npz") as golden:
        assert np.abs(golden["model/n3/out/pose_enc"]).max() > 65504
    assert 0 < max(drift(out)) < 1e-3


def test_both_variants_in_one_call_equal_those_of_two_calls(folder):
    """Each is converted from the float graph, not from the other variant."""
    import quantize

    hashes = []
    for calls in ([["--fp16"], ["--int8", "dynamic"]], [["--fp16", "--int8", "dynamic"]]):
        for call in calls:
            quantize.main([str(folder), *call])
        graphs = read_manifest(folder).graphs["model"]
        hashes.append((graphs.fp16.sha256, graphs.int8.sha256))
    assert hashes[0] == hashes[1]


@pytest.mark.parametrize(
    ("call", "line"),
    [
        ([], "nothing to do; give --int8 or --fp16"),
        (["--int8", "static"], "--pictures: missing"),
        (["--fp16", "--parts", "net.none"], "--parts: no node of the graph belongs to net.none"),
        (["--int8", "static", "--pictures", "nowhere"], "nowhere: 0 images, but 32 are needed"),
    ],
)
def test_wrong_arguments_are_errors_of_one_line(folder, call, line):
    import quantize

    with pytest.raises(SystemExit, match=line):
        quantize.main([str(folder), *call])
