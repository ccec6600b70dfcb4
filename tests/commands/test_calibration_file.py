"""`record --calibration`: what is printed, recorded and refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calm_edge.cli import main
from calm_edge.commands.calibration_file import with_calibration
from calm_edge.config import Config, merge
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.interchange.calibration.calibration import CalibratedCamera, Calibration
from calm_edge.interchange.calibration.formats import write
from calm_edge.kit.calibration import camera_of
from calm_edge.recording.reader import Recording
from tests.replay.small_drive import write_drive

T_P_A = se3.exp(np.array([0.52, -0.03, 0.05, 0.01, -0.04, 0.02]))
LENSES = (
    Perspective(812.0, 815.0, 655.0, 350.0, 1280, 720, (-0.3, 0.1, 0.001, -0.001)),
    Fisheye(700.0, 701.0, 640.0, 361.0, 1280, 720, (0.01, -0.002, 0.001, 0.0003)),
)


def camchain(folder, lenses=LENSES, rig=T_P_A):
    cameras = tuple(CalibratedCamera(lens, "test") for lens in lenses)
    (path,) = write("kalibr", folder, Calibration(cameras, rig, metric=True))
    return path


def given(path, spacing_m=0.0):
    return merge(Config(), {"calibration": {"file": str(path)}, "scale": {"spacing_m": spacing_m}})


def test_the_cameras_are_in_the_configuration_in_their_own_model(tmp_path):
    said: list[str] = []
    config = with_calibration(given(camchain(tmp_path / "out")), said.append)
    assert tuple(camera_of(entry) for entry in config.calibration.cameras) == LENSES
    rotation, centre = np.split(np.array(config.calibration.rig), 2)
    assert np.allclose(se3.so3_exp(rotation), T_P_A[:3, :3])
    assert np.allclose(centre * config.scale.spacing_m, T_P_A[:3, 3])
    assert "calibration of the primary: focal 812.0 px, sigma" in said[0]
    assert any("distance of the cameras in the calibration" in line for line in said)
    assert merge(Config(), config.to_dict()) == config


@pytest.mark.parametrize(("spacing_m", "lines"), [(0.521, 0), (0.6, 1)])
def test_a_given_spacing_holds_and_a_difference_is_said(tmp_path, spacing_m, lines):
    said: list[str] = []
    config = with_calibration(given(camchain(tmp_path / "out"), spacing_m), said.append)
    assert config.scale.spacing_m == spacing_m
    assert sum("m apart in the calibration" in line for line in said) == lines


def test_one_camera_is_the_primary(tmp_path):
    said: list[str] = []
    config = with_calibration(given(camchain(tmp_path / "out", LENSES[1:], None)), said.append)
    assert len(config.calibration.cameras) == 1 and config.calibration.rig == ()
    assert "used for the primary" in said[-1]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("calibrated") / "sequence", 12)


def recorded(drive, out, *arguments):
    options = ["--sequence", str(drive), "--out", str(out), "--pace", "lockstep"]
    options += ["--set", f"backbone.name=scripted:{drive}", "--spacing-m", "0.5"]
    return main(["record", *options, "--calibration", *map(str, arguments)])


def sized(width, height):
    return tuple(Perspective.from_hfov(70.0, width, height) for _ in range(2))


def test_a_recording_holds_what_the_file_said(tmp_path, drive):
    width, height = picture_size(drive)
    path = camchain(tmp_path / "cal", sized(width, height))
    assert recorded(drive, tmp_path / "rec", path) in (0, 3)
    config = Recording(tmp_path / "rec").config
    assert config.calibration.file == (str(path),)
    assert camera_of(config.calibration.cameras[1]) == sized(width, height)[1]
    # a replay needs the file no more
    path.unlink()
    again = main(["record", "--replay", str(tmp_path / "rec"), "--out", str(tmp_path / "again")])
    assert again in (0, 3)
    assert Recording(tmp_path / "again").config.calibration == config.calibration


def picture_size(drive):

    height, width = cv2.imread(str(next((drive / "cam0").iterdir()))).shape[:2]
    return width, height


def refusal(capsys):
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("calm-edge: ")
    return line


def test_pictures_of_another_shape_are_refused_before_recording(tmp_path, drive, capsys):
    path = camchain(tmp_path / "cal", sized(1000, 1000))
    assert recorded(drive, tmp_path / "rec", path) == 1
    line = refusal(capsys)
    assert str(path) in line and "primary" in line and "1000 x 1000" in line
    assert not (tmp_path / "rec").exists()


@pytest.mark.parametrize("content", ["", "cam0: 1\n", "%YAML:1.0\n---\na: 1\n"])
def test_a_wrong_file_is_one_line_before_recording(tmp_path, drive, capsys, content):
    (tmp_path / "wrong.yaml").write_text(content)
    assert recorded(drive, tmp_path / "rec", tmp_path / "wrong.yaml") == 1
    assert "wrong.yaml" in refusal(capsys) and not (tmp_path / "rec").exists()
    assert recorded(drive, tmp_path / "rec", tmp_path / "missing.yaml") == 1
    assert "missing.yaml: cannot be read" in refusal(capsys)
