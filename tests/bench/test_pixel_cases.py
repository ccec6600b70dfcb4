"""Drives of the table: unique names, and faults that differ from the source drive."""

from pathlib import Path

import numpy as np

from bench import drives
from bench.perturb import Clocks, Perturbation
from bench.pixel_cases import CASES, EVERY, REAL, UNSEEN, WORSE, made_worse
from calm_edge.evaluation.truth import read_truth
from tests.bench.rivals.test_calibration import write


def test_every_drive_has_one_name_and_only_whole_kilometres_count() -> None:
    assert len(EVERY) == len(CASES) + len(UNSEEN) + len(WORSE)
    counted = {case.name for case in EVERY.values() if case.counts}
    assert counted == {d.name for d in (*drives.DEVELOPMENT, *drives.HELD_OUT)}
    assert not any(case.counts for case in REAL)
    assert len([case for case in CASES if case.counts]) >= 4


def test_a_worse_kit_leaves_its_drive_as_it_was(tmp_path: Path) -> None:
    source = write(tmp_path / "d")
    change = Perturbation(Clocks(latency_ms=(40.0, 0.0)))
    folder = made_worse(drives.there(source), change)(tmp_path / "out")
    assert isinstance(folder, Path)
    late, right = read_truth(folder), read_truth(source)
    np.testing.assert_array_equal(late.t_ns - right.t_ns, 40_000_000)
    np.testing.assert_allclose(late.T_w_c, right.T_w_c, atol=1e-9)


def test_a_drive_that_is_not_here_cannot_be_made_worse(tmp_path: Path) -> None:
    gone = made_worse(drives.there(tmp_path / "gone"), Perturbation())(tmp_path / "out")
    assert gone == f"{tmp_path / 'gone'} is not here"
