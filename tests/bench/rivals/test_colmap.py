"""Pairs for COLMAP: along time and between the eyes, each once."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.rivals import colmap
from bench.rivals.environment import RivalRun
from tests.bench.rivals.test_calibration import write


def test_pairs_run_along_time_and_across() -> None:
    eyes = [[f"{eye}{k}" for k in range(12)] for eye in "ab"]
    pairs = list(colmap.picture_pairs(*eyes))
    assert len({frozenset(pair) for pair in pairs}) == len(pairs)
    within = {int(b[1:]) - int(a[1:]) for a, b in pairs if a[0] == b[0]}
    across = {int(b[1:]) - int(a[1:]) for a, b in pairs if a[0] != b[0]}
    assert within == set(colmap.STEPS)
    assert across == set(range(-colmap.ACROSS, colmap.ACROSS + 1))
    assert sum(a[0] == b[0] == "a" for a, b in pairs) == sum(a[0] == b[0] == "b" for a, b in pairs)


def test_its_job_is_the_folder_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write(tmp_path / "d")
    jobs: list[dict[str, Any]] = []

    def note(_python: Path, script: Path, job: dict[str, Any], _work: Path) -> RivalRun:
        assert script.is_file()
        jobs.append(job)
        return RivalRun(np.zeros(0, np.int64), np.zeros((0, 4, 4)), 0, 0.0, 0.0)

    monkeypatch.setattr(colmap, "environment", lambda *_: Path("python"))
    monkeypatch.setattr(colmap, "run_process", note)
    colmap.run(folder, tmp_path / "w")
    (job,) = jobs
    assert len(job["names"]) == len(job["t_ns"]) == 60
    names = {name for line in Path(job["pairs"]).read_text().splitlines() for name in line.split()}
    assert all((Path(job["images"]) / name).is_file() for name in names)
    assert len(names) == 120
    assert not {"calib.txt", "poses0.txt"} & {p.name for p in Path(job["images"]).rglob("*")}
