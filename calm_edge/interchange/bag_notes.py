"""Calibration, GPS fixes and IMU samples of a bag, to be kept beside the recording."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calm_edge.interchange.bag_pictures import stamp_ns
from calm_edge.interchange.bag_topics import Topic
from calm_edge.interchange.calibration import formats
from calm_edge.interchange.calibration.calibration import Calibration, CalibrationError

INFO = ("sensor_msgs/msg/CameraInfo", "foxglove.CameraCalibration")
FIX = ("sensor_msgs/msg/NavSatFix", "foxglove.LocationFix")
IMU = ("sensor_msgs/msg/Imu",)


@dataclass(slots=True)
class BagNotes:
    """What a bag holds beside pictures."""

    infos: dict[str, Any] = field(default_factory=dict)
    fixes: dict[str, list[tuple[Any, ...]]] = field(default_factory=dict)
    imus: dict[str, list[tuple[Any, ...]]] = field(default_factory=dict)

    def add(self, name: str, kind: str, log_ns: int, m: Any) -> None:
        """Keep a message of INFO, FIX or IMU."""
        t_s = f"{(stamp_ns(kind, m) or log_ns) / 1e9:.9f}"
        if kind in INFO:
            self.infos.setdefault(name, m)
        elif kind in FIX:
            status = getattr(getattr(m, "status", None), "status", "")
            row = (t_s, m.latitude, m.longitude, m.altitude, status, *m.position_covariance)
            self.fixes.setdefault(name, []).append(row)
        else:
            w, a = m.angular_velocity, m.linear_acceleration
            self.imus.setdefault(name, []).append((t_s, w.x, w.y, w.z, a.x, a.y, a.z))

    def write(self, folder: Path) -> list[tuple[str, int, Path]]:
        """Write a CSV file for each topic of fixes and of an IMU: (topic, rows, file)."""
        cov = [f"covariance_{i}{j}_m2" for i in "enu" for j in "enu"]
        fix = ["t_s", "latitude_deg", "longitude_deg", "altitude_m", "status", *cov]
        imu = ["t_s", *(f"{q}_{x}" for q in ("gyro_rad_s", "accel_m_s2") for x in "xyz")]
        found = []
        for stem, head, tables in (("gps", fix, self.fixes), ("imu", imu, self.imus)):
            for number, (name, rows) in enumerate(sorted(tables.items())):
                path = folder / (f"{stem}{number or ''}.csv")
                with path.open("w", newline="") as file:
                    csv.writer(file).writerows([head, *rows])
                found.append((name, len(rows), path))
        return found


def calibration(
    notes: BagNotes, chosen: list[Topic], scratch: Path, assumed: list[str]
) -> Calibration | None:
    """Calibration by the camera_info beside each picture topic, if there is one for each."""
    files = []
    for number, topic in enumerate(chosen):
        place = topic.name.rsplit("/", 1)[0]
        places = place, place.rsplit("/", 1)[0]
        infos = sorted(notes.infos.items())
        beside = [m for name, m in infos if name.rsplit("/", 1)[0] in places]
        if not beside:
            return None
        files.append(scratch / f"camera_info{number}.yaml")
        files[-1].write_text(_camera_info(beside[0]))
    try:
        return formats.read(tuple(files))
    except CalibrationError as error:
        assumed.append(f"no calibration: {str(error).partition(': ')[2] or error}")
        return None


def _camera_info(m: Any) -> str:
    """A camera_info message as YAML with its own keys."""

    def matrix(name: str) -> list[float]:
        value = getattr(m, name.lower(), None)
        return [float(v) for v in (getattr(m, name) if value is None else value)]

    lines = [f"image_width: {m.width}", f"image_height: {m.height}"]
    lines += [f"distortion_model: '{m.distortion_model}'"]
    lines += [f"{name}: {matrix(name)}" for name in "KDRP"]
    return "\n".join(lines) + "\n"
