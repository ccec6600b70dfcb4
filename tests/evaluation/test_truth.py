"""Reading the ground truth of a sequence folder."""

from pathlib import Path

import numpy as np
import pytest

from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.truth import read_truth
from calm_edge.geometry.camera import Perspective
from calm_edge.recording import SequenceError
from calm_edge.trajectories import TrajectoryError, write_kitti
from tests.evaluation.worlds import curve, stamps


def _folder(tmp_path: Path, n: int = 6) -> Path:
    write_kitti(tmp_path / "poses0.txt", curve(n))
    (tmp_path / "times0.txt").write_text("".join(f"{0.1 * i:.6f}\n" for i in range(n)))
    (tmp_path / "calib.txt").write_text("500 501 320 120 640 240\n600 600 319.5 119.5 640 240\n")
    np.save(tmp_path / "cloud.npy", np.ones((4, 3), np.float32))
    return tmp_path


def test_everything_is_read(tmp_path: Path) -> None:
    truth = read_truth(_folder(tmp_path))
    assert np.array_equal(truth.t_ns, stamps(6))
    assert np.allclose(truth.T_w_c, curve(6), atol=1e-8)
    assert truth.cameras is not None and truth.cloud is not None
    assert truth.cameras[0] == Perspective(500, 501, 320, 120, 640, 240)
    assert truth.cameras[1].fx == 600
    assert truth.cloud.shape == (4, 3)


def test_a_folder_without_poses_still_has_its_calibration(tmp_path: Path) -> None:
    folder = _folder(tmp_path)
    for name in ("poses0.txt", "cloud.npy", "times0.txt"):
        (folder / name).unlink()
    truth = read_truth(folder)
    assert len(truth.t_ns) == 0 and truth.cloud is None and truth.cameras is not None


def test_without_times_the_rate_is_ten_hertz(tmp_path: Path) -> None:
    folder = _folder(tmp_path)
    (folder / "times0.txt").unlink()
    assert np.array_equal(read_truth(folder).t_ns, stamps(6))


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("times0.txt", b"0.0\n0.1\n", "6 poses for 2 times"),
        ("calib.txt", b"500 500 320 120 640 240\n", "two rows"),
        ("calib.txt", b"f f c c w h\n", "not rows of `fx fy cx cy width height`"),
        ("cloud.npy", b"not numpy", "not a NumPy array"),
        ("poses0.txt", b"1 0 0\n", "3 columns"),
    ],
)
def test_bad_truth_ends_in_one_line(tmp_path: Path, name: str, content: bytes, text: str) -> None:
    folder = _folder(tmp_path)
    (folder / name).write_bytes(content)
    with pytest.raises((EvaluationError, TrajectoryError)) as error:
        read_truth(folder)
    assert text in str(error.value) and str(folder / name.replace("times", "poses")) in str(
        error.value
    )


def test_a_folder_without_truth_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match="holds none of"):
        read_truth(tmp_path)
    with pytest.raises(EvaluationError, match="no such folder"):
        read_truth(tmp_path / "nowhere")
    (tmp_path / "times0.txt").write_text("0.1\n0.0\n")
    write_kitti(tmp_path / "poses0.txt", curve(2))
    with pytest.raises(SequenceError, match="do not increase"):
        read_truth(tmp_path)
