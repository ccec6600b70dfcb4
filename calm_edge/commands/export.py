"""`calm-edge export`: write a drive in the formats of other programs."""

from __future__ import annotations

import argparse
from pathlib import Path

from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import LOSS, OK

# as of interchange/export/registry, which is not imported for `--help`
FORMATS = (
    "tum",
    "kitti",
    "csv",
    "colmap",
    "transforms",
    "ply",
    "laz",
    "ros2",
    "geojson",
    "gpx",
    "kml",
    "pictures",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "source", type=Path, metavar="REC_OR_MAP", help="a recording, or a folder made by map"
    )
    parser.add_argument("--to", choices=FORMATS, required=True, help="the format")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="a new folder")
    parser.add_argument(
        "--recording", type=Path, metavar="REC", help="of the map, if it was moved since"
    )
    parser.add_argument(
        "--distorted",
        action="store_true",
        help="pictures as recorded, with the lens (OPENCV, OPENCV_FISHEYE); default: undistorted",
    )
    parser.add_argument(
        "--every-frame",
        action="store_true",
        help="colmap and transforms: all frames that have a pose, not the keyframes alone",
    )
    parser.add_argument("--binary", action="store_true", help="COLMAP's .bin files")
    parser.add_argument("--force", action="store_true", help="replace files in the output folder")


def run(arguments: argparse.Namespace) -> int:
    """Export; print what was written, assumed and left out."""
    from calm_edge.interchange.export.base import ExportOptions
    from calm_edge.interchange.export.drive import RecordedDrive, read_drive, read_recorded
    from calm_edge.interchange.export.output import output_folder
    from calm_edge.interchange.export.pictures import Pictures
    from calm_edge.interchange.export.registry import EXPORTERS

    options = ExportOptions(
        arguments.distorted, arguments.binary, every_frame=arguments.every_frame
    )
    with output_folder(arguments.out, force=arguments.force) as folder:
        source = arguments.source, arguments.recording
        drive: RecordedDrive
        if arguments.to == Pictures.name:
            drive = read_recorded(*source)
            written = Pictures().write(drive, folder, options)
        else:
            drive = placed = read_drive(*source)
            written = EXPORTERS[arguments.to].write(placed, folder, options)
    for line in written.wrote:
        print(f"wrote       {arguments.out}/{line}")
    for line in written.assumed:
        print(f"assumed     {line}")
    for line in written.left_out or ("nothing",):
        print(f"left out    {line}")
    for line in drive.recording.losses:
        say(f"loss: {line}")
    return LOSS if drive.recording.losses else OK
