"""Encode dataclasses losslessly as protobuf messages: a JSON header and named raw arrays.

Every schema `calm_edge.<name>` has the same two fields: `header` (JSON text: every scalar field by
its dotted name; null for None) and `arrays` (name, numpy dtype string with byte order, shape,
C-ordered bytes, compression: if `zstd`, the bytes are a Zstandard frame). Each file holds the
schemas as FileDescriptorSet, so any protobuf tool reads it.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
from enum import Enum
from functools import cache
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import zstandard
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError, Message
from numpy.typing import NDArray

from calm_edge.geometry.camera import Camera
from calm_edge.recording import RecordingError, camera_record

# smaller arrays are not compressed
COMPRESSED_BYTES = 256
RECORDS = ("Submap", "Window", "PoseSample")

T = TypeVar("T")
Arrays = dict[str, NDArray[Any]]


def _descriptor() -> descriptor_pb2.FileDescriptorProto:
    field = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(
        name="calm_edge/records.proto", package="calm_edge", syntax="proto3"
    )
    array = file.message_type.add(name="Array")
    one, many = field.LABEL_OPTIONAL, field.LABEL_REPEATED
    array.field.add(name="name", number=1, type=field.TYPE_STRING, label=one)
    array.field.add(name="dtype", number=2, type=field.TYPE_STRING, label=one)
    array.field.add(name="shape", number=3, type=field.TYPE_INT64, label=many)
    array.field.add(name="data", number=4, type=field.TYPE_BYTES, label=one)
    array.field.add(name="compression", number=5, type=field.TYPE_STRING, label=one)
    for name in RECORDS:
        record = file.message_type.add(name=name)
        record.field.add(name="header", number=1, type=field.TYPE_STRING, label=one)
        record.field.add(
            name="arrays",
            number=2,
            type=field.TYPE_MESSAGE,
            label=many,
            type_name=".calm_edge.Array",
        )
    return file


_pool = descriptor_pool.DescriptorPool()
_pool.AddSerializedFile(_descriptor().SerializeToString())


def message_class(name: str) -> type[Message]:
    """Return the protobuf class of `calm_edge.<name>`, with name one of RECORDS."""
    return message_factory.GetMessageClass(_pool.FindMessageTypeByName(f"calm_edge.{name}"))


def flatten(value: Any, prefix: str = "") -> tuple[dict[str, Any], Arrays]:
    """Split a dataclass, nested ones included, into (JSON scalars, arrays) by dotted field name."""
    header: dict[str, Any] = {}
    arrays: Arrays = {}
    for field in dataclasses.fields(value):
        item, name = getattr(value, field.name), prefix + field.name
        if isinstance(item, np.ndarray):
            arrays[name] = item
        elif dataclasses.is_dataclass(item):
            # {} marks an optional dataclass as present, even if all its fields are arrays
            header[name] = {}
            inner_header, inner_arrays = flatten(item, name + ".")
            header.update(inner_header)
            arrays.update(inner_arrays)
        elif isinstance(item, Enum):
            header[name] = item.value
        elif isinstance(item, np.generic):
            header[name] = item.item()
        elif isinstance(item, tuple):
            header[name] = [_plain(v) for v in item]
        elif isinstance(item, float) and not math.isfinite(item):
            header[name] = str(item)  # JSON has no infinity
        elif isinstance(item, dict):
            header[name] = {str(k): float(v) for k, v in item.items()}
        else:
            header[name] = item
    return header, arrays


def array_bytes(value: Any) -> int:
    """Return the size of the arrays in a dataclass."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    if not dataclasses.is_dataclass(value):
        return 0
    return sum(array_bytes(getattr(value, field.name)) for field in dataclasses.fields(value))


def _plain(value: Any) -> Any:
    if isinstance(value, Camera):
        return camera_record.encode(value)
    return value.item() if isinstance(value, np.generic) else value


def unflatten(kind: type[T], header: dict[str, Any], arrays: Arrays, prefix: str = "") -> T:
    """Build a dataclass from the output of `flatten`; absent fields take their defaults.

    Raises RecordingError if a field without a default is absent.
    """
    values: dict[str, Any] = {}
    hints = _type_hints(kind)  # type: ignore[arg-type]
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        name = prefix + field.name
        hint: Any = hints[field.name]
        if get_origin(hint) in (Union, types.UnionType):
            hint = next(a for a in get_args(hint) if a is not type(None))
        if name in arrays:
            values[field.name] = arrays[name]
        elif name in header:
            value = header[name]
            if value is None:
                values[field.name] = None
            elif isinstance(hint, type) and dataclasses.is_dataclass(hint):
                values[field.name] = unflatten(hint, header, arrays, name + ".")
            elif get_origin(hint) is tuple:
                cameras = get_args(hint)[0] is Camera
                values[field.name] = tuple(map(camera_record.decode, value) if cameras else value)
            elif isinstance(hint, type):
                values[field.name] = hint(value)
            else:
                values[field.name] = value
    try:
        return kind(**values)
    except TypeError as error:
        raise RecordingError(f"{kind.__name__}: incomplete record ({error})") from None


@cache
def _type_hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def encode(name: str, header: dict[str, Any], arrays: Arrays) -> bytes:
    """Serialise header and arrays as `calm_edge.<name>`."""
    message: Any = message_class(name)()
    message.header = json.dumps(header)
    for key, value in arrays.items():
        data, compression = value.tobytes(), ""
        if len(data) >= COMPRESSED_BYTES:
            data, compression = zstandard.ZstdCompressor(level=3).compress(data), "zstd"
        message.arrays.add(
            name=key, dtype=value.dtype.str, shape=value.shape, data=data, compression=compression
        )
    return bytes(message.SerializeToString())


def _data(array: Any) -> bytes:
    """Bytes of an array of a message; raises ValueError or ZstdError."""
    if not array.compression:
        return bytes(array.data)
    size = math.prod(array.shape) * np.dtype(array.dtype).itemsize
    if array.compression != "zstd" or zstandard.frame_content_size(array.data) != size:
        raise ValueError(f"{array.name}: not compressed as it says")
    return zstandard.ZstdDecompressor().decompress(array.data)


def decode(name: str, data: bytes) -> tuple[dict[str, Any], Arrays]:
    """Parse `calm_edge.<name>` to (header, writable arrays); raises RecordingError."""
    message: Any = message_class(name)()
    try:
        message.ParseFromString(data)
        header = json.loads(message.header)
        arrays = {
            a.name: np.frombuffer(_data(a), np.dtype(a.dtype)).reshape(tuple(a.shape)).copy()
            for a in message.arrays
        }
    except (DecodeError, zstandard.ZstdError, ValueError, TypeError) as error:
        raise RecordingError(f"calm_edge.{name}: not a valid record ({error})") from None
    return header, arrays
