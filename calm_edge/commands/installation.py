"""Findings on what is installed: versions, libraries, the computer, the configured backbone."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from calm_edge import __version__
from calm_edge.commands.finding import Finding, bad, good, note
from calm_edge.config import Config

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
# module -> consequence if it is missing, and the remedy
OPTIONAL = {
    "av": ("no import of videos", "pip install av"),
    "rosbags": ("no import of ROS bags", "pip install rosbags"),
    "distributed": ("no map on a Dask cluster", "pip install distributed"),
    "pyproj": ("no LAZ of georeferenced maps", "pip install pyproj"),
    "laspy": ("no export of LAZ clouds", "pip install 'laspy[lazrs]'"),
    "yaml": ("no calibrations of ROS and Kalibr", "pip install pyyaml"),
    "tomlkit": (
        "no `calm-edge config` and `setup`, no changes to config files",
        "pip install tomlkit",
    ),
    "pynmea2": ("no GPS receiver on a serial port", "pip install pynmea2"),
    "rich": ("no state of the daemon in the terminal, only lines", "pip install rich"),
    "shtab": ("no `calm-edge completion`", "pip install shtab"),
    "serial": ("no pose on a serial port", "pip install pyserial"),
    "systemd": (
        "no watchdog and no readiness under systemd",
        "apt-get install gcc pkg-config libsystemd-dev python3-dev, then "
        "pip install systemd-python",
    ),
    "depthai": ("no OAK cameras", "pip install depthai, or the package calm-edge-oak"),
}
LEAST_MEMORY_MB = 1000.0


def findings(config: Config) -> Iterator[Finding]:
    """Yield the findings on versions, libraries, processor, memory and backbone."""
    python = platform.python_version()
    yield good("version", f"calm-edge {__version__}, Python {python}, {platform.machine()}")
    missing = [name for name in NEEDED if not installed(name)]
    yield from _libraries(missing)
    cores = len(os.sched_getaffinity(0))
    text = f"{cores} core{'s' * (cores > 1)}"
    if cores < 2:
        yield note(
            "processor", f"{text}: the estimator will lag", "`calm-edge map` solves the rest"
        )
    else:
        yield good("processor", text)
    yield from _memory()
    if not set(missing) - {"onnxruntime"}:
        yield from _backbone(config)


def installed(module: str) -> bool:
    """Whether a module can be found; importing it is left to the commands."""
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def _libraries(missing: list[str]) -> Iterator[Finding]:
    for module in missing:
        remedy = "install calm-edge again: make setup, or pip install ."
        yield bad(module, f"not installed: {NEEDED[module]}", remedy)
    if not missing:
        yield good("libraries", f"all {len(NEEDED)} that are needed")
    for module, (cost, remedy) in OPTIONAL.items():
        if installed(module):
            yield good(module, "installed")
        else:
            yield note(module, f"not installed: {cost}", remedy)


def _memory() -> Iterator[Finding]:
    table = {}
    for line in Path("/proc/meminfo").read_text().splitlines():
        name, _, value = line.partition(":")
        table[name] = int(value.split()[0]) / 1024
    free_mb, total_mb = table.get("MemAvailable", 0.0), table.get("MemTotal", 0.0)
    text = f"{free_mb / 1024:.1f} of {total_mb / 1024:.1f} GiB available"
    if free_mb < LEAST_MEMORY_MB:
        yield note("memory", f"{text}: the estimator may be ended", "close other programs")
    else:
        yield good("memory", text)


def _backbone(config: Config) -> Iterator[Finding]:
    from calm_edge.backbones.base import BackboneError
    from calm_edge.backbones.onnx.precision import model_of, pinned
    from calm_edge.backbones.registry import open_backbone

    try:
        chosen = pinned(config, deterministic=False)
        open_backbone(chosen)
    except BackboneError as error:
        yield bad("backbone", f"{config.backbone.name}: {error}", PLAIN)
        return
    precision = f", {chosen.backbone.precision}" if model_of(config) else ""
    yield good("backbone", f"{config.backbone.name} opens{precision}")
