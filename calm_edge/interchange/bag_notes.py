"""Calibration, GPS fixes and IMU samples of a bag."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calm_edge.interchange.bag_pictures import stamp_ns
from calm_edge.interchange.bag_topics import Topic
from calm_edge.interchange.calibration import formats
from calm_edge.interchange.calibration.calibration import Calibration, CalibrationError
from calm_edge.recording.sensors import ImuSample, Sample
from calm_edge.recording.sequence_folder import ORIGIN_NS
from device.gps.fix import Fix, FixKind, fix

INFO = ("sensor_msgs/msg/CameraInfo", "foxglove.CameraCalibration")
FIX = ("sensor_msgs/msg/NavSatFix", "foxglove.LocationFix")
IMU = ("sensor_msgs/msg/Imu",)


# of NavSatStatus
_KINDS = {
    -1: FixKind.NONE,
    0: FixKind.UNKNOWN,
    1: FixKind.DIFFERENTIAL,
    2: FixKind.DIFFERENTIAL,
}


@dataclass(slots=True)
class BagNotes:
    """What a bag holds beside pictures: the first calibration of a topic, fixes, IMU samples."""

    infos: dict[str, Any] = field(default_factory=dict)
    fixes: dict[str, list[Fix]] = field(default_factory=dict)
    imus: dict[str, list[ImuSample]] = field(default_factory=dict)

    def add(self, name: str, kind: str, log_ns: int, m: Any) -> None:
        """Keep a message of INFO, FIX or IMU. Stamps are those of the bag plus ORIGIN_NS."""
        t_ns = (stamp_ns(kind, m) or log_ns) + ORIGIN_NS
        if kind in INFO:
            self.infos.setdefault(name, m)
        elif kind in FIX:
            self.fixes.setdefault(name, []).append(_fix(t_ns, m))
        else:
            w, a = m.angular_velocity, m.linear_acceleration
            sample = ImuSample(t_ns, (w.x, w.y, w.z), (a.x, a.y, a.z))
            self.imus.setdefault(name, []).append(sample)

    def samples(self, took: list[str], dropped: list[str]) -> list[Sample]:
        """Samples of the fullest topic of fixes and of IMUs, by time; the other topics dropped."""
        found: list[Sample] = []
        for what, topics in (("fixes", self.fixes), ("IMU samples", self.imus)):
            for rank, name in enumerate(sorted(topics, key=lambda n: (-len(topics[n]), n))):
                line = f"{name}: {len(topics[name])} {what}"
                if rank:
                    dropped.append(f"{line}; those of the fullest topic are taken")
                else:
                    found += topics[name]
                    took.append(line)
        return sorted(found, key=lambda sample: sample.t_ns)


def _fix(t_ns: int, m: Any) -> Fix:
    status = getattr(getattr(m, "status", None), "status", 0)
    variances = [float(m.position_covariance[k]) for k in (0, 4, 8)] or [0.0] * 3
    known = all(0 < v < np.inf for v in variances)
    east, north, up = np.sqrt(variances).tolist() if known else (0.0, 0.0, 0.0)
    lla = float(m.latitude), float(m.longitude), float(m.altitude)
    kind = _KINDS.get(int(status), FixKind.UNKNOWN)
    if not np.isfinite(lla[:2]).all():
        kind = FixKind.NONE
    return fix(t_ns, None, lla, kind, (east, north, up) if known else None)


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
