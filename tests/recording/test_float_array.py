"""Arrays in CDR, in a reader of ROS messages."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from calm_edge.recording import float_array


@pytest.mark.parametrize("values", [[1.5], [500.25, -490.0], [1.0, 2.0, 3.0]])
def test_arrays_are_read_with_the_definition_that_a_recording_holds(values: list[float]) -> None:
    schema = float_array.SCHEMA
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema.data.decode(), schema.name))
    read = store.deserialize_cdr(float_array.encode(values), schema.name)
    assert read.data.tolist() == values
    assert read.layout.dim == [] and read.layout.data_offset == 0


def test_the_bytes_are_those_of_ros_2_humble() -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    made = store.types["std_msgs/msg/Float64MultiArray"](layout, np.array([0.5, 7.0]))
    assert bytes(store.serialize_cdr(made, made.__msgtype__)) == float_array.encode([0.5, 7.0])
