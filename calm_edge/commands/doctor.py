"""`calm-edge doctor`: print missing requirements, their consequences and the remedies."""

from __future__ import annotations

import argparse
import os
import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from calm_edge.commands.exit_codes import ERROR, OK

PLAIN = "only the backbone without one works (--set backbone.name=bundle)"
# module -> consequence if it is missing
NEEDED = {
    "cv2": "no images can be decoded",
    "simplejpeg": "no images can be decoded",
    "numpy": "nothing works",
    "scipy": "no reconstruction",
    "gtsam": "no trajectory",
    "mcap": "no recording",
    "mcap_protobuf": "no recording",
    "foxglove_schemas_protobuf": "no recording",
    "google.protobuf": "no recording",
    "lz4": "no recording",
    "zstandard": "no recording",
    "onnxruntime": f"no networks; {PLAIN}",
}
OPTIONAL = {
    "av": "no import of videos (pip install av)",
    "rosbags": "no import of ROS bags (pip install rosbags)",
    "distributed": "no map on a Dask cluster (pip install distributed)",
    "pyproj": "no LAZ of georeferenced maps (pip install pyproj)",
    "laspy": "no export of LAZ clouds (pip install 'laspy[lazrs]')",
    "yaml": "no calibrations of ROS and Kalibr (pip install pyyaml)",
    "tomlkit": "no `calm-edge config`, no changes to config files (pip install tomlkit)",
    "serial": "no pose on a serial port (pip install pyserial)",
    "rich": "no state of the daemon in the terminal, only lines (pip install rich)",
    "pynmea2": "no GPS receiver on a serial port (pip install pynmea2)",
    "systemd": "no watchdog and no readiness under systemd (pip install systemd-python, "
    "after apt-get install gcc pkg-config libsystemd-dev python3-dev)",
    "depthai": "no OAK cameras (pip install depthai, or the package calm-edge-oak)",
}
FREE_GB = 2.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "--out", type=Path, default=Path(), help="folder for recordings, checked for free space"
    )


def findings(out: Path) -> Iterator[tuple[bool, str]]:
    """Yield (True if fatal, one line with consequence and remedy) for each missing requirement."""
    for table, fatal in ((NEEDED, True), (OPTIONAL, False)):
        for module, cost in table.items():
            if not installed(module):
                yield fatal, f"{module}: not installed: {cost}"
    yield from _default_model()
    cores = len(os.sched_getaffinity(0))
    if cores < 2:
        yield False, f"{cores} core: the estimator will lag behind; `calm-edge map` solves the rest"
    if not out.is_dir():
        yield False, f"{out}: no such folder yet; its disk was not checked"
    else:
        free_gb = shutil.disk_usage(out).free / 1e9
        if free_gb < FREE_GB:
            yield True, f"{out}: only {free_gb:.1f} GB free; two cameras fill 10 GB an hour"
        if not os.access(out, os.W_OK):
            yield True, f"{out}: not writable"
    if not list(Path("/dev").glob("video*")):
        yield False, "no /dev/video*: only replays (--sequence, --replay) can be recorded"


def installed(module: str) -> bool:
    """Whether a module can be found; importing it is left to the commands."""
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def _default_model() -> Iterator[tuple[bool, str]]:
    """Yield a finding if the default backbone's network is missing or damaged."""
    from calm_edge.backbones.onnx.manifest import ManifestError
    from calm_edge.backbones.onnx.model_folder import find_model, read_manifest, verify
    from calm_edge.config import BackboneConfig

    try:
        verify(read_manifest(find_model(BackboneConfig().name.partition(":")[2])))
    except ManifestError as error:
        yield True, f"{error}: {PLAIN}"


def run(arguments: argparse.Namespace) -> int:
    """Print a line for each finding."""
    found = list(findings(arguments.out))
    for fatal, line in found:
        print(f"{'missing' if fatal else 'note':8} {line}")
    if not found:
        print("nothing is missing")
    return ERROR if any(fatal for fatal, _ in found) else OK
