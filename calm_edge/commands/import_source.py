"""`calm-edge import`: make a recording of videos, data sets, bags or folders of images."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.commands.configuration import add_configuration, effective_config
from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import OK

if TYPE_CHECKING:
    from calm_edge.config import Config
    from calm_edge.interchange.base import Imported, ImportOptions


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "source", type=Path, nargs="+", metavar="SOURCE", help="one source, or one for each camera"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="REC", help="a new recording")
    parser.add_argument(
        "--offset-s",
        type=float,
        metavar="X",
        help="added to the assistant's stamps; default: found from the motion",
    )
    parser.add_argument("--primary", default="", metavar="TOPIC", help="a bag's topic")
    parser.add_argument("--assistant", default="", metavar="TOPIC", help="a bag's topic")
    parser.add_argument(
        "--single",
        action="store_true",
        help="keep the pictures of a single camera: poses and maps need two",
    )
    parser.add_argument(
        "--rotate",
        type=int,
        nargs="+",
        choices=(0, 90, 180, 270),
        metavar="DEG",
        help="rotate the pictures clockwise, a value for each camera; default: as the file says",
    )
    parser.add_argument(
        "--accept-unsteady",
        action="store_true",
        help="accept video that looks stabilised or zoomed",
    )
    parser.add_argument(
        "--quality",
        type=int,
        metavar="Q",
        help="JPEG quality of decoded video, 1 to 100; default: recording.jpeg_quality",
    )
    add_configuration(parser)
    # nothing waits for an import
    parser.set_defaults(pace="lockstep")


def run(arguments: argparse.Namespace) -> int:
    """Import the sources; print what was taken, dropped and assumed."""
    from calm_edge.interchange import recorded
    from calm_edge.interchange.calibration.opencv import FILE as OPENCV
    from calm_edge.interchange.registry import importer
    from calm_edge.processes import interrupted_by_sigterm

    config = effective_config(arguments)
    options = parsed(arguments, config)
    sources = tuple(arguments.source)
    found = importer(sources)
    # what the writer logs of the disk is the error that ends an import, which is printed
    logging.getLogger("calm_edge.recording").addHandler(logging.NullHandler())
    with interrupted_by_sigterm(), recorded.unfinished(arguments.out, say) as folder:
        scratch = folder / "scratch"
        scratch.mkdir()
        imported = found.open(sources, options, scratch, say)
        counts = recorded.write(imported, with_spacing(config, imported), folder, found.name)
        recorded.remove(scratch)
    print(f"recording   {arguments.out}")
    print(f"frames      {', '.join(f'{n} {eye.name.lower()}' for eye, n in counts.items())}")
    for title, lines in facts(imported):
        for line in lines:
            print(f"{title:11} {line}")
    if imported.calibration is not None:
        print(f"calibration {arguments.out / recorded.CALIBRATION / OPENCV}")
    if imported.truth is not None:
        print(f"truth       {arguments.out / recorded.TRUTH} (eval --truth)")
    return OK


def parsed(arguments: argparse.Namespace, config: Config) -> ImportOptions:
    """Check the arguments; raises InterchangeError."""
    from calm_edge.interchange import InterchangeError
    from calm_edge.interchange.base import ImportOptions

    if len(arguments.source) > 2:
        raise InterchangeError(f"{len(arguments.source)} sources: give one or two")
    quality = config.recording.jpeg_quality if arguments.quality is None else arguments.quality
    if not 1 <= quality <= 100:
        raise InterchangeError(f"--quality {quality}: must be from 1 to 100")
    return ImportOptions(
        single=arguments.single,
        offset_s=arguments.offset_s,
        quality=quality,
        topics=(arguments.primary, arguments.assistant),
        turn_deg=None if arguments.rotate is None else tuple(arguments.rotate),
        unsteady=arguments.accept_unsteady,
    )


def with_spacing(config: Config, imported: Imported) -> Config:
    """Set the published spacing, unless the user gave one."""
    from calm_edge.config import merge

    published = imported.calibration.spacing_m if imported.calibration is not None else None
    if config.scale.spacing_m or not published:
        return config
    return merge(config, {"scale": {"spacing_m": published}})


def facts(imported: Imported) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """What was taken, dropped and assumed, with titles."""
    return (
        ("took", imported.took),
        ("dropped", tuple(imported.dropped) or ("nothing",)),
        ("assumed", imported.assumed or ("nothing",)),
    )
