"""Jobs of drives: in processes here, and on a Dask cluster that loses a worker."""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from pathlib import Path

import pytest

from calm_edge.offline import drive_jobs
from calm_edge.offline.drive_jobs import JobError, here, on_dask

# writes a line to a file, and kills itself at the first time if it is told to
JOB = """
import os, pathlib, signal, sys
file = pathlib.Path(sys.argv[1])
file.open("a").write("run\\n")
if len(sys.argv) > 2 and file.read_text().count("run") == 1:
    os.kill(os.getpid(), signal.SIGKILL)
sys.exit(int(file.name[0]))
"""


def test_exit_codes_are_in_order_and_a_killed_command_is_run_again(tmp_path: Path) -> None:
    commands = [["-c", JOB, str(tmp_path / name)] for name in ("0a", "3b", "1c")]
    commands[1].append("kill")
    assert list(here(commands, workers=2)) == [0, 3, 1]
    assert (tmp_path / "3b").read_text().count("run") == 2


def test_a_command_that_is_killed_each_time_has_failed(tmp_path: Path) -> None:
    always = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"
    assert list(here([["-c", always]])) == [1]


def test_without_a_scheduler_the_address_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed (dask extra)")
    monkeypatch.setattr(drive_jobs, "CONNECT_S", 0.2)
    with pytest.raises(JobError, match=r"--dask tcp://127\.0\.0\.1:9: no scheduler"):
        list(on_dask([["-c", ""]], "tcp://127.0.0.1:9"))


# writes the process id of the worker that runs it, then waits to be let go
WAITING = """
import os, pathlib, sys, time
folder, name = pathlib.Path(sys.argv[1]), sys.argv[2]
with (folder / (name + ".workers")).open("a") as file:
    file.write(f"{os.getppid()}\\n")
while not (folder / "go").exists():
    time.sleep(0.02)
(folder / (name + ".done")).touch()
"""


def test_the_drive_of_a_lost_worker_is_done_again(tmp_path: Path) -> None:
    distributed = pytest.importorskip(
        "distributed", reason="distributed is not installed (dask extra)"
    )
    # one for each worker: a third could be started in the place of the lost one, and wait for ever
    names = ["a", "b"]
    commands = [["-c", WAITING, str(tmp_path), name] for name in names]

    def workers(name: str) -> list[int]:
        file = tmp_path / f"{name}.workers"
        return [int(line) for line in file.read_text().split()] if file.exists() else []

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
        ) as cluster:
            codes = on_dask(commands, cluster.scheduler_address)
            found: list[int] = []
            thread = threading.Thread(target=lambda: found.extend(codes))
            thread.start()
            limit = time.monotonic() + 200
            while sum(bool(workers(name)) for name in names) < 2:
                assert time.monotonic() < limit
                time.sleep(0.02)
            lost = next(name for name in names if workers(name))
            os.kill(workers(lost)[0], signal.SIGKILL)
            while len(workers(lost)) < 2:
                assert time.monotonic() < limit
                time.sleep(0.02)
            (tmp_path / "go").touch()
            thread.join(max(1.0, limit - time.monotonic()))
    assert found == [0, 0]
    assert all((tmp_path / f"{name}.done").exists() for name in names)
    assert len(set(workers(lost))) == 2
