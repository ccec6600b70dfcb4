import cv2
import numpy as np
import pytest

from calm_edge.interchange.calibration.calibration import CalibrationError
from calm_edge.interchange.calibration.formats import read

K = np.array([[612.5, 0, 322.25], [0, 611.0, 238.5], [0, 0, 1]])
POINTS = np.array([[0.1, 0.05, 1], [-0.4, 0.3, 1], [0.35, -0.3, 1], [0.2, 0.25, 1.0]])
ZERO = np.zeros(3)


def stored(path, entries):
    storage = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    for key, value in entries.items():
        storage.write(key, value)
    storage.release()
    return path


def single(path, k, **others):
    entries = {"image_width": 640, "image_height": 480, "camera_matrix": K, **others}
    return stored(path, {**entries, "distortion_coefficients": np.array([k])})


TERMS = {
    "plumb_bob": [-0.28, 0.09, 0.0011, -0.0007, 0.01],
    "rational": [0.4, 0.1, 0.0003, -0.0002, 0.01, 0.71, 0.2, 0.03],
}


@pytest.mark.parametrize("suffix", ["yml", "xml"])
@pytest.mark.parametrize("k", TERMS.values(), ids=TERMS)
def test_a_perspective_lens_projects_as_in_opencv(tmp_path, k, suffix):
    each = read((single(tmp_path / f"camera.{suffix}", k),)).cameras[0]
    expected = cv2.projectPoints(POINTS, ZERO, ZERO, K, np.array(k))[0][:, 0]
    assert np.allclose(each.camera.project(POINTS), expected, atol=1e-9) and each.fit_px == 0


@pytest.mark.parametrize("suffix", ["yml", "xml"])
def test_a_fisheye_lens_projects_as_in_opencv(tmp_path, suffix):
    k = np.array([-0.02, 0.01, -0.003, 0.001])
    path = single(tmp_path / f"camera.{suffix}", k, fisheye_model=1)
    camera = read((path,)).cameras[0].camera
    expected = cv2.fisheye.projectPoints(POINTS[:, None], ZERO, ZERO, K, k)[0][:, 0]
    assert np.allclose(camera.project(POINTS), expected, atol=1e-9)


def test_thin_prism_and_tilt_are_fitted_with_their_difference(tmp_path):
    k = [-0.28, 0.09, 0.0011, -0.0007, 0.01, 0, 0, 0, 0.002, -0.001, 0.001, 0.0005, 0.004, -0.003]
    each = read((single(tmp_path / "camera.yml", k),)).cameras[0]
    expected = cv2.projectPoints(POINTS, ZERO, ZERO, K, np.array(k))[0][:, 0]
    off = np.abs(each.camera.project(POINTS) - expected).max()
    assert 0 < off <= each.fit_px < 1


def test_a_stereo_calibration_has_the_rig_of_the_second_camera_in_the_first(tmp_path):
    R, T = cv2.Rodrigues(np.array([0.01, -0.05, 0.02]))[0], np.array([[-0.5], [0.02], [0.01]])
    sizes = {"image_width": 640, "image_height": 480}
    k = np.zeros((1, 5))
    entries = {**sizes, "M1": K, "D1": k, "M2": 2 * K / K[2, 2] * [[0.5], [0.5], [0.5]], "D2": k}
    found = read((stored(tmp_path / "stereo.yml", {**entries, "R": R, "T": T}),))
    assert np.allclose(found.T_p_a @ np.vstack([np.hstack([R, T]), [0, 0, 0, 1]]), np.eye(4))
    # OpenCV's unit is that of the calibration target
    assert found.spacing_m is None and len(found.cameras) == 2


def test_an_omnidir_calibration_is_fitted(tmp_path):
    k = np.array([-0.1, 0.02, 0.001, -0.0005])
    path = single(tmp_path / "omni.yml", k, xi=np.array([[0.9]]))
    each = read((path,)).cameras[0]
    expected = cv2.omnidir.projectPoints(POINTS[:, None], ZERO, ZERO, K, 0.9, k)[0][:, 0]
    assert np.abs(each.camera.project(POINTS) - expected).max() <= each.fit_px < 1.0


def test_without_the_size_of_its_pictures_it_is_refused(tmp_path):
    path = stored(tmp_path / "intrinsics.yml", {"M1": K, "D1": np.zeros((1, 5))})
    with pytest.raises(CalibrationError, match="add image_width and image_height"):
        read((path,))


@pytest.mark.parametrize(
    "text", ["%YAML:1.0\n---\na: [1,", "<opencv_storage><a>", "%YAML:1.0\n---\na: 1\n"]
)
def test_a_damaged_file_is_one_line(tmp_path, text):
    path = tmp_path / "camera.yml"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=r"camera\.yml") as caught:
        read((path,))
    assert "\n" not in str(caught.value)


def test_a_lens_without_inverse_is_refused(tmp_path):
    with pytest.raises(CalibrationError, match="no inverse in"):
        read((single(tmp_path / "camera.yml", [-3.0, 0.0, 0.0, 0.0]),))


def test_a_fisheye_lens_wider_than_supported_is_refused(tmp_path):
    path = single(
        tmp_path / "camera.yml", [0.0, 0.0, 0.0, 0.0], fisheye_model=1,
        camera_matrix=np.array([[180.0, 0, 320], [0, 180, 240], [0, 0, 1]]),
    )  # fmt: skip
    with pytest.raises(CalibrationError, match=r"camera\.yml.*at most 160"):
        read((path,))
