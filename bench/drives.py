"""Drives on which the measurements run: found on disk, derived from others, or rendered once."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from bench.process import last_line
from calm_edge.evaluation import EvaluationError
from calm_edge.types import Bytes

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
SIMULATOR = ROOT.parent / "shared" / "tools" / "drive_sim.py"
SIMULATED = ROOT / "build" / "sim"

# Maps a work folder to a sequence folder, or to the reason why the drive is missing.
Prepare = Callable[[Path], Path | str]


def there(folder: Path) -> Prepare:
    """Prepare function that returns a sequence folder, or the reason why it is not on disk."""
    return lambda _out: folder if (folder / "cam1").is_dir() else f"{folder} is not here"


def pictures(folder: Path, eye: int) -> list[Path]:
    """Picture files of one eye of a sequence folder, in the order of replay."""
    return sorted(
        p for p in (folder / f"cam{eye}").iterdir() if p.suffix.lower() in (".png", ".jpg", ".jpeg")
    )


def read_picture(file: Path) -> Bytes:
    """Read a picture (H, W, 3) BGR; raises EvaluationError."""
    image = cv2.imread(str(file), cv2.IMREAD_COLOR)
    if image is None:
        raise EvaluationError(f"{file}: not a readable image")
    return np.asarray(image, np.uint8)


def shifted_by_one(source: Path, out: Path) -> Path:
    """Make the sequence folder `out`/sequence, in which the assistant is one frame ahead.

    It has links to the pictures of `source` without the assistant's first and the primary's last
    frame. So frame k of cam1 (the assistant) is frame k + 1 of the source, with the stamp it had
    there. All stamps stay true; only pairing the frames of both eyes by their index is wrong.
    """
    return _linked(source, out / "sequence", slice(None, -1), slice(1, None))


def _linked(source: Path, folder: Path, primary: slice, assistant: slice) -> Path:
    """Make a sequence folder of links to some frames of each eye of `source`, with their stamps."""
    shutil.rmtree(folder, ignore_errors=True)
    for eye, cut in enumerate((primary, assistant)):
        (folder / f"cam{eye}").mkdir(parents=True)
        images = sorted(p for p in (source / f"cam{eye}").iterdir() if p.is_file())
        for k, image in enumerate(images[cut]):
            (folder / f"cam{eye}" / f"{k:06d}{image.suffix}").symlink_to(image.resolve())
        lines = (source / f"times{eye}.txt").read_text().split()[cut]
        (folder / f"times{eye}.txt").write_text("\n".join(lines) + "\n")
    if (source / "poses0.txt").is_file():
        poses = (source / "poses0.txt").read_text().splitlines()[primary]
        (folder / "poses0.txt").write_text("\n".join(poses) + "\n")
    for name in ("calib.txt", "cloud.npy"):
        if (source / name).is_file():
            (folder / name).symlink_to((source / name).resolve())
    return folder


def excerpt(source: Path, first: int, last: int) -> Prepare:
    """Prepare function of the pairs `first` to `last`, inclusive, of a sequence folder."""

    def prepare(out: Path) -> Path | str:
        if not (source / "cam1").is_dir():
            return f"{source} is not here"
        cut = slice(first, last + 1)
        return _linked(source, out / "sequence", cut, cut)

    return prepare


def late_assistant(source: Path) -> Prepare:
    """Prepare function of `source` with the assistant one frame ahead, see `shifted_by_one`."""

    def prepare(out: Path) -> Path | str:
        if not (source / "cam1").is_dir():
            return f"{source} is not here"
        return shifted_by_one(source, out)

    return prepare


def simulated(name: str, *options: str) -> Prepare:
    """Prepare function of a drive rendered into build/sim/`name` by the simulator.

    options: of the simulator. Rendered only if the folder does not exist yet.
    """

    def prepare(_out: Path) -> Path | str:
        there = (SIMULATED / name / "cloud.npy").is_file()
        if not there and not SIMULATOR.is_file():
            return f"{SIMULATOR} is not here"
        return _rendered(name, [str(SIMULATOR)], options)

    return prepare


def plain_demo(_out: Path) -> Path | str:
    """Prepare the town's drive of `plain` cameras in build/sim: pinholes, no rolling shutter.

    Figures of speed refer to it. Rendered in about ten minutes only if it does not exist yet.
    """
    return _rendered("demo_plain", ["-m", "tests.synthetic.drive"], ("--kit", "plain"))


def _rendered(name: str, program: Sequence[str], options: Sequence[str]) -> Path | str:
    """Folder build/sim/`name`, rendered by a Python program unless it is there, or a reason."""
    folder = SIMULATED / name
    if (folder / "cloud.npy").is_file():
        return folder
    # rendered in a folder of its own, so that an interrupted rendering does not pass for a whole
    # drive
    part = SIMULATED / f"{name}.part"
    command = [sys.executable, *program, "--out", str(part), *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode or not (part / "cloud.npy").is_file():
        return f"{Path(program[-1]).name} failed: {last_line(done)}"
    shutil.rmtree(folder, ignore_errors=True)
    part.rename(folder)
    return folder


@dataclass(frozen=True, slots=True)
class Kilometre:
    """A rendered drive of 1 km or more, with and without timing faults.

    spacing_m: distance between the cameras. scene, timing: simulator options for track and rig,
    and for clock faults.
    """

    name: str
    spacing_m: float
    scene: tuple[str, ...]
    timing: tuple[str, ...] = ()

    @property
    def loose(self) -> Prepare:
        """Prepare function of the drive with its timing faults."""
        return simulated(self.name, *self._rig, *self.timing)

    @property
    def in_step(self) -> Prepare:
        """Prepare function of the drive without timing faults: synchronised, at an even rate."""
        if not self.timing:
            return self.loose
        return simulated(f"{self.name}_in_step", *self._rig)

    @property
    def _rig(self) -> tuple[str, ...]:
        return (*self.scene, "--baseline", f"{self.spacing_m:g}")


def _kilometre(name: str, track: str, spacing_m: float, scene: str, timing: str = "") -> Kilometre:
    return Kilometre(name, spacing_m, ("--track", track, *scene.split()), tuple(timing.split()))


# The rigs differ in fields of view, spacing, angle between the optical axes, clocks and exposure.
DEVELOPMENT = (
    _kilometre(
        "km_aalborg",
        "aalborg",
        1.2,
        "--frames 1060 --hfov 62 75 --rot-deg 1 -3 0.5 --seed 11",
        "--async 0.05",
    ),
    _kilometre(
        "km_e-track-2",
        "e-track-2",
        0.8,
        "--frames 860 --hfov 70 85 --rot-deg 1.5 -4 2 --blur 2 --seed 12",
        "--async 0.035",
    ),
    _kilometre(
        "km_street-1",
        "street-1",
        0.2,
        "--frames 880 --hfov 100 80 --rot-deg 3 7 -2 --seed 13",
        "--async 0.02 --jitter-ms 3",
    ),
    _kilometre(
        "km_alpine-1",
        "alpine-1",
        0.5,
        "--frames 910 --hfov 80 80 --rot-deg 0.5 -1.5 0.8 --bumps 2 --seed 14",
    ),
    # a lap is 2,058 m, so this is 1.3 laps
    _kilometre(
        "km_g-track-1_loop",
        "g-track-1",
        0.35,
        "--frames 1890 --vmax 15 --laps 1.3 --hfov 90 70 --rot-deg -1 2 1.5 --seed 15",
        "--async 0.03",
    ),
)
# Tracks used for no tuning, only for the final evaluation.
HELD_OUT = (
    _kilometre(
        "km_forza",
        "forza",
        0.6,
        "--frames 900 --hfov 75 75 --rot-deg 0.5 2 -1 --seed 21",
        "--async 0.04",
    ),
    _kilometre(
        "km_ole-road-1",
        "ole-road-1",
        0.9,
        "--frames 950 --hfov 95 65 --rot-deg -2 -5 3 --seed 22",
        "--async 0.025 --jitter-ms 2",
    ),
    _kilometre(
        "km_wheel-1",
        "wheel-1",
        0.3,
        "--frames 950 --hfov 85 100 --rot-deg 1 4 -1 --blur 2 --seed 23",
        "--async 0.05",
    ),
    _kilometre(
        "km_e-track-6",
        "e-track-6",
        0.45,
        "--frames 950 --hfov 66 80 --rot-deg 2 -6 2 --seed 24",
        "--async 0.015 --jitter-ms 4",
    ),
)
