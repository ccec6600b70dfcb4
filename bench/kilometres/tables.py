"""The paper's tables, on drives of kilometres with scripted predictions and loops.

Makes the runs that have no stored outcome yet and prints each table from all outcomes. Notes below
a table list the drives that were not run.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import monotonic

from bench.kilometres import part_rows, plan, rows
from bench.kilometres.dials import sized
from bench.kilometres.drives import SEQUENCES, Drive, DriveError, kitti
from bench.kilometres.loops import ScriptedLoops
from bench.kilometres.outcomes import OUTCOMES, Measured, Store, measure
from bench.kilometres.plan import Batch
from bench.kilometres.predictions import CACHE, cached
from bench.kilometres.rows import Results
from bench.tables import OUT, Table, publish
from calm_edge.config import Config
from calm_edge.types import CalmEdgeError

TABLES: dict[str, Callable[[Results, str], Table]] = {
    "ate": rows.open_drives,
    "loops": rows.looped_drives,
    "sync": part_rows.synchronisation,
    "scale": part_rows.scales,
    "focal": part_rows.focal_table,
    "ablation": part_rows.ablation,
}
# Seed 0 was used for development.
FIRST_SEED = 1


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--sequences", default=",".join(SEQUENCES), help="00,05,...")
    parser.add_argument("--seeds", type=int, default=1, help=f"number, from {FIRST_SEED} on")
    parser.add_argument("--repeated", default="", help="drives run at later seeds; default all")
    parser.add_argument("--only", default="", help=f"some of {','.join(TABLES)}")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="start no run after")
    parser.add_argument("--fresh", action="store_true", help="ignore kept outcomes")
    parser.add_argument("--stale", action="store_true", help="also use outcomes of earlier code")
    parser.add_argument("--frames", type=int, default=0, help="only the first frames; 0 for all")
    parser.add_argument("--outcomes", type=Path, default=OUTCOMES)
    parser.add_argument("--out", type=Path, default=OUT)


def run(asked: argparse.Namespace) -> int:
    """Make the missing runs, print and save the tables."""
    store = Store(asked.outcomes, asked.stale)
    only = asked.only.split(",") if asked.only else list(TABLES)
    names = asked.sequences.split(",")
    seeds = range(FIRST_SEED, FIRST_SEED + asked.seeds)
    until = monotonic() + 60 * asked.minutes
    repeated = asked.repeated.split(",") if asked.repeated else []
    measured: list[Measured] = []
    for name in only:
        if name not in TABLES:
            raise CalmEdgeError(f"--only {name}: unknown; known: {', '.join(TABLES)}")
    unknown = [name for name in names if name not in SEQUENCES]
    if unknown:
        raise DriveError(f"--sequences {unknown[0]}: unknown; known: {', '.join(SEQUENCES)}")
    for batch in plan.batches(only, names, seeds, repeated):
        measured += _measured(batch, store, asked, until)
    results = Results(measured, names)
    note = f"{store.earlier} of {len(measured)} runs were made by earlier code"
    for name in only:
        table = TABLES[name](results, asked.command)
        if store.earlier:
            table = replace(table, notes=(*table.notes, note))
        publish(table, asked.out)
    return 0


def _measured(
    batch: Batch, store: Store, asked: argparse.Namespace, until: float
) -> list[Measured]:
    """Read the stored outcomes of a batch, and make the missing runs while time allows.

    until: monotonic time after which no run is started, s.
    """
    name, seed, setting = batch.name, batch.seed, batch.setting
    # a shortened drive is stored under another name
    key = f"{name}-{asked.frames}" if asked.frames else name
    found, to_run = [], []
    for variant in batch.variants:
        kept = None if asked.fresh else store.get(key, seed, setting, variant)
        if kept is None:
            to_run.append(variant)
        else:
            found.append(kept)
    if not to_run or monotonic() > until:
        return found
    config = Config()
    drive = kitti(name, config, seed, setting.streams, asked.frames)
    backbone = cached(drive, sized(seed), CACHE)
    truths = _finder(batch, drive, config, 0.0)
    for variant in to_run:
        if monotonic() > until:
            break
        # Baselines cannot reject false loops, so they get true ones only. One finder for all of
        # them lets them share the cached sub-maps.
        ours = variant.aligner is None
        loops = _finder(batch, drive, config, setting.false_share) if ours else truths
        one = measure(drive, name, seed, backbone, setting, variant, loops, config)
        store.put(one, key, setting, variant)
        found.append(one)
        print(name, seed, setting.name, variant.name, one.ate_sim3_m, one.percent, one.failed,
              file=sys.stderr, flush=True)  # fmt: skip
    return found


def _finder(batch: Batch, drive: Drive, config: Config, false_share: float) -> ScriptedLoops | None:
    setting = batch.setting
    if not setting.loops:
        return None
    gap = config.loops.min_gap
    return ScriptedLoops(drive, gap, setting.detection, false_share, seed=batch.seed)
