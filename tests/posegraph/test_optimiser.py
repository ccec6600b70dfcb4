import multiprocessing
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from calm_edge.posegraph.optimiser import Immediate, Snapshot, Spawned
from tests.drives import curved
from tests.posegraph.graphs import graph_of

PATIENCE_S = 60.0


def snapshot(n=30, key=None):
    taken = graph_of(curved(n), noise=0.05).snapshot()
    return taken if key is None else Snapshot(key, taken.problem, taken.state)


def wait_for(condition):
    end = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        assert time.monotonic() < end
        time.sleep(0.01)
    return value


def gone(pid):
    """Whether a process has exited: it does not exist or is a zombie."""
    try:
        with open(f"/proc/{pid}/stat") as stat:  # noqa: PTH123
            return stat.read().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.fixture
def spawned():
    optimiser = Spawned()
    yield optimiser
    optimiser.close()


def test_immediate_gives_the_newest_once():
    optimiser = Immediate()
    assert optimiser.poll() is None
    optimiser.request(snapshot(key=1))
    optimiser.request(snapshot(key=2))
    assert optimiser.poll().graph == 2
    assert optimiser.poll() is None


def test_immediate_and_spawned_give_identical_bits(spawned):
    asked, here = snapshot(), Immediate()
    here.request(asked)
    spawned.request(asked)
    far, near = wait_for(spawned.poll).optimum, here.poll().optimum
    assert far.state.T_w_p.tobytes() == near.state.T_w_p.tobytes()
    assert far.state.T_p_a.tobytes() == near.state.T_p_a.tobytes()
    assert spawned.poll() is None


def test_only_the_newest_waiting_request_is_computed(spawned):
    keys = list(range(40))
    for key in keys:
        spawned.request(snapshot(10, key))
    given = []
    while not given or given[-1] != keys[-1]:
        given.append(wait_for(spawned.poll).graph)
    assert given == sorted(given)
    # while the process starts, only the newest request waits
    assert len(given) <= 3


def test_a_killed_process_is_replaced_at_the_next_request(spawned, caplog):
    spawned.request(snapshot(key=1))
    wait_for(spawned.poll)
    first = spawned.pid
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: gone(first))
    spawned.request(snapshot(key=2))
    wait_for(lambda: "the optimiser process died" in caplog.text)
    assert spawned.poll() is None
    spawned.request(snapshot(key=3))
    assert wait_for(spawned.poll).graph == 3
    assert spawned.pid != first


def test_close_kills_a_process_that_computes():
    optimiser = Spawned()
    optimiser.request(snapshot(10))
    wait_for(optimiser.poll)
    pid = optimiser.pid
    optimiser.request(snapshot(600))
    optimiser.close()
    wait_for(lambda: gone(pid))
    optimiser.request(snapshot(10))
    assert optimiser.poll() is None
    Spawned().close()


def solve_in_grandchild(connection):
    optimiser = Spawned()
    optimiser.request(snapshot(10, key=7))
    connection.send((wait_for(optimiser.poll).graph, optimiser.pid))
    time.sleep(PATIENCE_S)


def test_works_inside_a_daemonic_process_and_dies_with_it():
    ours, theirs = multiprocessing.Pipe()
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=solve_in_grandchild, args=(theirs,), daemon=True)
    process.start()
    assert ours.poll(PATIENCE_S)
    key, pid = ours.recv()
    assert key == 7
    process.kill()
    process.join()
    wait_for(lambda: gone(pid))


def test_snapshots_are_arrays_and_need_no_gtsam():
    taken = snapshot(10)
    assert isinstance(taken.state.T_w_p, np.ndarray)
    code = "import calm_edge.posegraph.optimiser, sys; sys.exit('gtsam' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
