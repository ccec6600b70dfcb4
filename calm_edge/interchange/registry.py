"""Choice of the importer by what the sources look like."""

from __future__ import annotations

from pathlib import Path

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.bag import Bags
from calm_edge.interchange.base import Importer
from calm_edge.interchange.euroc import EuRoC
from calm_edge.interchange.kitti_odometry import KittiOdometry
from calm_edge.interchange.kitti_raw import KittiRaw
from calm_edge.interchange.picture_folders import PictureFolders
from calm_edge.interchange.video_pair import VideoPair
from calm_edge.recording.segment import segment_files

# in the order in which they are asked: a folder of a data set may also look like a plainer one
IMPORTERS: tuple[Importer, ...] = (
    KittiRaw(),
    KittiOdometry(),
    EuRoC(),
    Bags(),
    VideoPair(),
    PictureFolders(),
)


def importer(sources: tuple[Path, ...]) -> Importer:
    """Return the first importer that recognises the sources; raises InterchangeError."""
    for source in sources:
        if not source.exists():
            raise InterchangeError(f"{source}: no such file or folder")
    for found in IMPORTERS:
        if found.recognises(sources):
            return found
    if sources[0].is_dir() and segment_files(sources[0]):
        raise InterchangeError(f"{sources[0]}: is a recording already; use record --replay, or map")
    known = "; ".join(i.reads for i in IMPORTERS)
    raise InterchangeError(f"{sources[0]}: not a format that can be imported ({known})")
