"""Import of folders of pictures: a sequence folder, or a folder for each camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.base import ONE_CAMERA, Imported, ImportOptions
from calm_edge.recording.picture_file import SUFFIXES
from calm_edge.recording.picture_folder import PictureFolder
from calm_edge.recording.sequence_folder import ORIGIN_NS, SequenceFolder
from calm_edge.recording.stamp_order import check_common_time
from device.frame import Eye, Frame, Unusable

Stream = Callable[[Eye], Iterator[Frame | Unusable]]
# files of stamps beside a camera's pictures
TIMES = ("times.txt", "timestamps.txt", "data.csv", "rgb.txt")


class PictureFolders:
    """Importer of pictures in folders, with stamps in their names or in a file beside them."""

    name = "pictures"
    reads = "a folder with cam0 and cam1, or a folder of pictures for each camera"

    def recognises(self, sources: tuple[Path, ...]) -> bool:
        """Whether the sources are folders of pictures, or one that holds both cameras'."""
        if len(sources) == 1 and all((sources[0] / f"cam{int(eye)}").is_dir() for eye in Eye):
            return True
        return all(source.is_dir() and _pictures(source) for source in sources)

    def open(
        self,
        sources: tuple[Path, ...],
        options: ImportOptions,
        scratch: Path,
        say: Callable[[str], None],
    ) -> Imported:
        """Read names and stamps; the pictures are read as frames. Raises CalmEdgeError."""
        shift_ns = round(1e9 * (options.offset_s or 0.0))
        assumed: list[str] = []
        if len(sources) == 1 and not _pictures(sources[0]):
            sequence = SequenceFolder(sources[0])
            stream: Stream = sequence.stream
            eyes, counts = tuple(Eye), [sequence.count(eye) for eye in Eye]
            assumed += sequence.notes
        else:
            if len(sources) == 1 and not options.single:
                raise InterchangeError(
                    f"{sources[0]}: pictures of one camera have no spacing, so nothing gives the "
                    "metre; give the other camera's folder too, or --single to keep the pictures"
                )
            eyes, stream, counts = _of_each(sources, shift_ns, assumed)
        if len(eyes) == 1:
            assumed.append(ONE_CAMERA)
        elif options.offset_s is None:
            assumed.append("both cameras are stamped by one clock")
        else:
            assumed.append(f"clock offset {options.offset_s:+g} s, as given")
        dropped: list[str] = []
        took = [
            f"{eye.name.lower()} {sources[eye if len(sources) > 1 else 0]}: {n} pictures"
            for eye, n in zip(eyes, counts, strict=True)
        ]

        def frames(eye: Eye) -> Iterator[Frame]:
            number = 0
            for frame in stream(eye):
                if isinstance(frame, Unusable):
                    if (line := frame.reason) not in dropped:
                        dropped.append(line)
                    continue
                t_ns = frame.t_ns + (shift_ns if eye is Eye.ASSISTANT else 0)
                yield Frame(eye, number, t_ns, frame.image, frame.own_stamp).encoded(
                    options.quality
                )
                number += 1

        return Imported(eyes, frames, tuple(took), dropped, tuple(assumed))


def _of_each(
    sources: tuple[Path, ...], shift_ns: int, assumed: list[str]
) -> tuple[tuple[Eye, ...], Stream, list[int]]:
    """One folder a camera."""
    cameras = [PictureFolder(source, _times(source)) for source in sources]
    for camera in cameras:
        assumed += camera.notes
    if len(cameras) == 2:
        if cameras[0].has_times != cameras[1].has_times:
            bare = next(camera for camera in cameras if not camera.has_times)
            raise InterchangeError(
                f"{bare.folder}: has no times, but the other camera has; put one in times.txt there"
            )
        spans = [cameras[0].t_ns, cameras[1].t_ns + shift_ns]
        check_common_time(sources[0].parent, [source.name for source in sources], spans)

    def stream(eye: Eye) -> Iterator[Frame | Unusable]:
        return cameras[eye].frames(eye, ORIGIN_NS)

    return tuple(Eye)[: len(cameras)], stream, [len(camera.files) for camera in cameras]


def _times(folder: Path) -> Path | None:
    """File of stamps in the folder of pictures, or beside it."""
    places = [folder, folder.parent] if folder.name == "data" else [folder]
    return next((p / n for p in places for n in TIMES if (p / n).is_file()), None)


def _pictures(folder: Path) -> bool:
    return any(p.suffix.lower() in SUFFIXES for p in folder.iterdir())
