"""Debian's stock kernel, unpacked into a cache, with modules for virtual cameras and disks."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path


class MachineError(RuntimeError):
    """The emulated machine cannot be built; one line with the remedy."""


def command(*words: str | Path, folder: Path | None = None) -> str:
    """Return what a command prints; raises MachineError with the last line of its errors."""
    try:
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise MachineError(f"{words[0]}: not installed; see hil_tests/vm/README.md") from None
    if done.returncode:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["failed without a message"]
        raise MachineError(f"{' '.join(map(str, words))}: {lines[-1]}")
    return done.stdout


def cache() -> Path:
    """Return the folder for kernels and the modules built for them."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(base) / "calm-edge" / "vm"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


class Kernel:
    """An unpacked kernel package: `boot/vmlinuz-VERSION`, `lib/modules/VERSION`."""

    def __init__(self, tree: Path) -> None:
        self.tree = tree
        self.image = next(tree.glob("boot/vmlinuz-*"))
        self.version = self.image.name.removeprefix("vmlinuz-")
        if not (tree / "lib/modules" / self.version / "modules.dep").is_file():
            command("depmod", "-b", tree, self.version)

    def modules(self, name: str) -> list[Path]:
        """Return the files of a module and its dependencies, in loading order."""
        listing = command("modprobe", "-d", self.tree, "-S", self.version, "--show-depends", name)
        return [Path(f) for f in re.findall(r"^insmod (\S+)", listing, re.MULTILINE)]


def fetch_package(name: str, into: Path) -> None:
    """Download and unpack a Debian package without installing it; raises MachineError."""
    with tempfile.TemporaryDirectory() as scratch:
        command("apt-get", "download", "-qq", name, folder=Path(scratch))
        package = next(Path(scratch).glob("*.deb"))
        command("dpkg-deb", "-x", package, into)


def fetch() -> Kernel:
    """Fetch the kernel of this Debian release, about 70 MB, once; raises MachineError."""
    tree = cache() / "kernel"
    if not list(tree.glob("boot/vmlinuz-*")):
        found = re.search(
            r"Depends: (linux-image-\d\S+)", command("apt-cache", "depends", "linux-image-amd64")
        )
        if found is None:
            raise MachineError("linux-image-amd64: not found; run apt-get update")
        half = tree.with_name("kernel.part")
        shutil.rmtree(half, ignore_errors=True)
        fetch_package(found[1], half)
        half.rename(tree)
    return Kernel(tree)
