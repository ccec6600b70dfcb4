"""Install, use, upgrade, remove and purge the packages in a Debian tree of their own.

Prints one row per step with what was measured. Needs root, debootstrap and unshare; without them it
prints why it was skipped and exits with 77. The tree has no network.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from itertools import islice
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WORK = ROOT / "build" / "deb"
BASE, TREE = WORK / "debian", WORK / "tree"
SUITE = "bookworm"
PACKAGES = "systemd,systemd-sysv,udev,dbus,python3,adduser,dmsetup,kmod,e2fsprogs,procps"
SKIPPED = 77
DATA = "/var/lib/calm-edge"
CONFIG = "/etc/calm-edge/calm-edge.toml"
DRIVE = ROOT / "demo" / "drive"
# of the demo drive, per camera: the first windows
FRAMES = 80

# imports every module of ours, and systemd's
IMPORTS = """
import importlib, pkgutil, calm_edge, device
n = 0
for package in (calm_edge, device):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
        n += 1
from systemd import daemon, journal
print(n)
"""


class Unexpected(Exception):
    """A step that did not do what it should."""


def run(*command: str | Path) -> str:
    """Return stdout and stderr of a command; raises Unexpected when it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    if done.returncode:
        tail = (done.stdout + done.stderr).strip().splitlines()[-4:]
        raise Unexpected(f"{command[0]} {command[-1]}: exit {done.returncode}: {' | '.join(tail)}")
    return done.stdout + done.stderr


def inside(script: str) -> str:
    """Run a shell script as root in the tree, without network, in a mount namespace of its own."""
    mounts = "mount -t proc proc {t}/proc && mount -t tmpfs tmpfs {t}/dev/shm && "
    enter = mounts.format(t=TREE) + f"exec chroot {TREE} /bin/sh -ec '{script}'"
    return run("unshare", "--net", "--mount", "--pid", "--fork", "sh", "-ec", enter)


def as_user(command: str) -> str:
    """Run a command in the tree as the service's user."""
    return inside(f"runuser -u calm-edge -- {command}")


def expect(condition: bool, what: str) -> None:
    """Raise Unexpected unless the condition holds."""
    if not condition:
        raise Unexpected(what)


def row_of(output: str, name: str) -> str:
    """Return the row of a command's output that begins with a name, spaces collapsed."""
    return " ".join(next(x for x in output.splitlines() if x.startswith(name)).split())


def fetch_base() -> Path:
    """Return a bare Debian tree, downloaded once; raises Unexpected."""
    if not (BASE / "bin").exists():
        WORK.mkdir(parents=True, exist_ok=True)
        partly = WORK / "debian.part"
        shutil.rmtree(partly, ignore_errors=True)
        how = ["--variant=minbase", f"--include={PACKAGES}"]
        run("debootstrap", *how, SUITE, partly, "http://deb.debian.org/debian")
        partly.rename(BASE)
    return BASE


def make_tree() -> str:
    """Make a fresh copy of the bare Debian tree."""
    fetch_base()
    shutil.rmtree(TREE, ignore_errors=True)
    run("cp", "-a", BASE, TREE)
    (TREE / "dev" / "shm").mkdir(exist_ok=True)
    version = (TREE / "etc" / "debian_version").read_text().strip()
    return f"Debian {version}, {inside('python3 --version').strip()}"


def build_twice() -> str:
    """Build both packages twice; the bytes must be the same."""
    debs = []
    commit = run("git", "rev-parse", "HEAD").strip()
    for name in ("first", "second"):
        shutil.rmtree(WORK / name, ignore_errors=True)
        builder = (sys.executable, "-m", "deploy.build_deb", "--commit", commit)
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
    """Check owners and modes inside the packages, and that only our own packages are in them."""
    count = 0
    for deb in (TREE / "root").glob("calm-edge*.deb"):
        for line in run("dpkg-deb", "--contents", deb).splitlines():
            mode, owner, *_, path = line.split(" -> ")[0].split()
            count += 1
            expect(owner == "root/root", f"not owned by root: {line}")
            expect("s" not in mode and (mode[0] == "l" or mode[8] != "w"), f"mode: {line}")
            for name in ("bench", "tests", "pytest"):
                expect(f"site-packages/{name}/" not in path, f"does not belong here: {line}")
    return f"{count} files, all owned by root, none setuid or writable by others"


def install() -> str:
    output = inside("dpkg -i /root/calm-edge_*.deb")
    expect("starts with the next boot" in output, f"no next step printed: {output[-300:]}")
    return installed()


def install_again() -> str:
    inside("dpkg -i /root/calm-edge_*.deb")
    return f"{installed()}; {unit()}"


def installed() -> str:
    """Check the user, its groups and the data folder."""
    who = inside("id calm-edge").strip()
    for group in ("video", "dialout", "plugdev"):
        expect(group in who, f"user is not in {group}: {who}")
    folder = inside(f'stat -c "%U:%G %a" {DATA}').strip()
    expect(folder == "calm-edge:calm-edge 750", f"{DATA} is {folder}")
    return f"without network; {DATA} {folder}"


def unit() -> str:
    """Check that the unit is enabled for the next boot and accepted by this release's systemd."""
    expect("enabled" in inside("systemctl is-enabled calm-edge.service"), "not enabled")
    live = inside("systemctl is-enabled calm-edge-live.service || true").strip()
    expect(live == "disabled", f"the live page is {live}")
    output = inside("systemd-analyze verify calm-edge.service calm-edge-live.service").strip()
    expect(not output, f"systemd-analyze: {output}")
    return "enabled, the live page not; systemd-analyze verify is silent"


def commands() -> str:
    """Check that the command runs and that every module of ours can be imported."""
    version = inside("calm-edge --version").strip()
    doctor = inside("calm-edge doctor --out /tmp || true")
    expect("fail " not in doctor, doctor)
    (TREE / "tmp" / "imports.py").write_text(IMPORTS)
    n = inside("/opt/calm-edge/bin/python3 -I /tmp/imports.py").strip().splitlines()[-1]
    return f"{version}; {n} modules import, systemd-python too"


def model() -> str:
    """Check the shipped network and run it."""
    return row_of(as_user("calm-edge model check calm-geo"), "runs")


def copy_drive(folder: Path, frames: int) -> None:
    """Copy the first frames of the demo drive."""
    for eye in ("cam0", "cam1"):
        (folder / eye).mkdir(parents=True, exist_ok=True)
        for image in islice(sorted((DRIVE / eye).iterdir()), frames):
            shutil.copy(image, folder / eye)
    for name in ("times0.txt", "times1.txt"):
        lines = (DRIVE / name).read_text().splitlines()[:frames]
        (folder / name).write_text("\n".join(lines) + "\n")


def record() -> str:
    """Record a replay with the installed daemon and the default backbone."""
    copy_drive(TREE / "tmp" / "drive", FRAMES)
    output = as_user(
        f"calm-edge record --sequence /tmp/drive --pace lockstep --spacing-m 0.5 --out {DATA}/try"
    )
    inside(f"calm-edge validate {DATA}/try")
    return row_of(output, "frames")


def make_map() -> str:
    """Map the recording; then no file of the package may have changed by all this use."""
    output = as_user(f"calm-edge map {DATA}/try --out {DATA}/map")
    for name in ("map.ply", "trajectory.tum", "report.html", "map.html"):
        expect((TREE / DATA.lstrip("/") / "map" / name).exists(), f"no {name}: {output}")
    changed = inside("dpkg --verify calm-edge || true").strip()
    expect(not changed, f"files of the package were changed by use: {changed}")
    return row_of(output, "map")


def upgrade() -> str:
    """Install a newer version over an edited configuration and a recording."""
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
    expect(config.read_text().endswith("# edited\n"), "the edited configuration was replaced")
    inside(f"calm-edge validate {DATA}/try")
    return f"{version} -> {now}; edited configuration and recording kept"


def remove() -> str:
    inside("dpkg -r calm-edge")
    expect(not (TREE / "opt/calm-edge").exists(), "something is left in /opt/calm-edge")
    expect((TREE / CONFIG.lstrip("/")).exists(), "the configuration was removed")
    return f"/opt/calm-edge gone; configuration kept; {kept()}"


def purge() -> str:
    output = inside("dpkg -P calm-edge")
    expect("recordings are kept" in output, f"not printed that recordings are kept: {output}")
    expect(not (TREE / "etc/calm-edge").exists(), "the configuration is still there")
    return f"configuration gone; {kept()}"


def kept() -> str:
    """Check that the recording is still there and still belongs to the service's user."""
    files = list((TREE / DATA.lstrip("/") / "try").glob("*.mcap"))
    expect(bool(files), f"no recording left in {DATA}")
    owner = inside(f"stat -c %U {DATA}/try").strip()
    expect(owner == "calm-edge", f"the recording belongs to {owner}")
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
    "map": make_map,
    "upgrade": upgrade,
    "remove": remove,
    "install again": install_again,
    "purge": purge,
}


def run_steps(steps: Mapping[str, Callable[[], str]]) -> bool:
    """Run steps, print a row for each, and return whether one failed, which ends them."""
    for name, step in steps.items():
        try:
            print(f"ok    {name:14} {step()}", flush=True)
        except Unexpected as error:
            print(f"FAIL  {name:14} {error}", flush=True)
            return True
    return False


def main() -> int:
    missing = [name for name in ("debootstrap", "unshare", "dpkg-deb") if not shutil.which(name)]
    if os.geteuid() or missing:
        why = f"{', '.join(missing)} not installed" if missing else "not root"
        print(f"deb-test: skipped, {why}")
        return SKIPPED
    WORK.mkdir(parents=True, exist_ok=True)
    failed = run_steps(STEPS)
    if not failed:
        shutil.rmtree(TREE)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
