"""What `record` makes of a spoilt drive; kept in a file by the state of the code."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench import steps
from bench.claimed import scale_sigma
from bench.outcome import FOLDER, check_unchanged, code_key, files_key
from bench.spoilt.cases import Base, Case, true_path_m
from bench.spoilt.serial_line import SerialLine
from calm_edge.commands.exit_codes import LOSS, OK
from calm_edge.geometry.polyline import path_length
from calm_edge.recording.reader import Recording
from calm_edge.trajectories import folded

# A path is right within this many sigmas, and without a sigma within this share.
SIGMAS, WITHOUT_SIGMA = 3.0, 0.05
# A parked car's path may be as long as this, m.
STANDING_M = 0.3

# In lines that `record` says while it works.
PROGRESS = "windows left to solve"


@dataclass(frozen=True, slots=True)
class Spoilt:
    """What came of a spoilt drive.

    exit_code, said: of `record`, and its last line but for its progress. path_m, true_m: estimated
    and true length of the path between the first and the last keyframe with a pose. scale_sigma:
    claimed sigma of the log scale, inf if unknown; None if not reported. states: of the daemon, as
    sent to the autopilot, in order of appearance. live, lost: numbers of poses, those without a
    metre among the lost ones. odometry: number of messages on the serial line. quality: largest of
    these; None without any. truth_log_sigma: of true_m.
    """

    drive: str
    case: str
    exit_code: int
    said: str
    path_m: float
    true_m: float
    scale_sigma: float | None
    states: tuple[str, ...]
    live: int
    lost: int
    odometry: int
    quality: int | None
    truth_log_sigma: float = 0.0

    @property
    def claims(self) -> bool:
        """Whether lengths are given as metres: by the exit code, or to the autopilot."""
        return self.exit_code == OK or self.odometry > 0

    @property
    def right(self) -> bool:
        """Whether the path is right within its sigma, or no metre is claimed and no crash."""
        if not self.claims:
            return self.exit_code == LOSS
        if self.true_m == 0:
            return self.path_m <= STANDING_M
        if self.scale_sigma is None:
            allowed = WITHOUT_SIGMA
        else:
            allowed = SIGMAS * math.hypot(self.scale_sigma, self.truth_log_sigma)
        return self.path_m > 0 and abs(math.log(self.path_m / self.true_m)) <= allowed


def spoilt(base: Base, case: Case, checkout: Path) -> Spoilt:
    """Record a spoilt drive once for each state of the code, and of that here.

    Raises EvaluationError.
    """
    name = f"spoilt_{base.name}_{case.name}"
    measure = files_key(Path(__file__).parent.glob("*.py"))
    kept = FOLDER / code_key(checkout) / f"{name}.{measure}.json"
    if kept.is_file():
        values: dict[str, Any] = json.loads(kept.read_text())
        return Spoilt(**values | {"states": tuple(values["states"])})
    work = kept.parent / name
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    case.make(base, work / "sequence")
    found = _recorded(base, case, checkout, work)
    check_unchanged(checkout, work)
    kept.write_text(json.dumps(asdict(found)))
    return found


def last_said(done: subprocess.CompletedProcess[str]) -> str:
    """Last line of stderr that is not about progress, or of stdout without one."""
    lines = [line for line in done.stderr.splitlines() if line.strip() and PROGRESS not in line]
    return (lines or done.stdout.splitlines() or [""])[-1].strip()


def _recorded(base: Base, case: Case, checkout: Path, work: Path) -> Spoilt:
    recording = work / "recording"
    with SerialLine() as line:
        done = steps.process(
            "record",
            *("--sequence", str(work / "sequence"), "--out", str(recording)),
            *("--pace", "lockstep", "--spacing-m", f"{base.spacing_m:g}"),
            # in lockstep poses come in bursts; a slow line would lose some
            *("--set", f"pose_output.port={line.port}", "--set", "pose_output.baud=921600"),
            checkout=checkout,
        )
    source = Recording(recording)
    updates = list(source.updates())
    trajectory = folded(update.trajectory for update in updates)
    t_ns = np.zeros(0, np.int64) if trajectory is None else trajectory.t_ns
    usable = [sample.status.usable for sample in source.poses()]
    qualities = line.qualities()
    return Spoilt(
        base.name,
        case.name,
        done.returncode,
        last_said(done),
        0.0 if trajectory is None else path_length(trajectory.T_w_c[:, :3, 3]),
        true_path_m(base, case, t_ns),
        scale_sigma(updates),
        line.states(),
        usable.count(True),
        usable.count(False),
        len(qualities),
        max(qualities, default=None),
        base.truth_log_sigma,
    )
