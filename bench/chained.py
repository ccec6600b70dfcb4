"""The paper's chaining baselines, run on the sub-maps of a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from bench.baselines.chain import ALIGNMENTS, chain
from bench.baselines.overlap import Correspondences, common_views, correspondences
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.estimate import Estimate
from calm_edge.recording.reader import Recording
from calm_edge.types import Int, LocalizerUpdate
from device.frame import Eye


def matched_submaps(updates: Sequence[LocalizerUpdate]) -> list[LocalizerUpdate]:
    """Updates with landmarks or depth, the last one of each sub-map, in order of ids.

    Windows that are solved again at the end of a drive, with the final estimate of the kit
    (cameras, rig and time offset), are logged without landmarks and depth. So these are the live
    solutions.
    """
    last = {
        update.submap.id: update
        for update in updates
        if update.prediction.landmarks is not None or update.prediction.depth is not None
    }
    return [last[key] for key in sorted(last)]


def overlaps(updates: Sequence[LocalizerUpdate], size: Int) -> Iterator[Correspondences]:
    """Yield the correspondences of consecutive sub-maps. size: (2,) of the pictures, px."""
    for previous, new in pairwise(updates):
        views = common_views(previous.submap, new.submap)
        yield correspondences(previous.prediction, views[0], new.prediction, views[1], size)


def chained(recording: Path, alignment: str) -> Estimate:
    """Chain a recording's sub-maps by `alignment`, a key of ALIGNMENTS, without loops.

    World unit: metres if the spacing is configured, by the scale of the first sub-map; else the
    spacing. Raises EvaluationError if a sub-map cannot be aligned, and RecordingError.
    """
    source = Recording(recording)
    updates = matched_submaps(list(source.updates()))
    frame = next(source.frames(Eye.PRIMARY), None)
    if frame is None or not updates:
        raise EvaluationError(f"{recording}: no sub-map with landmarks or depth, nothing to chain")
    height, width = frame.bgr().shape[:2]
    submaps = [update.submap for update in updates]
    result = chain(ALIGNMENTS[alignment], submaps, overlaps(updates, np.array([width, height])))
    if result.T_w_c is None:
        raise EvaluationError(f"{result.name} chaining: {result.failed}")
    order = np.argsort(result.t_ns, kind="stable")
    return Estimate(
        f"{result.name} chaining of {recording}",
        result.t_ns[order],
        result.T_w_c[order],
        submaps=len(submaps),
        first_frame=(frame.sequence, frame.t_ns),
    )
