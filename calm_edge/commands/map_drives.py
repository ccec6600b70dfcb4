"""`calm-edge map` of several recordings: one map of the place that they show."""

from __future__ import annotations

import argparse
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import ERROR, LOSS, OK
from calm_edge.processes import interrupted_by_sigterm

if TYPE_CHECKING:
    from calm_edge.commands.map_pages import Options
    from calm_edge.config import Config

# folder of what is computed of each drive, and in it of what is computed of all
PARTS, SCRATCH = "parts", "joined"


def run(arguments: argparse.Namespace, options: Options) -> int:
    """Map each drive by a command of its own, then join them; 3 if a drive is apart or lacks parts.

    The output folder holds no map, or one to be replaced. Raises CalmEdgeError.
    """
    from calm_edge.commands.drive_reference import references
    from calm_edge.commands.joined_outputs import write
    from calm_edge.offline import drive_jobs
    from calm_edge.offline.drive_part import read_part
    from calm_edge.offline.joined_drives import join
    from calm_edge.offline.shared_places import closures
    from calm_edge.types import CalmEdgeError

    out: Path = arguments.out
    recordings: list[Path] = arguments.recording
    names = unique_names(recordings)
    configs = agreed_configs(recordings, arguments.set, options.quality)
    given = references(recordings, names, arguments.truth, arguments.gps)
    parts = out / PARTS
    if arguments.force:
        shutil.rmtree(parts, ignore_errors=True)
    elif parts.exists() and not arguments.resume:
        raise CalmEdgeError(
            f"{out}: holds an unfinished map; continue it with --resume, or replace it with --force"
        )
    started = time.monotonic()
    with interrupted_by_sigterm():
        parts.mkdir(parents=True, exist_ok=True)
        commands = [
            part_command(recording, parts / name, arguments.set, options.quality)
            for recording, name in zip(recordings, names, strict=True)
        ]
        ran = (
            drive_jobs.here(commands)
            if arguments.dask is None
            else drive_jobs.on_dask(commands, arguments.dask)
        )
        failed = [name for name, code in zip(names, ran, strict=True) if code not in (OK, LOSS)]
        if failed:
            say(f"{', '.join(failed)}: not mapped, see above; continue with --resume")
            return ERROR
        known = [i for i, name in enumerate(names) if (parts / name / "part.json").is_file()]
        read = [read_part(parts / names[i], recordings[i], configs[i]) for i in known]
        if not read:
            say("no drive could be mapped")
            return LOSS
        drives = [part.placed for part in read]
        joined = join(drives, closures(drives, configs[0], say), configs[0])
        kept = [names[i] for i in known], [given[i] for i in known]
        code = write(read, *kept, joined, out, parts / SCRATCH, options)
    for i, name in enumerate(names):
        if i not in known:
            say(f"loss: {name}: no window of it could be solved")
            code = LOSS
    shutil.rmtree(parts)
    print(f"took        {time.monotonic() - started:.0f} s")
    return code


def part_command(
    recording: Path, out: Path, settings: Sequence[str], quality: str = "normal"
) -> list[str]:
    """Arguments of Python for the work on one drive; continues what is in `out`."""
    options = ["--quality", quality, *(f"--set={text}" for text in settings)]
    again = ["--resume"] if out.exists() else []
    where = [str(recording.resolve()), "--out", str(out.resolve())]
    return ["-m", "calm_edge.cli", "map", *where, "--part", *again, *options]


def unique_names(recordings: Sequence[Path]) -> list[str]:
    """Name of each drive: that of its recording, with its number where two are alike."""
    names = [recording.resolve().name.removesuffix(".mcap") for recording in recordings]
    return [name if names.count(name) == 1 else f"{name}-{i}" for i, name in enumerate(names)]


def agreed_configs(
    recordings: Sequence[Path], settings: Sequence[str], quality: str = "normal"
) -> list[Config]:
    """Configurations of the recordings; raises CalmEdgeError if their lengths have no common unit.

    They have one in metres, or if all are of one kit without a spacing. quality: name of a preset,
    over which the settings are set.
    """
    from calm_edge.config import merge, parse_assignment
    from calm_edge.offline.quality import PRESETS
    from calm_edge.recording.reader import Recording
    from calm_edge.types import CalmEdgeError

    if len({recording.resolve() for recording in recordings}) < len(recordings):
        raise CalmEdgeError("a recording is named twice; name each once")
    found = []
    for recording in recordings:
        opened = Recording(recording)
        opened.check_cameras()
        config = merge(opened.config, PRESETS[quality])
        for text in settings:
            config = merge(config, parse_assignment(text))
        found.append(config)
    metric = [bool(config.scale.spacing_m) for config in found]
    if any(metric) and not all(metric):
        without = recordings[metric.index(False)]
        raise CalmEdgeError(
            f"{without}: has no scale.spacing_m, others have one; their lengths cannot be joined"
        )
    return found
