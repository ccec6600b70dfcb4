"""What `calm-edge map` is given beside each of several recordings: true poses and GPS fixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calm_edge.evaluation.truth import Truth
    from calm_edge.offline.gps_fixes import GpsFixes


@dataclass(frozen=True, slots=True)
class DriveReference:
    """Truth and fixes of one drive; None without."""

    truth: Truth | None = None
    fixes: GpsFixes | None = None


def references(
    recordings: Sequence[Path],
    names: Sequence[str],
    truths: Sequence[Path],
    gps: Sequence[Path],
) -> list[DriveReference]:
    """Read what was given for each recording; raises CalmEdgeError.

    truths: none, or one for each. gps: none, in which case recorded fixes are taken, one for each,
    or one with the fixes of all.
    """
    from calm_edge.evaluation.truth import read_truth
    from calm_edge.offline.joined_gps import fixes_of_drives
    from calm_edge.recording.reader import Recording
    from calm_edge.types import CalmEdgeError

    n = len(recordings)
    if truths and len(truths) != n:
        raise CalmEdgeError(f"--truth: {len(truths)} for {n} recordings; give one for each")
    if len(gps) not in (0, 1, n):
        raise CalmEdgeError(
            f"--gps: {len(gps)} for {n} recordings; give one for each, or one with the fixes of all"
        )
    read = [read_truth(folder) for folder in truths]
    opened = dict(zip(names, map(Recording, recordings), strict=True))
    fixes = fixes_of_drives(opened, gps)
    return [DriveReference(read[i] if read else None, fixes[i]) for i in range(n)]


def only(given: Sequence[Path], option: str) -> Path | None:
    """What an option gives for a map of one recording; raises CalmEdgeError if it is repeated."""
    from calm_edge.types import CalmEdgeError

    if len(given) > 1:
        raise CalmEdgeError(f"--{option}: {len(given)} for one recording; give one")
    return given[0] if given else None
