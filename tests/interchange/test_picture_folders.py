"""Folders of pictures with stamps in names or files, and files that are none."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.base import Imported, ImportOptions
from calm_edge.interchange.picture_folders import PictureFolders
from calm_edge.interchange.registry import importer
from calm_edge.recording import SequenceError
from calm_edge.recording.sequence_folder import ORIGIN_NS
from device.frame import Eye
from tests.interchange.moving import pictures

T = np.arange(6) / 10
START_NS = 1_700_000_000_000_000_000


def folder(path: Path, names: list[str], eye: int = 0) -> Path:
    path.mkdir(parents=True)
    for name, picture in zip(names, pictures(T + 0.1 * eye), strict=True):
        assert cv2.imwrite(str(path / name), picture)
    return path


def named_in_ns(suffix: str) -> list[str]:
    return [f"{START_NS + round(1e9 * t)}.{suffix}" for t in T]


def opened(*sources: Path, **options: object) -> Imported:
    wanted = ImportOptions(**options)  # type: ignore[arg-type]
    found = importer(sources)
    assert isinstance(found, PictureFolders)
    return found.open(sources, wanted, sources[0], lambda text: None)


@pytest.mark.parametrize("suffix", ["bmp", "tif", "webp", "png", "jpg"])
def test_stamps_in_names(tmp_path: Path, suffix: str) -> None:
    sources = [folder(tmp_path / f"c{i}", named_in_ns(suffix), i) for i in range(2)]
    imported = opened(*sources)
    for eye in Eye:
        frames = list(imported.frames(eye))
        assert [f.t_ns for f in frames] == [START_NS + ORIGIN_NS + round(1e9 * t) for t in T]
        shown = pictures(T + 0.1 * eye)
        assert abs(frames[3].gray().astype(int) - shown[3]).mean() < 6
        assert all(isinstance(f.image, bytes) for f in frames)
    assert any("ns, from the names" in line for line in imported.assumed)


def test_stamps_in_a_file_and_an_offset(tmp_path: Path) -> None:
    """As TUM lists them: seconds and a name a row."""
    sources = [folder(tmp_path / f"c{i}", [f"{k}.png" for k in range(6)], i) for i in range(2)]
    for source in sources:
        rows = "".join(f"{1e9 + t:.6f} {k}.png\n" for k, t in enumerate(T))
        (source / "rgb.txt").write_text("# timestamp filename\n" + rows)
    imported = opened(*sources, offset_s=0.025)
    apart = [f.t_ns for f in imported.frames(Eye.ASSISTANT)]
    assert apart == [10**18 + round(1e9 * t) + 25_000_000 + ORIGIN_NS for t in T]


def test_a_sequence_folder(tmp_path: Path) -> None:
    for i in range(2):
        folder(tmp_path / f"cam{i}", [f"{k:03d}.jpg" for k in range(6)], i)
        (tmp_path / f"times{i}.txt").write_text("".join(f"{t + 0.01 * i:.3f}\n" for t in T))
    imported = opened(tmp_path)
    assert next(imported.frames(Eye.ASSISTANT)).t_ns == ORIGIN_NS + 10_000_000
    assert not any("10 Hz" in line for line in imported.assumed)


def test_what_is_no_picture_is_dropped_and_said(tmp_path: Path) -> None:
    sources = [folder(tmp_path / f"c{i}", named_in_ns("png"), i) for i in range(2)]
    broken = sorted(sources[0].iterdir())[2]
    broken.write_bytes(b"none")
    imported = opened(*sources)
    assert [f.sequence for f in imported.frames(Eye.PRIMARY)] == [0, 1, 2, 3, 4]
    assert len(imported.dropped) == 1 and broken.name in imported.dropped[0]


def test_what_is_refused(tmp_path: Path) -> None:
    first = folder(tmp_path / "c0", named_in_ns("png"))
    with pytest.raises(InterchangeError, match="no spacing"):
        opened(first)
    assert opened(first, single=True).eyes == (Eye.PRIMARY,)
    bare = folder(tmp_path / "c1", [f"{k}.png" for k in range(6)])
    with pytest.raises(InterchangeError, match="c1: has no times"):
        opened(first, bare)
    later = [f"{START_NS + 10**11 + k * 10**8}.png" for k in range(6)]
    with pytest.raises(SequenceError, match="no time in common"):
        opened(first, folder(tmp_path / "c2", later))
