import json
from pathlib import Path

import numpy as np
import pytest

from bench.datasets.argoverse import load, sequences
from bench.datasets.drive import write
from calm_edge.evaluation.truth import read_truth
from calm_edge.interchange.published import DatasetError
from calm_edge.recording.sequence_folder import SequenceFolder
from device.frame import Eye
from tests.bench.datasets import trees
from tests.evaluation.worlds import curve

LOG = "0ef28d5c-ae34-370b-99e7-6709e1c4b929"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return trees.argoverse(tmp_path / "argoverse-tracking")


def test_the_left_cameras_truth_comes_from_the_vehicles(root: Path, tmp_path: Path) -> None:
    out = write(load(root, "0ef"), tmp_path / "out")
    sequence, truth = SequenceFolder(out), read_truth(out)
    np.testing.assert_allclose(
        truth.T_w_c, np.linalg.inv(curve(trees.N)[0]) @ curve(trees.N), atol=1e-6
    )
    # the right eye's last picture comes 1 ms after the last pose
    assert (sequence.count(Eye.PRIMARY), sequence.count(Eye.ASSISTANT)) == (trees.N, trees.N - 1)
    for eye in Eye:
        shown = [int(frame.bgr()[0, 0, 0]) for frame in sequence.frames(eye)]
        expected = [trees.shade(int(eye), k) for k in range(sequence.count(eye))]
        np.testing.assert_allclose(shown, expected, atol=2)
    late = sequence.t_ns(Eye.ASSISTANT) - sequence.t_ns(Eye.PRIMARY)[:-1]
    np.testing.assert_array_equal(late, 1_000_000)
    assert load(root, LOG).spacing_m == pytest.approx(0.299)
    assert load(root, LOG).notes == (
        "1 pictures before the first or after the last pose are left out",
    )


def test_the_sweeps_become_one_cloud_in_the_first_cameras_world(root: Path, tmp_path: Path) -> None:
    truth = read_truth(write(load(root, LOG), tmp_path / "out"))
    assert truth.cloud is not None
    # the wall was swept twice and is there once, but for points on a voxel's edge
    assert 14 <= len(truth.cloud) <= 28
    ahead = 10.0 - trees.MOUNTS["stereo_front_left"][0]
    np.testing.assert_allclose(truth.cloud[:, 2], ahead, atol=1e-3)
    assert truth.cloud[:, 0].min() == pytest.approx(-3 + 0.15, abs=1e-3)
    np.testing.assert_allclose(np.unique(truth.cloud[:, 1].round(2)), [-0.6, 1.4], atol=1e-3)


def test_a_shorter_drive_has_the_cloud_it_saw(root: Path) -> None:
    both, one = load(root, LOG).cloud, load(root, LOG, 2).cloud
    assert both is not None and one is not None and len(one) == 14 <= len(both)


def test_without_lidar_there_is_no_cloud(root: Path) -> None:
    (root / "train1" / LOG / "lidar").rename(root / "elsewhere")
    assert load(root, LOG).cloud is None


@pytest.mark.parametrize("depth", [0, 1])
def test_logs_are_found_where_the_archives_put_them(root: Path, depth: int) -> None:
    trees.argoverse(root, "44c12a1d")
    assert sequences([root, root / "train1"][depth]) == [LOG, "44c12a1d"]


def test_a_log_that_two_names_begin_with_is_refused(root: Path) -> None:
    trees.argoverse(root, "0ea")
    with pytest.raises(DatasetError, match="2 logs begin with '0e'"):
        load(root, "0e")


@pytest.mark.parametrize(
    ("path", "names"),
    [
        ("stereo_front_right", r"stereo_front_right: no such folder"),
        ("poses", r"poses: no such folder"),
        ("vehicle_calibration_info.json", r"vehicle_calibration_info\.json is in no folder LOG"),
    ],
)
def test_faults_are_named_as_reasons(root: Path, path: str, names: str) -> None:
    (root / "train1" / LOG / path).rename(root / "elsewhere")
    with pytest.raises(DatasetError, match=names):
        load(root, LOG)


def test_a_pose_or_a_camera_that_is_none_is_named(root: Path) -> None:
    log = root / "train1" / LOG
    pose = next((log / "poses").iterdir())
    kept = pose.read_text()
    for text in ("[]", "{", json.dumps({"rotation": [1, 0], "translation": [0, 0, 0]})):
        pose.write_text(text)
        with pytest.raises(DatasetError, match=pose.name):
            load(root, LOG)
    pose.write_text(kept)
    (log / "vehicle_calibration_info.json").write_text('{"camera_data_": []}')
    with pytest.raises(DatasetError, match="no calibration of image_raw_stereo_front_left"):
        load(root, LOG)
