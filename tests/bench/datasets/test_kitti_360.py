from pathlib import Path

import numpy as np
import pytest

from bench.datasets.drive import write
from bench.datasets.kitti_360 import KITTI_360, load, sequences
from calm_edge.evaluation.truth import read_truth
from calm_edge.interchange.published import DatasetError
from calm_edge.recording.sequence_folder import SequenceFolder
from device.frame import Eye
from tests.bench.datasets import trees
from tests.evaluation.worlds import curve

DRIVE = "2013_05_28_drive_0003_sync"
FIRST, LAST = trees.POSED_360[0], trees.POSED_360[-1]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return trees.kitti_360(tmp_path / "KITTI-360")


@pytest.mark.parametrize("name", ["0003", "03", "3", DRIVE])
def test_frames_between_the_first_and_the_last_pose(root: Path, tmp_path: Path, name: str) -> None:
    out = write(load(root, name), tmp_path / "out")
    sequence, truth = SequenceFolder(out), read_truth(out)
    for eye in Eye:
        shown = [int(frame.bgr()[0, 0, 0]) for frame in sequence.frames(eye)]
        assert shown == [trees.shade(int(eye), k) for k in range(FIRST, LAST + 1)]
    primary, assistant = (sequence.t_ns(eye) for eye in Eye)
    np.testing.assert_array_equal(assistant - primary, 4000)
    np.testing.assert_array_equal(np.diff(primary), 50_000_000)
    T = curve(trees.FRAMES_360)
    true = np.linalg.inv(T[FIRST]) @ T[FIRST : LAST + 1]
    posed = np.array(trees.POSED_360) - FIRST
    np.testing.assert_allclose(truth.T_w_c[posed], true[posed], atol=1e-6)
    # the gap is filled along the way, not left out
    np.testing.assert_allclose(truth.T_w_c[:, :3, 3], true[:, :3, 3], atol=0.1)
    assert load(root, name).spacing_m == pytest.approx(trees.SPACING_M)


def test_what_was_filled_in_is_said(root: Path) -> None:
    left_out, filled = load(root, "0003").notes
    assert left_out == "3 frames before the first pose are left out"
    assert filled.startswith("the truth of 2 of 10 frames is interpolated")
    assert "3 frames apart" in filled
    assert len(load(root, "0003", 3).notes) == 1


def test_a_frame_that_an_eye_lacks_is_left_out_of_both(root: Path) -> None:
    (root / "data_2d_raw" / DRIVE / "image_01" / "data_rect" / f"{5:010d}.png").unlink()
    drive = load(root, "0003", 4)
    assert [int(p.stem) for p in drive.pictures[0]] == [3, 4, 6, 7]
    assert [int(p.stem) for p in drive.pictures[1]] == [3, 4, 6, 7]


def test_twelve_numbers_are_a_pose_too(root: Path) -> None:
    path = root / "data_poses" / DRIVE / "cam0_to_world.txt"
    whole = load(root, "0003").T_w_c
    rows = [" ".join(row.split()[:13]) for row in path.read_text().splitlines()]
    path.write_text("\n".join(rows))
    np.testing.assert_array_equal(load(root, "0003").T_w_c, whole)


def test_the_papers_settings() -> None:
    assert KITTI_360.frames == 2000
    assert KITTI_360.settings == ("--set", "loops.enabled=false")


def test_only_drives_with_poses_are_listed(root: Path) -> None:
    (root / "data_2d_raw" / "2013_05_28_drive_0008_sync").mkdir()
    assert sequences(root) == ["0003"]


@pytest.mark.parametrize(
    ("path", "text", "names"),
    [
        ("data_2d_raw", None, r"data_2d_raw/2013_05_28_drive_0003_sync: no such folder"),
        (f"data_2d_raw/{DRIVE}/image_01/data_rect", None, r"image_01/data_rect: no such folder"),
        (f"data_2d_raw/{DRIVE}/image_00/timestamps.txt", None, r"timestamps\.txt: cannot be read"),
        (f"data_2d_raw/{DRIVE}/image_00/timestamps.txt", "noon\n", r"'noon' is not a date"),
        (
            f"data_2d_raw/{DRIVE}/image_01/timestamps.txt",
            f"{trees.START_360}.1\n",
            r"image_01/timestamps\.txt: 1 rows, too few for frame 12",
        ),
        (f"data_poses/{DRIVE}/cam0_to_world.txt", None, r"cam0_to_world\.txt: cannot be read"),
        (f"data_poses/{DRIVE}/cam0_to_world.txt", "1 2\n", r"2 numbers; 13 or 17"),
        ("calibration/perspective.txt", None, r"perspective\.txt: cannot be read"),
        ("calibration/perspective.txt", "S_rect_00: 1\n", r"no line `P_rect_00:`"),
    ],
)
def test_damage_names_the_file(root: Path, path: str, text: str | None, names: str) -> None:
    if text is None:
        (root / path).rename(root / "elsewhere")
    else:
        (root / path).write_text(text)
    with pytest.raises(DatasetError, match=names):
        load(root, "0003")
