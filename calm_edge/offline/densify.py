"""Compute the depth of all windows in worker processes."""

from __future__ import annotations

import multiprocessing
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calm_edge.backbones.base import Backbone
from calm_edge.backbones.registry import open_backbone
from calm_edge.config import Config
from calm_edge.geometry import picture_mask
from calm_edge.processes import CHILD_ENVIRONMENT, environment, follow_parent, signals_held
from calm_edge.recording.reader import Recording
from calm_edge.recording.window_record import WindowRecord, window_hints
from calm_edge.types import (
    Bytes,
    CalmEdgeError,
    Float32,
    Int,
    LocalizerUpdate,
    Masks,
    SubmapWindow,
)

WORKERS = 2
# windows submitted ahead, which bounds the depth maps held in memory
AHEAD = 2 * WORKERS

_worker: dict[str, Any] = {}


class DensifyError(CalmEdgeError):
    """A worker process was killed."""


def densified(
    path: Path,
    config: Config,
    windows: Sequence[WindowRecord],
    updates: Sequence[LocalizerUpdate],
    workers: int = WORKERS,
) -> Iterator[tuple[Float32, Float32] | str]:
    """Yield depth (N, h, w) in raw units and confidence (N, h, w) of each window, in order.

    For a window without depth, yield one line with the reason. Raises DensifyError if a worker
    dies.
    """
    jobs = iter(zip(windows, updates, strict=True))
    waiting: deque[Future[tuple[Float32, Float32] | str]] = deque()
    with environment(CHILD_ENVIRONMENT):
        pool = ProcessPoolExecutor(
            workers, multiprocessing.get_context("spawn"), _set_up, (path, config)
        )
        try:
            while True:
                while len(waiting) < AHEAD and (job := next(jobs, None)) is not None:
                    record, update = job
                    light = replace(update, trajectory=_nothing(update))
                    with signals_held():
                        waiting.append(pool.submit(_densify, record, light))
                if not waiting:
                    return
                yield waiting.popleft().result()
        except BrokenProcessPool:
            raise DensifyError(
                "a worker that computes depth was killed; free memory and map again"
            ) from None
        finally:
            pool.shutdown(cancel_futures=True)


def _nothing(update: LocalizerUpdate) -> Any:
    """An empty trajectory to send to workers: they do not read it, and it grows with the drive."""
    t = update.trajectory
    return replace(t, keyframe_ids=t.keyframe_ids[:0], t_ns=t.t_ns[:0], T_w_c=t.T_w_c[:0])


def _set_up(path: Path, config: Config) -> None:
    follow_parent()
    cv2.setNumThreads(1)
    backbone: Backbone = open_backbone(config)
    _worker.update(recording=Recording(path), backbone=backbone, config=config)


def _densify(record: WindowRecord, update: LocalizerUpdate) -> tuple[Float32, Float32] | str:
    prediction = update.prediction
    if prediction.depth is None:
        try:
            window = _worker["recording"].window(record)
            images = [keyframe.frame.bgr() for keyframe in window.keyframes()]
            hints = window_hints(record, update, _worker["config"])
            prediction = _worker["backbone"].densify(images, hints, prediction)
        except CalmEdgeError as error:
            return f"window {record.submap_id}: no depth: {error}"
    if prediction.depth is None:
        return f"window {record.submap_id}: the backbone gives no depth"
    confidence = prediction.confidence
    if confidence is None:
        confidence = np.ones_like(prediction.depth)
    return used_depth(prediction.depth, update.masks, record.eyes), confidence


def pictures(window: SubmapWindow, depth: Float32) -> list[Bytes | None]:
    """Pictures (H, W, 3) BGR of the views of a window, None of those without depth (N, h, w)."""
    each = zip(window.keyframes(), depth, strict=True)
    return [keyframe.frame.bgr() if known.any() else None for keyframe, known in each]


def used_depth(depth: Float32, masks: Masks | None, eyes: Int) -> Float32:
    """Depth (N, h, w), unknown (0) in the parts of the pictures that are left out."""
    used = depth.copy()
    for eye in (0, 1):
        mask = None if masks is None else masks.of_eye(eye)
        if mask is not None:
            left_out = picture_mask.stretched(mask, (depth.shape[1], depth.shape[2]))
            used[(eyes == eye)[:, None, None] & left_out] = 0
    return used
