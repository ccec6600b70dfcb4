"""COLMAP (PyPI `pycolmap`): offline structure from motion without calibration."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from bench.drives import pictures
from bench.rivals.environment import RivalRun, environment, run_process
from calm_edge.recording.sequence_folder import SequenceFolder
from device.frame import Eye

PACKAGES = ("pycolmap==4.2.1", "numpy")
SCRIPT = Path(__file__).with_name("colmap_process.py")

# Pictures are matched within an eye at these distances in frames, between the eyes up to ACROSS.
STEPS = (1, 2, 3, 5, 8)
ACROSS = 2


def picture_pairs(primary: Sequence[str], assistant: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the names of picture pairs to match, within each eye and between the eyes."""
    for names in (primary, assistant):
        for step in STEPS:
            yield from zip(names, names[step:], strict=False)
    for i, name in enumerate(primary):
        for other in assistant[max(i - ACROSS, 0) : i + ACROSS + 1]:
            yield name, other


def run(folder: Path, work: Path) -> RivalRun:
    """Run COLMAP on a sequence folder with one unknown focal length per eye.

    Returns the poses of its largest model. Raises RivalMissing, EvaluationError.
    """
    folder = folder.resolve()
    python = environment("colmap", *PACKAGES)
    images = work / "images"
    shutil.rmtree(images, ignore_errors=True)
    names: list[list[str]] = []
    for eye in Eye:
        (images / f"cam{int(eye)}").mkdir(parents=True)
        files = pictures(folder, eye)
        for file in files:
            (images / f"cam{int(eye)}" / file.name).symlink_to(file.resolve())
        names.append([f"cam{int(eye)}/{file.name}" for file in files])
    lines = [" ".join(pair) for pair in picture_pairs(*names)]
    (work / "pairs.txt").write_text("\n".join(lines) + "\n")
    job = {
        "images": str(images),
        "pairs": str(work / "pairs.txt"),
        "work": str(work),
        "names": names[0],
        "t_ns": SequenceFolder(folder).t_ns(Eye.PRIMARY).tolist(),
    }
    return run_process(python, SCRIPT, job, work)
