"""Speed of this computer with the configured backbone, measured by `record` itself and stored."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from calm_edge import __version__, typed
from calm_edge.backbones.onnx import verdict
from calm_edge.backbones.onnx.precision import pinned
from calm_edge.commands import street
from calm_edge.commands.config_text import commented
from calm_edge.commands.finding import Finding, good, note
from calm_edge.config import Config, merge
from calm_edge.recording.reader import Recording
from calm_edge.types import CalmEdgeError
from device.atomic_file import replace_text

NAME = "speed"
# a window that takes longer than this share of the time to the next leaves nothing for bends, in
# which keyframes come faster
COMFORTABLE = 0.75
LIMIT_S = 900.0


class SpeedError(CalmEdgeError):
    """The speed could not be measured."""


@dataclass(frozen=True, slots=True)
class Speed:
    """Time for a window, and from one window to the next on the road, in seconds.

    load: running processes per core when the measurement began.
    """

    window_s: float
    period_s: float
    load: float

    def finding(self) -> Finding:
        """The measurement in words."""
        text = f"a window takes {self.window_s:.1f} s, on the road one comes every "
        text += f"{self.period_s:.1f} s"
        busy = self.load > 0.5
        if busy:
            text += f" (measured while other programs ran, load {self.load:.1f} per core)"
        if self.window_s <= COMFORTABLE * self.period_s:
            return good(NAME, f"{text}: live poses keep up")
        late = "poses lag behind at times" if self.window_s <= self.period_s else "windows are left"
        remedy = "measure again on an idle computer, or " if busy else ""
        remedy += "set backbone.name to bundle; all is recorded, `calm-edge map` solves the rest"
        return note(NAME, f"{text}: {late}", remedy)


def stored(config: Config) -> Speed | None:
    """The measurement of this computer and configuration; None if there is none."""
    try:
        table = json.loads(_path(config).read_text())
        speed: Speed = typed.record("", Speed, table, SpeedError)
    except (OSError, ValueError, SpeedError):
        return None
    return speed


def measure(config: Config) -> Speed:
    """Record a rendered drive of three windows, and store the time of the last one.

    The first two are solved without knowledge of the cameras, which takes longer. Raises
    SpeedError, BackboneError.
    """
    frontend, backbone = config.frontend, pinned(config, deterministic=False).backbone
    keyframes = 2 * frontend.n_max - frontend.n_overlap
    load = os.getloadavg()[0] / len(os.sched_getaffinity(0))
    chosen = merge(
        Config(),
        {
            "frontend": dataclasses.asdict(frontend),
            "backbone": {
                key: getattr(backbone, key) for key in ("name", "precision", "max_views", "seed")
            },
        },
    )
    with TemporaryDirectory(prefix="calm-edge-") as name:
        folder = Path(name)
        (folder / "speed.toml").write_text(commented(chosen, changed_only=True), "utf-8")
        size = config.capture.width_px, config.capture.height_px
        rate_hz = 1 / frontend.max_keyframe_gap_s
        street.write_street(folder / "drive", keyframes, rate_hz, size)
        _record(folder)
        updates = [update for update in Recording(folder / "rec").updates() if update.stage_ms]
    if len(updates) < 2:
        raise SpeedError(f"{len(updates)} rendered windows were solved; the speed is unknown")
    window_s = sum(updates[-1].stage_ms.values()) / 1e3
    period_s = (frontend.n_max - frontend.n_overlap) * frontend.max_keyframe_gap_s
    speed = Speed(window_s, period_s, load)
    path = _path(config)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_text(path, json.dumps(dataclasses.asdict(speed)) + "\n")
    except OSError as error:
        raise SpeedError(
            f"{path}: cannot be written ({error.strerror}); set XDG_CACHE_HOME to another folder"
        ) from None
    return speed


def _record(folder: Path) -> None:
    command = [sys.executable, "-m", "calm_edge.cli", "record", "--pace", "lockstep"]
    command += ["--config", str(folder / "speed.toml"), "--spacing-m", str(street.SPACING_M)]
    command += ["--sequence", str(folder / "drive"), "--out", str(folder / "rec")]
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        raise SpeedError(f"three windows take longer than {LIMIT_S / 60:.0f} minutes") from None
    if run.returncode not in (0, 3):
        lines = run.stderr.strip().splitlines() or [f"record ended with {run.returncode}"]
        # an error may refer to the line above it
        text = "; ".join(line.removeprefix("calm-edge: ") for line in lines[-2:])
        raise SpeedError(f"the rendered drive: {text}")


def _path(config: Config) -> Path:
    """The file of this computer, version, backbone, windows and size of pictures."""
    backbone, capture = config.backbone, config.capture
    of = [verdict.machine(), __version__, backbone.name, backbone.precision, backbone.max_views]
    of += [dataclasses.asdict(config.frontend), capture.width_px, capture.height_px]
    name = hashlib.sha256(json.dumps(of).encode()).hexdigest()[:16]
    return verdict.cache_folder().parent / f"speed-{name}.json"
