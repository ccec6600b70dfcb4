"""Test the package on a booted machine with virtual cameras: installation, start, a hang, a stop, a
failing disk, removal. systemd is process 1; `service_guest.sh` runs in the guest.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from deploy.try_deb import Unexpected, fetch_base
from hil_tests.report import Row, Verdict, judged
from hil_tests.vm.kernel import MachineError, command
from hil_tests.vm.machine import Machine

NAME = "service"
VIVID = "vivid n_devs=2 node_types=0x1,0x1 num_inputs=1,1 input_types=0x0,0x0"
MODULES = (VIVID, "usbserial", "cdc_acm", "dm-flakey")
GUEST = Path(__file__).with_name("service_guest.sh")
ROOT = Path(__file__).resolve().parents[2]
# recordings keep a gigabyte of it free
DISK_BYTES = 3 << 30
LIMIT_S = 1500.0


def rows(out: Path) -> Iterator[Row]:
    """Yield a row for each `ROW name|verdict|seen` of the guest; raises MachineError."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    command(sys.executable, "-m", "deploy.build_deb", "--no-oak", "--out", out, folder=ROOT)
    disk = out / "data.img"
    with disk.open("wb") as file:
        file.truncate(DISK_BYTES)
    command("mke2fs", "-q", "-F", "-t", "ext4", disk)
    try:
        tree = fetch_base()
    except Unexpected as error:
        raise MachineError(str(error)) from None
    machine = Machine(MODULES, root=tree, disks=(disk,), systemd=True, memory_mib=3072)
    outcome = machine.run(GUEST.read_text(), out, LIMIT_S)
    disk.unlink()
    log = out / "service.log"
    for line in log.read_text(errors="replace").splitlines() if log.exists() else ():
        if line.startswith("ROW "):
            what, verdict, seen = line.removeprefix("ROW ").split("|", 2)
            yield Row(NAME, what, Verdict(verdict), seen)
    ended = "to its last line" if outcome.rc == 0 else f"ended with {outcome.rc}; see {log}"
    yield judged(NAME, "guest script", outcome.rc == 0, ended, "runs to its last line")


def missing() -> str:
    """Return what is missing for this test, in words; empty when nothing is."""
    tools = ("qemu-system-x86_64", "debootstrap", "mke2fs", "debugfs", "busybox", "cpio")
    absent = [name for name in tools if not shutil.which(name)]
    if absent:
        return f"{', '.join(absent)} not installed; see hil_tests/vm/README.md"
    root = subprocess.run(["id", "-u"], capture_output=True, text=True, check=True).stdout.strip()
    return "" if root == "0" else "needs root"
