"""Time and memory of the joint optimum, all poses and sub-maps of a long drive solved together.

The optimum itself is computed in a process of its own; taking the snapshot for it and moving all
sub-maps after it delay the live path.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bench.cost import circuit
from bench.cost.length import MOST_MB, Course
from bench.tables import Check, Table
from calm_edge.config import Config
from calm_edge.estimator import scale
from calm_edge.estimator.atlas import Atlas
from calm_edge.posegraph.optimiser import Snapshot, Solved, Spawned
from calm_edge.posegraph.optimum import optimum
from calm_edge.types import CalmEdgeError, Submap

MOST_MS = 0.5
# Largest ratio of the time per keyframe on the whole drive to that on its first quarter for which
# the time counts as linear in the number of keyframes.
LINEAR = 1.5


@dataclass(frozen=True, slots=True)
class Optimisation:
    """Times of one joint optimum over the first keyframes of the drive.

    cpu_s: of the optimisation, outside the live path. snapshot_s, update_s: on the live path, for
    taking the snapshot before and moving all sub-maps after. loops, accepted: numbers of loops in
    the graph, and of those not rejected as outliers.
    """

    keyframes: int
    loops: int
    accepted: int
    cpu_s: float
    snapshot_s: float
    update_s: float

    @property
    def ms_a_keyframe(self) -> float:
        return 1e3 * self.cpu_s / self.keyframes


class _DeferredOptimiser:
    """Optimiser that stores the request and solves it when `solve` is called, to time each part."""

    def __init__(self) -> None:
        self.snapshot: Snapshot | None = None
        self.solved: Solved | None = None

    def request(self, snapshot: Snapshot) -> None:
        self.snapshot = snapshot

    def solve(self) -> None:
        assert self.snapshot is not None
        found = optimum(self.snapshot.problem, self.snapshot.state)
        self.solved = Solved(self.snapshot.graph, found)

    def poll(self) -> Solved | None:
        return self.solved

    def close(self) -> None:
        self.snapshot = self.solved = None


def optimisations(course: Course, shares: Sequence[float] = (0.25, 0.5, 1.0)) -> list[Optimisation]:
    """Optimise the pose graph of the first part of the drive, without and with loops.

    shares: lengths of that part, as shares of the drive. Uses the sub-maps before correction for
    focal errors: this scripted backbone draws focal and pose errors independently, so correction
    would add errors to the poses.
    """
    scaled = _uncorrected(course)
    _optimise(course.config, scaled[:2], with_loops=False)  # warm-up: loads GTSAM
    runs = []
    for with_loops in (False, True):
        for share in shares:
            runs.append(_optimise(course.config, scaled[: round(share * len(scaled))], with_loops))
    return runs


def peak_bytes(course: Course, deadline_s: float = 300.0) -> int:
    """Peak memory [bytes] of the optimiser's process on the whole drive with loops.

    Raises CalmEdgeError if there is no result within deadline_s.
    """
    atlas, _ = _graph(course.config, _uncorrected(course), with_loops=True)
    beside, end = Spawned(), time.monotonic() + deadline_s
    try:
        atlas.request_optimum(beside)
        while beside.poll() is None:
            if time.monotonic() > end:
                raise CalmEdgeError(f"the optimiser did not finish within {deadline_s:.0f} s")
            time.sleep(0.05)
        status = Path(f"/proc/{beside.pid}/status").read_text(encoding="ascii")
    finally:
        beside.close()
    (kilobytes,) = (line.split()[1] for line in status.splitlines() if line.startswith("VmHWM:"))
    return 1024 * int(kilobytes)


def snapshot(course: Course) -> Snapshot:
    """Request to the optimiser: the graph of the whole drive with loops."""
    atlas, _ = _graph(course.config, _uncorrected(course), with_loops=True)
    beside = _DeferredOptimiser()
    atlas.request_optimum(beside)
    assert beside.snapshot is not None
    return beside.snapshot


def _uncorrected(course: Course) -> list[Submap]:
    """Sub-maps in world units with the backbone's poses, not corrected for focal errors."""
    plain = [
        replace(s, T_s_c=s.T_s_c_raw, cameras=s.cameras_raw, scale=1.0) for s in course.submaps
    ]
    return [scale.rectify(submap, course.config.scale.spacing) for submap in plain]


def _graph(config: Config, submaps: Sequence[Submap], *, with_loops: bool) -> tuple[Atlas, int]:
    """Place the sub-maps in an Atlas and add the loops; return it with the number of loops."""
    atlas = Atlas(config)
    for submap in submaps:
        atlas.add(submap)
    n = submaps[-1].primary_ids[-1] + 1
    new = config.frontend.n_max - config.frontend.n_overlap
    loops = circuit.closures(n, circuit.CLOSURE_EVERY * new) if with_loops else []
    for loop in loops:
        atlas.add_loop(loop)
    return atlas, len(loops)


def _optimise(config: Config, submaps: Sequence[Submap], with_loops: bool) -> Optimisation:
    atlas, n_loops = _graph(config, submaps, with_loops=with_loops)
    beside, start = _DeferredOptimiser(), time.process_time()
    atlas.request_optimum(beside)
    asked = time.process_time()
    beside.solve()
    solved = time.process_time()
    atlas.settle(beside)
    taken = time.process_time()
    assert beside.solved is not None
    return Optimisation(
        keyframes=submaps[-1].primary_ids[-1] + 1,
        loops=n_loops,
        accepted=int(beside.solved.optimum.loops.sum()),
        cpu_s=solved - asked,
        snapshot_s=asked - start,
        update_s=taken - solved,
    )


def table(
    runs: Sequence[Optimisation], command: str, estimator_bytes: float, optimiser_bytes: float
) -> Table:
    """Table with a row for each run.

    estimator_bytes: memory of this process after the drive. optimiser_bytes: peak memory of the
    optimiser's process.
    """
    rows = [
        (
            run.keyframes,
            run.loops,
            run.accepted,
            run.cpu_s,
            run.ms_a_keyframe,
            1e3 * run.snapshot_s,
            1e3 * run.update_s,
        )
        for run in runs
    ]
    worst = max(run.ms_a_keyframe for run in runs)
    longest = max(runs, key=lambda run: run.keyframes)
    shortest = min(runs, key=lambda run: run.keyframes)
    ratio = longest.ms_a_keyframe / shortest.ms_a_keyframe
    together_mb = (estimator_bytes + optimiser_bytes) / 1e6
    checks = (
        Check("joint optimum, ms a keyframe, the worst", f"<= {MOST_MS}", worst, worst <= MOST_MS),
        Check(
            f"a keyframe of {longest.keyframes} against one of {shortest.keyframes}",
            f"linear (<= {LINEAR})",
            round(ratio, 2),
            ratio <= LINEAR,
        ),
        Check(
            "memory of the estimator and its optimiser at the end, MB",
            f"<= {MOST_MB}",
            round(together_mb),
            together_mb <= MOST_MB,
        ),
    )
    notes = (
        "processor time; the optimum is computed in a separate process, which merges pending "
        "requests",
        "on the live path: the snapshot before the optimum, and moving all sub-maps after it",
        f"memory: {estimator_bytes / 1e6:.0f} MB of this process after the drive, peak of the "
        f"optimiser {optimiser_bytes / 1e6:.0f} MB; without capture, tracker and the windows that "
        "`bundle` keeps to solve again",
    )
    columns = (
        "keyframes",
        "loops",
        "accepted",
        "s",
        "ms a keyframe",
        "snapshot, live ms",
        "moving, live ms",
    )
    title = "Joint optimum of a long drive"
    return Table("bench_optimum", title, command, columns, tuple(rows), checks, notes)
