"""Install and use the package of another architecture in a Debian tree, emulated by QEMU.

Prints one row per step with what was measured. Needs root, debootstrap, qemu-user-static and the
kernel's binfmt_misc; without them it prints why it was skipped and exits with 77. The tree has no
network. What it records is compared with what this machine makes of the same frames.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from calm_edge.geometry import se3
from calm_edge.trajectories import read_tum
from deploy.try_deb import DATA, IMPORTS, SKIPPED, SUITE, WORK, copy_drive, expect, run, run_steps

PACKAGES = "python3,adduser,libsystemd0,init-system-helpers"
BINFMT = Path("/proc/sys/fs/binfmt_misc")
# Debian's architecture -> QEMU's machine, the first bytes of its programs, and which bits of them
# count (qemu-binfmt-conf.sh of QEMU)
EMULATED = {
    "arm64": (
        "aarch64",
        r"\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\xb7\x00",
        r"\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe\xff\xff\xff",
    ),
}
# e_machine in the header of a program
E_MACHINE = {"arm64": 183}
# Largest difference of a keyframe's position, share of the path, and of its direction, degrees: the
# same arithmetic with other instructions rounds differently, and the solver amplifies that.
# 12 frames: 0.0005 % and 0.004 degrees.
MAX_SHIFT, MAX_TURN_DEG = 0.002, 0.05


class ForeignTree:
    """A Debian tree of another architecture, whose programs QEMU runs.

    frames: of the demo drive, per camera.
    """

    def __init__(self, architecture: str, frames: int, backbone: str) -> None:
        self.architecture, self.frames, self.backbone = architecture, frames, backbone
        self.base, self.tree = WORK / f"debian-{architecture}", WORK / f"tree-{architecture}"

    def inside(self, script: str) -> str:
        """Run a shell script as root in the tree, without network."""
        mounts = "mount -t proc proc {t}/proc && mount -t tmpfs tmpfs {t}/dev/shm && "
        enter = mounts.format(t=self.tree) + f"exec chroot {self.tree} /bin/sh -ec '{script}'"
        return run("unshare", "--net", "--mount", "--pid", "--fork", "sh", "-ec", enter)

    def make(self) -> str:
        """Make a fresh tree; the bare one is downloaded once."""
        if not (self.base / "bin").exists():
            partly = self.base.with_suffix(".part")
            shutil.rmtree(partly, ignore_errors=True)
            how = ["--variant=minbase", f"--include={PACKAGES}"]
            arch = f"--arch={self.architecture}"
            run(
                "debootstrap",
                "--foreign",
                arch,
                *how,
                SUITE,
                partly,
                "http://deb.debian.org/debian",
            )
            run("chroot", partly, "/debootstrap/debootstrap", "--second-stage")
            partly.rename(self.base)
        shutil.rmtree(self.tree, ignore_errors=True)
        run("cp", "-a", self.base, self.tree)
        (self.tree / "dev" / "shm").mkdir(exist_ok=True)
        return self.inside("uname -m && python3 --version").strip().replace("\n", ", ")

    def build(self) -> str:
        """Build the package and check that all machine code in it is of the architecture."""
        out = WORK / self.architecture
        shutil.rmtree(out, ignore_errors=True)
        run(sys.executable, "-m", "deploy.build_deb", "--arch", self.architecture, "--out", out)
        sizes = []
        for deb in sorted(out.glob("*.deb")):
            unpacked = out / "unpacked"
            run("dpkg-deb", "-x", deb, unpacked)
            for file in unpacked.rglob("*"):
                if file.is_file() and not file.is_symlink():
                    head = file.open("rb").read(20)
                    machine = int.from_bytes(head[18:20], "little")
                    wrong = head[:4] == b"\x7fELF" and machine != E_MACHINE[self.architecture]
                    expect(not wrong, f"{deb.name}: {file.name} is for machine {machine}")
            shutil.rmtree(unpacked)
            shutil.copy(deb, self.tree / "root")
            sizes.append(f"{deb.name} {deb.stat().st_size / 1e6:.0f} MB")
        return ", ".join(sizes)

    def install(self) -> str:
        self.inside("dpkg -i /root/calm-edge*.deb")
        return self.inside("calm-edge --version").strip()

    def imports(self) -> str:
        """Import every module of ours, and systemd's."""
        (self.tree / "tmp" / "imports.py").write_text(IMPORTS)
        n = self.inside("/opt/calm-edge/bin/python3 -I /tmp/imports.py").strip().splitlines()[-1]
        return f"{n} modules import, systemd-python too"

    def record(self) -> str:
        """Record the first frames of the demo drive in lockstep."""
        drive = self.tree / "tmp" / "drive"
        copy_drive(drive, self.frames)
        started = time.monotonic()
        output = self.inside(
            "OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 calm-edge record --sequence /tmp/drive "
            f"--pace lockstep --spacing-m 0.5 --set backbone.name={self.backbone} --out {DATA}/try "
            "|| [ $? -eq 3 ]"
        )
        line = next(x for x in output.splitlines() if x.startswith("sub-maps"))
        return f"{' '.join(line.split())}, {time.monotonic() - started:.0f} s"

    def map(self) -> str:
        """Map the recording."""
        output = self.inside(f"calm-edge map {DATA}/try --out {DATA}/map || [ $? -eq 3 ]")
        return " ".join(next(x for x in output.splitlines() if x.startswith("map")).split())

    def compare(self) -> str:
        """Compare the trajectory with that of this machine."""
        here = WORK / f"here-{self.architecture}"
        shutil.rmtree(here, ignore_errors=True)
        copy_drive(here / "drive", self.frames)
        run(
            "sh", "-ec",
            f"{sys.executable} -m calm_edge.cli record --sequence {here}/drive --pace lockstep "
            f"--spacing-m 0.5 --set backbone.name={self.backbone} --out {here}/try "
            "|| [ $? -eq 3 ]",
        )  # fmt: skip
        t_here, T_here = read_tum(here / "try" / "record_trajectory.tum")
        there = self.tree / DATA.lstrip("/") / "try" / "record_trajectory.tum"
        t_there, T_there = read_tum(there)
        expect(np.array_equal(t_here, t_there), f"{len(t_there)} keyframes, not {len(t_here)}")
        length = np.linalg.norm(np.diff(T_here[:, :3, 3], axis=0), axis=1).sum()
        apart = se3.inverse(T_here) @ T_there
        shift = float(np.linalg.norm(apart[:, :3, 3], axis=1).max() / length)
        turn = float(np.degrees(np.linalg.norm(se3.so3_log(apart[:, :3, :3]), axis=1).max()))
        text = f"{len(t_here)} keyframes differ by at most {shift:.4%} of the path, {turn:.3f} deg"
        expect(shift < MAX_SHIFT and turn < MAX_TURN_DEG, text)
        return f"{text} (allowed: {MAX_SHIFT:.1%}, {MAX_TURN_DEG} deg)"


def missing(architecture: str) -> str:
    """What the test lacks on this machine; empty if nothing."""
    if architecture not in EMULATED:
        return f"ARCH={architecture} is not emulated; choose one of {', '.join(EMULATED)}"
    emulator = f"qemu-{EMULATED[architecture][0]}-static"
    absent = [name for name in ("debootstrap", "unshare", emulator) if not shutil.which(name)]
    if absent:
        return f"{', '.join(absent)} not installed: apt-get install qemu-user-static debootstrap"
    return "not root" if os.geteuid() else ""


@contextmanager
def emulation(architecture: str) -> Iterator[bool]:
    """Let the kernel run programs of an architecture by QEMU meanwhile; False if it cannot."""
    machine, magic, mask = EMULATED[architecture]
    entry = BINFMT / f"qemu-{machine}"
    if not (BINFMT / "register").exists():
        how = ["mount", "-t", "binfmt_misc", "binfmt_misc", str(BINFMT)]
        subprocess.run(how, capture_output=True, check=False)
    if entry.exists():
        yield True
        return
    # F: the interpreter is opened now, so that it is found from within the tree
    rule = f":{entry.name}:M::{magic}:{mask}:{shutil.which(f'{entry.name}-static')}:F"
    try:
        (BINFMT / "register").write_text(rule)
    except OSError:
        yield False
        return
    try:
        yield True
    finally:
        entry.write_text("-1")


def main() -> int:
    parser = argparse.ArgumentParser(prog="make deb-test ARCH=arm64", description=__doc__)
    parser.add_argument("--arch", default="arm64")
    parser.add_argument("--frames", type=int, default=12, help="of the demo drive, per camera")
    parser.add_argument("--backbone", default="bundle")
    arguments = parser.parse_args()
    if lacks := missing(arguments.arch):
        print(f"deb-test: skipped, {lacks}")
        return SKIPPED
    WORK.mkdir(parents=True, exist_ok=True)
    tree = ForeignTree(arguments.arch, arguments.frames, arguments.backbone)
    steps: dict[str, Callable[[], str]] = {
        "a bare tree": tree.make,
        "build": tree.build,
        "install": tree.install,
        "imports": tree.imports,
        "record": tree.record,
        "map": tree.map,
        "compare": tree.compare,
    }
    with emulation(arguments.arch) as works:
        if not works:
            print("deb-test: skipped, the kernel has no binfmt_misc for programs that QEMU runs")
            return SKIPPED
        failed = run_steps(steps)
    if not failed:
        shutil.rmtree(tree.tree)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
