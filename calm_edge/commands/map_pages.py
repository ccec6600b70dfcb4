"""The two pages of a map: what map.html shows, and report.html."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calm_edge.config import Config
    from calm_edge.evaluation.estimate import Estimate
    from calm_edge.evaluation.truth import Truth
    from calm_edge.mapping.seams import Seam
    from calm_edge.offline.drive import Drive
    from calm_edge.offline.map_times import MapTimes
    from calm_edge.recording.reader import Recording
    from calm_edge.report.blur import Blur
    from calm_edge.report.keyframe_pictures import KeyframePictures
    from calm_edge.report.map_page import MapView
    from calm_edge.types import Bytes, Int

# keyframes with pictures in map.html of a preview: each takes about 6 ms
PREVIEW_PAIRS = 100


@dataclass(frozen=True, slots=True)
class Options:
    """Options of `map` on its outputs.

    quality: name of the preset. pictures: whether the pages have pictures of the cameras. blur:
    applied to these.
    """

    quality: str = "normal"
    pictures: bool = True
    blur: Blur | None = None

    @property
    def pairs(self) -> int:
        """Largest number of keyframes with pictures in map.html."""
        from calm_edge.report.keyframe_pictures import MAX_PAIRS

        return PREVIEW_PAIRS if self.quality == "preview" else MAX_PAIRS


def title(recording: Recording) -> str:
    """Name of the recording and of the folder that it is in."""
    path = recording.path.resolve()
    return f"{path.parent.name}/{path.name}"


def drive_view(
    recording: Recording,
    config: Config,
    drive: Drive,
    estimate: Estimate,
    color: Bytes,
    tiles: Int,
    seams: Sequence[Seam],
    options: Options,
    most: int | None = None,
) -> MapView:
    """What map.html shows of a drive.

    color: (P, 3) RGB of the estimate's points. tiles: rows (sub-map id, points). most: number of
    keyframes with pictures; None: as many as one page has.
    """
    from calm_edge.report.drive_view import map_view
    from calm_edge.report.events import marked_events
    from calm_edge.report.keyframe_pictures import keyframe_pictures

    origin = recording.origin_ns
    stamps = estimate.t_ns + origin
    shown: Sequence[KeyframePictures] = ()
    if options.pictures:
        pairs = options.pairs if most is None else most
        shown = keyframe_pictures(recording, drive.windows, stamps, options.blur, pairs)
    submaps = [update.submap for update in drive.updates]
    grain = config.mapping.cloud_voxel * config.scale.spacing
    events = marked_events(recording.events(), stamps, estimate.T_w_c)
    return map_view(
        title(recording), estimate, color, tiles, submaps, origin, grain, shown, seams, events
    )


def write_report(
    recording: Recording,
    drive: Drive,
    estimate: Estimate,
    color: Bytes,
    truth: Truth | None,
    losses: Sequence[str],
    out: Path,
    times: MapTimes,
    options: Options,
) -> list[str]:
    """Write report.html, including the trajectory error if truth is given; return what it lacks.

    color: (P, 3) RGB of the estimate's points. losses: lines that the page names.
    """
    from calm_edge.offline.georeference import ENU_TUM, GPS_SUMMARY
    from calm_edge.offline.map_drive import OUTPUTS, PAGE, REPORT
    from calm_edge.report.drive_log import read_log
    from calm_edge.report.drive_report import compared, report_data
    from calm_edge.report.events import marked_events
    from calm_edge.report.keyframe_pictures import late_pictures
    from calm_edge.report.report import write_report as write

    figures, truth, missing = compared(estimate, truth)
    pictures = late_pictures(recording, drive.windows) if options.pictures else []
    if options.blur is not None:
        pictures = [None if picture is None else options.blur(picture) for picture in pictures]
    origin = recording.origin_ns
    poses = sorted(recording.poses(), key=lambda sample: sample.t_ns)
    zero_ns = int(estimate.t_ns[0]) + origin if len(estimate.t_ns) else None
    data = report_data(
        title(recording),
        estimate,
        drive.updates,
        color,
        truth,
        figures,
        [*losses, *missing],
        pictures,
        read_log(recording, zero_ns, poses),
        origin,
        marked_events(recording.events(), estimate.t_ns + origin, estimate.T_w_c),
    )
    written = [name for name in (*OUTPUTS, ENU_TUM, GPS_SUMMARY) if name != REPORT]
    files = (*(out / name for name in written), recording.path)
    write(out / REPORT, replace(data, map_s=times.seconds, files=files, map_page=PAGE))
    return missing
