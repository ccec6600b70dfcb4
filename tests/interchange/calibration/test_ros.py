import numpy as np
import pytest

from calm_edge.interchange.calibration.calibration import CalibrationError
from calm_edge.interchange.calibration.formats import read

FILE = """\
image_width: 640
image_height: 480
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [612.5, 0, 322.25, 0, 611.0, 238.5, 0, 0, 1]
distortion_model: MODEL
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.28, 0.09, 0.0011, -0.0007, 0.01]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [600, 0, 320, TX, 0, 600, 240, 0, 0, 0, 1, 0]
"""
# as printed by `ros2 topic echo`
MESSAGE = """\
header:
  frame_id: left
height: 480
width: 640
distortion_model: plumb_bob
d:
- -0.28
- 0.09
- 0.0011
- -0.0007
- 0.01
k: [612.5, 0, 322.25, 0, 611.0, 238.5, 0, 0, 1]
r: [1, 0, 0, 0, 1, 0, 0, 0, 1]
p: [600, 0, 320, 0, 0, 600, 240, 0, 0, 0, 1, 0]
"""


def camera_info(path, model="plumb_bob", tx="0"):
    path.write_text(FILE.replace("MODEL", model).replace("TX", tx))
    return path


def test_a_printed_message_is_the_same_camera(tmp_path):
    (tmp_path / "message.yaml").write_text(MESSAGE)
    printed = read((tmp_path / "message.yaml",))
    assert printed.cameras == read((camera_info(tmp_path / "left.yaml"),)).cameras


@pytest.mark.parametrize("part", ["binning_x: 2", "roi: {x_offset: 0, y_offset: 40}"])
def test_a_part_of_the_picture_is_refused(tmp_path, part):
    path = tmp_path / "message.yaml"
    path.write_text(f"{MESSAGE}binning_y: 0\nroi: {{x_offset: 0, y_offset: 0, height: 0}}\n")
    assert len(read((path,)).cameras) == 1
    path.write_text(f"{MESSAGE}{part}\n")
    with pytest.raises(CalibrationError, match="binned pictures or a region of interest"):
        read((path,))


def test_a_stereo_pair_has_its_baseline_in_metres(tmp_path):
    left, right = (
        camera_info(tmp_path / "left.yaml"),
        camera_info(tmp_path / "right.yaml", tx="-72"),
    )
    found = read((left, right))
    assert np.allclose(found.T_p_a[:3, 3], [0.12, 0, 0]) and found.spacing_m == pytest.approx(0.12)
    # the primary may be either of them
    assert np.allclose(read((right, left)).T_p_a[:3, 3], [-0.12, 0, 0])


def test_two_single_cameras_have_no_rig(tmp_path):
    files = camera_info(tmp_path / "left.yaml"), camera_info(tmp_path / "right.yaml")
    assert read(files).T_p_a is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("plumb_bob", "thin"), "distortion_model 'thin' is not supported"),
        (("[612.5", "[a"), "camera_matrix is not a list of numbers"),
        (("image_width: 640", "other: 1"), "image_width"),
        (("camera_matrix", "matrix"), "camera_matrix"),
        (("plumb_bob", "equidistant"), "a fisheye lens has 4 coefficients, not 5"),
    ],
)
def test_wrong_content_is_one_line(tmp_path, change, message):
    path = camera_info(tmp_path / "left.yaml")
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change))
    with pytest.raises(CalibrationError, match=message) as caught:
        read((path,))
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
