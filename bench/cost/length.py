"""Processor time and memory per sub-map over a long drive."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from bench.cost import circuit
from bench.kilometres.dials import sized
from bench.scripted import ScriptedBackbone
from bench.tables import Check, Table
from calm_edge.config import Config, merge
from calm_edge.estimator import localizer as localizer_module
from calm_edge.estimator.localizer import Localizer
from calm_edge.kit.layout import SIZE
from calm_edge.report import chart
from calm_edge.types import CalmEdgeError, Float, Hints, KitBelief, Prediction, Submap

# Sub-map from which all buffers of limited size are full: the 1,000 places of the loop finder, and
# the 200 sub-maps from which the time offset is estimated.
SETTLED = 300
ENDS = 200
# Up to this growth over the drive, as a share of its mean, processor time per sub-map without the
# backbone's counts as constant.
FLAT_SHARE = 0.1
MOST_MB = 600
# Landmarks per sub-map. Nothing is occluded in the convex room, so nearly all views see each of
# them: about 7,000 observations.
_LANDMARKS = 350


class TeachingBackbone:
    """Scripted backbone with kit evidence and as many landmarks as `bundle` has.

    Kit evidence: information on cameras, rig and time offset. The number of landmarks determines
    the time of the search for the focal length (paper V-A). Errors of focal and poses
    are drawn independently (`ScriptedErrors.coupled` off): solving for consistent ones is slow.
    """

    def __init__(self, backbone: ScriptedBackbone) -> None:
        self._backbone = backbone

    def infer(self, images: Sequence[NDArray[np.uint8]], hints: Hints) -> Prediction:
        """Return the scripted prediction with kit evidence and fewer landmarks."""
        prediction = self._backbone.infer(images, hints)
        marks = prediction.landmarks
        assert marks is not None
        every = len(marks.points_s) // _LANDMARKS + 1
        (kept,) = np.nonzero(marks.index % every == 0)
        thinned = replace(
            marks,
            points_s=marks.points_s[::every],
            index=marks.index[kept] // every,
            view=marks.view[kept],
            uv=marks.uv[kept],
        )
        return replace(prediction, landmarks=thinned, kit=KitBelief(np.zeros(SIZE), np.eye(SIZE)))

    def densify(
        self, images: Sequence[NDArray[np.uint8]], hints: Hints, prediction: Prediction
    ) -> Prediction:
        """Add the scripted depth."""
        return self._backbone.densify(images, hints, prediction)


@dataclass(frozen=True, slots=True)
class Course:
    """Measurements of one drive by sub-map (S,), and its final sub-maps.

    stage_ms: processor time of each stage except the backbone; its key `rest` is the time outside
    all stages. infer_ms: processor time of the backbone. rss: memory of this process, bytes.
    replaced: whether earlier poses moved at this sub-map (a new epoch).
    """

    stage_ms: dict[str, Float]
    infer_ms: Float
    rss: Float
    replaced: NDArray[np.bool_]
    submaps: tuple[Submap, ...]
    config: Config

    @property
    def live_ms(self) -> Float:
        """Processor time (S,) of all stages except the backbone, ms."""
        return np.asarray(np.sum(list(self.stage_ms.values()), axis=0))


def rss() -> int:
    """Resident memory of this process, bytes."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize()


def drive(n_submaps: int, config: Config | None = None, seed: int = 0) -> Course:
    """Run the Localizer over the circuit and measure each sub-map.

    Raises CalmEdgeError for fewer than ten sub-maps, or if one is skipped.
    """
    if n_submaps < 10:
        raise CalmEdgeError(f"--submaps {n_submaps}: give at least 10")
    spacing_m = float(np.linalg.norm(circuit.T_P_A[:3, 3]))
    config = merge(config or Config(), {"scale": {"spacing_m": spacing_m}})
    scene = circuit.scene(circuit.n_keyframes(n_submaps, config.frontend))
    backbone = TeachingBackbone(ScriptedBackbone(scene, replace(sized(seed), coupled=False)))
    localizer = Localizer(config, backbone)
    stages: dict[str, Float] = {}
    memory, replaced = np.zeros(n_submaps), np.zeros(n_submaps, bool)
    rest, epoch = np.zeros(n_submaps), 0
    # processor time, so that other load of the machine does not count
    with mock.patch.object(localizer_module, "perf_counter", time.process_time):
        for k, window in enumerate(circuit.windows(n_submaps, config.frontend)):
            start = time.process_time()
            update = localizer.process(window)
            total_ms = 1e3 * (time.process_time() - start)
            if update is None:
                raise CalmEdgeError(f"sub-map {k} was skipped: {localizer.skipped[-1].reason}")
            for stage, ms in update.stage_ms.items():
                stages.setdefault(stage, np.zeros(n_submaps))[k] = ms
            rest[k] = total_ms - sum(update.stage_ms.values())
            replaced[k], epoch = update.trajectory.epoch != epoch, update.trajectory.epoch
            memory[k] = rss()
    infer = stages.pop("infer")
    return Course({**stages, "rest": rest}, infer, memory, replaced, localizer.submaps, config)


def growth(values: Float, settled: int) -> float:
    """Growth over all S sub-maps, by a straight line fitted to values (S,) from `settled` on."""
    x = np.arange(settled, len(values))
    return float(np.polyfit(x, values[settled:], 1)[0] * len(values))


def table(course: Course, command: str) -> Table:
    """Table of cost and memory at the start of the drive, after SETTLED sub-maps and at the end.

    One row for each stage of the live path and one for memory.
    """
    n = len(course.infer_ms)
    settled, ends = min(SETTLED, n // 2), min(ENDS, n // 5)
    new = course.config.frontend.n_max - course.config.frontend.n_overlap
    replaced = course.replaced
    once = np.where(replaced, np.nan, course.live_ms)
    once = np.where(np.isnan(once), np.nanmedian(once), once)
    series = [
        ("live cost, ms", course.live_ms),
        *((f"  {stage}, ms", ms) for stage, ms in course.stage_ms.items()),
        ("live cost without replacement of all poses, ms", once),
        ("memory, MB", course.rss / 1e6),
    ]
    rows = []
    for name, values in series:
        first, after, last = values[:ends], values[settled : settled + ends], values[-ends:]
        means = (float(part.mean()) for part in (first, after, last))
        rows.append((name, *means, float(values.max()), growth(values, settled)))
    gained = growth(course.live_ms, settled) / float(course.live_ms[settled:].mean())
    state = growth(course.rss, settled) / (n * new)
    end_mb = float(course.rss[-1]) / 1e6
    checks = (
        Check(
            f"growth of the live cost over {n} sub-maps, of its mean",
            f"none (<= {FLAT_SHARE:.0%})",
            round(gained, 3),
            gained <= FLAT_SHARE,
        ),
        Check(
            "memory of the estimator at the end, MB",
            f"<= {MOST_MB}",
            round(end_mb),
            end_mb <= MOST_MB,
        ),
    )
    notes = (
        f"{n} sub-maps of {course.config.frontend.n_max} + {course.config.frontend.n_max} "
        f"keyframes; processor time of one core without the model and without the joint optimum; "
        f"load average {os.getloadavg()[0]:.1f}",
        f"the line is fitted from sub-map {settled}, where all caps are reached; the scripted "
        f"model takes {course.infer_ms.mean():.0f} ms a sub-map and is not counted",
        f"state: {state:,.0f} bytes a keyframe of the primary",
        f"all poses were replaced {int(replaced.sum())} times, as focals or time offset became "
        f"better known; the last time at sub-map "
        f"{int(np.flatnonzero(replaced).max(initial=0))}",
        "without loops, hence without joint optima; "
        f"{(course.live_ms + course.infer_ms).sum() / 1e3:.0f} s of processor time in all",
    )
    columns = ("", f"first {ends}", f"from {settled}", f"last {ends}", "most", f"line over {n}")
    title = "Over a long drive of the scripted model"
    return Table("bench_length", title, command, columns, tuple(rows), checks, notes)


def plot(course: Course) -> str:
    """SVG plot of processor time per sub-map, in all and of the longest stages, and of memory."""
    live = course.live_ms
    x = np.arange(len(live), dtype=np.float64)
    shown = chart.limits(x), (0.0, 1.6 * float(np.percentile(live, 99)))
    times = chart.Chart(*shown, ("sub-map", "processor ms"), 400)
    times.line(x, live, chart.MUTED, "a sub-map, no model", width=0.8, opacity=0.4)
    times.line(x, _running(live), chart.ESTIMATE, "mean of 51", width=2)
    longest = sorted(course.stage_ms, key=lambda stage: -course.stage_ms[stage].mean())[:3]
    for stage, dash in zip(longest, ("7 4", "7 4 2 4", "2 3"), strict=False):
        times.line(x, _running(course.stage_ms[stage]), chart.MUTED, stage, dash=dash)
    memory = chart.Chart(shown[0], (0.0, MOST_MB), ("sub-map", "memory, MB"), 220)
    memory.line(x, course.rss / 1e6, chart.TRUTH, width=2)
    return chart.stacked((times, memory), "processor time and memory over a long drive")


def _running(values: Float, reach: int = 25) -> Float:
    """Moving average (S,) over `reach` values before and after each."""
    return np.asarray(uniform_filter1d(values, 2 * reach + 1, mode="nearest"))
