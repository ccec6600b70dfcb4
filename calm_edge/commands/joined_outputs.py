"""Write the outputs of a map of several drives: one cloud, and a folder for each drive."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import LOSS, OK
from calm_edge.commands.map_pages import Options, drive_view, write_report

if TYPE_CHECKING:
    from calm_edge.evaluation.estimate import Estimate
    from calm_edge.mapping.seams import Seam
    from calm_edge.offline.drive import Drive
    from calm_edge.offline.drive_part import DrivePart
    from calm_edge.offline.joined_drives import Joined
    from calm_edge.report.joined_page import DriveRow
    from calm_edge.types import Bytes, Int

# folder of the output with one of each drive
DRIVES = "drives"


@dataclass(frozen=True, slots=True)
class Finished:
    """A drive whose trajectory is written to its folder.

    drive: in the common frame unless it is apart. estimate: with the points of its own sub-maps,
    none if it is apart. color: (P, 3) RGB of these. tiles: rows (sub-map id, points).
    """

    name: str
    part: DrivePart
    drive: Drive
    apart: bool
    estimate: Estimate
    color: Bytes
    tiles: Int
    folder: Path

    @property
    def losses(self) -> list[str]:
        """A line for each missing part."""
        config, metre = self.part.config, self.drive.metre
        lines = [*self.part.placed.recording.losses, *self.drive.missing(config)]
        if config.scale.spacing_m and not metre.metric:
            lines.append(f"no metre: {metre.reason or 'unknown'}; lengths have an unknown scale")
        if self.apart:
            lines.append("is apart: no place of the others was recognised in it")
        return lines


def write(
    parts: Sequence[DrivePart],
    names: Sequence[str],
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
    finished = trajectories(parts, names, joined, out, tiles)
    for each in finished:
        where = "in a world of its own" if each.apart else "in the common frame"
        print(f"trajectory  {each.folder / TUM} ({len(each.estimate.t_ns)} keyframes, {where})")
    closures = [(names[a], names[b], count) for (a, b), count in sorted(joined.used.items())]
    for a, b, count in closures:
        print(f"joined      {a} and {b} by {count} places")
    georeferenced(finished, out)
    losses = [*joined.notes, *(f"{each.name}: {line}" for each in finished for line in each.losses)]
    write_pages(finished, joined, closures, seams, losses, out, options)
    # the files of the first drive stand for the map in `export` and `eval`
    shutil.copyfile(finished[0].folder / TUM, out / TUM)
    content = json.loads((finished[0].folder / SUMMARY).read_text())
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
            images = [keyframe.frame.bgr() for keyframe in window.keyframes()]
            mapper.add(numbered(update.submap, n), *depth, images)
    say("fusing and deforming the sub-maps")
    sizes = []
    with CloudWriter(out / MAP, replace=True) as cloud:
        for tile in mapper.finish():
            cloud.write(tile)
            sizes.append(len(tile.points_w))
    return np.array([mapper.submap_ids(), sizes], np.int64).T, mapper.seams()


def trajectories(
    parts: Sequence[DrivePart], names: Sequence[str], joined: Joined, out: Path, tiles: Int
) -> list[Finished]:
    """Write trajectory and summary of each drive, also of those that are apart."""
    from calm_edge.mapping.cloud_file import read_cloud
    from calm_edge.offline.map_drive import MAP, write_trajectory
    from calm_edge.offline.map_times import MapTimes
    from calm_edge.offline.shared_places import STRIDE

    points_w, color = read_cloud(out / MAP)
    owner = np.repeat(tiles[:, 0] // STRIDE, tiles[:, 1])
    found = []
    for n, (part, name) in enumerate(zip(parts, names, strict=True)):
        drive, folder = joined.drives.get(n, part.placed.drive), out / DRIVES / name
        folder.mkdir(parents=True)
        times, recording = MapTimes(), part.placed.recording
        estimate = write_trajectory(recording, part.config, drive, folder, None, times)
        mine = owner == n
        apart = n in joined.apart
        if not apart:
            estimate = replace(estimate, points_w=points_w[mine])
        own = tiles[tiles[:, 0] // STRIDE == n] - [STRIDE * n, 0]
        found.append(Finished(name, part, drive, apart, estimate, color[mine], own, folder))
    return found


def georeferenced(finished: Sequence[Finished], out: Path) -> None:
    """Place the common frame, and each drive that is apart, by the fixes recorded."""
    from calm_edge.offline.georeference import ENU_TUM, GPS_SUMMARY, georeference
    from calm_edge.offline.gps_fixes import fixes_of
    from calm_edge.offline.joined_gps import GpsDrive, place_joined

    for name in (ENU_TUM, GPS_SUMMARY):
        # of a map that is replaced
        (out / name).unlink(missing_ok=True)
    together: dict[int, GpsDrive] = {}
    for n, each in enumerate(finished):
        fixes = fixes_of(each.part.placed.recording, None)
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


def write_pages(
    finished: Sequence[Finished],
    joined: Joined,
    closures: Sequence[tuple[str, str, int]],
    seams: Sequence[Seam],
    losses: Sequence[str],
    out: Path,
    options: Options,
) -> None:
    """Write map.html, report.html and the report of each drive; print where."""
    from calm_edge.mapping.cloud_file import read_cloud
    from calm_edge.offline.georeference import GPS_SUMMARY
    from calm_edge.offline.map_drive import MAP, OUTPUTS, PAGE, REPORT, TUM
    from calm_edge.offline.map_times import MapTimes
    from calm_edge.report.account import unit
    from calm_edge.report.joined_page import JoinedData, write_joined
    from calm_edge.report.joined_view import joined as joined_view
    from calm_edge.report.keyframe_pictures import MAX_PAIRS
    from calm_edge.report.map_page import write_map_page

    for each in finished:
        args = each.part.placed.recording, each.drive, each.estimate, each.color
        write_report(*args, None, each.losses, each.folder, MapTimes(), options)
    together = [each for each in finished if not each.apart]
    title = " + ".join(each.name for each in together)
    views = []
    for each in together:
        own = each.part.placed.recording, each.part.config, each.drive, each.estimate
        most = max(MAX_PAIRS // len(together), 2)
        views.append(drive_view(*own, each.color, each.tiles, (), options, most))
    view = joined_view(title, [each.name for each in together], views)
    marks = [np.zeros((0, 4), np.float32), *(seam.marks for seam in seams)]
    page = write_map_page(out / PAGE, replace(view, seams=np.concatenate(marks)))
    print(f"walk        {out / PAGE} ({page})")
    rows = tuple(_row(n, each, joined) for n, each in enumerate(finished))
    beside = [name for name in (*OUTPUTS, GPS_SUMMARY) if name not in (REPORT, TUM)]
    data = JoinedData(
        title,
        unit(together[0].estimate),
        rows,
        tuple(closures),
        *read_cloud(out / MAP),
        tuple(losses),
        tuple(out / name for name in beside),
    )
    write_joined(out / REPORT, data)
    print(f"report      {out / REPORT}, and one in the folder of each drive")


def _row(n: int, each: Finished, joined: Joined) -> DriveRow:
    from calm_edge.offline.map_drive import REPORT
    from calm_edge.report.joined_page import DriveRow

    scale = joined.scales.get(n, 1.0)
    return DriveRow(each.name, each.estimate.T_w_c, each.apart, scale, each.folder / REPORT)
