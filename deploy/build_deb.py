"""Build calm-edge_VERSION_ARCH.deb and calm-edge-oak_VERSION_ARCH.deb from one commit.

The packages hold a virtual environment with all dependencies under /opt/calm-edge: nothing is
downloaded when they are installed. They fit the release that they are built on, and its
architecture or the one given: then the libraries are the published wheels for it, and
systemd-python is the release's own. The same commit, built with the same tools, gives the same
bytes.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import subprocess
import sys
import tarfile
from dataclasses import dataclass
from pathlib import Path

from deploy.deb_archive import SCRIPTS, control_folder, pack

ROOT = Path(__file__).resolve().parents[1]
PREFIX = Path("opt/calm-edge")
# parts of wheels that nothing imports at run time; gtsam declares pytest for tests of its own
UNUSED = (
    *("**/tests", "*/include", "numpy/_core/include", "**/*.pyi", "bin", "share"),
    *("gtsam/Data", "gtsam/examples", "onnxruntime/transformers", "onnxruntime/tools"),
    *("onnxruntime/quantization", "onnxruntime/datasets", "depthai_cli"),
    *("pytest*", "_pytest", "py.py", "pluggy*", "iniconfig*"),
)
# Debian's architecture -> the machine in the names of wheels
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
MAINTAINER = "calm-edge maintainers <maintainers@calm-edge.invalid>"
ABOUT = {
    "Suggests": "calm-edge-oak",
    "Description": "SLAM with two uncalibrated cameras\n"
    " Records both cameras, sends poses to a flight controller, and makes a dense\n"
    " map of the recording afterwards. Runs as a service from boot.",
}
ABOUT_OAK = {
    "Description": "OAK cameras for calm-edge\n The driver library of Luxonis' cameras.",
}


@dataclass(frozen=True, slots=True)
class Target:
    """What the packages are built for: the release's interpreter, architecture and C library.

    foreign: the architecture is not that of this machine.
    """

    python: Path
    version: tuple[int, int]
    architecture: str
    libc: str
    foreign: bool = False

    @property
    def name(self) -> str:
        return f"python{self.version[0]}.{self.version[1]}"

    @property
    def site(self) -> Path:
        """site-packages, relative to the root of the file system."""
        return PREFIX / "lib" / self.name / "site-packages"

    @property
    def wheels(self) -> list[str]:
        """Options by which pip takes wheels of a foreign architecture."""
        if not self.foreign:
            return []
        machine, newest = MACHINES[self.architecture], int(self.libc.split(".")[1])
        tags = [f"manylinux_2_{minor}_{machine}" for minor in range(newest, 16, -1)]
        tags += [f"manylinux2014_{machine}", f"linux_{machine}"]
        version = f"{self.version[0]}{self.version[1]}"
        chosen = ["--implementation", "cp", "--python-version", version, "--only-binary=:all:"]
        return [*chosen, *(f"--platform={tag}" for tag in tags)]


def report(text: str) -> None:
    print(f"deb: {text}", file=sys.stderr)


def output(*command: str | Path) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout


def target_of(python: Path, architecture: str = "") -> Target:
    """Describe the release's own interpreter; exits with one line if there is none that will do.

    architecture: of the packages, by default that of this machine.
    """
    if not python.exists():
        sys.exit(f"deb: {python} is missing. Remedy: apt-get install python3 python3-dev")
    script = "import sys, platform; print(*sys.version_info[:2], platform.libc_ver()[1])"
    major, minor, libc = output(python, "-I", "-c", script).split()
    if (int(major), int(minor)) < (3, 11):
        sys.exit(f"deb: {python} is {major}.{minor}; calm-edge needs 3.11 (Debian 12) or newer")
    here = output("dpkg", "--print-architecture").strip()
    architecture = architecture or here
    if architecture not in MACHINES:
        sys.exit(f"deb: ARCH={architecture}: choose one of {', '.join(MACHINES)}")
    real = Path(f"/usr/bin/python{major}.{minor}")
    return Target(real, (int(major), int(minor)), architecture, libc, architecture != here)


def install_packages(target: Target, site: Path, commit: Path, *what: str) -> None:
    """Install into a site-packages folder as pip does for the target, less what is unused.

    commit: the folder of the unpacked commit, with its constraints.txt.
    """
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input", "-q"]
    where = ["--python", str(target.python), "install", "--target", str(site)]
    how = ["--no-compile", "--no-warn-script-location", "-c", str(commit / "constraints.txt")]
    how += target.wheels
    done = subprocess.run([*pip, *where, *how, *what], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(
            f"deb: pip failed: {done.stderr.strip().splitlines()[-1]}. systemd-python is built "
            "here; it needs: apt-get install gcc pkg-config libsystemd-dev python3-dev"
        )
    for pattern in UNUSED:
        for path in list(site.glob(pattern)):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    if target.foreign:
        # with --target and a foreign platform pip also leaves its byte code of this machine
        for cache in list(site.rglob("__pycache__")):
            shutil.rmtree(cache)
    tag = f"cpython-{target.version[0]}{target.version[1]}-"
    for path in list(site.glob("depthai.cpython-*.so")):
        if tag not in path.name:
            path.unlink()
    for info in site.glob("*.dist-info"):
        # these record paths of the build
        for name in ("RECORD", "direct_url.json", "REQUESTED"):
            (info / name).unlink(missing_ok=True)


def own_wheel(target: Target, source: Path, out: Path) -> Path:
    """Build the wheel of calm-edge, which holds no machine code."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input", "-q"]
    how = ["--no-deps", "--wheel-dir", str(out), "-c", str(source / "constraints.txt")]
    output(*pip, "wheel", *how, str(source))
    return next(out.glob("calm_edge-*.whl"))


def install_systemd(target: Target, site: Path, work: Path) -> None:
    """Install the release's own systemd-python of a foreign architecture: there is no wheel of it.

    With apt's lists in a folder of their own, so that this machine's are not changed.
    """
    state = work / "apt"
    for name in ("lists/partial", "cache/archives/partial"):
        (state / name).mkdir(parents=True)
    (state / "status").touch()
    options = {
        "APT::Architecture": target.architecture,
        "APT::Architectures": target.architecture,
        "Dir::State": state,
        "Dir::State::status": state / "status",
        "Dir::Cache": state / "cache",
    }
    apt = ["apt-get", "-q", *(f"-o{key}={value}" for key, value in options.items())]
    for step in (["update"], ["download", "python3-systemd"]):
        done = subprocess.run([*apt, *step], cwd=state, capture_output=True, text=True, check=False)
        if done.returncode:
            tail = (done.stderr.strip() or "no output").splitlines()[-1]
            sys.exit(f"deb: apt-get {step[0]}: {tail}; it needs the network")
    unpacked = state / "unpacked"
    output("dpkg-deb", "-x", next(state.glob("python3-systemd_*.deb")), unpacked)
    found = unpacked / "usr/lib/python3/dist-packages/systemd"
    shutil.copytree(found, site / "systemd", ignore=shutil.ignore_patterns("test"))


def unpack(commit: str, folder: Path) -> Path:
    """Unpack what the packages hold of a commit; returns the folder."""
    documents = ("docs/deploy.md", "docs/live.md", "docs/serial.md", "README.md")
    parts = ["calm_edge", "device", "deploy", "pyproject.toml", "constraints.txt", *documents]
    command = ["git", "archive", commit, *parts]
    done = subprocess.run(command, check=False, capture_output=True, cwd=ROOT)
    if done.returncode:
        sys.exit(f"deb: git archive: {done.stderr.decode().strip()}")
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as tar:
        tar.extractall(folder, filter="data")
    return folder


def place_files(stage: Path, commit: Path) -> None:
    """Copy the unit, device rules, configuration, documents and maintainer scripts into place."""
    for name, place in {
        "deploy/calm-edge.service": "usr/lib/systemd/system/calm-edge.service",
        "deploy/calm-edge-live.service": "usr/lib/systemd/system/calm-edge-live.service",
        "deploy/calm-edge-live-open.conf": "usr/share/doc/calm-edge/calm-edge-live-open.conf",
        "deploy/99-calm-edge.rules": "usr/lib/udev/rules.d/99-calm-edge.rules",
        "deploy/calm-edge.modules-load.conf": "usr/lib/modules-load.d/calm-edge.conf",
        "deploy/calm-edge.toml": "etc/calm-edge/calm-edge.toml",
        "deploy/debian/copyright": "usr/share/doc/calm-edge/copyright",
        "README.md": "usr/share/doc/calm-edge/README.md",
        "docs/deploy.md": "usr/share/doc/calm-edge/deploy.md",
        "docs/live.md": "usr/share/doc/calm-edge/live.md",
        "docs/serial.md": "usr/share/doc/calm-edge/serial.md",
    }.items():
        (stage / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(commit / name, stage / place)
    for script in SCRIPTS:
        shutil.copy(commit / "deploy" / "debian" / script, control_folder(stage) / script)


def make_environment(stage: Path, target: Target) -> None:
    """Make a virtual environment as `python3 -m venv --without-pip` does, and the command."""
    folder = stage / PREFIX
    (folder / "bin").mkdir(parents=True)
    (folder / "bin" / "python3").symlink_to(target.python)
    version = ".".join(map(str, target.version))
    (folder / "pyvenv.cfg").write_text(
        f"home = {target.python.parent}\ninclude-system-site-packages = false\n"
        f"version = {version}\nexecutable = {target.python}\n"
    )
    command = folder / "bin" / "calm-edge"
    command.write_text(
        f"#!/{PREFIX}/bin/python3 -I\n"
        "import sys\n\nfrom calm_edge.cli import main\n\nif __name__ == '__main__':\n"
        "    sys.exit(main())\n"
    )
    command.chmod(0o755)
    (stage / "usr/bin").mkdir(parents=True)
    (stage / "usr/bin/calm-edge").symlink_to(f"/{PREFIX}/bin/calm-edge")


def compile_modules(stage: Path, target: Target) -> None:
    """Compile to byte code that is used unchecked, for root file systems that are read-only."""
    how = ["-q", "--invalidation-mode", "unchecked-hash", "-s", str(stage), "-p", "/"]
    subprocess.run(
        [str(target.python), "-I", "-m", "compileall", *how, str(stage / PREFIX)],
        check=True,
        env={**os.environ, "PYTHONHASHSEED": "0"},
    )


def build(
    out: Path, version: str, python: Path, with_oak: bool, commit: str, architecture: str = ""
) -> list[Path]:
    """Build both packages, or the main one alone; returns their paths."""
    target = target_of(python, architecture)
    committed = output("git", "log", "-1", "--format=%ct", commit).strip()
    epoch = os.environ.get("SOURCE_DATE_EPOCH", committed)
    report(f"calm-edge {version} for {target.name} on {target.architecture}, commit {commit[:10]}")
    work = out / "stage"
    shutil.rmtree(work, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    main, oak = work / "main", work / "oak"
    (main / target.site).mkdir(parents=True)
    source = unpack(commit, work / "commit")
    if target.foreign:
        wheel = own_wheel(target, source, work)
        install_packages(target, main / target.site, source, str(wheel))
        install_systemd(target, main / target.site, work)
    else:
        install_packages(target, main / target.site, source, f"{source}[systemd]")
    make_environment(main, target)
    place_files(main, source)
    compile_modules(main, target)
    following = f"{target.version[0]}.{target.version[1] + 1}"
    python_version = ".".join(map(str, target.version))
    common = {
        "Version": version,
        "Architecture": target.architecture,
        "Maintainer": MAINTAINER,
        "Section": "science",
        "Priority": "optional",
    }
    needs = (
        f"libc6 (>= {target.libc}), python3 (>= {python_version}), python3 (<< {following}), "
        "libsystemd0, adduser, init-system-helpers"
    )
    made = [
        pack(main, out, {"Package": "calm-edge", **common, "Depends": needs, **ABOUT}, epoch),
    ]
    if with_oak:
        (oak / target.site).mkdir(parents=True)
        # numpy, which it needs, is in the main package
        install_packages(target, oak / target.site, source, "--no-deps", "depthai")
        compile_modules(oak, target)
        needs = f"calm-edge (= {version})"
        fields = {"Package": "calm-edge-oak", **common, "Depends": needs, **ABOUT_OAK}
        made.append(pack(oak, out, fields, epoch))
    for _, line in made:
        report(line)
    shutil.rmtree(work)
    return [deb for deb, _ in made]


def main() -> None:
    parser = argparse.ArgumentParser(prog="make deb", description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "deb")
    parser.add_argument("--version", default="", help="default: that of calm_edge/__init__.py")
    parser.add_argument("--python", type=Path, default=Path("/usr/bin/python3"))
    parser.add_argument("--commit", default="HEAD")
    parser.add_argument("--arch", default="", help="amd64 or arm64; default: of this machine")
    parser.add_argument("--no-oak", action="store_true", help="the main package alone")
    arguments = parser.parse_args()
    commit = output("git", "rev-parse", arguments.commit).strip()
    text = output("git", "show", f"{commit}:calm_edge/__init__.py")
    version = arguments.version or text.split('__version__ = "')[1].split('"')[0]
    out, python = arguments.out.resolve(), arguments.python
    for deb in build(out, version, python, not arguments.no_oak, commit, arguments.arch):
        print(deb)


if __name__ == "__main__":
    main()
