"""A rival that cannot be installed is skipped with a reason; a crash is an error with its log."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bench.rivals import environment
from bench.rivals.environment import RivalMissing, run_process
from calm_edge.evaluation import EvaluationError


def test_what_pip_cannot_find_is_missing_not_an_error_of_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(environment, "RIVALS", tmp_path)
    said = []

    def refuse(step: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        said.append(step)
        return subprocess.CompletedProcess(step, len(said) - 1, "", "noise\nno such package")

    monkeypatch.setattr(environment.subprocess, "run", refuse)
    with pytest.raises(RivalMissing, match=r"r cannot be installed \(no such package\)"):
        environment.environment("r", "thing==1")
    assert said[1][-1] == "thing==1" and not (tmp_path / "r" / "ready").exists()


def test_an_environment_is_made_once_and_again_for_other_packages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(environment, "RIVALS", tmp_path)
    made = []

    def install(step: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        python = tmp_path / "r" / "bin" / "python"
        python.parent.mkdir(parents=True, exist_ok=True)
        python.touch()
        made.append(step[-1])
        return subprocess.CompletedProcess(step, 0, "", "")

    monkeypatch.setattr(environment.subprocess, "run", install)
    for packages, count in ((("a",), 2), (("a",), 2), (("a", "b"), 4)):
        assert environment.environment("r", *packages) == tmp_path / "r" / "bin" / "python"
        assert len(made) == count


ANSWER = """
import json, sys
job = json.load(open(sys.argv[1]))
poses = [[1, 0, 0, k, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] for k in (2, 1)]
said = {"t_ns": [20, 10], "T_w_c": poses, "frames": job["n"], "cpu_s": 1.5}
json.dump(said, open(sys.argv[2], "w"))
sys.exit(job["code"])
"""


@pytest.mark.parametrize("code", [0, 3])
def test_an_answer_counts_though_the_process_dies_after_it(tmp_path: Path, code: int) -> None:
    script = tmp_path / "s.py"
    script.write_text(ANSWER)
    run = run_process(Path(sys.executable), script, {"n": 4, "code": code}, tmp_path / "w")
    np.testing.assert_array_equal(run.t_ns, [10, 20])
    np.testing.assert_array_equal(run.T_w_c[:, 0, 3], [1, 2])
    assert run.frames == 4 and run.cpu_s == 1.5 and run.focal_px == ()


def test_no_answer_names_the_log(tmp_path: Path) -> None:
    script = tmp_path / "s.py"
    script.write_text("import sys; sys.exit('lost')")
    work = tmp_path / "w"
    work.mkdir()
    (work / "result.json").write_text("of an earlier run")
    with pytest.raises(EvaluationError, match=r"s: exit 1 without a result; see .*log\.txt"):
        run_process(Path(sys.executable), script, {}, work)
    assert "lost" in (work / "log.txt").read_text()
