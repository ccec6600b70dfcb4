"""`std_msgs/msg/Float64MultiArray` of ROS 2, which viewers plot that plot no JSON."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from calm_edge.recording.topic_schema import TopicSchema

_DEFINITION = f"""std_msgs/MultiArrayLayout layout
float64[] data
{"=" * 80}
MSG: std_msgs/MultiArrayLayout
std_msgs/MultiArrayDimension[] dim
uint32 data_offset
{"=" * 80}
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""
SCHEMA = TopicSchema("std_msgs/msg/Float64MultiArray", "ros2msg", _DEFINITION.encode(), "cdr")
# plain CDR, little endian
_HEADER = b"\x00\x01\x00\x00"


def encode(values: Sequence[float]) -> bytes:
    """Encode at least one number, without a layout, in CDR: aligned to 8 bytes from the header."""
    dimensions = offset = 0
    counts = struct.pack("<3I4x", dimensions, offset, len(values))
    return _HEADER + counts + struct.pack(f"<{len(values)}d", *values)
