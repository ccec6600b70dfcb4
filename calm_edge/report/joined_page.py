"""Report of a map of several drives: which are joined, their paths and the cloud."""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calm_edge import __version__
from calm_edge.geometry.polyline import path_length
from calm_edge.report import curves, map_image, map_sections, page, tables
from calm_edge.types import Bytes, Float, Float32


@dataclass(frozen=True, slots=True)
class DriveRow:
    """A drive. T_w_c: (N, 4, 4), in the common frame unless it is apart.

    scale: factor by which its lengths were multiplied. report: its own page.
    """

    name: str
    T_w_c: Float
    apart: bool
    scale: float
    report: Path


@dataclass(frozen=True, slots=True)
class JoinedData:
    """Content of the page. drives: in order; the first one's start is the common frame.

    closures: pairs of names and the number of common places. points_w: (P, 3), color: (P, 3) RGB.
    notes: on what is missing. files: to link to.
    """

    title: str
    unit: str
    drives: tuple[DriveRow, ...]
    closures: tuple[tuple[str, str, int], ...]
    points_w: Float32
    color: Bytes
    notes: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()

    @property
    def joined(self) -> list[DriveRow]:
        """Drives in the common frame."""
        return [drive for drive in self.drives if not drive.apart]


def render(data: JoinedData, path: Path) -> str:
    """The page as self-contained HTML text. path: of the page, from which it links to files."""
    lead = f"A map of {len(data.drives)} drives, calm-edge {__version__}"
    parts = [f'<h1>{html.escape(data.title)}</h1><p class="lead">{html.escape(lead)}</p>']
    parts.append(f'<p class="account">{html.escape(account(data))}</p>')
    if data.notes:
        items = "".join(f"<li>{html.escape(note)}</li>" for note in data.notes)
        parts.append(page.section("Not observed, not complete", "", f"<ul>{items}</ul>", "warn"))
    together = data.joined
    R = map_image.level_rotation(np.concatenate([drive.T_w_c for drive in together]))
    paths = [drive.T_w_c[:, :3, 3] @ R.T for drive in together]
    drawn = curves.overlaid(paths, [drive.name for drive in together], data.unit)
    note = "Each begins at its dot. Drives that are apart are in their own reports."
    parts.append(page.section("The drives from above", note, drawn))
    parts += map_sections.sections(data.points_w, data.color, R, paths, data.unit)
    columns = "drive", "path", "keyframes", "frame", "lengths multiplied by"
    rows = [
        (
            drive.name,
            f"{_length(drive):,.1f} {data.unit}",
            str(len(drive.T_w_c)),
            "its own: apart" if drive.apart else "common",
            f"{drive.scale:.4f}",
        )
        for drive in data.drives
    ]
    parts.append(page.section("Drives", "", tables.rows(columns, rows)))
    if data.closures:
        found = [(f"{a} and {b}", str(count)) for a, b, count in data.closures]
        note = "Places recognised in both, whose poses agree."
        table = tables.rows(("drives", "common places"), found)
        parts.append(page.section("Joined by", note, table))
    reports = [drive.report for drive in data.drives]
    if links := tables.files(path, [*reports, *data.files]):
        note = "These open as long as the page stays where it is."
        parts.append(page.section("Files", note, links))
    return page.whole(data.title, parts)


def write_joined(path: Path, data: JoinedData) -> None:
    """Write the page as UTF-8, replacing an earlier one at once."""
    page.write(path, render(data, path))


def account(data: JoinedData) -> str:
    """What was joined, in sentences."""
    together = data.joined
    length = sum(_length(drive) for drive in together)
    if len(together) == 1:
        text = f"No drive shows a place of another: the map is of {together[0].name} alone."
    else:
        places = sum(count for _, _, count in data.closures)
        text = (
            f"{len(together)} drives, {length:,.0f} {data.unit} in all, are in one frame, joined "
            f"by {places} common places."
        )
    apart = [drive.name for drive in data.drives if drive.apart]
    if apart and len(together) > 1:
        text += f" Apart, without a common place: {', '.join(apart)}."
    return text


def _length(drive: DriveRow) -> float:
    return path_length(drive.T_w_c[:, :3, 3])
