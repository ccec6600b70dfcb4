"""Pictures of a video: their own stamps, rotation, parts, and damaged files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.video import Video, parts
from tests.interchange.moving import SIZE, pictures, uneven, write_video

T = uneven(30.0, 0.7, 1)


@pytest.mark.parametrize(
    ("name", "codec"),
    [("a.mp4", "libx264"), ("a.mov", "libx265"), ("a.avi", "mjpeg"), ("a.ts", "mpeg4")],
)
def test_stamps_are_those_of_the_file(tmp_path: Path, name: str, codec: str) -> None:
    """AVI has a constant rate: its stamps are multiples of its interval."""
    file = write_video(tmp_path / name, T, pictures(T), codec)
    read = list(Video((file,)).pictures())
    found = np.array([t for t, _ in read])
    assert len(found) == len(T)
    assert abs(found - T).max() < (0.02 if name.endswith("avi") else 1e-4)
    shown = np.array([picture[:, :, 1] for _, picture in read], float)
    assert abs(shown - np.array(pictures(T))).mean() < 8


@pytest.mark.parametrize("clockwise", [90, 180, 270])
def test_pictures_are_rotated_as_the_file_says(tmp_path: Path, clockwise: int) -> None:
    """A phone writes sideways pictures and the rotation that shows them upright."""
    upright = pictures(T[:8])
    stored = [np.ascontiguousarray(np.rot90(p, clockwise // 90)) for p in upright]
    # a display matrix counts counterclockwise
    file = write_video(tmp_path / "a.mp4", T[:8], stored, "libx264", rotation=-clockwise)
    video = Video((file,))
    (_, first), *_ = video.pictures()
    assert video.report.turned_deg == clockwise and video.report.size == SIZE
    assert abs(first[:, :, 1].astype(float) - upright[0]).mean() < 8


def test_parts_follow_each_other_by_one_interval(tmp_path: Path) -> None:
    t = np.arange(10) / 25
    for number in (9, 10, 11):
        write_video(tmp_path / f"drive_{number}.mp4", t, pictures(t + number))
    files = parts(tmp_path)
    assert [file.stem for file in files] == ["drive_9", "drive_10", "drive_11"]
    video = Video(files)
    assert [t for t, _ in video.pictures()] == pytest.approx(np.arange(30) / 25, abs=2e-3)
    assert video.report.joins_s == pytest.approx([0.4, 0.8], abs=2e-3)


def test_a_truncated_file_is_read_to_its_damage(tmp_path: Path) -> None:
    file = write_video(tmp_path / "a.ts", T, pictures(T))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    n = len(list(Video((file,)).pictures()))
    assert 0 < n < len(T)


@pytest.mark.parametrize("content", [b"", b"no video at all" * 99])
def test_what_is_no_video_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mp4").write_bytes(content)
    with pytest.raises(InterchangeError, match=r"a\.mp4: cannot be read as a video"):
        list(Video((tmp_path / "a.mp4",)).pictures())


def test_parts_of_different_sizes_are_refused(tmp_path: Path) -> None:
    write_video(tmp_path / "a1.mp4", T, pictures(T))
    write_video(tmp_path / "a2.mp4", T, [p[:64, :128] for p in pictures(T)])
    with pytest.raises(InterchangeError, match=r"a2\.mp4: pictures of 128x64 after 160x96 px"):
        list(Video(parts(tmp_path)).pictures())
