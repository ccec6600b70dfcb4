"""Errors over the sigmas claimed for them, on drives with exact truth: focals, scale, poses.

The drives are those of `bench lottery` and the demo; what that command has recorded is not recorded
again. On real clips, whose calibration is not exact, the parts of one drive are compared with each
other.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from bench.drives import ROOT, there
from bench.kit_agreement import CLIPS, agreement
from bench.lottery.command import add_draw, versions
from bench.lottery.draw import draw
from bench.lottery.requirements import TURNING_DEG, scales
from bench.normalised import COLUMNS, Normalised, normalised
from bench.outcome import Outcome, outcomes, trial
from bench.relative_poses import Stretches
from bench.tables import OUT, Check, Table, publish

DEMO = trial("demo", there(ROOT / "demo" / "drive"), 0.5)
# Largest median sigma of focal and scale on drives that turn, percent.
MOST_SIGMA = 2.0
# Shorter stretches have no sigma in percent of their length, m.
LEAST_M = 1.0
_EYES = ("primary", "assistant")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_draw(parser)
    parser.add_argument("--clips", action="store_true", help="the real clips as well, minutes each")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Measure all drives, print and save a table for each version; 1 if this one misses any."""
    missed = 0
    for name, checkout in versions(options):
        trials = [*(draw(options.seed, k) for k in range(options.n)), DEMO]
        missed = publish(table(name, options.command, outcomes(trials, checkout)), options.out)
    if options.clips:
        missed |= publish(agreement(options.command, CLIPS), options.out)
    return missed


def table(name: str, command: str, found: Sequence[Outcome]) -> Table:
    """Table of all quantities, with what is asked of them."""
    turning = [one for one in found if one.yaw_deg > TURNING_DEG]
    shown = [*focals(found), scales(found)]
    poses = [*of_poses(found, "live"), *of_poses(found, "final")]
    checks: list[Check] = []
    for one in (*shown, *poses):
        checks.extend(one.checks())
    for one in (*focals(turning), scales(turning)):
        checks.append(one.narrow(MOST_SIGMA, f"{one.name}, more than {TURNING_DEG:g} deg of yaw"))
    unknown = sum(one.missing for one in (*shown, *poses))
    notes = (
        f"{len(found)} drives, {len(turning)} with more than {TURNING_DEG:g} degrees of yaw",
        f"{unknown} errors without a finite sigma are not among the n",
        "poses: each axis over its own sigma, on consecutive stretches; live ones by the published "
        "covariances and the scale's sigma then, final ones by those of the joint graph and the "
        "final sigmas of scale and focal",
    )
    rows = tuple(one.row() for one in (*shown, *poses))
    return Table(
        f"honesty_{name}", f"Honesty, {name}", command, COLUMNS, rows, tuple(checks), notes
    )


def focals(found: Sequence[Outcome]) -> list[Normalised]:
    """Log focal of each eye, whether or not it is called observed."""
    out = []
    for eye, name in enumerate(_EYES):
        known = [one for one in found if one.focal_error and one.focal_sigma]
        errors = [one.focal_error[eye] for one in known if one.focal_error]
        sigmas = [one.focal_sigma[eye] for one in known if one.focal_sigma]
        out.append(normalised(f"focal, {name}", errors, sigmas))
    return out


def of_poses(found: Sequence[Outcome], which: str) -> list[Normalised]:
    """Relative poses `live` or `final`: position and rotation, over each length."""
    every: list[dict[str, Stretches]] = [dict(getattr(one, which)) for one in found]
    names = dict.fromkeys(name for some in every for name in some)
    out = []
    for name in names or ("1 s", "100 m"):
        some = joined(stretches[name] for stretches in every if name in stretches)
        total = np.sqrt((some.sigma[:, :3] ** 2).sum(1)), np.sqrt((some.sigma[:, 3:] ** 2).sum(1))
        far = (some.length_m > LEAST_M) & np.isfinite(total[0])
        share = 100 * total[0][far] / some.length_m[far]
        turn = np.degrees(total[1][np.isfinite(total[1])])
        for what, axes, claimed, unit in (
            ("position", slice(0, 3), share, "% of the distance"),
            ("rotation", slice(3, 6), turn, "degrees"),
        ):
            out.append(
                normalised(
                    f"{which} pose over {name}, {what}",
                    some.error[:, axes].ravel(),
                    some.sigma[:, axes].ravel(),
                    unit,
                    float(np.median(claimed)) if len(claimed) else None,
                )
            )
    return out


def joined(several: Iterable[Stretches]) -> Stretches:
    """Stretches of several drives in one."""
    parts = [Stretches.none(), *several]
    return Stretches(*(np.concatenate([getattr(p, k) for p in parts]) for k in Stretches.__slots__))
