import numpy as np
import pytest

from calm_edge.geometry.camera import Perspective
from calm_edge.interchange.calibration.calibration import CalibrationError, matched
from calm_edge.interchange.calibration.formats import read

CAMERA = Perspective(1000.0, 1002.0, 951.0, 545.0, 1920, 1080, (-0.3, 0.1))
ROW = "{n} OPENCV 640 480 500 510 322 238 -0.2 0.05 0.001 -0.002\n"


def test_pictures_of_the_same_size_are_taken_as_they_are():
    assert matched(CAMERA, 1920, 1080) == (CAMERA, "")


def test_a_smaller_picture_of_the_same_shape_is_scaled_with_a_sentence():
    camera, said = matched(CAMERA, 1280, 720)
    ray = np.array([0.3, -0.2, 1.0])
    # pixel centres: the corner (-0.5, -0.5) stays
    assert np.allclose(camera.project(ray) + 0.5, (CAMERA.project(ray) + 0.5) / 1.5)
    assert "1920 x 1080" in said and "1280 x 720" in said and "scaled" in said


@pytest.mark.parametrize("size", [(1280, 960), (1440, 1080), (1080, 1920)])
def test_a_cropped_picture_is_refused(size):
    with pytest.raises(CalibrationError, match="cropped"):
        matched(CAMERA, *size)


def files(folder, *counts):
    out = []
    for number, count in enumerate(counts):
        path = folder / f"camera{number}.txt"
        path.write_text("".join(ROW.format(n=n + 1) for n in range(count)))
        out.append(path)
    return tuple(out)


@pytest.mark.parametrize("counts", [(1,), (2,), (1, 1)])
def test_one_or_two_cameras_are_taken(tmp_path, counts):
    assert len(read(files(tmp_path, *counts)).cameras) == sum(counts)


@pytest.mark.parametrize(
    ("counts", "message"),
    [((3,), "holds 3 cameras"), ((2, 1), "must hold one"), ((1, 1, 1), "or one per camera")],
)
def test_other_numbers_of_cameras_are_refused(tmp_path, counts, message):
    with pytest.raises(CalibrationError, match=message):
        read(files(tmp_path, *counts))


@pytest.mark.parametrize("content", [b"", b"hello", b"\x00\xff" * 50, b"a: 1\n", b"[]"])
def test_other_files_are_refused_by_name(tmp_path, content):
    (tmp_path / "any").write_bytes(content)
    with pytest.raises(CalibrationError, match="any: not a calibration of"):
        read((tmp_path / "any",))


def test_a_missing_file_and_a_folder_are_refused_by_name(tmp_path):
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(CalibrationError, match="cannot be read"):
            read((path,))
