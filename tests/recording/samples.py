"""Sample values whose every field would be altered by a lossy encoding."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calm_edge.config import Config, merge
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.se3 import exp
from calm_edge.recording.window_record import of_window
from calm_edge.recording.writer import RecordingWriter
from calm_edge.types import (
    Keyframe,
    KitBelief,
    Landmarks,
    LocalizerUpdate,
    Masks,
    PoseSample,
    PoseStatus,
    Prediction,
    Submap,
    SubmapWindow,
    Trajectory,
)
from device.frame import Eye, Frame

T0_NS = 5_000_000_123


def jpeg(seed: int, size: int = 64) -> bytes:
    noise = np.random.default_rng(seed).integers(0, 255, (size, size, 3), np.uint8)
    return bytes(cv2.imencode(".jpg", noise)[1].tobytes())


def frame(eye: Eye, sequence: int, size: int = 64) -> Frame:
    t_ns = T0_NS + sequence * 100_000_000 + int(eye) * 17_000_001
    return Frame(eye, sequence, t_ns, jpeg(2 * sequence + eye, size))


def pose(i: int = 0) -> PoseSample:
    rng = np.random.default_rng(i)
    return PoseSample(
        T0_NS + i * 50_000_000,
        exp(rng.normal(size=6)),
        rng.normal(size=3),
        np.cov(rng.normal(size=(6, 20))),
        i,
        list(PoseStatus)[i % 3],
        turn_rate_c=rng.normal(size=3),
        twist_covariance=np.cov(rng.normal(size=(6, 20))),
        scale_log_sigma=0.02,
        scale_offset=rng.normal(size=3),
        focal_offset=rng.normal(size=6),
        drift=np.cov(rng.normal(size=(6, 20))),
    )


def update(i: int = 0, depth: bool = True) -> LocalizerUpdate:
    rng = np.random.default_rng(100 + i)
    n = 5
    # values that fp16 and uint8 represent exactly
    metres = rng.uniform(1, 80, (n, 6, 8)).astype(np.float16).astype(np.float32)
    steps = rng.integers(0, 256, (n, 6, 8)).astype(np.float32) / np.float32(255)
    kit = KitBelief(rng.normal(size=4), np.eye(4) / 3)
    optics = rng.uniform(300, 900, (n, 4)).tolist()
    cameras = tuple(Perspective(*row, 640, 480, (0.1, -1 / 3, 1e-4)) for row in optics)
    wide = tuple(Fisheye(*row[:2], 319.5, 239.5, 640, 480, (0.01, 1 / 7)) for row in optics)
    T = exp(rng.normal(size=(n, 6)))
    prediction = Prediction(
        cameras,
        T,
        metres if depth else None,
        steps if depth else None,
        rng.uniform(size=n),
        Landmarks(
            rng.normal(size=(7, 3)),
            rng.integers(0, 7, 11),
            rng.integers(0, n, 11),
            rng.normal(size=(11, 2)).astype(np.float32),
        ),
        kit,
    )
    t_ns = T0_NS + 1_000_000_000 * i + np.arange(n, dtype=np.int64)
    submap = Submap(
        i, (0, 1, 2), (0, 1), 2, t_ns, T, cameras, T + 0.125, wide, 1 / 3, exp(rng.normal(size=6)),
        np.array([0.03, np.inf]),
    )  # fmt: skip
    poses = exp(rng.normal(size=(9, 6)))
    trajectory = Trajectory(np.arange(9), T0_NS + np.arange(9), poses, exp(rng.normal(size=6)), i)
    stage_ms = {"infer": 1 / 7, "place": 0.1}
    masks = Masks(None, np.arange(6, dtype=np.uint8).reshape(2, 3) % 2)
    return LocalizerUpdate(submap, prediction, trajectory, stage_ms, kit, masks=masks)


def window(i: int = 0, loop: bool = True) -> SubmapWindow:
    primary = tuple(Keyframe(i + k, frame(Eye.PRIMARY, i + 2 * k)) for k in range(3))
    assistant = tuple(Keyframe(i + k, frame(Eye.ASSISTANT, i + 3 * k)) for k in range(2))
    loop_keyframe = Keyframe(0, frame(Eye.PRIMARY, 0)) if loop else None
    return SubmapWindow(i, primary, assistant, 1, loop_keyframe)


def config(**recording: Any) -> Config:
    return merge(Config(), {"recording": recording})


def small_recording(folder: Path, n: int = 12, **recording: Any) -> Path:
    """Record n frames per eye, poses, two updates and a window, in chunks of 8 kB."""
    settings = config(**{"chunk_bytes": 8192, "log_depth": True, **recording})
    with RecordingWriter(folder, settings, {"camera_primary": "usb-1"}) as writer:
        for k in range(n):
            for eye in Eye:
                writer.write_frame(frame(eye, k))
            writer.write_pose(pose(k))
            if k % 6 == 5:
                writer.write_window(of_window(window(k // 6)))
                writer.write_update(update(k // 6))
    return folder


def same(a: Any, b: Any) -> bool:
    """Whether two values are equal in type, dtype, shape and every bit."""
    if isinstance(a, np.ndarray):
        return (
            isinstance(b, np.ndarray)
            and a.dtype == b.dtype
            and a.shape == b.shape
            and a.tobytes() == b.tobytes()
        )
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(
            same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a)
        )
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and bool(a == b)
