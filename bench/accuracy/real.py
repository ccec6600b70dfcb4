"""Requirements on the real clips and on the drive with cameras 0.2 m apart."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bench.accuracy import stereo
from bench.accuracy.drives import HINTED, KARLSRUHE, KARLSRUHE_SPACING_M, NARROW, PART, WHOLE
from bench.outcome import Outcome, recording_of
from bench.tables import Check
from calm_edge.evaluation.estimate import Estimate, read_estimate
from calm_edge.geometry import se3
from calm_edge.geometry.similarity import align
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.types import Float, Int
from device.frame import Eye

SIGMAS = 3.0
MOST_SIM3_M, MOST_HINTED_M, MOST_NARROW_PERCENT = 0.72, 0.30, 1.0
MOST_FOCAL_PERCENT, MOST_SCALE_PERCENT = 5.0, 5.0
Row = tuple[str, object, str]


def measured(found: Mapping[str, Outcome], checkout: Path) -> tuple[list[Row], list[Check]]:
    """Rows (figure, value, note) and requirements, given the outcomes by name."""
    rows: list[Row] = []
    checks: list[Check] = []
    whole, part = found[WHOLE.name], found[PART.name]
    for name, outcome in found.items():
        rows.append((f"{name}: ATE, % of path", outcome.ate_percent, outcome.failed))
        rows.append((f"{name}: Sim(3), m", outcome.sim3_m, ""))
        rows.append((f"{name}: sigma of the scale, %", _percent(outcome.scale_sigma), ""))
    checks.append(_most(f"{WHOLE.name}: Sim(3), m", MOST_SIM3_M, whole.sim3_m))
    hinted = found[HINTED.name]
    ate_m = None if hinted.ate_percent is None else hinted.ate_percent * hinted.path_m / 100
    checks.append(_most(f"{HINTED.name}: SE(3), m", MOST_HINTED_M, ate_m))
    checks.append(narrow(found[NARROW.name]))
    if not whole.failed:
        checks.append(_against_stereo(whole, checkout))
    if not whole.failed and not part.failed:
        checks += focals(part, whole)
        paths = [read_estimate(recording_of(one, checkout)) for one in (PART, WHOLE)]
        ratio = 100 * math.log(length_ratio(*paths))
        what = f"{PART.name}: scale against the whole clip's, %"
        checks.append(_within(what, f"within {MOST_SCALE_PERCENT:g}", ratio, MOST_SCALE_PERCENT))
    return rows, checks


def narrow(found: Outcome) -> Check:
    """The drive with cameras 0.2 m apart: small error, or a sigma of the scale that covers it."""
    what, asked = f"{found.drive}: ATE, % of path", "<= 1, or scale within 3 sigma"
    if found.ate_percent is None or found.scale_error is None:
        return Check(what, asked, found.failed, False)
    covered = found.scale_sigma is not None and abs(found.scale_error) <= SIGMAS * found.scale_sigma
    return Check(
        what, asked, found.ate_percent, found.ate_percent <= MOST_NARROW_PERCENT or covered
    )


def focals(part: Outcome, whole: Outcome) -> list[Check]:
    """Focals of a part of a clip within its own sigmas, and in percent, of the whole clip's.

    Errors against the published calibration, which is not exact, but the same in both.
    """
    if part.focal_error is None or whole.focal_error is None or part.focal_sigma is None:
        return [Check(f"{part.drive}: focal", "within 3 sigma and 5 %", "not reported", False)]
    checks = []
    for eye, name in enumerate(("primary", "assistant")):
        apart = part.focal_error[eye] - whole.focal_error[eye]
        what = f"{part.drive}: focal of the {name} against the whole clip's, "
        in_sigma = apart / part.focal_sigma[eye]
        checks.append(_within(f"{what}sigma", "within 3", in_sigma, SIGMAS))
        checks.append(_within(f"{what}%", "within 5", 100 * apart, MOST_FOCAL_PERCENT))
    return checks


def length_ratio(a: Estimate, b: Estimate) -> float:
    """Scale of trajectory a relative to b where both have poses, by a similarity."""
    t_ns = a.t_ns[(a.t_ns >= b.t_ns[0]) & (a.t_ns <= b.t_ns[-1])]
    pa, pb = positions(a, t_ns), positions(b, t_ns)
    return 1 / align(pa, pb, with_scale=True).scale


def positions(estimate: Estimate, t_ns: Int) -> Float:
    """Positions (N, 3) at stamps (N,), interpolated between the keyframes."""
    start = estimate.t_ns[0]
    along = (estimate.t_ns - start) / 1e9
    return se3.interpolate_at(along, estimate.T_w_c, (t_ns - start) / 1e9)[:, :3, 3]


def _against_stereo(whole: Outcome, checkout: Path) -> Check:
    """Lengths of karlsruhe_town against those of calibrated stereo on the same pictures."""
    estimate = read_estimate(recording_of(WHOLE, checkout))
    peer = stereo.motions(KARLSRUHE, KARLSRUHE_SPACING_M)
    t_ns = SequenceFolder(KARLSRUHE).t_ns(Eye.PRIMARY)
    ends = np.stack([t_ns[peer.first], t_ns[peer.first + stereo.APART]])
    inside = (ends >= estimate.t_ns[0]).all(0) & (ends <= estimate.t_ns[-1]).all(0)
    p = [positions(estimate, t) for t in ends[:, inside]]
    length = np.linalg.norm(p[1] - p[0], axis=1)
    log_ratio, sigma = stereo.log_scale(length, peer.metres[inside])
    what = f"{WHOLE.name}: scale against calibrated stereo, %"
    if whole.scale_sigma is None:
        asked = "within 3 sigma; no sigma is reported"
        return Check(what, asked, 100 * log_ratio, False)
    total = math.hypot(sigma, whole.scale_sigma)
    asked = f"within 3 sigma of {100 * total:.2f}"
    return _within(what, asked, 100 * log_ratio, SIGMAS * 100 * total)


def _percent(log: float | None) -> float | None:
    return None if log is None else 100 * log


def _most(what: str, most: float, value: float | None) -> Check:
    return Check(what, f"<= {most:g}", value, value is not None and value <= most)


def _within(what: str, asked: str, value: float, most: float) -> Check:
    return Check(what, asked, value, abs(value) <= most)
