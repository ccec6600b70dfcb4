"""One drive's part of a map of several: its sub-maps in their own world, and their depth."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path

import numpy as np

from calm_edge.config import Config
from calm_edge.mapping.spool import Spool
from calm_edge.offline.densify import densified, pictures
from calm_edge.offline.drive import Drive
from calm_edge.offline.progress import Progress
from calm_edge.offline.shared_places import JoinError, PlacedDrive
from calm_edge.offline.unfinished import FOLDER, Unfinished, plan
from calm_edge.recording.reader import Recording
from device.atomic_file import replace_text

# says that a part is complete
DONE = "part.json"


@dataclass(frozen=True, slots=True)
class DrivePart:
    """A part as read: the placed drive, its configuration, and the spool with its depth."""

    placed: PlacedDrive
    config: Config
    spool: Spool


def write_part(
    recording: Recording,
    config: Config,
    drive: Drive,
    out: Path,
    work: Unfinished,
    say: Callable[[str], None],
) -> list[str]:
    """Compute the depth of all sub-maps to the spool of `work`, in `out`; return the losses.

    Depth that an interrupted run has computed is not computed again.
    """
    spool = Spool(work.spool)
    masks = drive.updates[-1].masks
    missing = [not spool.holds(update.submap.id) for update in drive.updates]
    windows = list(compress(drive.windows, missing))
    updates = [replace(update, masks=masks) for update in compress(drive.updates, missing)]
    losses = list(drive.losses)
    progress = Progress("depth of sub-maps", len(windows), say)
    depths = densified(recording.path, config, windows, updates)
    for record, depth in zip(windows, depths, strict=True):
        progress.step()
        if isinstance(depth, str):
            losses.append(depth)
            continue
        spool.write(record.submap_id, *depth, pictures(recording.window(record), depth[0]))
    content = {"recording": str(recording.path.resolve()), "losses": losses}
    replace_text(out / DONE, json.dumps(content) + "\n")
    return losses


def read_part(folder: Path, recording: Path, config: Config) -> DrivePart:
    """Read the part of a recording; raises JoinError if it is not complete."""
    if not (folder / DONE).is_file():
        raise JoinError(f"{folder}: not complete; continue with --resume")
    work = Unfinished(folder / FOLDER, config, plan(recording, config))
    drive = work.placed()
    if drive is None:
        raise JoinError(f"{folder}: holds no placed sub-maps; start anew with --force")
    drive.losses = json.loads((folder / DONE).read_text())["losses"]
    return DrivePart(PlacedDrive(Recording(recording), drive), config, Spool(work.spool))


def depth_of(part: DrivePart, submap_id: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Depth (N, h, w) and confidence (N, h, w) of a sub-map; None if it has none."""
    if not part.spool.holds(submap_id):
        return None
    found = part.spool.depth(submap_id)
    return found.depth, found.confidence.astype(np.float32) / np.float32(255)
