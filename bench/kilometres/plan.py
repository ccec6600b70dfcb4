"""Runs that the kilometre tables need, in the order of running."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bench.kilometres.outcomes import Setting
from bench.kilometres.rivals import HeldViews, rival
from bench.kilometres.runs import Variant
from bench.kilometres.streams import Streams

OPEN = Setting("open")
LOOPS = Setting("loops", loops=True, false_share=0.05)
ASYNC = Setting("async", Streams(alternate=True))
HALVED = Setting("halved", Streams(halved=True))

_HELD = HeldViews()
OURS = Variant("ours")
SIM3, SL4 = rival("sim3", _HELD), rival("sl4", _HELD)
RIVALS = (SIM3, SL4)


@dataclass(frozen=True, slots=True)
class Ablation:
    """A variant of our method with one part switched off.

    paper: error over that of the full model in the paper (table 9), None if not reported. why:
    explanation printed if the difference is not significant.
    """

    variant: Variant
    title: str
    paper: float | None
    why: str


def _without(name: str, **changes: dict[str, object]) -> Variant:
    return Variant(name, changes)


PAPER_SEARCH = _without("paper-search", correction={"weighted": False, "refine": False})
ABLATIONS = (
    Ablation(
        _without("no-optimisation", posegraph={"optimise": False}),
        "w/o optimisation",
        19.24 / 19.07,
        "without loops the graph only averages the overlaps of the windows",
    ),
    Ablation(
        _without("no-correction", correction={"apply": "never"}),
        "w/o pose correction",
        28.18 / 19.07,
        "no gain where the estimated focal is not better than the backbone's",
    ),
    Ablation(
        _without("no-rotation", correction={"rotation": False}),
        "w/o rotation correction",
        27.93 / 19.07,
        "improves turns where the estimated focal is right and bends them where it is wrong",
    ),
    Ablation(
        _without("no-translation", correction={"translation": False}),
        "w/o translation correction",
        20.07 / 19.07,
        "the direction of forward travel hardly depends on the focal; the paper has 5 %",
    ),
    Ablation(
        _without("no-scale", scale={"rectify": False}),
        "w/o scale rectification",
        45.14 / 19.07,
        "the raw scale of the windows is nearly constant",
    ),
    Ablation(
        PAPER_SEARCH,
        "search as in the paper",
        None,
        "which search is nearer to the true focal differs by drive",
    ),
    Ablation(
        _without("loose-rig", correction={"rigid_rig": False}),
        "w/o rigid rig",
        None,
        "with right focals the assistant has no constant turn to remove",
    ),
    Ablation(
        _without("general-translation", correction={"general_translation": True}),
        "general translation form",
        None,
        "rotation between neighbouring keyframes is small, where both forms agree",
    ),
)

TABLES = ("ate", "loops", "sync", "scale", "focal", "ablation")
# the shorter drives, fewest frames first
SHORT = ("04", "03", "07", "06", "10", "09", "05")
REVISITING = ("00", "02", "05", "06", "07", "09")


@dataclass(frozen=True, slots=True)
class Batch:
    """Variants to run on one drive, seed and setting."""

    name: str
    seed: int
    setting: Setting
    variants: tuple[Variant, ...]


def batches(
    only: Sequence[str], names: Sequence[str], seeds: Sequence[int], repeated: Sequence[str] = ()
) -> list[Batch]:
    """List the runs of the tables `only`, those that most tables need first.

    At the first seed all drives run without loop closing; then follow the other settings and seeds,
    first on the drives in SHORT. repeated: drives to run at the seeds after the first; all if
    empty.
    """
    first, further, last = [], [], []
    ordered = [n for n in SHORT if n in names] + [n for n in names if n not in SHORT]
    for seed in seeds:
        for name in ordered:
            if seed != seeds[0] and repeated and name not in repeated:
                continue
            for rank, batch in enumerate(_of_drive(only, name, seed)):
                if seed == seeds[0] and rank == 0:
                    first.append(batch)
                elif name in SHORT:
                    further.append(batch)
                else:
                    last.append(batch)
    return first + further + last


def _of_drive(only: Sequence[str], name: str, seed: int) -> list[Batch]:
    wanted, found = set(only), []
    open_ones: tuple[Variant, ...] = ()
    if wanted & {"ate", "scale"}:
        open_ones = (OURS, *RIVALS)
    elif wanted & {"focal", "sync", "ablation", "loops"}:
        open_ones = (OURS,)
    found.append(Batch(name, seed, OPEN, open_ones))
    if "sync" in wanted:
        found += [Batch(name, seed, setting, (OURS,)) for setting in (ASYNC, HALVED)]
    if "loops" in wanted and name in REVISITING:
        found.append(Batch(name, seed, LOOPS, (OURS, *RIVALS)))
    if "ablation" in wanted:
        found.append(Batch(name, seed, OPEN, tuple(a.variant for a in ABLATIONS)))
    return found
