"""An emulated machine: a stock kernel under QEMU on a read-only view of this root file system.

The guest runs the very files that are here, the virtual environment too; what it writes is lost,
but for one shared folder (/mnt in the guest). Nothing is accelerated: it shows behaviour, not
timing.

    python -m hil_tests.vm.machine --out build/vm --module "vivid n_devs=2" guest.sh
"""

from __future__ import annotations

import argparse
import contextlib
import gzip
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hil_tests.vm.kernel import Kernel, MachineError, fetch

ROOT_MODULES = ("virtio_pci", "9p", "9pnet_virtio", "overlay")
DISK_MODULES = ("virtio_blk", "ext4")
APPLETS = ("sh", "mount", "mkdir", "insmod", "cat", "echo", "chroot", "sync", "poweroff")
_LOG, _RC, _CONSOLE = "guest.log", "guest.rc", "console.log"

_INIT = """#!/bin/sh
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev
while read file options; do insmod /lib/$file $options || echo "insmod $file: failed"; done < /load
mount -t 9p -o trans=virtio,version=9p2000.L,msize=1048576,cache=loose,ro root /host
mount -t tmpfs tmpfs /over; mkdir /over/upper /over/work
mount -t overlay -o lowerdir=/host,upperdir=/over/upper,workdir=/over/work overlay /new
mount -t proc proc /new/proc; mount -t sysfs sys /new/sys; mount -t devtmpfs dev /new/dev
mkdir -p /new/dev/pts /new/dev/shm
mount -t devpts devpts /new/dev/pts; mount -t tmpfs shm /new/dev/shm
mount -t 9p -o trans=virtio,version=9p2000.L,msize=1048576 out /new/mnt
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
"""
_SCRIPT_INIT = """mount -t tmpfs tmpfs /new/run
chroot /new /bin/bash -c '/bin/bash /mnt/guest.sh > /mnt/guest.log 2>&1'
echo $? > /new/mnt/guest.rc; sync; poweroff -f
"""
# systemd cleans /tmp, which would copy the host's /tmp up file by file: hide it; the script is a
# unit that powers the machine off
_SYSTEMD_INIT = """mount -t tmpfs tmpfs /new/tmp; mount -t tmpfs tmpfs /new/var/tmp
mkdir -p /new/etc/systemd/system/multi-user.target.wants
cat > /new/etc/systemd/system/vm-guest.service <<'UNIT'
[Unit]
After=basic.target
[Service]
Type=oneshot
Environment=HOME=/root
StandardOutput=append:/mnt/guest.log
StandardError=inherit
ExecStart=/bin/bash /mnt/guest.sh
ExecStopPost=/bin/sh -c 'echo $EXIT_STATUS > /mnt/guest.rc; sync'
ExecStopPost=/bin/systemctl poweroff --force --force
UNIT
ln -sf ../vm-guest.service /new/etc/systemd/system/multi-user.target.wants/vm-guest.service
exec switch_root /new /lib/systemd/systemd --unit=multi-user.target
"""


@dataclass(frozen=True, slots=True)
class Outcome:
    """The end of a guest script.

    rc: its exit status; None when the machine was stopped before. log: its stdout and stderr.
    console: the kernel's. power_cut: stopped because the log held the given words.
    """

    rc: int | None
    log: str
    console: str
    power_cut: bool = False


@dataclass(frozen=True, slots=True)
class Machine:
    """An emulated machine.

    modules: `NAME` or `NAME OPTION=VALUE ...`, loaded before the guest script; what they need
    comes along. files: modules built here, loaded last, likewise with options.
    root: the tree the guest sees as /. disks: images, in the guest /dev/vda, /dev/vdb ..., never
    cached by the host, so that a power cut loses what was not synced. systemd: as process 1.
    extra: more arguments of qemu, such as a second `-serial`.
    """

    modules: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    root: Path = Path("/")
    disks: tuple[Path, ...] = ()
    systemd: bool = False
    memory_mib: int = 2048
    extra: tuple[str, ...] = ()

    def run(
        self, guest: str, out: Path, timeout_s: float = 300.0, cut_power_at: str | None = None
    ) -> Outcome:
        """Boot, run the guest script (its text) and wait for its end; raises MachineError.

        out: the shared folder. cut_power_at: words in the script's log at which the emulator is
        killed, before anything can sync.
        """
        out.mkdir(parents=True, exist_ok=True)
        for name in (_LOG, _RC, _CONSOLE):
            (out / name).unlink(missing_ok=True)
        (out / "guest.sh").write_text(guest)
        kernel = fetch()
        with tempfile.TemporaryDirectory(prefix="calm-edge-vm-") as scratch:
            initrd = self._initrd(kernel, Path(scratch))
            with (out / _CONSOLE).open("wb") as console:
                process = self._start(kernel, initrd, out, console.fileno())
                cut = _wait(process, out / _LOG, timeout_s, cut_power_at)
        rc = _text(out / _RC).strip()
        return Outcome(
            int(rc) if rc and not cut else None, _text(out / _LOG), _text(out / _CONSOLE), cut
        )

    def _initrd(self, kernel: Kernel, scratch: Path) -> Path:
        """Pack busybox, the modules in loading order, and an init that mounts the root."""
        tree = scratch / "tree"
        for name in ("bin", "proc", "sys", "dev", "lib", "host", "over", "new"):
            (tree / name).mkdir(parents=True)
        busybox = shutil.which("busybox")
        if busybox is None:
            raise MachineError("busybox: not installed; see hil_tests/vm/README.md")
        shutil.copy(busybox, tree / "bin/busybox")
        for applet in (*APPLETS, "ln", "switch_root"):
            (tree / "bin" / applet).symlink_to("busybox")
        load: dict[str, str] = {}
        for line in (*ROOT_MODULES, *(DISK_MODULES if self.disks else ()), *self.modules):
            name, _, options = line.partition(" ")
            files = kernel.modules(name)
            for file in files:
                shutil.copy(file, tree / "lib" / file.name)
                load.setdefault(file.name, "")
            if files and options:
                load[files[-1].name] = options
        for line in self.files:
            name, _, options = line.partition(" ")
            shutil.copy(name, tree / "lib" / Path(name).name)
            load[Path(name).name] = options
        (tree / "load").write_text("".join(f"{f} {o}\n" for f, o in load.items()))
        init = tree / "init"
        init.write_text(_INIT + (_SYSTEMD_INIT if self.systemd else _SCRIPT_INIT))
        init.chmod(0o755)
        names = "\n".join(str(p.relative_to(tree)) for p in sorted(tree.rglob("*")))
        packed = subprocess.run(
            ["cpio", "-o", "-H", "newc", "--quiet"],
            cwd=tree, input=names.encode(), capture_output=True, check=True,
        ).stdout  # fmt: skip
        initrd = scratch / "initrd.gz"
        initrd.write_bytes(gzip.compress(packed, 1))
        return initrd

    def _start(
        self, kernel: Kernel, initrd: Path, out: Path, console: int
    ) -> subprocess.Popen[bytes]:
        def share(tag: str, path: Path, options: str) -> list[str]:
            mapped = f"local,id={tag},path={path},security_model=none{options}"
            return ["-fsdev", mapped, "-device", f"virtio-9p-pci,fsdev={tag},mount_tag={tag}"]

        words = ["qemu-system-x86_64", "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2"]
        words += [
            "-m",
            str(self.memory_mib),
            "-display",
            "none",
            "-serial",
            "stdio",
            "-nic",
            "none",
        ]
        words += ["-no-reboot", "-kernel", str(kernel.image), "-initrd", str(initrd)]
        words += ["-append", "console=ttyS0 quiet panic=-1 loglevel=4"]
        words += share("root", self.root, ",readonly=on,multidevs=remap")
        words += share("out", out.resolve(), "")
        for disk in self.disks:
            words += ["-drive", f"file={disk},format=raw,if=virtio,cache=none"]
        try:
            return subprocess.Popen(
                [*words, *self.extra],
                stdin=subprocess.DEVNULL, stdout=console, stderr=subprocess.STDOUT,
            )  # fmt: skip
        except FileNotFoundError:
            raise MachineError("qemu: not installed; see hil_tests/vm/README.md") from None


def _wait(process: subprocess.Popen[bytes], log: Path, timeout_s: float, words: str | None) -> bool:
    """Wait for the end, kill a machine past its time; returns whether the power was cut."""
    end_s = time.monotonic() + timeout_s
    try:
        while process.poll() is None and time.monotonic() < end_s:
            if words is not None and words in _text(log):
                return True
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.2)
        return False
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def _text(path: Path) -> str:
    return path.read_text(errors="replace") if path.is_file() else ""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one guest script; returns its exit status, 124 if it did not end."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("guest", type=Path, help="a bash script")
    parser.add_argument("--out", type=Path, required=True, help="the folder shared as /mnt")
    parser.add_argument("--module", action="append", default=[], help='"vivid n_devs=2"')
    parser.add_argument("--file", action="append", default=[], help="a module built here")
    parser.add_argument("--disk", action="append", type=Path, default=[], help="an image")
    parser.add_argument("--root", type=Path, default=Path("/"))
    parser.add_argument("--systemd", action="store_true", help="as process 1 (slow)")
    parser.add_argument("--timeout", type=float, default=300.0, metavar="S")
    parser.add_argument("--cut-power-at", metavar="WORDS")
    a = parser.parse_args(argv)
    machine = Machine(tuple(a.module), tuple(a.file), a.root, tuple(a.disk), a.systemd)
    try:
        outcome = machine.run(a.guest.read_text(), a.out, a.timeout, a.cut_power_at)
    except (MachineError, OSError) as error:
        print(f"vm: {error}", file=sys.stderr)
        return 1
    print(outcome.log, end="")
    if outcome.rc is None and not outcome.power_cut:
        print(f"vm: the guest did not end; see {a.out / _CONSOLE}", file=sys.stderr)
    return 0 if outcome.power_cut else 124 if outcome.rc is None else outcome.rc


if __name__ == "__main__":
    sys.exit(main())
