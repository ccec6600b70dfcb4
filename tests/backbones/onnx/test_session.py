"""Loading and running of a graph, and errors of one line."""

from __future__ import annotations

import numpy as np
import pytest
from onnx import TensorProto, helper, save_model

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.onnx.session import Session


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Graph y = 2 x, z = sum of the rows of y, for x (any, 3) float."""
    nodes = [
        helper.make_node("Add", ["x", "x"], ["y"]),
        helper.make_node("ReduceSum", ["y", "axis"], ["z"], keepdims=0),
    ]
    graph = helper.make_graph(
        nodes,
        "double",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, ["n", 3])],
        [
            helper.make_tensor_value_info("y", TensorProto.FLOAT, ["n", 3]),
            helper.make_tensor_value_info("z", TensorProto.FLOAT, [3]),
        ],
        [helper.make_tensor("axis", TensorProto.INT64, [1], [0])],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    file = tmp_path_factory.mktemp("session") / "double.onnx"
    save_model(model, file)
    return file


@pytest.mark.parametrize("n", [1, 4])
def test_outputs_are_returned_by_name_for_any_free_size(path, n):
    x = np.arange(3.0 * n).reshape(n, 3)
    out = Session(path).run({"x": x})
    assert np.array_equal(out["y"], 2 * x) and np.array_equal(out["z"], 2 * x.sum(0))
    assert out["y"].dtype == np.float32


def test_only_the_requested_outputs_are_returned(path):
    assert list(Session(path).run({"x": np.zeros((2, 3))}, ["z"])) == ["z"]


def test_tensors_are_described(path):
    session = Session(path, threads=1)
    assert session.inputs["x"].shape == (None, 3)
    assert str(session.inputs["x"]) == "x (any, 3)"
    assert list(session.outputs) == ["y", "z"]


@pytest.mark.parametrize(
    ("feeds", "line"),
    [
        ({}, "input 'x' was not given"),
        ({"x": np.zeros((2, 3)), "w": np.zeros(1)}, "has no input 'w'; it has x"),
        ({"x": np.zeros((2, 4))}, "input x (any, 3) was given the shape (2, 4)"),
        ({"x": np.zeros(3)}, "input x (any, 3) was given the shape (3,)"),
    ],
)
def test_wrong_inputs_are_errors_of_one_line(path, feeds, line):
    with pytest.raises(BackboneError) as caught:
        Session(path).run(feeds)
    assert str(caught.value) == f"{path}: {line}"


def test_a_missing_required_tensor_is_an_error(path):
    with pytest.raises(BackboneError, match="has no output 'depth'; it has y, z"):
        Session(path, needs_outputs=["y", "depth"])
    with pytest.raises(BackboneError, match="has no input 'image'; it has x"):
        Session(path, needs_inputs=["image"])


def test_an_invalid_graph_file_is_an_error_of_one_line(tmp_path):
    with pytest.raises(BackboneError, match="no such graph"):
        Session(tmp_path / "none.onnx")
    (tmp_path / "bad.onnx").write_bytes(b"not a graph")
    with pytest.raises(BackboneError, match=r"bad\.onnx: cannot be loaded: ") as caught:
        Session(tmp_path / "bad.onnx")
    assert "\n" not in str(caught.value)
