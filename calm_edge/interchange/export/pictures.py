"""Pictures as recorded with their stamps: a sequence folder, which `record --sequence` reads."""

from __future__ import annotations

from pathlib import Path

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.drive import RecordedDrive

PNG = b"\x89PNG"


class Pictures:
    """`cam0/`, `cam1/` and `times0.txt`, `times1.txt`: seconds, a line for each picture.

    Needs no poses: a recording of one camera, or without a backbone, can be exported too.
    """

    name = "pictures"
    writes = "pictures as recorded and their stamps"

    def write(self, drive: RecordedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write the pictures, as the camera sent them; raises InterchangeError without any."""
        wrote = []
        for eye in drive.eyes:
            (folder / f"cam{int(eye)}").mkdir()
            count = 0
            with (folder / f"times{int(eye)}.txt").open("w") as times:
                for frame in drive.recording.frames(eye):
                    # recordings hold files of pictures, no pixels
                    assert isinstance(frame.image, bytes)
                    suffix = "png" if frame.image.startswith(PNG) else "jpg"
                    name = f"cam{int(eye)}/{count:06d}.{suffix}"
                    (folder / name).write_bytes(frame.image)
                    own_ns = frame.t_ns + drive.stamp_ns
                    times.write(f"{own_ns // 10**9}.{own_ns % 10**9:09d}\n")
                    count += 1
            wrote.append(f"cam{int(eye)}: {count} pictures of the {eye.name.lower()}")
            wrote.append(f"times{int(eye)}.txt: their stamps in seconds")
        if not wrote:
            raise InterchangeError(f"{drive.path}: holds no pictures; nothing to export")
        left_out = ("poses (--to tum)", "what else the recording holds: GPS, calibration, sub-maps")
        return Written(tuple(wrote), (f"stamps {drive.stamps}",), left_out)
