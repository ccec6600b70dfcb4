"""Spoilt copies of two drives: made by the shared tool, or here where it has no such case."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from bench.drives import DATA, ROOT, pictures, read_picture
from bench.process import last_line
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.truth import Truth, read_truth
from calm_edge.types import Float

TOOL = ROOT.parent / "shared" / "tools" / "spoil.py"
PAIRS, FEW_PAIRS = 60, 24
# Lower part of a picture that a dark bonnet takes, and its brightness.
BONNET, DARK = 0.25, 0.08


@dataclass(frozen=True, slots=True)
class Base:
    """A drive to spoil. truth_log_sigma: of the length of its true path."""

    name: str
    folder: Path
    spacing_m: float
    truth_log_sigma: float = 0.0


BASES = (
    Base("demo", ROOT / "demo" / "drive", 0.5),
    # by calibrated stereo, the path is 5 % longer than by its INS
    Base("karlsruhe_town", DATA / "karlsruhe_town", 0.5712, 0.03),
)

# Makes a spoilt sequence folder of a base in the second folder, which does not exist yet.
Make = Callable[[Base, Path], None]


@dataclass(frozen=True, slots=True)
class Case:
    """A way to spoil a drive. moves: whether the car does; else the true path has no length."""

    name: str
    make: Make
    moves: bool = True


def spoil(source: Path, out: Path, case: str, n: int = PAIRS) -> None:
    """Spoil the first n pairs of `source` with the shared tool; raises EvaluationError."""
    made = out.parent / f"{out.name}.made"
    command = [sys.executable, str(TOOL), str(source), str(made), case, "--frames", str(n)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode or not (made / case / "cam1").is_dir():
        raise EvaluationError(f"{TOOL.name} {case}: {last_line(done)}")
    (made / case).rename(out)
    shutil.rmtree(made)


def _tool(name: str, moves: bool = True) -> Case:
    return Case(name, lambda base, out: spoil(base.folder, out, name), moves)


def _first(n: int) -> Make:
    def make(base: Base, out: Path) -> None:
        for eye in (0, 1):
            (out / f"cam{eye}").mkdir(parents=True)
            for k, file in enumerate(pictures(base.folder, eye)[:n]):
                (out / f"cam{eye}" / f"{k:06d}{file.suffix}").symlink_to(file)
            _write_times(out, eye, _times(base.folder, eye)[:n])

    return make


def one_camera(base: Base, out: Path) -> None:
    """Give the primary's odd pictures to one eye and its even ones to the other, stamps true.

    So does a user of one dash camera who splits its video.
    """
    files, times = pictures(base.folder, 0)[: 2 * PAIRS], _times(base.folder, 0)[: 2 * PAIRS]
    for eye in (0, 1):
        (out / f"cam{eye}").mkdir(parents=True)
        for k, file in enumerate(files[eye::2]):
            (out / f"cam{eye}" / f"{k:06d}{file.suffix}").symlink_to(file)
        _write_times(out, eye, times[eye::2])


def parked_bonnet(base: Base, out: Path) -> None:
    """A parked car with a dark bonnet: the first pair, its lower part dark, under fresh noise."""
    dark = out.parent / f"{out.name}.dark"
    shutil.rmtree(dark, ignore_errors=True)
    _first(PAIRS)(base, dark)
    for eye in (0, 1):
        file = pictures(dark, eye)[0]
        picture = read_picture(file)
        rows = slice(round((1 - BONNET) * len(picture)), None)
        picture[rows] = np.round(picture[rows] * DARK).astype(np.uint8)
        file.unlink()
        cv2.imwrite(str(file), picture)
    spoil(dark, out, "parked")
    shutil.rmtree(dark)


def parked_night(base: Base, out: Path) -> None:
    """A parked car at night: the first pair over and over, nearly black, under fresh noise."""
    parked = out.parent / f"{out.name}.parked"
    shutil.rmtree(parked, ignore_errors=True)
    spoil(base.folder, parked, "parked")
    spoil(parked, out, "dark")
    shutil.rmtree(parked)


def _times(folder: Path, eye: int) -> list[str]:
    return (folder / f"times{eye}.txt").read_text().split()


def _write_times(folder: Path, eye: int, times: list[str]) -> None:
    (folder / f"times{eye}.txt").write_text("".join(f"{t}\n" for t in times))


CASES = (
    Case("unspoilt", _first(PAIRS)),
    Case("straight_start", _first(FEW_PAIRS)),
    _tool("same_camera_twice"),
    Case("one_camera", one_camera),
    _tool("offset04"),
    _tool("clock_1percent"),
    Case("parked_bonnet", parked_bonnet, moves=False),
    Case("parked_night", parked_night, moves=False),
    _tool("truck_while_parked", moves=False),
)


def true_path_m(base: Base, case: Case, t_ns: np.ndarray) -> float:
    """Length of the true path between the first and the last of stamps (N,) of the primary, m."""
    if not case.moves or not len(t_ns):
        return 0.0
    truth: Truth = read_truth(base.folder)
    steps = np.linalg.norm(np.diff(truth.T_w_c[:, :3, 3], axis=0), axis=1)
    along: Float = np.concatenate([[0.0], np.cumsum(steps)])
    ends = np.interp([t_ns[0], t_ns[-1]], truth.t_ns, along)
    return float(ends[1] - ends[0])
