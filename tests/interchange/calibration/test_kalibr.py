import numpy as np
import pytest

from calm_edge.interchange.calibration.calibration import CalibrationError
from calm_edge.interchange.calibration.formats import read

RAYS = np.array([[0.1, 0.05, 1], [-0.6, 0.3, 1], [0.7, -0.5, 1], [0.2, 0.55, 1.0]])
FILE = """\
cam0:
  camera_model: {model}
  intrinsics: {intrinsics}
  distortion_model: {distortion}
  distortion_coeffs: {k}
  resolution: [752, 480]
  rostopic: /cam0/image_raw
  T_cam_imu:
  - [1.0, 0.0, 0.0, 0.0]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  timeshift_cam_imu: 0.001
cam1:
  T_cn_cnm1:
  - [0.9999, 0.0, 0.0141418, -0.11]
  - [0.0, 1.0, 0.0, 0.0004]
  - [-0.0141418, 0.0, 0.9999, -0.0008]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  intrinsics: [457.6, 456.1, 379.9, 255.2]
  distortion_model: radtan
  distortion_coeffs: [-0.28, 0.074, -0.0001, -0.00003]
  resolution: [752, 480]
"""


def camchain(
    path, model="pinhole", intrinsics=(458.7, 457.3, 367.2, 248.4), distortion="none", k=()
):
    fields = {"model": model, "intrinsics": list(intrinsics), "distortion": distortion}
    path.write_text(FILE.format(**fields, k=list(k)))
    return path


def pixels(distorted, intrinsics):
    fu, fv, pu, pv = intrinsics
    return distorted * [fu, fv] + [pu, pv]


def test_the_rig_is_that_of_cam1_in_cam0_in_metres(tmp_path):
    found = read((camchain(tmp_path / "camchain.yaml"),))
    p_0 = np.array([0.3, 0.2, 4.0, 1.0])
    T_1_0 = np.array(
        [
            [0.9999, 0, 0.0141418, -0.11],
            [0, 1, 0, 0.0004],
            [-0.0141418, 0, 0.9999, -0.0008],
            [0, 0, 0, 1],
        ]
    )
    assert np.allclose(np.linalg.solve(found.T_p_a, p_0), T_1_0 @ p_0, atol=1e-6)
    assert found.spacing_m == pytest.approx(0.11, abs=1e-4)


def test_omni_is_fitted(tmp_path):
    xi, optics = 0.8, (800.0, 802.0, 367.2, 248.4)
    path = camchain(tmp_path / "camchain.yaml", "omni", (xi, *optics))
    each = read((path,)).cameras[0]
    length = np.linalg.norm(RAYS, axis=1)
    expected = pixels(RAYS[:, :2] / (RAYS[:, 2] + xi * length)[:, None], optics)
    assert np.abs(each.camera.project(RAYS) - expected).max() <= each.fit_px < 0.5
    assert each.fit_px > 0 and each.model == "omni-none"


def test_double_sphere_is_fitted(tmp_path):
    xi, alpha, optics = -0.18, 0.59, (350.0, 351.0, 367.2, 248.4)
    path = camchain(tmp_path / "camchain.yaml", "ds", (xi, alpha, *optics))
    each = read((path,)).cameras[0]
    d1 = np.linalg.norm(RAYS, axis=1)
    d2 = np.sqrt(RAYS[:, 0] ** 2 + RAYS[:, 1] ** 2 + (xi * d1 + RAYS[:, 2]) ** 2)
    below = alpha * d2 + (1 - alpha) * (xi * d1 + RAYS[:, 2])
    expected = pixels(RAYS[:, :2] / below[:, None], optics)
    assert np.abs(each.camera.project(RAYS) - expected).max() <= each.fit_px < 0.5


def test_fov_is_fitted(tmp_path):
    w, optics = 0.9, (420.0, 421.0, 367.2, 248.4)
    each = read(
        (camchain(tmp_path / "camchain.yaml", intrinsics=optics, distortion="fov", k=(w,)),)
    ).cameras[0]
    r = np.linalg.norm(RAYS[:, :2], axis=1)
    expected = pixels(RAYS[:, :2] * (np.arctan(2 * r * np.tan(w / 2)) / (r * w))[:, None], optics)
    assert np.abs(each.camera.project(RAYS) - expected).max() <= each.fit_px < 0.5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("camera_model: pinhole", "camera_model: mystery"), "cam0: camera_model 'mystery'"),
        (
            ("distortion_model: none", "distortion_model: fov"),
            "cam0: distortion_coeffs has too few",
        ),
        (("[458.7, ", "["), "cam0: intrinsics has 3 numbers, not 4"),
        (("[0.9999, 0.0", "[0.7, 0.0"), "cam1: T_cn_cnm1 is not a rotation"),
        (("  resolution: [752, 480]", "  res: 1"), "cam0: resolution"),
        (("cam1:\n", "cam1: 3\nother:\n"), "cam1 holds no camera"),
    ],
)
def test_wrong_content_is_one_line(tmp_path, change, message):
    path = camchain(tmp_path / "camchain.yaml")
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change, 1))
    with pytest.raises(CalibrationError, match=message) as caught:
        read((path,))
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
