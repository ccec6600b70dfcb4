"""Error and time on whole drives, by `bundle` with and without the network.

Errors: lockstep runs without the network and with it, in fp32 and in int8, compared in pairs of the
same drive and seed. Time: seconds per window in runs in real time. Results are kept in
build/eval/model_pipeline.json; a run of some drives replaces only their results.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.model import pipeline_runs as runs
from bench.model.ours import MODEL
from bench.paired import COLUMNS, Errors, PairedRatio, compare
from bench.tables import OUT, Check, Table, exit_code, publish
from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.onnx.precision import opened
from calm_edge.config import BackboneConfig, Config

COMMAND = "python -m bench model.pipeline"
# Targets: error with the network over that without; sigmas by which one drive may be worse with it;
# upper end of the 95 % interval of the error in int8 over that in fp32.
ASKED, WORSE_SIGMAS, INT8_END = 0.9, 2.0, 1.1
# Target seconds of a window without its depth, and of the depth.
WINDOW_S, DEPTH_S = 0.8, 1.5


def worst_drive(errors: Errors, reference: Errors) -> tuple[str, float] | None:
    """Name of the drive on which a variant is worst, and by how many sigmas.

    By the mean log ratio of its errors to the reference. The sigma is pooled over all drives from
    the scatter between seeds; None if no drive has two seeds. A drive lost by the variant alone
    counts as infinitely worse.
    """
    logs: dict[str, list[float]] = {}
    for key in errors.keys() & reference.keys():
        mine, theirs = errors[key], reference[key]
        if theirs is None:
            continue
        logs.setdefault(key[0], []).append(math.log(mine / theirs) if mine else math.inf)
    lost = sorted(name for name, drive in logs.items() if math.inf in drive)
    if lost:
        return lost[0], math.inf
    freedom = sum(len(drive) - 1 for drive in logs.values())
    if freedom == 0:
        return None
    squares = sum(((np.array(d) - np.mean(d)) ** 2).sum() for d in logs.values())
    sigma = max(math.sqrt(squares / freedom), 1e-9)
    sigmas = {n: float(np.mean(d)) / sigma * math.sqrt(len(d)) for n, d in logs.items()}
    name = max(sorted(sigmas), key=lambda n: sigmas[n])
    return name, sigmas[name]


def ate_table(results: Mapping[str, Any]) -> Table:
    """Table of error ratios, and the requirements on them."""
    plain, network, int8 = (runs.errors(results, v) for v in (runs.PLAIN, runs.NETWORK, runs.INT8))
    rows: list[tuple[Any, ...]] = []
    checks: list[Check] = []
    notes = [
        "ratios of the error, below 1 the first is better; a drive's interval needs two seeds",
        "seed 0 is the whole drive, other seeds drop 5 % of its frames at random",
        "sigmas are those of the scatter between seeds, pooled over the drives",
    ]
    if plain.keys() & network.keys():
        ratio, what = compare(network, plain), f"bundle:{MODEL} over bundle"
        rows.append(tuple(ratio.row(what)))
        rows += _by_drive(network, plain)
        kept = ratio.within(ASKED) and ratio.verdict == "better" and not ratio.failed
        checks.append(Check(what, f"< {ASKED:g}, interval below 1", _shown(ratio), kept))
        worst = worst_drive(network, plain)
        if worst is not None:
            name, sigmas = worst
            kept = sigmas <= WORSE_SIGMAS
            shown = f"{name}: {sigmas:.1f} sigma"
            checks.append(Check("worst drive", f"<= {WORSE_SIGMAS:g} sigma", shown, kept))
    if int8.keys() & network.keys():
        ratio, what = compare(int8, network), "int8 over fp32"
        rows.append(tuple(ratio.row(what)))
        ends = ratio.high is not None and ratio.high < INT8_END
        kept = ends and ratio.verdict in ("tie", "better") and not ratio.failed
        asked = f"interval includes 1 or is below, ends below {INT8_END:g}"
        checks.append(Check(what, asked, _shown(ratio), kept))
    for drive, variants in results.items():
        why = {f.get("skipped") for seeds in variants.values() for f in seeds.values()} - {None}
        notes += [f"{drive} skipped: {reason}" for reason in sorted(why)]
        for variant, seeds in variants.items():
            broken = [f"seed {s}: {f['failed']}" for s, f in seeds.items() if "failed" in f]
            notes += [f"{drive}, {variant} failed: {line}" for line in broken]
    title = "Whole drives without and with the network"
    return Table(
        "54_model_pipeline", title, COMMAND, COLUMNS, tuple(rows), tuple(checks), tuple(notes)
    )


def _by_drive(errors: Errors, reference: Errors) -> list[tuple[Any, ...]]:
    out = []
    for drive in dict.fromkeys(name for name, _ in sorted(errors.keys() & reference.keys())):
        own, other = ({k: v for k, v in e.items() if k[0] == drive} for e in (errors, reference))
        out.append(tuple(compare(own, other).row(f"  {drive}")))
    return out


def _shown(ratio: PairedRatio) -> str:
    if ratio.ratio is None:
        return "no pair of finished runs"
    ends = f"({ratio.low:.3f} to {ratio.high:.3f})"
    return f"{ratio.ratio:.3f} {ends}, {ratio.pairs} pairs, {ratio.failed} failed"


def time_table(results: Mapping[str, Any]) -> Table:
    """Table of the seconds per full window by stage, in real time, and the requirements on them."""
    rows: list[tuple[Any, ...]] = []
    checks: list[Check] = []
    for variant in runs.TIMED:
        windows = [
            window
            for variants in results.values()
            for figures in variants.get(variant.name, {}).values()
            for window in figures.get("windows_s", ())
        ]
        if not windows:
            continue
        stages = dict.fromkeys(stage for window in windows for stage in window)
        total = [sum(s for k, s in w.items() if k != runs.DEPTH_STAGE) for w in windows]
        rows.append((variant.name, "all but depth", *_spread(total)))
        for stage in stages:
            own = [window[stage] for window in windows if stage in window]
            rows.append((variant.name, f"  {stage}", *_spread(own)))
        if variant is runs.TIMED[-1]:
            depth = [w[runs.DEPTH_STAGE] for w in windows if runs.DEPTH_STAGE in w]
            for what, seconds, most in (
                ("a window", total, WINDOW_S),
                ("its depth", depth, DEPTH_S),
            ):
                if seconds:
                    mean = float(np.mean(seconds))
                    asked = f"mean <= {most:g} s"
                    checks.append(Check(what, asked, f"{mean:.2f} s", mean <= most))
    return Table(
        "55_model_time",
        "Seconds a window of 15 + 15 keyframes, twelve of each eye new, in real time",
        f"{COMMAND} --part time",
        ("variant", "stage", "mean s", "50 % s", "90 % s", "windows"),
        tuple(rows),
        tuple(checks),
        (
            "wall time, beside capture and other load of the machine; infer: encoder, matching and "
            "solver; search and rectify: the correction; the first windows of a drive, before the "
            "focal lengths are known, take twice as long",
        ),
    )  # fmt: skip


def _spread(seconds: list[float]) -> tuple[float, float, float, int]:
    half, most = np.percentile(seconds, [50, 90]).tolist()
    return float(np.mean(seconds)), half, most, len(seconds)


PARTS = {
    "network": (runs.PLAIN, runs.NETWORK),
    "int8": (runs.NETWORK, runs.INT8),
    "time": runs.TIMED,
}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--part", action="append", choices=list(PARTS))
    drives = parser.add_mutually_exclusive_group()
    drives.add_argument("--only", action="append", metavar="DRIVE", choices=list(runs.DRIVES))
    drives.add_argument("--all", action="store_true", help="every development drive, hours")
    drives.add_argument("--held-out", action="store_true", help="tracks nothing is tuned on")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--show", action="store_true", help="show the kept results alone")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Run the drives, print and save the tables; return 1 if a requirement is not met.

    Without the network, print the reason and return 0.
    """
    try:
        if options.show:
            results = runs.read_results(options.out / runs.RESULTS)
        else:
            opened(Config(backbone=BackboneConfig(name=f"bundle:{MODEL}", precision="fp32")))
            known = runs.HELD_OUT if options.held_out else runs.ALL if options.all else runs.SHORT
            chosen = [runs.DRIVES[name] for name in options.only or known]
            parts = [PARTS[part] for part in options.part or PARTS]
            variants = list(dict.fromkeys(variant for part in parts for variant in part))
            results = runs.run_all(chosen, variants, max(1, options.seeds), options.out)
        tables = [ate_table(results), time_table(results)]
    except BackboneError as error:
        print(f"skipped: {error}", file=sys.stderr)
        return 0
    for table in tables:
        if table.rows:
            publish(table, options.out)
    return exit_code(tables)
