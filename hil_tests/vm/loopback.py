"""Test Motion JPEG through a kernel device: v4l2loopback, built for the guest's kernel."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from hil_tests.report import Row, Verdict, judged
from hil_tests.vm.kernel import Kernel, cache, command, fetch, fetch_package
from hil_tests.vm.machine import Machine

NAME = "mjpeg"
OPTIONS = "devices=2 exclusive_caps=1,1 max_buffers=8"
SOURCE = "v4l2loopback-dkms"
ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 500.0


def rows(out: Path) -> Iterator[Row]:
    """Yield a row for each `ROW name|verdict|seen` of the guest; raises MachineError."""
    guest = f"cd {ROOT} && exec {sys.executable} -m hil_tests.vm.loopback_guest\n"
    machine = Machine(("videodev",), files=(f"{module(fetch())} {OPTIONS}",))
    outcome = machine.run(guest, out, LIMIT_S)
    for line in outcome.log.splitlines():
        if line.startswith("ROW "):
            what, verdict, seen = line.removeprefix("ROW ").split("|", 2)
            yield Row(NAME, what, Verdict(verdict), seen)
    ended = "to its last line" if outcome.rc == 0 else f"ended with {outcome.rc}; see {out}"
    yield judged(NAME, "guest script", outcome.rc == 0, ended, "runs to its last line")


def module(kernel: Kernel) -> Path:
    """Return the module for a kernel, built once; raises MachineError."""
    made = cache() / f"v4l2loopback-{kernel.version}.ko"
    if made.is_file():
        return made
    tree = cache() / "loopback"
    shutil.rmtree(tree, ignore_errors=True)
    release, _, _ = kernel.version.rpartition("-")
    series = ".".join(kernel.version.split(".")[:2])
    headers = f"linux-headers-{kernel.version}"
    for package in (headers, f"linux-headers-{release}-common", f"linux-kbuild-{series}", SOURCE):
        fetch_package(package, tree)
    # the headers expect to be installed under /usr/src
    makefile = tree / "usr/src" / headers / "Makefile"
    makefile.write_text(makefile.read_text().replace("/usr/src/", f"{tree}/usr/src/"))
    (source,) = (tree / "usr/src").glob("v4l2loopback-*")
    command("make", "-s", "-C", makefile.parent, f"M={source}", "CC=gcc", "modules")
    shutil.copy(source / "v4l2loopback.ko", made)
    shutil.rmtree(tree)
    return made
