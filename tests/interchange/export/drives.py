"""A small recording whose true poses are known, to be exported."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from calm_edge.config import Config, merge
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.recording.time_base import ORIGIN_KEY
from calm_edge.recording.writer import RecordingWriter
from calm_edge.trajectories import write_tum
from calm_edge.types import (
    Float,
    Int,
    Landmarks,
    LocalizerUpdate,
    Metre,
    PoseSample,
    PoseStatus,
    Prediction,
    Submap,
    Trajectory,
)
from device.frame import Eye, Frame, jpeg
from tests.evaluation.worlds import curve, stamps

FRAMES, EVERY = 24, 4
ORIGIN_NS = 1_000_000_000
LATE_NS = 20_000_000
T_P_A = se3.exp(np.array([0.5, 0.02, -0.01, 0.01, 0.03, -0.02]))
LENSES: tuple[Camera, Camera] = (
    Perspective(180.0, 184.0, 94.5, 66.5, 192, 128, (-0.08, 0.02)),
    Perspective(220.0, 220.0, 99.5, 61.5, 192, 128, (-0.05, 0.01)),
)
# metres, in the world; in front of every view
MARKERS = np.array([[0.0, 0.5, 40.0], [-6.0, -2.0, 45.0], [5.0, 3.0, 50.0], [9.0, -4.0, 60.0]])


def true_times() -> Int:
    """Stamps (FRAMES,) of both cameras' frames, on the recording's clock."""
    return stamps(FRAMES)


def true_poses() -> Float:
    """T_w_p (FRAMES, 4, 4) metres, the first one at the world's origin."""
    T = curve(FRAMES * 8)[:FRAMES]
    return np.asarray(se3.inverse(T[0]) @ T)


def assistant_poses() -> Float:
    """T_w_a (FRAMES, 4, 4) at the times of the assistant's exposures."""
    seconds = (true_times() - true_times()[0]) / 1e9
    return np.asarray(se3.interpolate_at(seconds, true_poses(), seconds + LATE_NS / 1e9) @ T_P_A)


def picture(camera: Camera, T_w_c: Float) -> np.ndarray:
    """The markers as Gaussian spots, 1.5 px wide, through the lens: (h, w, 3)."""
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)
    shown = np.zeros(grid.shape[:2])
    for uv in camera.project(se3.transform(se3.inverse(T_w_c), MARKERS)):
        shown += 220 * np.exp(-((grid - uv) ** 2).sum(-1) / (2 * 1.5**2))
    return np.repeat(np.clip(shown, 0, 255).astype(np.uint8)[..., None], 3, 2)


def write_recording(
    folder: Path,
    *,
    lenses: tuple[Camera, Camera] = LENSES,
    live: list[PoseSample] | None = None,
    sigma: float = 0.01,
    spacing_m: float = 0.5,
) -> Path:
    """Record the drive: keyframes are exact; live poses are `live_poses(0.8)` unless given."""
    t, T_p, T_a = true_times(), true_poses(), assistant_poses()
    config = merge(Config(), {"scale": {"spacing_m": spacing_m}})
    with RecordingWriter(
        folder, config, {ORIGIN_KEY: str(ORIGIN_NS), "pace": "lockstep"}, lossless=True
    ) as writer:
        for i in range(FRAMES):
            for eye, T in zip(Eye, (T_p[i], T_a[i]), strict=True):
                data = jpeg(picture(lenses[eye], T), 98)
                writer.write_frame(Frame(eye, i, int(t[i]), data))
        for sample in live_poses(0.8) if live is None else live:
            writer.write_pose(sample)
        writer.write_update(update(lenses, sigma))
    return folder


def live_poses(scale: float, *, exact: bool = False) -> list[PoseSample]:
    """Live poses that drift, in another scale, lost at first and from frame 14 to 16; or exact."""
    t, T = true_times(), true_poses()
    drift = se3.exp(np.outer(np.arange(FRAMES), [0.01, 0, 0, 0, 0.001, 0]))
    samples = []
    for i in range(FRAMES):
        lost = (i < 2 or 14 <= i < 17) and not exact
        T_live = T[i] @ (np.eye(4) if exact else drift[i])
        T_live[:3, 3] *= scale
        samples.append(
            PoseSample(
                int(t[i]),
                np.full((4, 4), np.nan) if lost else T_live,
                np.full(3, np.nan) if lost else np.array([0.0, 0, 10]),
                np.full((6, 6), np.nan) if lost else 1e-4 * np.eye(6),
                0,
                PoseStatus.LOST if lost else PoseStatus.LIVE,
                scale_log_sigma=0.01,
            )
        )
    return samples


def update(lenses: tuple[Camera, Camera], sigma: float) -> LocalizerUpdate:
    """One window with all keyframes, every EVERY-th frame, and the markers as landmarks."""
    t, T_p, T_a = true_times()[::EVERY], true_poses()[::EVERY], assistant_poses()[::EVERY]
    n = len(t)
    T_s_c = np.concatenate([T_p, T_a])
    cameras = (lenses[0],) * n + (lenses[1],) * n
    submap = Submap(
        0,
        tuple(range(n)),
        tuple(range(n)),
        0,
        np.concatenate([t, t]),
        T_s_c,
        cameras,
        T_s_c,
        cameras,
        1.0,
        np.eye(4),
        np.full(2, sigma),
        assistant_late_ns=LATE_NS,
        scale_log_sigma=0.01,
    )
    uv = [
        c.project(se3.transform(se3.inverse(T), MARKERS))
        for c, T in zip(cameras, T_s_c, strict=True)
    ]
    rows = [
        (mark, view, point)
        for view, points in enumerate(uv)
        for mark, point in enumerate(points)
        if (point > 0).all() and (point < [191, 127]).all()
    ]
    marks = Landmarks(
        MARKERS + 0.3,
        np.array([row[0] for row in rows], np.int64),
        np.array([row[1] for row in rows], np.int64),
        np.array([row[2] for row in rows], np.float32),
    )
    trajectory = Trajectory(np.arange(n), t, T_p, T_P_A, 0)
    prediction = Prediction(cameras, T_s_c, landmarks=marks)
    return LocalizerUpdate(submap, prediction, trajectory, metre=Metre(0.01))


def with_map(recording: Path, folder: Path) -> Path:
    """The outputs of `map` that an export reads: a trajectory and its summary."""
    folder.mkdir()
    made = update(LENSES, 0.01).trajectory
    made = replace(made, T_w_c=made.T_w_c.copy())
    made.T_w_c[:, :3, 3] *= 1.1
    write_tum(folder / "trajectory.tum", made.t_ns - ORIGIN_NS, made.T_w_c)
    summary = {
        "recording": str(recording),
        "T_p_a": T_P_A.tolist(),
        "spacing_m": 0.5,
        "metre": {"sigma_percent": 1.0, "reason": ""},
    }
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder


# Place on the Earth: latitude, longitude, height; axes, scale and shift to east, north, up.
ORIGIN = np.array([48.1, 11.55, 530.0])
# The camera looks north-east, z down-turned by a degree
R = se3.so3_exp(np.array([0.0, 0.0, 0.8])) @ np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
SCALE, SHIFT = 1.25, np.array([3.0, -4.0, 1.5])


def georeferenced(folder: Path) -> Path:
    """Place a map on the Earth."""
    content = {
        "origin_deg_deg_m": ORIGIN.tolist(),
        "T_enu_w": se3.compose(R, SHIFT).tolist(),
        "scale": SCALE,
        "tilt_sigma_deg": 0.3,
        "residual_rms_m": 1.4,
    }
    (folder / "gps.json").write_text(json.dumps(content))
    return folder
