"""Typed access to the values of a parsed calibration file; errors name the file and the key."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from calm_edge.geometry import se3
from calm_edge.interchange.calibration.calibration import CalibrationError
from calm_edge.types import Float


def parsed_yaml(path: Path, data: bytes) -> dict[str, Any]:
    """Parse YAML with a mapping at its top; raises CalibrationError."""
    try:
        content = yaml.safe_load(data.decode())
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise CalibrationError(f"{path}: not valid YAML ({reason})") from None
    if not isinstance(content, dict):
        raise CalibrationError(f"{path}: no calibration in it")
    return content


def is_yaml_with(data: bytes, *keys: str) -> bool:
    """Whether any of the keys begins a line of a text file."""
    lines = data.decode(errors="replace").splitlines()
    return any(line.startswith(f"{key}:") for line in lines for key in keys)


def numbers(where: str, name: str, value: Any, counts: Sequence[int] = ()) -> list[float]:
    """A list of finite numbers; raises CalibrationError unless its length is one of `counts`."""
    try:
        array = np.array(value, np.float64).ravel()
    except (TypeError, ValueError):
        raise CalibrationError(f"{where}: {name} is not a list of numbers") from None
    if not np.isfinite(array).all():
        raise CalibrationError(f"{where}: {name} is not a list of finite numbers")
    if counts and len(array) not in counts:
        wanted = " or ".join(map(str, counts))
        raise CalibrationError(f"{where}: {name} has {len(array)} numbers, not {wanted}")
    return [float(each) for each in array]


def transform(where: str, name: str, value: Any) -> Float:
    """A rigid transform (4, 4); raises CalibrationError if its rotation is none."""
    T = np.array(numbers(where, name, value, (16,))).reshape(4, 4)
    return rigid(where, name, T[:3, :3], T[:3, 3])


def rigid(where: str, name: str, R: Float, t: Float) -> Float:
    """The transform (4, 4) of a rotation (3, 3), rounded in the file, and a translation (3,)."""
    U, _, Vt = np.linalg.svd(R)
    nearest = U @ Vt
    if np.abs(nearest - R).max() > 1e-3 or np.linalg.det(nearest) < 0:
        raise CalibrationError(f"{where}: {name} is not a rotation")
    if not np.linalg.norm(t) > 0:
        raise CalibrationError(f"{where}: {name} puts both cameras in one place")
    return se3.compose(nearest, np.ravel(t))
