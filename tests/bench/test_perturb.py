"""Only the given faults are added, and the ground truth stays true."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench import perturb
from bench.perturb import Clocks, Perturbation, perturbed
from calm_edge.evaluation.truth import read_truth
from calm_edge.recording import SequenceError
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.trajectories import read_kitti, write_kitti
from device.frame import Eye
from tests.evaluation.worlds import curve

N = 40
SIZE = (64, 40)
SHADE = np.arange(N) * 5


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sequence folder in which the brightness of a picture encodes its index."""
    folder = tmp_path_factory.mktemp("perturb") / "drive"
    for eye in range(2):
        (folder / f"cam{eye}").mkdir(parents=True)
        for k, shade in enumerate(SHADE):
            image = np.full((SIZE[1], SIZE[0], 3), shade, np.uint8)
            cv2.imwrite(str(folder / f"cam{eye}" / f"{k:06d}.png"), image)
        (folder / f"times{eye}.txt").write_text("".join(f"{k / 10:.9f}\n" for k in range(N)))
        write_kitti(folder / f"poses{eye}.txt", curve(N))
    (folder / "calib.txt").write_text("50 51 32 20 64 40\n60 61 33 21 64 40\n")
    np.save(folder / "cloud.npy", np.zeros((1, 3), np.float32))
    return folder


def shades(folder: Path, eye: Eye) -> list[int]:
    return [int(frame.bgr()[0, 0, 0]) for frame in SequenceFolder(folder).frames(eye)]


def seconds(folder: Path, eye: Eye) -> np.ndarray:
    return (SequenceFolder(folder).t_ns(eye) - 10**9) / 1e9


def test_nothing_asked_is_the_same_drive(drive: Path, tmp_path: Path) -> None:
    out = perturbed(drive, tmp_path / "o", Perturbation())
    for eye in Eye:
        assert shades(out, eye) == SHADE.tolist()
        np.testing.assert_array_equal(seconds(out, eye), seconds(drive, eye))
        name = f"poses{int(eye)}.txt"
        np.testing.assert_array_equal(read_kitti(out / name), read_kitti(drive / name))
        assert all((out / f"cam{int(eye)}").joinpath(f"{k:06d}.png").is_symlink() for k in range(N))
    assert read_truth(out).cameras == read_truth(drive).cameras
    assert read_truth(out).cloud is not None


def test_latency_and_drift_are_an_eyes_own(drive: Path, tmp_path: Path) -> None:
    clocks = Clocks(latency_ms=(20.0, 60.0), drift_ppm=(0.0, 50.0))
    out = perturbed(drive, tmp_path / "o", Perturbation(clocks))
    t = seconds(drive, Eye.PRIMARY)
    np.testing.assert_allclose(seconds(out, Eye.PRIMARY), t + 0.020, atol=1e-9)
    np.testing.assert_allclose(seconds(out, Eye.ASSISTANT), t * (1 + 50e-6) + 0.060, atol=1e-9)


def test_a_pose_keeps_its_picture_under_the_lying_stamp(drive: Path, tmp_path: Path) -> None:
    change = Perturbation(Clocks(jitter_ms=5.0), drop=(0.3, 0.0), split=True, seed=3)
    out = perturbed(drive, tmp_path / "o", change)
    index = [SHADE.tolist().index(s) for s in shades(out, Eye.PRIMARY)]
    assert all(k % 2 == 1 for k in index)
    truth = read_truth(out)
    np.testing.assert_allclose(truth.T_w_c, curve(N)[index], atol=1e-9)
    lie = seconds(out, Eye.PRIMARY) - np.array(index) / 10
    assert 0 < np.abs(lie).max() < 0.03
    np.testing.assert_array_equal(truth.t_ns, SequenceFolder(out).t_ns(Eye.PRIMARY))


def test_the_split_gives_odd_to_the_primary_and_even_to_the_assistant(
    drive: Path, tmp_path: Path
) -> None:
    out = perturbed(drive, tmp_path / "o", Perturbation(split=True))
    assert shades(out, Eye.PRIMARY) == SHADE[1::2].tolist()
    assert shades(out, Eye.ASSISTANT) == SHADE[::2].tolist()


def test_drops_are_of_their_eye_and_repeat_with_the_seed(drive: Path, tmp_path: Path) -> None:
    change = Perturbation(drop=(0.0, 0.5), seed=4)
    out = perturbed(drive, tmp_path / "o", change)
    again = perturbed(drive, tmp_path / "again", change)
    assert shades(out, Eye.PRIMARY) == SHADE.tolist()
    left = shades(out, Eye.ASSISTANT)
    assert 10 < len(left) < 30 and left[0] == SHADE[0] and left[-1] == SHADE[-1]
    assert left == shades(again, Eye.ASSISTANT)


@given(
    jitter=st.floats(0, 200),
    latency=st.floats(-60, 60),
    drift=st.floats(-200, 200),
    seed=st.integers(0, 99),
)
@settings(max_examples=50, deadline=None)
def test_time_never_stands_still(jitter: float, latency: float, drift: float, seed: int) -> None:
    t = np.arange(50, dtype=np.int64) * 33_000_000
    clocks = Clocks((latency, latency), jitter, (drift, drift))
    out = perturb.stamped(t, clocks, 1, np.random.default_rng(seed))
    assert (np.diff(out) >= perturb.LEAST_GAP_NS).all()


def test_jitter_has_the_sigma_asked_for() -> None:
    t = np.arange(5000, dtype=np.int64) * 100_000_000
    lie = perturb.stamped(t, Clocks(jitter_ms=5.0), 0, np.random.default_rng(0)) - t
    assert 4.8e6 < lie.std() < 5.2e6 and abs(lie.mean()) < 0.3e6


@pytest.mark.parametrize("crop", [(0.03, 0.0), (-0.03, 0.05), (0.0, -0.1)])
def test_a_crop_moves_the_principal_point_by_what_was_asked(crop: tuple[float, float]) -> None:
    size = (1200, 400)
    left, top, right, bottom = perturb.crop_window(size, crop)
    assert left * right == 0 and top * bottom == 0
    width, height = size[0] - left - right, size[1] - top - bottom
    moved = (width / 2 - (size[0] / 2 - left)) / width, (height / 2 - (size[1] / 2 - top)) / height
    np.testing.assert_allclose(moved, crop, atol=1.5e-3)


def test_a_cropped_drive_says_so_in_its_calibration_alone(drive: Path, tmp_path: Path) -> None:
    out = perturbed(drive, tmp_path / "o", Perturbation(crop=((0.1, 0.0), (0.0, -0.1))))
    assert SequenceFolder(out).size(Eye.PRIMARY) == (53, 40)
    assert SequenceFolder(out).size(Eye.ASSISTANT) == (64, 33)
    cameras = read_truth(out).cameras
    assert cameras is not None
    assert cameras[0].cx == 32 - 11 and cameras[1].cy == 21
    assert cameras[0].fx == 50 and cameras[1].fy == 61
    assert shades(out, Eye.PRIMARY) == SHADE.tolist()


def test_gain_and_blur_change_the_pixels(tmp_path: Path) -> None:
    folder = tmp_path / "d"
    for eye in range(2):
        (folder / f"cam{eye}").mkdir(parents=True)
        image = np.zeros((30, 30, 3), np.uint8)
        image[:, 15:] = 100
        cv2.imwrite(str(folder / f"cam{eye}" / "0.png"), image)
    out = perturbed(folder, tmp_path / "o", Perturbation(blur_px=2.0, gain=(1.0, 1.5)))
    frames = [next(SequenceFolder(out).frames(eye)).bgr() for eye in Eye]
    assert 20 < frames[0][15, 14, 0] < 80
    assert frames[0][15, 29, 0] == 100 and frames[1][15, 29, 0] == 150


def test_what_is_no_picture_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "d"
    for eye in range(2):
        (folder / f"cam{eye}").mkdir(parents=True)
        cv2.imwrite(str(folder / f"cam{eye}" / "0.png"), np.zeros((30, 30, 3), np.uint8))
    broken = folder / "cam0" / "0.png"
    broken.write_bytes(broken.read_bytes()[:40])
    with pytest.raises(SequenceError, match=r"cam0/0\.png"):
        perturbed(folder, tmp_path / "o", Perturbation(blur_px=1.0))
