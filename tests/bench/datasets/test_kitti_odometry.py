from pathlib import Path

import numpy as np
import pytest

from bench.datasets.drive import odd_even, write
from bench.datasets.kitti_odometry import load, sequences
from calm_edge.evaluation.truth import read_truth
from calm_edge.interchange.published import DatasetError
from calm_edge.recording.sequence_folder import SequenceFolder
from device.frame import Eye
from tests.bench.datasets import trees
from tests.evaluation.worlds import curve


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return trees.kitti_odometry(tmp_path / "dataset")


def shades(folder: Path, eye: Eye) -> list[int]:
    return [int(frame.bgr()[0, 0, 0]) for frame in SequenceFolder(folder).frames(eye)]


def test_the_sequence_folder_has_the_colour_eyes_times_truth_and_optics(
    root: Path, tmp_path: Path
) -> None:
    out = write(load(root, "00"), tmp_path / "out")
    for eye in Eye:
        assert shades(out, eye) == [trees.shade(int(eye), k) for k in range(trees.N)]
        seconds = (SequenceFolder(out).t_ns(eye) - 10**9) / 1e9
        np.testing.assert_allclose(seconds, 0.1037 * np.arange(trees.N), atol=1e-9)
    truth = read_truth(out)
    assert truth.cameras is not None
    np.testing.assert_allclose(
        truth.cameras[1].matrix, [[40, 0, 31], [0, 40, 9], [0, 0, 1]], atol=1e-9
    )
    # of camera 2, in the world of its own first pose
    camera_2 = curve(trees.N).copy()
    camera_2[:, :3, 3] += camera_2[:, :3, :3] @ [0.06, 0.01, 0]
    np.testing.assert_allclose(truth.T_w_c, np.linalg.inv(camera_2[0]) @ camera_2, atol=1e-8)
    assert load(root, "00").spacing_m == pytest.approx(trees.SPACING_M)


def test_without_colour_the_grey_eyes_are_taken(tmp_path: Path) -> None:
    root = trees.kitti_odometry(tmp_path / "grey", cameras=(0, 1))
    drive = load(root, "00")
    assert drive.pictures[1][0].parent.name == "image_1"
    assert drive.spacing_m == pytest.approx(0.5)
    np.testing.assert_allclose(drive.T_w_c, curve(trees.N), atol=1e-8)


def test_asynchronous_is_odd_to_the_primary_and_even_to_the_assistant(
    root: Path, tmp_path: Path
) -> None:
    out = write(odd_even(load(root, "00", 8)), tmp_path / "out")
    assert shades(out, Eye.PRIMARY) == [trees.shade(0, k) for k in (1, 3, 5, 7)]
    assert shades(out, Eye.ASSISTANT) == [trees.shade(1, k) for k in (0, 2, 4, 6)]
    sequence, truth = SequenceFolder(out), read_truth(out)
    step = sequence.t_ns(Eye.PRIMARY) - sequence.t_ns(Eye.ASSISTANT)
    np.testing.assert_allclose(step, 103_700_000, atol=1)
    true = load(root, "00").T_w_c[1:8:2]
    np.testing.assert_allclose(truth.T_w_c, np.linalg.inv(true[0]) @ true, atol=1e-8)


def test_the_first_frames_alone(root: Path) -> None:
    drive = load(root, "00", 5)
    assert len(drive.pictures[0]) == len(drive.pictures[1]) == len(drive.T_w_c) == 5


def test_only_sequences_with_poses_are_listed(root: Path) -> None:
    trees.kitti_odometry(root, "03")
    (root / "sequences" / "11").mkdir()
    assert sequences(root) == ["00", "03"]


@pytest.mark.parametrize(
    ("harm", "names"),
    [
        ("sequences", r"dataset/sequences: no such folder"),
        ("poses", r"dataset/poses: no such folder"),
    ],
)
def test_a_wrong_root_names_what_is_missing(root: Path, harm: str, names: str) -> None:
    (root / harm).rename(root / "elsewhere")
    with pytest.raises(DatasetError, match=names):
        sequences(root)


@pytest.mark.parametrize(
    ("path", "text", "names"),
    [
        ("sequences/00/image_3", None, r"image_3: no such folder"),
        ("sequences/00/calib.txt", None, r"calib\.txt: cannot be read"),
        ("sequences/00/calib.txt", "P0: 1 2\n", r"calib\.txt: no line `P2:`"),
        ("sequences/00/calib.txt", "P2: 1 2\nP3: 1 2\n", r"a row has 2 numbers; 12 are"),
        ("sequences/00/times.txt", "0\n1\n", r"12 and 12 pictures, 2 times, 12 poses"),
        ("sequences/00/times.txt", "zero\n", r"times\.txt: not a row of numbers"),
        ("poses/00.txt", None, r"poses/00\.txt: missing"),
    ],
)
def test_a_damaged_sequence_names_the_file(
    root: Path, path: str, text: str | None, names: str
) -> None:
    if text is None:
        (root / path).rename(root / "elsewhere")
    else:
        (root / path).write_text(text)
    with pytest.raises(DatasetError, match=names):
        load(root, "00")
