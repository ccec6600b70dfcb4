"""Outcomes of the runs behind the kilometre tables, in one file for each run.

So an interruption loses only one run. The file name has a hash of the code, the error model and the
settings; outcomes of other code are read only on request.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from bench.kilometres.dials import sized
from bench.kilometres.drives import Drive
from bench.kilometres.loops import ScriptedLoops
from bench.kilometres.predictions import CACHE, CachedBackbone
from bench.kilometres.runs import Variant, run
from bench.kilometres.sources import digest
from bench.kilometres.streams import Streams
from calm_edge.config import Config
from calm_edge.estimator.localizer import Localizer
from calm_edge.evaluation.trajectory import scale_consistency
from calm_edge.types import CalmEdgeError
from device.atomic_file import replace_text

OUTCOMES = CACHE / "outcomes"
# Computed at import, so that editing the code during a long run does not change the file names.
_CODE = digest(("bench.kilometres.outcomes", "bench.kilometres.rivals"))


class OutcomeError(CalmEdgeError):
    """An outcome file cannot be read."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Conditions of a run.

    loops: whether loops are closed. detection, false_share: see ScriptedLoops; the baselines get no
    false loops.
    """

    name: str
    streams: Streams = field(default_factory=Streams)
    loops: bool = False
    detection: float = 0.7
    false_share: float = 0.0


@dataclass(frozen=True, slots=True)
class Focals:
    """Focal lengths of a run, one value per eye, px.

    true: ground truth. raw: mean absolute error of the focals that the backbone predicts for each
    sub-map. mean: mean of these focals over the drive. held: final estimate of the focal search.
    log_sigma: sigma of its log, None if the motion does not determine it. damping: tenths of a
    focal's error that are corrected in the poses.
    """

    true: tuple[float, ...]
    raw: tuple[float, ...]
    mean: tuple[float, ...]
    held: tuple[float, ...]
    log_sigma: tuple[float | None, ...]
    damping: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Measured:
    """Figures of one run; errors in m, None after a failure or for a drive that is too short.

    missing: number of keyframes without a pose, out of n_keyframes. ms: wall time per sub-map.
    scale_error, scale_std: error and standard deviation of the scale over windows of keyframes, the
    paper's Scale Consistency Analysis. failed: reason why there is no trajectory, else empty.
    """

    drive: str
    seed: int
    setting: str
    variant: str
    path_m: float
    n_keyframes: int
    n_submaps: int
    missing: int
    ms: float | None
    ate_sim3_m: float | None
    ate_se3_m: float | None
    scale_error: float | None
    scale_std: float | None
    focals: Focals | None
    failed: str

    @property
    def percent(self) -> float | None:
        """ATE after Sim(3) alignment, percent of the path."""
        return None if self.ate_sim3_m is None else 100 * self.ate_sim3_m / self.path_m


class Store:
    """Folder of outcomes.

    stale: for a run without an outcome of the present code, use the latest one of earlier code.
    earlier: number of outcomes of earlier code returned so far.
    """

    def __init__(self, folder: Path = OUTCOMES, stale: bool = False) -> None:
        self._folder, self._stale = folder, stale
        self.earlier = 0

    def get(self, name: str, seed: int, setting: Setting, variant: Variant) -> Measured | None:
        """Return the stored outcome of a run, None if there is none; raises OutcomeError."""
        file = self._file(name, seed, setting, variant)
        if self._stale and not file.is_file():
            like = f"{file.stem.rsplit('_', 1)[0]}_*.json"
            older = sorted(self._folder.glob(like), key=lambda f: f.stat().st_mtime)
            file = older[-1] if older else file
            self.earlier += bool(older)
        return _read(file) if file.is_file() else None

    def put(self, measured: Measured, name: str, setting: Setting, variant: Variant) -> None:
        """Store an outcome; the file is replaced atomically."""
        self._folder.mkdir(parents=True, exist_ok=True)
        file = self._file(name, measured.seed, setting, variant)
        replace_text(file, json.dumps(asdict(measured), indent=1, allow_nan=False) + "\n")

    def _file(self, name: str, seed: int, setting: Setting, variant: Variant) -> Path:
        made_by = f"{_CODE}{sized(seed)}{setting}{sorted(variant.changes.items())}"
        digest = hashlib.sha256(made_by.encode()).hexdigest()[:12]
        return self._folder / f"{name}_{seed}_{setting.name}_{variant.name}_{digest}.json"


def measure(
    drive: Drive,
    name: str,
    seed: int,
    backbone: CachedBackbone,
    setting: Setting,
    variant: Variant,
    loops: ScriptedLoops | None,
    config: Config,
) -> Measured:
    """Run one variant and compute its figures.

    An exception of any kind becomes the text `failed`, so that the other runs go on.
    """
    focals: list[Focals] = []

    def inspect(localizer: Localizer) -> None:
        if (found := focals_of(drive, localizer)) is not None:
            focals.append(found)

    try:
        outcome = run(drive, backbone, variant, config, loops, inspect)
    except Exception as error:  # a crash of one run fails this row only
        return _failed(drive, name, seed, setting, variant, f"{type(error).__name__}: {error}")
    if not math.isfinite(outcome.ate_sim3_m):
        return _failed(drive, name, seed, setting, variant, "no trajectory")
    p, truth = outcome.T_w_p[:, :3, 3], drive.T_w_p[outcome.keyframe_ids, :3, 3]
    consistency = scale_consistency(p, truth)
    return Measured(
        drive=name,
        seed=seed,
        setting=setting.name,
        variant=variant.name,
        path_m=outcome.path_m,
        n_keyframes=len(drive.keyframes),
        n_submaps=outcome.n_submaps,
        missing=outcome.missing,
        ms=outcome.ms,
        ate_sim3_m=outcome.ate_sim3_m,
        ate_se3_m=outcome.ate_se3_m,
        scale_error=consistency[0] if consistency else None,
        scale_std=consistency[1] if consistency else None,
        focals=focals[0] if focals else None,
        failed="",
    )


def focals_of(drive: Drive, localizer: Localizer) -> Focals | None:
    """Raw and final focals of a finished run; None if it estimated no focals."""
    held = localizer.intrinsics
    if held is None:
        return None
    of_submaps = [s for s in localizer.submaps if s.assistant_ids]
    raw = np.array([np.median([c.fx for c in s.cameras_raw[: s.n_primary]]) for s in of_submaps])
    ends = [s.n_primary + len(s.assistant_ids) for s in of_submaps]
    pairs = zip(of_submaps, ends, strict=True)
    other = np.array(
        [np.median([c.fx for c in s.cameras_raw[s.n_primary : end]]) for s, end in pairs]
    )
    both, true = np.stack([raw, other], 1), np.array([c.fx for c in drive.scene.cameras])
    sigma = [float(s) if np.isfinite(s) else None for s in held.focal_log_sigma]
    return Focals(
        true=tuple(true.tolist()),
        raw=tuple(np.abs(both - true).mean(0).tolist()),
        mean=tuple(both.mean(0).tolist()),
        held=tuple(held.focals.tolist()),
        log_sigma=tuple(sigma),
        damping=tuple(held.damping.tolist()),
    )


def _failed(
    drive: Drive, name: str, seed: int, setting: Setting, variant: Variant, why: str
) -> Measured:
    n = len(drive.keyframes)
    return Measured(
        drive=name, seed=seed, setting=setting.name, variant=variant.name, path_m=drive.path_m,
        n_keyframes=n, n_submaps=len(drive.windows), missing=n, ms=None, ate_sim3_m=None,
        ate_se3_m=None, scale_error=None, scale_std=None, focals=None, failed=why[:200],
    )  # fmt: skip


def _read(file: Path) -> Measured:
    try:
        kept: Mapping[str, Any] = json.loads(file.read_text())
        made = {of.name: kept[of.name] for of in fields(Measured)}
        if (focals := made["focals"]) is not None:
            made["focals"] = Focals(**{key: tuple(value) for key, value in focals.items()})
        return Measured(**made)
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise OutcomeError(f"{file}: not an outcome ({error}); remove it") from None
