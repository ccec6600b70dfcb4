"""Installs, uses, upgrades, removes and purges the packages in a Debian tree of their own.

A row a step, each with what was seen. Needs root, debootstrap and unshare; without them it says so
and exits with 77. The tree has no network while packages are installed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WORK = ROOT / "build" / "deb"
BASE, TREE = WORK / "debian", WORK / "tree"
SUITE = "bookworm"
PACKAGES = "systemd,systemd-sysv,udev,dbus,python3,adduser,dmsetup,kmod,e2fsprogs,procps"
SKIPPED = 77
DATA = "/var/lib/calm-edge"
CONFIG = "/etc/calm-edge/calm-edge.toml"


class Unexpected(Exception):
    """A step that did not do what it should."""


def run(*command: str | Path) -> str:
    """stdout and stderr of a command; raises Unexpected when it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    if done.returncode:
        tail = (done.stdout + done.stderr).strip().splitlines()[-4:]
        raise Unexpected(f"{command[0]} {command[-1]}: exit {done.returncode}: {' | '.join(tail)}")
    return done.stdout + done.stderr


def inside(script: str) -> str:
    """A shell script as root of the tree, without network, in mounts of its own."""
    mounts = "mount -t proc proc {t}/proc && mount -t tmpfs tmpfs {t}/dev/shm && "
    enter = mounts.format(t=TREE) + f"exec chroot {TREE} /bin/sh -ec '{script}'"
    return run("unshare", "--net", "--mount", "--pid", "--fork", "sh", "-ec", enter)


def expect(condition: bool, what: str) -> None:
    """Raises Unexpected unless the condition holds."""
    if not condition:
        raise Unexpected(what)


def fetch_base() -> Path:
    """A bare Debian tree, fetched once; raises Unexpected."""
    if not (BASE / "bin").exists():
        WORK.mkdir(parents=True, exist_ok=True)
        partly = WORK / "debian.part"
        shutil.rmtree(partly, ignore_errors=True)
        how = ["--variant=minbase", f"--include={PACKAGES}"]
        run("debootstrap", *how, SUITE, partly, "http://deb.debian.org/debian")
        partly.rename(BASE)
    return BASE


def make_tree() -> str:
    """A fresh copy of the bare Debian, without network from here on."""
    fetch_base()
    shutil.rmtree(TREE, ignore_errors=True)
    run("cp", "-a", BASE, TREE)
    (TREE / "dev" / "shm").mkdir(exist_ok=True)
    version = (TREE / "etc" / "debian_version").read_text().strip()
    return f"Debian {version}, {inside('python3 --version').strip()}"


def build_twice() -> str:
    """Both packages, and the same bytes from a second build."""
    debs = []
    commit = run("git", "rev-parse", "HEAD").strip()
    builder = [sys.executable, ROOT / "deploy" / "build_deb.py", "--commit", commit]
    for name in ("first", "second"):
        shutil.rmtree(WORK / name, ignore_errors=True)
        run(*builder, "--out", WORK / name)
        debs.append({p.name: p for p in sorted((WORK / name).glob("*.deb"))})
    expect(len(debs[0]) == 2 and debs[0].keys() == debs[1].keys(), f"built {list(debs[0])}")
    for name, path in debs[0].items():
        expect(path.read_bytes() == debs[1][name].read_bytes(), f"{name} differs when built again")
    for deb in (TREE / "root").glob("*.deb"):
        deb.unlink()
    for path in debs[0].values():
        shutil.copy(path, TREE / "root")
    sizes = ", ".join(f"{n} {p.stat().st_size / 1e6:.0f} MB" for n, p in debs[0].items())
    return f"twice the same bytes: {sizes}"


def contents() -> str:
    """Owners and modes inside the packages."""
    count = 0
    for deb in (TREE / "root").glob("calm-edge*.deb"):
        for line in run("dpkg-deb", "--contents", deb).splitlines():
            mode, owner, *_ = line.split()
            count += 1
            expect(owner == "root/root", f"not owned by root: {line}")
            expect("s" not in mode and (mode[0] == "l" or mode[8] != "w"), f"mode: {line}")
    return f"{count} files, all root's, none setuid or writable by others"


def install() -> str:
    said = inside("dpkg -i /root/calm-edge_*.deb")
    expect("starts with the next boot" in said, f"no word on what to do next: {said[-300:]}")
    return installed()


def install_again() -> str:
    inside("dpkg -i /root/calm-edge_*.deb")
    return f"{installed()}; {unit()}"


def installed() -> str:
    """User, groups and data folder are there."""
    who = inside("id calm-edge").strip()
    for group in ("video", "dialout", "plugdev"):
        expect(group in who, f"user is not in {group}: {who}")
    folder = inside(f'stat -c "%U:%G %a" {DATA}').strip()
    expect(folder == "calm-edge:calm-edge 750", f"{DATA} is {folder}")
    return f"without network; {DATA} {folder}"


def unit() -> str:
    """Enabled for the next boot, and accepted by this release's systemd."""
    expect("enabled" in inside("systemctl is-enabled calm-edge.service"), "not enabled")
    said = inside("systemd-analyze verify calm-edge.service").strip()
    expect(not said, f"systemd-analyze: {said}")
    return "enabled; systemd-analyze verify is silent"


def commands() -> str:
    """The command runs, finds its libraries, and every module of ours can be imported."""
    inside("calm-edge --help >/dev/null")
    doctor = inside("calm-edge doctor --out /tmp || true")
    expect("missing" not in doctor, doctor)
    script = """
import importlib, pkgutil, calm_edge, device
n = 0
for package in (calm_edge, device):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if "evaluation" in module.name or module.name.endswith(("__main__", "oak")):
            continue
        importlib.import_module(module.name)
        n += 1
from systemd import daemon, journal
print(n)
"""
    (TREE / "tmp" / "imports.py").write_text(script)
    n = inside("/opt/calm-edge/bin/python3 -I /tmp/imports.py").strip().splitlines()[-1]
    return f"{n} modules import, systemd-python too"


def model() -> str:
    """Our own network is whole, and runs."""
    said = inside("runuser -u calm-edge -- calm-edge model check calm-geo")
    runs = next(line for line in said.splitlines() if line.startswith("runs"))
    return " ".join(runs.split())


def record() -> str:
    """A drive through the installed daemon, as the user of the service."""
    drive = TREE / "tmp" / "drive"
    if not drive.exists():
        from tests.replay.small_drive import write_drive

        write_drive(drive)
    said = inside(
        "runuser -u calm-edge -- calm-edge record --sequence /tmp/drive --pace lockstep "
        f"--spacing-m 0.5 --set backbone.name=scripted:/tmp/drive --out {DATA}/try"
    )
    frames = next(line for line in said.splitlines() if line.startswith("frames"))
    inside(f"calm-edge validate {DATA}/try")
    changed = inside("dpkg --verify calm-edge || true").strip()
    expect(not changed, f"files of the package have changed by use: {changed}")
    return " ".join(frames.split())


def upgrade() -> str:
    """A newer version over an edited config and a recording."""
    config = TREE / CONFIG.lstrip("/")
    config.write_text(config.read_text() + "# edited\n")
    newer = WORK / "newer"
    shutil.rmtree(newer, ignore_errors=True)
    run("dpkg-deb", "-R", next((TREE / "root").glob("calm-edge_*.deb")), newer)
    control = newer / "DEBIAN" / "control"
    version = inside("dpkg-query -W -f \\${Version} calm-edge").strip()
    control.write_text(control.read_text().replace(f"Version: {version}", f"Version: {version}.1"))
    run("dpkg-deb", "--root-owner-group", "-Znone", "-b", newer, TREE / "root" / "newer.deb")
    shutil.rmtree(newer)
    inside("dpkg -i /root/newer.deb")
    (TREE / "root" / "newer.deb").unlink()
    now = inside("dpkg-query -W -f \\${Version} calm-edge").strip()
    expect(now == f"{version}.1", f"version is {now}")
    expect(config.read_text().endswith("# edited\n"), "the edited config was replaced")
    inside(f"calm-edge validate {DATA}/try")
    return f"{version} -> {now}; edited config and recording kept"


def remove() -> str:
    inside("dpkg -r calm-edge")
    expect(not (TREE / "opt/calm-edge").exists(), "something is left in /opt/calm-edge")
    expect((TREE / CONFIG.lstrip("/")).exists(), "the config was removed")
    return f"/opt/calm-edge gone; config kept; {kept()}"


def purge() -> str:
    said = inside("dpkg -P calm-edge")
    expect("recordings are kept" in said, f"not said that recordings are kept: {said}")
    expect(not (TREE / "etc/calm-edge").exists(), "config is still there")
    return f"config gone; {kept()}"


def kept() -> str:
    """What is left of the recording, which must be all."""
    files = list((TREE / DATA.lstrip("/") / "try").glob("*.mcap"))
    expect(bool(files), f"no recording left in {DATA}")
    owner = inside(f"stat -c %U {DATA}/try").strip()
    expect(owner == "calm-edge", f"recording is {owner}'s")
    return f"{len(files)} segment kept, {sum(f.stat().st_size for f in files)} bytes"


STEPS: dict[str, Callable[[], str]] = {
    "a bare tree": make_tree,
    "build": build_twice,
    "contents": contents,
    "install": install,
    "unit": unit,
    "commands": commands,
    "model": model,
    "record": record,
    "upgrade": upgrade,
    "remove": remove,
    "install again": install_again,
    "purge": purge,
}


def main() -> int:
    lacks = [name for name in ("debootstrap", "unshare", "dpkg-deb") if not shutil.which(name)]
    if os.geteuid() or lacks:
        why = f"{', '.join(lacks)} not installed" if lacks else "not root"
        print(f"deb-test: skipped, {why}")
        return SKIPPED
    sys.path.insert(0, str(ROOT))
    WORK.mkdir(parents=True, exist_ok=True)
    for name, step in STEPS.items():
        try:
            print(f"ok    {name:14} {step()}", flush=True)
        except Unexpected as error:
            print(f"FAIL  {name:14} {error}", flush=True)
            return 1
    shutil.rmtree(TREE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
