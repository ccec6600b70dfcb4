"""Simulated GPS fixes of drives with true poses: delay, refused fixes, scale and residuals.

Fixes at 10 Hz have noise in each axis, some are tens of metres off, some seconds have none, and all
are late. They are written as GPX, read back and aligned to the recorded trajectory, with the
spacing and without it. Recordings are made once, or given.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from bench import steps
from bench.drives import ROOT
from bench.tables import OUT, Check, Table, publish
from calm_edge.evaluation.estimate import Estimate, from_recording
from calm_edge.evaluation.truth import Truth, read_truth
from calm_edge.geometry import body_frame, local_enu, se3
from calm_edge.offline.georeference import Placement, place
from calm_edge.offline.gps_fixes import GpsFixes, read_fixes
from calm_edge.recording.reader import Recording
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.types import CalmEdgeError, Float, Int

COLUMNS = (
    *("drive", "seed", "lengths by", "delay s", "sigma s", "refused", "wrong", "scale"),
    *("sigma %", "residual m", "path error m"),
)
RATE_HZ = 10.0
# where the drive begins: latitude, longitude [deg], height [m]; heading of the first camera [rad]
ORIGIN, HEADING = np.array([48.1, 11.55, 530.0]), 0.7
# of wrong fixes, beyond the noise [m]
WRONG_M = 40.0
# errors over their sigmas, and the error of the aligned path over the noise
MOST_SIGMAS, MOST_NOISES = 3.0, 1.0
# of the fixes that are wrong by more than MOST_SIGMAS times the noise
LEAST_REFUSED = 0.9


@dataclass(frozen=True, slots=True)
class Simulated:
    """Fixes: t_ns (M,) with the user's stamps, lla (M, 3), wrong (M,) those that are far off.

    T_enu_w: (4, 4) true pose of the truth's world in east, north, up.
    """

    t_ns: Int
    lla: Float
    wrong: np.ndarray
    T_enu_w: Float


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("folder", type=Path, nargs="+", help="sequence folders, with poses0.txt")
    parser.add_argument(
        "--recording", type=Path, nargs="+", default=[], metavar="REC", help="of the folders"
    )
    parser.add_argument("--spacing-m", type=float, default=0.55, metavar="X")
    parser.add_argument("--seeds", type=int, default=3, help="draws of the fixes")
    parser.add_argument("--noise-m", type=float, default=1.5, help="sigma in each axis")
    parser.add_argument("--delay-s", type=float, default=0.3)
    parser.add_argument("--gap-s", type=float, default=3.0, help="without fixes, amid the drive")
    parser.add_argument("--wrong", type=float, default=0.08, help="share of wrong fixes")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Align every drive to each draw, print and save the table; 1 if a requirement is not met."""
    given: list[Path] = options.recording
    if given and len(given) != len(options.folder):
        raise CalmEdgeError(f"--recording: give {len(options.folder)}, one for each folder")
    rows, checks = [], []
    for n, folder in enumerate(options.folder):
        recording = given[n] if given else _recorded(folder, options.spacing_m)
        stored = Recording(recording)
        estimate = from_recording(recording)
        estimate = replace(estimate, t_ns=estimate.t_ns - stored.origin_ns)
        truth = read_truth(folder)
        # with the user's stamps
        truth = replace(truth, t_ns=truth.t_ns - ORIGIN_NS)
        found: dict[str, list[Check]] = {}
        for seed in range(options.seeds):
            fixes = simulated(truth, options, seed)
            for by in ("spacing", "GPS"):
                row, met = aligned(estimate, truth, fixes, by, options)
                rows.append((folder.name, seed, by, *row))
                for check in met:
                    found.setdefault(f"{folder.name}, by {by}: {check.what}", []).append(check)
        # the worst draw counts
        for what, each in found.items():
            checks.append(replace(max(each, key=_shortfall), what=what))
    title = "Alignment to simulated GPS fixes"
    table = Table("gps", title, options.command, COLUMNS, tuple(rows), tuple(checks))
    return publish(table, options.out)


def _shortfall(check: Check) -> float:
    """Larger for a value that is further on the wrong side."""
    return float(-check.measured if check.asked.startswith(">=") else check.measured)


def _recorded(folder: Path, spacing_m: float) -> Path:
    out = ROOT / "build" / "gps" / folder.name
    out.parent.mkdir(parents=True, exist_ok=True)
    steps.record(folder, out, ("--spacing-m", f"{spacing_m:g}"))
    return out


def simulated(truth: Truth, options: argparse.Namespace, seed: int) -> Simulated:
    """Draw the fixes of a drive."""
    rng = np.random.default_rng(seed)
    # the first camera is level
    T_enu_w = np.eye(4)
    T_enu_w[:3, :3] = se3.so3_exp(np.array([0.0, 0.0, HEADING]))
    T_enu_w = T_enu_w @ body_frame.FLU_FROM_FRD @ body_frame.mounting((0.0, 0.0, 0.0))
    true = se3.transform(T_enu_w, truth.T_w_c[:, :3, 3])
    start_ns = int(truth.t_ns[0])
    seconds = (truth.t_ns - start_ns) / 1e9
    t = np.arange(options.delay_s, seconds[-1], 1 / RATE_HZ)
    middle = seconds[-1] / 2
    t = t[np.abs(t - middle) > options.gap_s / 2]
    at = np.stack([np.interp(t - options.delay_s, seconds, true[:, k]) for k in range(3)], 1)
    seen = at + rng.normal(0, options.noise_m, at.shape)
    wrong = rng.random(len(t)) < options.wrong
    seen[wrong, :2] += rng.normal(0, WRONG_M, (int(wrong.sum()), 2))
    far = np.linalg.norm((seen - at)[:, :2], axis=1) > 2 * MOST_SIGMAS * options.noise_m
    t_ns = start_ns + np.rint(1e9 * t).astype(np.int64)
    return Simulated(t_ns, local_enu.geodetic(seen, ORIGIN), wrong & far, T_enu_w)


def aligned(
    estimate: Estimate, truth: Truth, fixes: Simulated, by: str, options: argparse.Namespace
) -> tuple[tuple[object, ...], list[Check]]:
    """Values of a row, and the checks on them. by: what gives the scale."""
    read = through_gpx(fixes, options.noise_m)
    shown = estimate if by == "spacing" else replace(estimate, spacing_m=None)
    said: list[str] = []
    placed = place(shown, read, said.append)
    if placed is None:
        raise CalmEdgeError(said[-1])
    found = placed.alignment
    sigma = 100 * found.scale_log_sigma
    refused = int((found.inside & ~found.used).sum())
    caught = float((found.inside & ~found.used)[fixes.wrong].mean()) if fixes.wrong.any() else 1.0
    error = path_error(placed, estimate, truth, fixes)
    residual = float(placed.content["residual_rms_m"])
    late = abs(found.delay_s - options.delay_s) / found.delay_sigma_s
    metre = 0.0 if estimate.metre is None else estimate.metre.log_sigma
    stretched = abs(float(np.log(found.scale))) / float(np.hypot(found.scale_log_sigma, metre))
    row = found.delay_s, found.delay_sigma_s, refused, int(fixes.wrong.sum()), found.scale
    most = MOST_NOISES * options.noise_m
    checks = [
        Check("delay, error over sigma", f"<= {MOST_SIGMAS:g}", late, late <= MOST_SIGMAS),
        Check("wrong fixes refused", f">= {LEAST_REFUSED:g}", caught, caught >= LEAST_REFUSED),
        Check("path error, m", f"<= {most:g}", error, error <= most),
    ]
    if by == "GPS":
        what, asked = "scale, error over sigma", f"<= {MOST_SIGMAS:g}"
        checks.append(Check(what, asked, stretched, stretched <= MOST_SIGMAS))
    return (*row, sigma, residual, error), checks


def through_gpx(fixes: Simulated, noise_m: float) -> GpsFixes:
    """Write the fixes as GPX and read them; their sigma is the noise."""
    points = []
    for t_ns, (latitude, longitude, height) in zip(
        fixes.t_ns.tolist(), fixes.lla.tolist(), strict=True
    ):
        at = datetime.fromtimestamp(0, UTC) + timedelta(microseconds=t_ns // 1000)
        points.append(
            f'<trkpt lat="{latitude:.9f}" lon="{longitude:.9f}"><ele>{height:.4f}</ele>'
            f"<time>{at.isoformat()}</time></trkpt>"
        )
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        path = Path(folder) / "fixes.gpx"
        track = f"<trk><trkseg>{''.join(points)}</trkseg></trk>"
        path.write_text(f'<gpx xmlns="http://www.topografix.com/GPX/1/1">{track}</gpx>')
        read = read_fixes(path)
    return replace(read, sigma_m=np.full(read.lla.shape, noise_m))


def path_error(placed: Placement, estimate: Estimate, truth: Truth, fixes: Simulated) -> float:
    """Rms distance [m] of the aligned keyframes from their true places on the Earth."""
    content = placed.content
    p = placed.alignment.apply(placed.T_m_w @ estimate.T_w_c)[:, :3, 3]
    seconds = (truth.t_ns - truth.t_ns[0]) / 1e9
    at = (estimate.t_ns - truth.t_ns[0]) / 1e9
    true = se3.transform(fixes.T_enu_w, truth.T_w_c[:, :3, 3])
    wanted = np.stack([np.interp(at, seconds, true[:, k]) for k in range(3)], 1)
    # both in the frame of the true origin
    origin = np.array(content["origin_deg_deg_m"])
    moved = local_enu.enu(local_enu.geodetic(p, origin), ORIGIN)
    return float(np.sqrt(((moved - wanted) ** 2).sum(1).mean()))
