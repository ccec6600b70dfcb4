"""Convert TOML tables to typed dataclasses; unknown keys and wrong types are errors."""

from __future__ import annotations

import dataclasses
import math
from types import NoneType, UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from calm_edge.types import CalmEdgeError


def coerce(where: str, kind: Any, value: Any, error: type[CalmEdgeError]) -> Any:
    """Convert a `value` read from TOML to the type `kind`; raises `error` with a one-line message.

    where: name of the key, which begins the message. Supported types: str, bool, int, float, Any,
    Literal, tuple[X, ...] (from a single number or text too), dict[str, X], X | None, int | str,
    and dataclasses of these.
    """
    origin = get_origin(kind)
    if kind is Any:
        return value
    if origin is UnionType:
        kinds = [k for k in get_args(kind) if k is not NoneType]
        return coerce(where, next((k for k in kinds if type(value) is k), kinds[0]), value, error)
    if origin is Literal:
        if value not in get_args(kind):
            raise error(f"{where} = {value!r}: expected one of {', '.join(get_args(kind))}")
        return value
    if origin is tuple:
        single = str if get_args(kind)[0] is str else int | float
        if isinstance(value, single) and not isinstance(value, bool):
            value = [value]
        if not isinstance(value, list | tuple):
            raise error(f"{where}: expected a list, got {value!r}")
        return tuple(coerce(where, get_args(kind)[0], v, error) for v in value)
    if origin is dict:
        item = get_args(kind)[1]
        table = _table(where, value, error)
        return {k: coerce(f"{where}.{k}", item, v, error) for k, v in table.items()}
    if dataclasses.is_dataclass(kind):
        return record(where, kind, value, error)
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        return _finite(where, value, error)
    if type(value) is not kind:
        raise error(f"{where}: expected {kind.__name__}, got {value!r}")
    return value


def record(where: str, kind: Any, value: Any, error: type[CalmEdgeError]) -> Any:
    """Convert a table to the dataclass `kind`; fields without a default are required.

    where: name of the table, put before the key in messages; empty at the top. Raises `error`.
    """
    table = _table(where, value, error)
    kinds = get_type_hints(kind)
    before = f"{where}." if where else ""
    for key in table:
        if key not in kinds:
            raise error(f"{before}{key}: no such key; known: {', '.join(kinds)}")
    for field in dataclasses.fields(kind):
        absent = field.default is field.default_factory is dataclasses.MISSING
        if absent and field.name not in table:
            raise error(f"{before}{field.name}: missing")
    return kind(**{k: coerce(f"{before}{k}", kinds[k], v, error) for k, v in table.items()})


def _finite(where: str, value: float, error: type[CalmEdgeError]) -> float:
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise error(f"{where}: expected a finite number")
    return number


def _table(where: str, value: Any, error: type[CalmEdgeError]) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise error(f"{where}: expected a table of keys")
    return value
