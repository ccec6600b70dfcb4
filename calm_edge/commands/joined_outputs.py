"""Write the outputs of a map of several drives: one cloud, and a folder for each drive."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import LOSS, OK
from calm_edge.commands.finished_drive import FinishedDrive
from calm_edge.commands.joined_pages import write_pages, write_reports

if TYPE_CHECKING:
    from calm_edge.commands.drive_reference import DriveReference
    from calm_edge.commands.map_pages import Options
    from calm_edge.evaluation.joint import JointError
    from calm_edge.mapping.seams import Seam
    from calm_edge.offline.drive_part import DrivePart
    from calm_edge.offline.joined_drives import Joined
    from calm_edge.types import Int

# folder of the output with one of each drive
DRIVES = "drives"


def write(
    parts: Sequence[DrivePart],
    names: Sequence[str],
    given: Sequence[DriveReference],
    joined: Joined,
    out: Path,
    scratch: Path,
    options: Options,
) -> int:
    """Write cloud, trajectories, pages and summary; print what was written; return the exit code.

    scratch: folder for the mapper's files, removed by the caller.
    """
    from calm_edge.mapping.seams import summary
    from calm_edge.offline.map_drive import MAP, SUMMARY, TUM

    tiles, seams = fused(parts, joined, out, scratch)
    joints = summary(seams)
    print(f"map         {out / MAP} ({int(tiles[:, 1].sum()):,} points)")
    if joints is not None:
        print(f"seams       {joints}")
    # of a map that is replaced
    shutil.rmtree(out / DRIVES, ignore_errors=True)
    finished = trajectories(parts, names, given, joined, out, tiles, options.quality)
    for each in finished:
        where = "in a world of its own" if each.apart else "in the common frame"
        print(f"trajectory  {each.folder / TUM} ({len(each.estimate.t_ns)} keyframes, {where})")
    closures = [(names[a], names[b], count) for (a, b), count in sorted(joined.used.items())]
    for a, b, count in closures:
        print(f"joined      {a} and {b} by {count} places")
    georeferenced(finished, out)
    error = compared(finished)
    losses = [*joined.notes, *write_reports(finished, options)]
    write_pages(finished, joined, closures, seams, losses, out, options)
    # the files of the first drive stand for the map in `export` and `eval`
    shutil.copyfile(finished[0].folder / TUM, out / TUM)
    content = json.loads((finished[0].folder / SUMMARY).read_text())
    folder = Path(DRIVES) / finished[0].name / content["submap_folder"]
    content["submap_folder"] = str(folder)
    content["drives"] = [
        {
            "name": each.name,
            "apart": each.apart,
            "scale": joined.scales.get(n, 1.0),
            "recording": str(each.part.placed.recording.path.resolve()),
        }
        for n, each in enumerate(finished)
    ]
    content["joined"] = [{"drives": [a, b], "closures": count} for a, b, count in closures]
    content["seams"] = None if joints is None else asdict(joints)
    content["error"] = None if error is None else asdict(error)
    (out / SUMMARY).write_text(json.dumps(content, indent=2) + "\n")
    for line in losses:
        say(f"loss: {line}")
    return LOSS if losses else OK


def fused(
    parts: Sequence[DrivePart], joined: Joined, out: Path, scratch: Path
) -> tuple[Int, tuple[Seam, ...]]:
    """Write the cloud of all joined drives.

    Returns rows (sub-map id, points), as in the file, and the seams; ids are of `shared_places`.
    """
    from calm_edge.mapping.cloud_file import CloudWriter
    from calm_edge.mapping.mapper import Mapper
    from calm_edge.offline.densify import pictures
    from calm_edge.offline.drive_part import depth_of
    from calm_edge.offline.joined_drives import numbered
    from calm_edge.offline.map_drive import MAP

    config = parts[0].config
    shutil.rmtree(scratch, ignore_errors=True)
    mapper = Mapper(config.mapping, config.scale.spacing, scratch, config.backbone.seed)
    for n, drive in joined.drives.items():
        part = parts[n]
        for record, update in zip(drive.windows, drive.updates, strict=True):
            depth = depth_of(part, update.submap.id)
            if depth is None:
                continue
            window = part.placed.recording.window(record)
            mapper.add(numbered(update.submap, n), *depth, pictures(window, depth[0]))
    say("fusing and deforming the sub-maps")
    sizes = []
    with CloudWriter(out / MAP, replace=True) as cloud:
        for tile in mapper.finish():
            cloud.write(tile)
            sizes.append(len(tile.points_w))
    return np.array([mapper.submap_ids(), sizes], np.int64).T, mapper.seams()


def trajectories(
    parts: Sequence[DrivePart],
    names: Sequence[str],
    given: Sequence[DriveReference],
    joined: Joined,
    out: Path,
    tiles: Int,
    quality: str,
) -> list[FinishedDrive]:
    """Write trajectory and summary of each drive, also of those that are apart."""
    from calm_edge.mapping.cloud_file import read_cloud
    from calm_edge.offline.map_drive import MAP, write_trajectory
    from calm_edge.offline.map_times import MapTimes
    from calm_edge.offline.shared_places import STRIDE

    points_w, color = read_cloud(out / MAP)
    owner = np.repeat(tiles[:, 0] // STRIDE, tiles[:, 1])
    found = []
    for n, (part, name, beside) in enumerate(zip(parts, names, given, strict=True)):
        drive, folder = joined.drives.get(n, part.placed.drive), out / DRIVES / name
        folder.mkdir(parents=True)
        times, recording = MapTimes(), part.placed.recording
        estimate = write_trajectory(recording, part.config, drive, folder, None, times, quality)
        mine = owner == n
        apart = n in joined.apart
        if not apart:
            estimate = replace(estimate, points_w=points_w[mine])
        own = tiles[tiles[:, 0] // STRIDE == n] - [STRIDE * n, 0]
        shown = estimate, color[mine], own
        found.append(FinishedDrive(name, part, drive, apart, *shown, folder, beside))
    return found


def georeferenced(finished: Sequence[FinishedDrive], out: Path) -> None:
    """Place the common frame, and each drive that is apart, by the fixes of the drives."""
    from calm_edge.offline.georeference import ENU_TUM, GPS_SUMMARY, georeference
    from calm_edge.offline.joined_gps import GpsDrive, place_joined

    for name in (ENU_TUM, GPS_SUMMARY):
        # of a map that is replaced
        (out / name).unlink(missing_ok=True)
    together: dict[int, GpsDrive] = {}
    for n, each in enumerate(finished):
        fixes = each.given.fixes
        if not each.apart:
            together[n] = GpsDrive(each.name, each.estimate, fixes)
        elif fixes is not None and georeference(each.estimate, fixes, each.folder, say):
            print(f"GPS         {each.folder / ENU_TUM}, {each.folder / GPS_SUMMARY}")
    placement = place_joined(together, say)
    if placement is None:
        return
    for n, drive in together.items():
        placement.write(drive.estimate, finished[n].folder)
    placement.write(finished[0].estimate, out)
    print(f"GPS         {out / GPS_SUMMARY}, {ENU_TUM} in the folder of each joined drive")


def compared(finished: Sequence[FinishedDrive]) -> JointError | None:
    """Error of the joined drives in one frame, printed; None, with a line, if it is not known."""
    from calm_edge.evaluation import EvaluationError
    from calm_edge.evaluation.joint import joint_error

    together = [each for each in finished if not each.apart]
    pairs = [(each.estimate, each.given.truth) for each in together if each.given.truth is not None]
    if len(pairs) < 2:
        return None
    try:
        error = joint_error(pairs)
    except EvaluationError as reason:
        say(f"not compared with the truth in one frame: {reason}")
        return None
    of = zip(together, error.by_drive, strict=True)
    each_m = ", ".join(f"{each.name} {ate_m:.3f} m" for each, ate_m in of)
    print(f"error       {error.ate_m:.3f} m (rms) in one frame: {each_m}")
    return error
