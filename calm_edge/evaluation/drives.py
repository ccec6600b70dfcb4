"""The drives that are measured: found, derived from one another, or rendered once."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"
SIMULATOR = ROOT.parent / "shared" / "tools" / "drive_sim.py"
SIMULATED = ROOT / "build" / "sim"

# Given a folder to work in: the sequence folder, or why there is none.
Prepare = Callable[[Path], Path | str]


def there(folder: Path) -> Prepare:
    """A folder as it lies on the disk."""
    return lambda _out: folder if (folder / "cam1").is_dir() else f"{folder} is not here"


def shifted_by_one(source: Path, out: Path) -> Path:
    """`out`/sequence: links to `source`, the assistant without its first frame, the primary
    without its last.

    Frame k of cam1 is the source's k + 1, and so is its time: stamps stay true, and only who
    pairs frames by counting them is wrong.
    """
    folder = out / "sequence"
    shutil.rmtree(folder, ignore_errors=True)
    for eye, cut in ((0, slice(None, -1)), (1, slice(1, None))):
        (folder / f"cam{eye}").mkdir(parents=True)
        images = sorted(p for p in (source / f"cam{eye}").iterdir() if p.is_file())
        for k, image in enumerate(images[cut]):
            (folder / f"cam{eye}" / f"{k:06d}{image.suffix}").symlink_to(image.resolve())
        lines = (source / f"times{eye}.txt").read_text().split()[cut]
        (folder / f"times{eye}.txt").write_text("\n".join(lines) + "\n")
    poses = (source / "poses0.txt").read_text().splitlines()[:-1]
    (folder / "poses0.txt").write_text("\n".join(poses) + "\n")
    for name in ("calib.txt", "cloud.npy"):
        if (source / name).is_file():
            (folder / name).symlink_to((source / name).resolve())
    return folder


def late_assistant(source: Path) -> Prepare:
    """`source` shifted by one frame."""

    def prepare(out: Path) -> Path | str:
        if not (source / "cam1").is_dir():
            return f"{source} is not here"
        return shifted_by_one(source, out)

    return prepare


def simulated(name: str, *options: str) -> Prepare:
    """A drive rendered once into build/sim/."""

    def prepare(_out: Path) -> Path | str:
        folder = SIMULATED / name
        if (folder / "cloud.npy").is_file():
            return folder
        if not SIMULATOR.is_file():
            return f"{SIMULATOR} is not here"
        command = [sys.executable, str(SIMULATOR), "--out", str(folder), *options]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode or not (folder / "cloud.npy").is_file():
            said = done.stderr.strip().splitlines() or ["it said nothing"]
            return f"{SIMULATOR.name} failed: {said[-1]}"
        return folder

    return prepare
