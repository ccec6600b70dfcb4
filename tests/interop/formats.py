"""Table of all formats in and out, each opened by a reader of another maker: `make formats`.

    python -m tests.interop.formats [MAP TRUTH]

Sources are small and made on the spot. What is exported is MAP, a folder made by `map`, with the
truth of its drive; without one a small drive whose poses are known exactly. Readers that are not
installed are named and skipped: evo, pycolmap, laspy, pyproj, rosbags, PyAV.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from calm_edge.evaluation.table import aligned
from calm_edge.geometry import se3
from calm_edge.mapping.cloud_file import CloudWriter
from calm_edge.trajectories import write_kitti
from calm_edge.types import MapTile
from tests.interchange.export.drives import (
    FRAMES,
    MARKERS,
    ORIGIN_NS,
    georeferenced,
    live_poses,
    true_poses,
    true_times,
    with_map,
    write_recording,
)
from tests.interop import formats_in, formats_out
from tests.interop.format_row import Row
from tests.interop.formats_out import Drive

COLUMNS = "format", "source", "opened by", "figures", "agrees"


def small_drive(folder: Path) -> Drive:
    """A georeferenced map with a cloud, and a truth that is off by 5 cm and in another frame."""
    recording = write_recording(folder / "recording", live=live_poses(1.0, exact=True))
    made = georeferenced(with_map(recording, folder / "map"))
    with CloudWriter(made / "map.ply") as cloud:
        points = np.random.default_rng(1).uniform(-1, 1, (500, 3)) + np.resize(MARKERS, (500, 3))
        cloud.write(MapTile(points.astype(np.float32), np.full((500, 3), 90, np.uint8)))
    truth = folder / "truth"
    truth.mkdir()
    T = se3.exp(np.array([3.0, 1, 2, 0.2, 0.4, 0.1])) @ true_poses()
    T[:, :3, 3] += np.random.default_rng(3).normal(0, 0.05, (FRAMES, 3))
    write_kitti(truth / "poses0.txt", T)
    own = (true_times() - ORIGIN_NS).tolist()
    (truth / "times0.txt").write_text("".join(f"{t / 1e9:.9f}\n" for t in own))
    return Drive(made, truth)


def read(row: Row) -> tuple[str, str, str, bool | None]:
    """Reader, figures and whether they agree, None if the reader is absent."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            found = row.read(Path(folder))
        except ImportError as error:
            return row.source, "-", f"skipped: not installed: {error.name or error}", None
        except RuntimeError as error:
            return row.source, "-", str(error), False
    return row.source, found.reader, found.figures, found.agrees


def main(arguments: list[str]) -> int:
    """Print the tables; 1 if a reader does not agree."""
    with tempfile.TemporaryDirectory() as scratch:
        drive = (
            Drive(Path(arguments[0]), Path(arguments[1]))
            if arguments
            else small_drive(Path(scratch))
        )
        failed = False
        for title, rows in (("In", formats_in.ROWS), ("Out", formats_out.rows(drive))):
            lines = [(row.name, *read(row)) for row in rows]
            failed |= any(line[-1] is False for line in lines)
            print("\n".join([title, *aligned(lines, COLUMNS)]), flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
