"""Test the V4L2 driver on the kernel's virtual cameras (vivid), with each fault they can inject."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from hil_tests.report import Row, Verdict, judged
from hil_tests.vm.machine import Machine

NAME = "cameras"
# each camera with a metadata node beside it, as USB cameras have
VIVID = "vivid n_devs=2 node_types=0x20001,0x20001 num_inputs=1,1 input_types=0x0,0x0"
ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 400.0


def rows(out: Path) -> Iterator[Row]:
    """Yield a row for each `ROW name|verdict|seen` of the guest; raises MachineError."""
    guest = f"cd {ROOT} && exec {sys.executable} -m hil_tests.vm.cameras_guest\n"
    outcome = Machine((VIVID,)).run(guest, out, LIMIT_S)
    for line in outcome.log.splitlines():
        if line.startswith("ROW "):
            what, verdict, seen = line.removeprefix("ROW ").split("|", 2)
            yield Row(NAME, what, Verdict(verdict), seen)
    ended = "to its last line" if outcome.rc == 0 else f"ended with {outcome.rc}; see {out}"
    yield judged(NAME, "guest script", outcome.rc == 0, ended, "runs to its last line")
