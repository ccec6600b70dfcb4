"""Builds calm-edge_VERSION_ARCH.deb and calm-edge-oak_VERSION_ARCH.deb out of one commit.

The packages hold a virtual environment with every wheel they need under /opt/calm-edge: nothing is
downloaded when they are installed. They fit the release and the machine that they are built on,
and the same commit gives the same bytes.
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

from deb_archive import SCRIPTS, control_folder, pack

ROOT = Path(__file__).resolve().parents[1]
PREFIX = Path("opt/calm-edge")
# drawings in reports alone: `map` is at home on a bigger machine
LEFT_OUT = {
    *("matplotlib", "contourpy", "cycler", "fonttools", "kiwisolver", "pillow"),
    *("pyparsing", "python-dateutil"),
}
OAK = "depthai"
# what a wheel brings along for its own developers
UNUSED = (
    *("**/tests", "*/include", "numpy/_core/include", "**/*.pyi", "bin", "share", "pylab.py"),
    *("gtsam/Data", "gtsam/examples", "onnxruntime/transformers", "onnxruntime/tools"),
    *("onnxruntime/quantization", "onnxruntime/datasets", "depthai_cli"),
)
# of models/: what is needed to run one, not to make it; a model without its licence is refused
MODEL_SUFFIXES = {".toml", ".json", ".onnx", ".npz"}
MAINTAINER = "calm-edge maintainers <maintainers@calm-edge.invalid>"
ABOUT = {
    "Suggests": "calm-edge-oak",
    "Description": "SLAM with two ordinary cameras that nobody calibrated\n"
    " Records both cameras, sends poses to a flight controller, and makes a dense\n"
    " map of the recording afterwards. Runs as a service from boot.",
}
ABOUT_OAK = {
    "Description": "OAK cameras for calm-edge\n The driver library of Luxonis' cameras.",
}


@dataclass(frozen=True, slots=True)
class Target:
    """What the packages are for: the interpreter of the release, and the machine."""

    python: Path
    version: tuple[int, int]
    architecture: str
    libc: str

    @property
    def name(self) -> str:
        return f"python{self.version[0]}.{self.version[1]}"

    @property
    def site(self) -> Path:
        """site-packages below the file system's root."""
        return PREFIX / "lib" / self.name / "site-packages"


def say(text: str) -> None:
    print(f"deb: {text}", file=sys.stderr)


def output(*command: str | Path) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout


def target_of(python: Path) -> Target:
    """The release's own interpreter; exits with a line when there is none that will do."""
    if not python.exists():
        sys.exit(f"deb: {python} is missing. Mend: apt-get install python3 python3-dev")
    ask = "import sys, platform; print(*sys.version_info[:2], platform.libc_ver()[1])"
    major, minor, libc = output(python, "-I", "-c", ask).split()
    if (int(major), int(minor)) < (3, 11):
        sys.exit(f"deb: {python} is {major}.{minor}; calm-edge needs 3.11 (Debian 12) or newer")
    architecture = output("dpkg", "--print-architecture").strip()
    real = Path(f"/usr/bin/python{major}.{minor}")
    return Target(real, (int(major), int(minor)), architecture, libc)


def requirements(commit: str) -> tuple[list[str], list[str]]:
    """Pinned lines for the main package and for the OAK one."""
    text = "\n".join(
        (ROOT / n).read_text() for n in ("requirements.txt", "requirements-systemd.txt")
    )
    lines = [line.strip() for line in text.splitlines() if line.strip() and line[0] != "#"]
    named = [(line, line.partition("==")[0].lower()) for line in lines]
    return (
        [line for line, name in named if name not in LEFT_OUT and name != OAK],
        [line for line, name in named if name == OAK],
    )


def install_wheels(target: Target, site: Path, lines: list[str]) -> None:
    """The pinned wheels, unpacked by pip for the target's interpreter, less what is unused."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input", "-q"]
    where = ["--python", str(target.python), "install", "--target", str(site)]
    how = ["--no-deps", "--no-compile", "--no-warn-script-location"]
    done = subprocess.run([*pip, *where, *how, *lines], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(
            f"deb: pip failed: {done.stderr.strip().splitlines()[-1]}. systemd-python is built "
            "here; it needs: apt-get install gcc pkg-config libsystemd-dev python3-dev"
        )
    for pattern in UNUSED:
        for path in list(site.glob(pattern)):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    tag = f"cpython-{target.version[0]}{target.version[1]}-"
    for path in list(site.glob("depthai.cpython-*.so")):
        if tag not in path.name:
            path.unlink()
    for info in site.glob("*.dist-info"):
        # pip writes down where it was run and with what; neither belongs into the package
        for name in ("RECORD", "direct_url.json", "REQUESTED"):
            (info / name).unlink(missing_ok=True)


def unpack_commit(stage: Path, target: Target, commit: str) -> None:
    """Our own files, as committed, to where each belongs."""
    kept = stage.parent / "commit"
    with tarfile.open(fileobj=io.BytesIO(archive(commit))) as tar:
        tar.extractall(kept, filter="data")
    app = stage / PREFIX / "app"
    for name in ("calm_edge", "device"):
        shutil.copytree(kept / name, app / name)
    for path in (kept / "models").rglob("*"):
        if path.suffix in MODEL_SUFFIXES or path.name == "LICENSE":
            place = app / path.relative_to(kept)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, place)
    (stage / target.site / "calm-edge.pth").write_text("../../../app\n")
    deploy = kept / "deploy"
    for source, place in {
        "calm-edge.service": "usr/lib/systemd/system/calm-edge.service",
        "99-calm-edge.rules": "usr/lib/udev/rules.d/99-calm-edge.rules",
        "calm-edge.modules-load.conf": "usr/lib/modules-load.d/calm-edge.conf",
        "calm-edge.toml": "etc/calm-edge/calm-edge.toml",
        "debian/copyright": "usr/share/doc/calm-edge/copyright",
        "../README.md": "usr/share/doc/calm-edge/README.md",
        "../docs/deploy.md": "usr/share/doc/calm-edge/deploy.md",
        "../docs/serial.md": "usr/share/doc/calm-edge/serial.md",
    }.items():
        (stage / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(deploy / source, stage / place)
    for script in SCRIPTS:
        shutil.copy(deploy / "debian" / script, control_folder(stage) / script)


def archive(commit: str) -> bytes:
    """What is packed of a commit, as a tar file."""
    documents = ("docs/deploy.md", "docs/serial.md", "README.md")
    parts = ["calm_edge", "device", "models", "deploy", *documents]
    command = ["git", "archive", commit, *parts]
    done = subprocess.run(command, check=False, capture_output=True, cwd=ROOT)
    if done.returncode:
        sys.exit(f"deb: git archive: {done.stderr.decode().strip()}")
    return done.stdout


def make_environment(stage: Path, target: Target) -> None:
    """A virtual environment as `python3 -m venv` leaves it, without pip, and the command."""
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
    """Byte code that needs no check of times, for root file systems that are read-only."""
    how = ["-q", "--invalidation-mode", "unchecked-hash", "-s", str(stage), "-p", "/"]
    subprocess.run(
        [str(target.python), "-I", "-m", "compileall", *how, str(stage / PREFIX)],
        check=True,
        env={**os.environ, "PYTHONHASHSEED": "0"},
    )


def build(out: Path, version: str, python: Path, with_oak: bool, commit: str) -> list[Path]:
    """Both packages, or the main one alone."""
    target = target_of(python)
    committed = output("git", "log", "-1", "--format=%ct", commit).strip()
    epoch = os.environ.get("SOURCE_DATE_EPOCH", committed)
    say(f"calm-edge {version} for {target.name} on {target.architecture}, of commit {commit[:10]}")
    work = out / "stage"
    shutil.rmtree(work, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    main, oak = work / "main", work / "oak"
    (main / target.site).mkdir(parents=True)
    control_folder(main)
    lines, oak_lines = requirements(commit)
    install_wheels(target, main / target.site, lines)
    make_environment(main, target)
    unpack_commit(main, target, commit)
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
        install_wheels(target, oak / target.site, oak_lines)
        compile_modules(oak, target)
        needs = f"calm-edge (= {version})"
        fields = {"Package": "calm-edge-oak", **common, "Depends": needs, **ABOUT_OAK}
        made.append(pack(oak, out, fields, epoch))
    for _, line in made:
        say(line)
    shutil.rmtree(work)
    return [deb for deb, _ in made]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "deb")
    parser.add_argument("--version", default="", help="default: that of calm_edge/__init__.py")
    parser.add_argument("--python", type=Path, default=Path("/usr/bin/python3"))
    parser.add_argument("--commit", default="HEAD")
    parser.add_argument("--no-oak", action="store_true", help="the main package alone")
    arguments = parser.parse_args()
    commit = output("git", "rev-parse", arguments.commit).strip()
    text = output("git", "show", f"{commit}:calm_edge/__init__.py")
    version = arguments.version or text.split('__version__ = "')[1].split('"')[0]
    out, python = arguments.out.resolve(), arguments.python
    for deb in build(out, version, python, not arguments.no_oak, commit):
        print(deb)


if __name__ == "__main__":
    main()
