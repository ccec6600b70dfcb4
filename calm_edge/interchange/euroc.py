"""EuRoC and others in the ASL layout: `mav0/{cam0,cam1}/{data,data.csv,sensor.yaml}`.

`mav0/state_groundtruth_estimate0` has the true poses of the body: stamp [ns], position [m],
quaternion w x y z. T_BS in a sensor.yaml takes the camera's points to the body.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from calm_edge.geometry import se3
from calm_edge.interchange.base import Imported, ImportOptions
from calm_edge.interchange.calibration import fields
from calm_edge.interchange.calibration.calibration import CalibratedCamera, Calibration
from calm_edge.interchange.calibration.opencv import distorted_camera
from calm_edge.interchange.published import (
    DatasetError,
    Published,
    folder,
    imported,
    lines,
    numbers,
    size,
)
from calm_edge.types import Float, Int

TRUTH = "state_groundtruth_estimate0"


def read(place: Path) -> Published:
    """Read the folder with cam0 and cam1; raises DatasetError, CalibrationError."""
    listed = [_listed(place / f"cam{eye}") for eye in range(2)]
    dropped = tuple(line for _, _, missing in listed for line in missing)
    cameras, T_b_c = [], []
    for eye, (files, _, _) in enumerate(listed):
        if not files:
            raise DatasetError(f"{place / f'cam{eye}'}: data.csv names no picture that is there")
        camera, T = _camera(place / f"cam{eye}" / "sensor.yaml", size(files[0]))
        cameras.append(camera)
        T_b_c.append(T)
    calibration = Calibration(tuple(cameras), se3.inverse(T_b_c[0]) @ T_b_c[1], metric=True)
    truth = _truth(place / TRUTH)
    return Published(
        (listed[0][0], listed[1][0]),
        (listed[0][1], listed[1][1]),
        calibration,
        None if truth is None else (truth[0], truth[1] @ T_b_c[0]),
        dropped,
    )


def _rows(path: Path, what: str) -> list[str]:
    return [line for line in lines(path, what) if not line.lstrip().startswith("#")]


def _listed(place: Path) -> tuple[tuple[Path, ...], Int, list[str]]:
    """Pictures in data.csv, their stamps, and a line on those that are missing."""
    folder(place, "data, data.csv and sensor.yaml")
    stamps, files, missing = [], [], 0
    for row in _rows(place / "data.csv", "a stamp [ns] and a file name a row"):
        stamp, _, name = row.partition(",")
        if not stamp.strip().isdigit():
            raise DatasetError(f"{place / 'data.csv'}: {row[:60]!r} has no stamp in ns")
        file = place / "data" / (name.strip() or f"{stamp.strip()}.png")
        if not file.is_file():
            missing += 1
            continue
        stamps.append(int(stamp))
        files.append(file)
    if (np.diff(stamps) <= 0).any():
        raise DatasetError(f"{place / 'data.csv'}: its stamps do not increase")
    lost = [f"{place / 'data.csv'}: {missing} rows without a picture"] if missing else []
    return tuple(files), np.array(stamps, np.int64), lost


def _camera(path: Path, shape: tuple[int, int]) -> tuple[CalibratedCamera, Float]:
    """Camera, and T_b_c (4, 4) from it to the body."""
    try:
        content = fields.parsed_yaml(path, path.read_bytes())
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror})") from None
    where = str(path)
    matrix = fields.numbers(where, "intrinsics", content.get("intrinsics"), (4,))
    k = fields.numbers(where, "distortion_coefficients", content.get("distortion_coefficients"))
    model = str(content.get("distortion_model", "")).lower()
    if model not in ("radial-tangential", "radtan", "plumb_bob", "equidistant", "none"):
        raise DatasetError(f"{path}: distortion_model {model!r} is not supported")
    fx, fy, cx, cy = matrix
    fisheye = model == "equidistant"
    camera = distorted_camera(where, (fx, fy, cx, cy), k, shape, fisheye=fisheye)
    mounted = content.get("T_BS")
    T = mounted.get("data") if isinstance(mounted, dict) else mounted
    return camera, fields.transform(where, "T_BS", T)


def _truth(place: Path) -> tuple[Int, Float] | None:
    """Stamps (M,) ns and T_w_b (M, 4, 4) of the body, None if there are none."""
    path = place / "data.csv"
    if not path.is_file():
        return None
    rows = _rows(path, "stamp, position and quaternion a row")
    if len(rows) < 2:
        raise DatasetError(f"{path}: {len(rows)} poses; at least two are needed")
    t_ns, values = [], []
    for row in rows:
        stamp, _, rest = row.partition(",")
        try:
            t_ns.append(int(stamp))
        except ValueError:
            raise DatasetError(f"{path}: {row[:60]!r} has no stamp in ns") from None
        values.append(numbers(path, ",".join(rest.split(",")[:7]), (7,)))
    table = np.array(values)
    # scalar first
    R = se3.rotations(np.roll(table[:, 3:] / np.linalg.norm(table[:, 3:], axis=1)[:, None], -1, 1))
    return np.array(t_ns, np.int64), se3.compose(R, table[:, :3])


class EuRoC:
    """Importer of a sequence in the ASL layout."""

    name = "EuRoC"
    reads = "a sequence folder of EuRoC or in its layout (mav0)"

    def recognises(self, sources: tuple[Path, ...]) -> bool:
        """Whether the folder, or mav0 in it, has cam0/data.csv and cam0/sensor.yaml."""
        place = _place(sources[0]) / "cam0"
        there = (place / "data.csv").is_file() and (place / "sensor.yaml").is_file()
        return len(sources) == 1 and there

    def open(
        self,
        sources: tuple[Path, ...],
        options: ImportOptions,
        scratch: Path,
        say: Callable[[str], None],
    ) -> Imported:
        """Read the sequence."""
        return imported(read(_place(sources[0])), self.name)


def _place(source: Path) -> Path:
    return source / "mav0" if (source / "mav0").is_dir() else source
