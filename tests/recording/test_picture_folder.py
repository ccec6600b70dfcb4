"""A folder of pictures is read in the order of its camera, with the stamps that belong to them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from calm_edge.recording import SequenceError
from calm_edge.recording.picture_folder import PictureFolder
from device.frame import Eye, Frame, Unusable

EPOCH_NS = 1_403_715_273_000_000_000


def folder_of(folder: Path, names: Sequence[str]) -> Path:
    """A folder of grey pictures whose brightness is 10 times their number."""
    folder.mkdir(parents=True)
    for k, name in enumerate(names):
        cv2.imwrite(str(folder / name), np.full((16, 16, 3), 10 * k, np.uint8))
    return folder


def numbers(pictures: PictureFolder) -> list[int]:
    frames = pictures.frames(Eye.PRIMARY)
    return [round(float(f.bgr().mean()) / 10) for f in frames if isinstance(f, Frame)]


@pytest.mark.parametrize(
    "names",
    [
        [f"frame{k}.png" for k in range(12)],
        [f"frame_{9990 + k:04d}.png" for k in range(12)],
        [f"{k}_left.PNG" for k in range(95, 107)],
        [f"{EPOCH_NS + k * 50_000_000}.png" for k in range(12)],
        [f"img_{8.7 + 0.15 * k:.2f}.png" for k in range(12)],
    ],
)
def test_pictures_come_in_natural_order(tmp_path: Path, names: list[str]) -> None:
    pictures = PictureFolder(folder_of(tmp_path / "cam0", names))
    assert numbers(pictures) == list(range(12))
    assert (np.diff(pictures.t_ns) > 0).all()


def test_hidden_files_and_other_ones_are_left_out(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "cam0", [f"{k:06d}.jpg" for k in range(3)])
    for name in ("._000000.jpg", "._000001.jpg", ".hidden.jpg", "Thumbs.db", "notes.txt"):
        (folder / name).write_bytes(b"\0\5\x16\7" + bytes(4092))
    (folder / "000009.jpg").mkdir()
    assert numbers(PictureFolder(folder)) == [0, 1, 2]


def test_without_times_ten_hertz_are_assumed_and_said(tmp_path: Path) -> None:
    pictures = PictureFolder(folder_of(tmp_path / "cam0", ["0.jpg", "1.jpg", "2.jpg"]))
    assert pictures.t_ns.tolist() == [0, 100_000_000, 200_000_000] and not pictures.has_times
    assert pictures.notes == (f"{tmp_path}/cam0: no times are given: 10 Hz is assumed",)


def test_times_in_names_are_said(tmp_path: Path) -> None:
    names = [f"{(EPOCH_NS + k * 50_000_000) // 1000}.png" for k in range(4)]
    pictures = PictureFolder(folder_of(tmp_path / "cam0", names))
    assert pictures.t_ns.tolist() == [EPOCH_NS + k * 50_000_000 for k in range(4)]
    assert pictures.has_times and "read as us, from the names" in pictures.notes[0]


def test_times_that_name_pictures_need_not_be_complete(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "data", [f"{k:03d}.png" for k in range(6)])
    times = tmp_path / "data.csv"
    rows = [(0.0, "000"), (0.1, "001"), (0.2, "lost"), (0.3, "003"), (0.4, "004"), (0.5, "005")]
    times.write_text("#time,name\n" + "".join(f"{t:.1f},img/{name}.png\n" for t, name in rows))
    pictures = PictureFolder(folder, times)
    assert numbers(pictures) == [0, 1, 3, 4, 5]
    assert pictures.t_ns.tolist() == [k * 100_000_000 for k in (0, 1, 3, 4, 5)]
    assert "names no time for 1 of 6 pictures" in pictures.notes[0]
    assert "1 of 6 times have no picture" in pictures.notes[1]


def test_a_removed_picture_keeps_the_times_of_the_others(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "cam0", [f"{k:06d}.png" for k in range(6)])
    (folder / "000002.png").unlink()
    times = tmp_path / "times0.txt"
    times.write_text("".join(f"{0.1 * k:.1f}\n" for k in range(6)))
    pictures = PictureFolder(folder, times)
    assert pictures.t_ns.tolist() == [k * 100_000_000 for k in (0, 1, 3, 4, 5)]
    (folder / "000004.png").rename(folder / "other.png")
    with pytest.raises(SequenceError, match="6 times for 5 images"):
        PictureFolder(folder, times)


def test_stamps_out_of_order_are_marked(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "cam0", [f"{k:06d}.png" for k in range(20)])
    times = tmp_path / "times0.txt"
    times.write_text("".join(f"{0.1 * (k - 4 * (k in (7, 8))):.2f}\n" for k in range(20)))
    pictures = PictureFolder(folder, times)
    np.testing.assert_allclose(pictures.t_ns, np.arange(20) * 10**8, atol=1)
    own = [frame.own_stamp for frame in pictures.frames(Eye.PRIMARY) if isinstance(frame, Frame)]
    assert [k for k, each in enumerate(own) if not each] == [7, 8]
    (note,) = pictures.notes
    assert "line 8: 0.300000 s does not follow the one before, 2 stamps in all" in note
    times.write_text("".join(f"{0.1 * (k // 2):.2f}\n" for k in range(20)))
    with pytest.raises(SequenceError, match="times0"):
        PictureFolder(folder, times)


def test_a_file_that_is_no_picture_leaves_a_gap(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "cam0", [f"{k}.jpg" for k in range(4)])
    (folder / "2.jpg").write_bytes(b"")
    frames = list(PictureFolder(folder).frames(Eye.ASSISTANT, 5))
    assert [frame.sequence for frame in frames] == [0, 1, 2, 3]
    unusable = frames[2]
    assert isinstance(unusable, Unusable) and "2.jpg: empty" in unusable.reason
    assert isinstance(frames[3], Frame) and frames[3].t_ns == 300_000_005


def test_a_folder_without_pictures_is_named(tmp_path: Path) -> None:
    (tmp_path / "cam0").mkdir()
    (tmp_path / "cam0" / "a.txt").write_text("")
    for folder in (tmp_path / "cam0", tmp_path / "absent"):
        with pytest.raises(SequenceError, match=folder.name):
            PictureFolder(folder)


def test_a_clock_that_was_set_is_said(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "cam0", [f"{k:06d}.png" for k in range(20)])
    times = tmp_path / "times0.txt"
    times.write_text("".join(f"{0.1 * k + 1.779e9 * (k > 11):.2f}\n" for k in range(20)))
    pictures = PictureFolder(folder, times)
    np.testing.assert_allclose(pictures.t_ns, np.arange(20) * 10**8, atol=1)
    (note,) = pictures.notes
    assert "line 13" in note and "later ones are shifted by -1779000000.000 s" in note


def test_a_link_that_leads_nowhere_is_a_lost_picture(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "cam0", [f"{k}.jpg" for k in range(4)])
    (folder / "2.jpg").unlink()
    (folder / "2.jpg").symlink_to("elsewhere.jpg")
    (folder / "3.jpg").unlink()
    (folder / "3.jpg").symlink_to("3.jpg")
    frames = list(PictureFolder(folder).frames(Eye.PRIMARY))
    assert [isinstance(frame, Unusable) for frame in frames] == [False, False, True, True]


def test_other_kinds_of_pictures_are_to_be_converted(tmp_path: Path) -> None:
    (tmp_path / "cam0").mkdir()
    (tmp_path / "cam0" / "0.heic").write_bytes(b"\0\0\0\x18ftypheic")
    with pytest.raises(SequenceError, match=r"convert its \.heic"):
        PictureFolder(tmp_path / "cam0")
