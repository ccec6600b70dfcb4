"""The encoding is lossless."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from calm_edge.recording import RecordingError, record
from calm_edge.types import LocalizerUpdate, PoseSample, Submap
from tests.recording import samples


@given(
    hnp.arrays(
        st.sampled_from([np.float64, np.float32, np.float16, np.int64, np.uint8, np.bool_]),
        hnp.array_shapes(min_dims=0, max_dims=4, min_side=0),
    )
)
def test_any_array_is_decoded_exactly(array: np.ndarray) -> None:
    _, arrays = record.decode("Submap", record.encode("Submap", {}, {"a": array}))
    assert samples.same(np.asarray(array), arrays["a"])
    assert arrays["a"].flags.writeable


def test_non_contiguous_and_big_endian_arrays_keep_their_values() -> None:
    array = np.arange(12, dtype=">f8").reshape(3, 4).T
    _, arrays = record.decode("Submap", record.encode("Submap", {}, {"a": array}))
    np.testing.assert_array_equal(arrays["a"], array)


@pytest.mark.parametrize("depth", [True, False])
def test_nested_dataclasses_round_trip(depth: bool) -> None:
    update = samples.update(depth=depth)
    data = record.encode("Submap", *record.flatten(update))
    again = record.unflatten(LocalizerUpdate, *record.decode("Submap", data))
    assert samples.same(update, again)


def test_absent_optional_and_empty_values_round_trip() -> None:
    update = samples.update()
    prediction = dataclasses.replace(
        update.prediction, kit=None, landmarks=None, focal_log_sigma=None
    )
    bare = dataclasses.replace(update, prediction=prediction, kit=None, stage_ms={})
    again = record.unflatten(LocalizerUpdate, *record.flatten(bare))
    assert samples.same(bare, again)


def test_infinity_is_written_as_text_because_json_has_none() -> None:
    submap = dataclasses.replace(samples.update().submap, scale_log_sigma=np.inf)
    header, arrays = record.flatten(submap)
    text = json.dumps(header, allow_nan=False)
    assert samples.same(submap, record.unflatten(Submap, json.loads(text), arrays))


def test_fields_of_an_earlier_version_are_ignored() -> None:
    header, arrays = record.flatten(samples.pose())
    again = record.unflatten(PoseSample, header | {"gone": 1}, arrays | {"T_gone": np.eye(4)})
    assert samples.same(samples.pose(), again)


def test_a_missing_field_raises_a_recording_error() -> None:
    header, arrays = record.flatten(samples.pose())
    del arrays["T_w_c"]
    with pytest.raises(RecordingError, match="PoseSample"):
        record.unflatten(PoseSample, header, arrays)


@pytest.mark.parametrize("data", [b"\xff\xff\xff", b"", b"\x0a\x03{,}"])
def test_foreign_bytes_raise_a_recording_error(data: bytes) -> None:
    with pytest.raises(RecordingError):
        record.decode("PoseSample", data)


def test_python_objects_are_not_decoded() -> None:
    message = record.message_class("Submap")()
    message.header = "{}"  # type: ignore[attr-defined]
    message.arrays.add(name="a", dtype="|O", shape=[1], data=bytes(8))  # type: ignore[attr-defined]
    with pytest.raises(RecordingError):
        record.decode("Submap", message.SerializeToString())


def test_large_arrays_are_compressed_and_read_back_to_the_bit() -> None:
    index = np.repeat(np.arange(500), 9)
    arrays = {"index": index, "noise": np.random.default_rng(0).normal(size=99), "few": index[:4]}
    data = record.encode("Submap", {}, arrays)
    assert len(data) < index.nbytes / 8 + 99 * 8 + 200
    _, again = record.decode("Submap", data)
    for name, array in arrays.items():
        assert again[name].dtype == array.dtype and (again[name] == array).all()


@pytest.mark.parametrize(
    "change",
    [
        {"compression": "lz4"},
        {"data": b"no frame"},
        # a frame that says it holds more than the array
        {"shape": [1]},
    ],
)
def test_a_damaged_compressed_array_is_a_damaged_record(change: dict[str, Any]) -> None:
    message: Any = record.message_class("Submap")()
    message.ParseFromString(record.encode("Submap", {}, {"index": np.arange(500)}))
    for name, value in change.items():
        if name == "shape":
            del message.arrays[0].shape[:]
            message.arrays[0].shape.extend(value)
        else:
            setattr(message.arrays[0], name, value)
    with pytest.raises(RecordingError, match="not a valid record"):
        record.decode("Submap", message.SerializeToString())
