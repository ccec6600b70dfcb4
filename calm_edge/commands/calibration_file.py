"""Calibration files of a configuration: read into it, and compared with the pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from calm_edge.config import Config, ConfigError, merge
from calm_edge.geometry import se3
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.interchange.calibration.formats import read
from calm_edge.kit.calibration import EYES, camera_of, described, matched
from calm_edge.recording.reader import Recording
from calm_edge.recording.sequence_folder import SequenceFolder
from device.frame import Eye

# Spacings that differ by a larger share are reported.
SAME_SPACING = 0.03


def with_calibration(config: Config, say: Callable[[str], None]) -> Config:
    """Read `calibration.file` into `calibration.cameras` and `rig`; raises CalibrationError.

    Without `scale.spacing_m` a rig in metres gives it. say: what was read, and its sigmas.
    """
    calibration = read(tuple(Path(name) for name in config.calibration.file))
    cameras = []
    for each in calibration.cameras:
        model = "fisheye" if isinstance(each.camera, Fisheye) else "perspective"
        cameras.append({**asdict(each.camera), "model": model, "fit_px": each.fit_px})
    rig: list[float] = []
    if calibration.T_p_a is not None:
        t = calibration.T_p_a[:3, 3]
        rig = [*se3.so3_log(calibration.T_p_a[:3, :3]).tolist(), *(t / np.linalg.norm(t)).tolist()]
    config = merge(config, {"calibration": {"cameras": cameras, "rig": rig}})
    for line in described(config.calibration):
        say(line)
    if len(cameras) == 1:
        say("the calibration holds one camera: it is used for the primary")
    measured, given = calibration.spacing_m, config.scale.spacing_m
    if measured is None:
        return config
    if not given:
        say(f"scale.spacing_m = {measured:.4f}: the distance of the cameras in the calibration")
        return merge(config, {"scale": {"spacing_m": measured}})
    if abs(measured / given - 1) > SAME_SPACING:
        say(f"the cameras are {measured:.3f} m apart in the calibration; {given:g} m is used")
    return config


def picture_size(
    config: Config, eye: Eye, sequence: Path | None, recording: Recording | None
) -> tuple[int, int]:
    """Width and height [px] of what is replayed, otherwise as configured."""
    if sequence is not None:
        height, width = next(iter(SequenceFolder(sequence).frames(eye))).gray().shape
        return width, height
    if recording is not None:
        return recording.picture_size(eye)
    return config.capture.width_px, config.capture.height_px


def refuse_other_sizes(config: Config, sequence: Path | None, recording: Recording | None) -> None:
    """Raise ConfigError if the calibration cannot be converted to the size of the pictures.

    sequence, recording: what is replayed; otherwise the size is the configured one.
    """
    for eye, entry in zip(Eye, config.calibration.cameras, strict=False):
        width, height = picture_size(config, eye, sequence, recording)
        camera, reason = matched(camera_of(entry), width, height)
        if camera is None:
            files = ", ".join(config.calibration.file)
            raise ConfigError(f"{files}: the {EYES[eye]} camera was {reason}")
