"""What every importer must do, whichever format it reads: one suite over all of them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from calm_edge.interchange.base import Importer, ImportOptions
from calm_edge.interchange.registry import IMPORTERS, importer
from calm_edge.recording.sequence_folder import ORIGIN_NS
from device.frame import Eye
from tests.interchange import layouts
from tests.interchange.bags import write_ros
from tests.interchange.moving import SIZE, pictures, write_video

Build = Callable[[Path], tuple[Path, ...]]
T = np.arange(8) / 10


def videos(folder: Path) -> tuple[Path, ...]:
    """Two videos with the same stamps."""
    return tuple(write_video(folder / f"{i}.mp4", T, pictures(T + i)) for i in range(2))


def folders(folder: Path) -> tuple[Path, ...]:
    """A folder of pictures for each camera, with nanoseconds as names."""
    found = folder / "left", folder / "right"
    for eye, place in enumerate(found):
        layouts.shoot(place, T, eye, [f"{layouts.START_NS + round(1e9 * t)}.png" for t in T])
    return found


def bag(folder: Path) -> tuple[Path, ...]:
    """A ROS 2 bag."""
    return (write_ros(folder / "drive", T),)


BUILDS: dict[str, Build] = {
    "bag": bag,
    "video": videos,
    "pictures": folders,
    "KITTI raw": lambda folder: (layouts.kitti_raw(folder, T),),
    "KITTI odometry": lambda folder: (layouts.kitti_odometry(folder, T),),
    "EuRoC": lambda folder: (layouts.euroc(folder, T),),
}
OPTIONS = ImportOptions(offset_s=0.0)


@pytest.fixture(params=[found.name for found in IMPORTERS])
def reader(request: pytest.FixtureRequest) -> Importer:
    return next(found for found in IMPORTERS if found.name == request.param)


@pytest.fixture
def sources(reader: Importer, tmp_path: Path) -> tuple[Path, ...]:
    (tmp_path / "source").mkdir()
    return BUILDS[reader.name](tmp_path / "source")


def test_a_source_is_recognised_by_its_importer_first(
    reader: Importer, sources: tuple[Path, ...]
) -> None:
    assert importer(sources) is reader
    assert reader.name and reader.reads


def test_frames_are_encoded_numbered_and_in_order(
    reader: Importer, sources: tuple[Path, ...], tmp_path: Path
) -> None:
    (tmp_path / "scratch").mkdir()
    imported = reader.open(sources, OPTIONS, tmp_path / "scratch", lambda text: None)
    assert imported.eyes == tuple(Eye)
    assert imported.took and all("\n" not in line for line in imported.took + imported.assumed)
    for eye in Eye:
        frames = list(imported.frames(eye))
        assert [f.sequence for f in frames] == list(range(len(T)))
        assert all(f.eye is eye and isinstance(f.image, bytes) for f in frames)
        assert frames[0].t_ns >= ORIGIN_NS
        assert all(a.t_ns < b.t_ns for a, b in pairwise(frames))
        assert [f.t_ns - frames[0].t_ns for f in frames] == pytest.approx(T * 1e9, abs=1e3)
        assert frames[0].gray().shape == SIZE[::-1]
        # a second pass gives the same frames
        assert [f.t_ns for f in imported.frames(eye)] == [f.t_ns for f in frames]


def test_sources_are_not_changed(
    reader: Importer, sources: tuple[Path, ...], tmp_path: Path
) -> None:
    def content() -> dict[Path, bytes]:
        files = (f for f in (tmp_path / "source").rglob("*") if f.is_file())
        return {f: f.read_bytes() for f in files}

    before = content()
    (tmp_path / "scratch").mkdir()
    imported = reader.open(sources, OPTIONS, tmp_path / "scratch", lambda text: None)
    for eye in Eye:
        list(imported.frames(eye))
    assert content() == before
