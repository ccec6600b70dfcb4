"""One drive of a map of several, when its trajectory is written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calm_edge.commands.drive_reference import DriveReference
    from calm_edge.evaluation.estimate import Estimate
    from calm_edge.offline.drive import Drive
    from calm_edge.offline.drive_part import DrivePart
    from calm_edge.types import Bytes, Int


@dataclass(frozen=True, slots=True)
class FinishedDrive:
    """A drive whose trajectory is written to its folder.

    drive: in the common frame unless it is apart. estimate: with the points of its own sub-maps,
    none if it is apart. color: (P, 3) RGB of these. tiles: rows (sub-map id, points). given: truth
    and fixes.
    """

    name: str
    part: DrivePart
    drive: Drive
    apart: bool
    estimate: Estimate
    color: Bytes
    tiles: Int
    folder: Path
    given: DriveReference

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
