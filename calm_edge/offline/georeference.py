"""Align a map's trajectory to GPS fixes; the free trajectory is left as it is."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calm_edge.evaluation.estimate import Estimate
from calm_edge.geometry import body_frame, se3
from calm_edge.geometry.gps_alignment import Alignment, GpsAlignmentError, align
from calm_edge.geometry.local_enu import enu
from calm_edge.offline.gps_fixes import GpsFixes
from calm_edge.trajectories import write_tum
from calm_edge.types import Float

ENU_TUM, GPS_SUMMARY = "trajectory.enu.tum", "gps.json"
# lengths of GPS and of the spacing that differ by more sigmas disagree
DISAGREE_SIGMAS = 3.0
# of the log of a length by the spacing, if the drive does not say
SPACING_LOG_SIGMA = 0.01


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the world of a map lies on the Earth. T_m_w: (4, 4) world -> axes with z up.

    alignment: of these axes to east, north, up. content: of GPS_SUMMARY.
    """

    alignment: Alignment
    T_m_w: Float
    content: dict[str, Any]

    def write(self, estimate: Estimate, out: Path) -> None:
        """Write ENU_TUM, the poses of an estimate in east, north, up, and GPS_SUMMARY."""
        write_tum(out / ENU_TUM, estimate.t_ns, self.alignment.apply(self.T_m_w @ estimate.T_w_c))
        (out / GPS_SUMMARY).write_text(json.dumps(self.content, indent=2) + "\n")


def georeference(
    estimate: Estimate, fixes: GpsFixes, out: Path, say: Callable[[str], None]
) -> Alignment | None:
    """Place an estimate by fixes and write the files; None, with a line for the user, if not."""
    placement = place(estimate, fixes, say)
    if placement is None:
        return None
    placement.write(estimate, out)
    return placement.alignment


def place(
    estimate: Estimate, fixes: GpsFixes, say: Callable[[str], None], *, one_kit: bool = True
) -> Placement | None:
    """Align an estimate's world to fixes, with the fixes' median position as origin.

    estimate: with the user's stamps, as the fixes. The scale is that of the spacing, if lengths
    are metric, and otherwise of GPS. one_kit: there is one spacing. None, with a line for the user,
    if the fixes do not determine it or contradict it.
    """
    origin = np.median(fixes.lla, axis=0)
    positions = enu(fixes.lla, origin)
    # axes of the first camera -> z up
    T_m_w = body_frame.FLU_FROM_FRD @ body_frame.mounting((0.0, 0.0, 0.0))
    T_m_c = T_m_w @ estimate.T_w_c
    start_ns = int(estimate.t_ns[0])
    path_s, fix_s = (estimate.t_ns - start_ns) / 1e9, (fixes.t_ns - start_ns) / 1e9
    metric = estimate.metric
    path, agreement = T_m_c[:, :3, 3], None
    try:
        free = chosen = align(path_s, path, fix_s, positions, fixes.sigma_m, free_scale=True)
        if metric:
            agreement = _agreement(estimate, free, one_kit=one_kit)
            chosen = align(path_s, path, fix_s, positions, fixes.sigma_m, free_scale=False)
    except GpsAlignmentError as error:
        say(f"{fixes.path}: not aligned to GPS: {agreement or error}")
        return None
    refused = chosen.inside & ~chosen.used
    content = {
        "source": str(fixes.path),
        "origin_deg_deg_m": origin.tolist(),
        "T_enu_w": se3.compose(chosen.R @ T_m_w[:3, :3], chosen.t).tolist(),
        "scale": chosen.scale,
        "scale_by": "spacing" if metric else "GPS",
        "gps_scale": free.scale,
        "gps_scale_sigma_percent": 100 * free.scale_log_sigma,
        "delay_s": chosen.delay_s,
        "delay_sigma_s": chosen.delay_sigma_s,
        "tilt_sigma_deg": float(np.degrees(chosen.tilt_sigma)),
        "fixes": len(fixes.t_ns),
        "without_position": fixes.dropped,
        "outside_the_path": int((~chosen.inside).sum()),
        "refused": int(refused.sum()),
        "used": int(chosen.used.sum()),
        "residual_median_m": float(np.median(chosen.residual_m[chosen.used])),
        "residual_rms_m": float(np.sqrt(np.mean(chosen.residual_m[chosen.used] ** 2))),
        "disagreement": agreement,
    }
    say(
        f"{fixes.path}: {content['used']} fixes used, {content['refused']} refused, "
        f"{content['outside_the_path']} outside the path; {content['residual_rms_m']:.2f} m apart "
        f"(rms), delay {chosen.delay_s:.3f} ± {chosen.delay_sigma_s:.3f} s"
    )
    if agreement:
        say(agreement)
    return Placement(chosen, T_m_w, content)


def _agreement(estimate: Estimate, free: Alignment, *, one_kit: bool) -> str | None:
    """Sentence on a disagreement of GPS and the spacing on lengths; None without one."""
    metre = estimate.metre
    own = SPACING_LOG_SIGMA if metre is None or not metre.metric else metre.log_sigma
    off = float(np.log(free.scale))
    if abs(off) <= DISAGREE_SIGMAS * float(np.hypot(own, free.scale_log_sigma)):
        return None
    text = f"GPS disagrees with scale.spacing_m: its lengths are {100 * np.expm1(off):+.1f} %"
    if not one_kit:
        return text
    assert estimate.spacing_m is not None
    return f"{text}; the spacing would be {estimate.spacing_m * free.scale:.3f} m"
