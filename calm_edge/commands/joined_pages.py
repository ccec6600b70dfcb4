"""Pages of a map of several drives: a report of each, map.html and report.html of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calm_edge.commands.map_pages import Options, drive_view, write_report

if TYPE_CHECKING:
    from calm_edge.commands.finished_drive import FinishedDrive
    from calm_edge.mapping.seams import Seam
    from calm_edge.offline.joined_drives import Joined
    from calm_edge.report.joined_page import DriveRow


def write_reports(finished: Sequence[FinishedDrive], options: Options) -> list[str]:
    """Write the report of each drive; return a line for each thing missing in a drive."""
    from calm_edge.offline.map_times import MapTimes

    lines = []
    for each in finished:
        args = each.part.placed.recording, each.drive, each.estimate, each.color
        truth, folder = each.given.truth, each.folder
        lacking = write_report(*args, truth, each.losses, folder, MapTimes(), options)
        lines += [f"{each.name}: {line}" for line in (*each.losses, *lacking)]
    return lines


def write_pages(
    finished: Sequence[FinishedDrive],
    joined: Joined,
    closures: Sequence[tuple[str, str, int]],
    seams: Sequence[Seam],
    losses: Sequence[str],
    out: Path,
    options: Options,
) -> None:
    """Write map.html and report.html; print where."""
    from calm_edge.mapping.cloud_file import read_cloud
    from calm_edge.offline.georeference import GPS_SUMMARY
    from calm_edge.offline.map_drive import MAP, OUTPUTS, PAGE, REPORT, TUM
    from calm_edge.report.account import unit
    from calm_edge.report.joined_page import JoinedData, write_joined
    from calm_edge.report.joined_view import joined as joined_view
    from calm_edge.report.map_page import write_map_page

    together = [each for each in finished if not each.apart]
    title = " + ".join(each.name for each in together)
    views = []
    for each in together:
        own = each.part.placed.recording, each.part.config, each.drive, each.estimate
        most = max(options.pairs // len(together), 2)
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


def _row(n: int, each: FinishedDrive, joined: Joined) -> DriveRow:
    from calm_edge.offline.map_drive import REPORT
    from calm_edge.report.joined_page import DriveRow

    scale = joined.scales.get(n, 1.0)
    return DriveRow(each.name, each.estimate.T_w_c, each.apart, scale, each.folder / REPORT)
