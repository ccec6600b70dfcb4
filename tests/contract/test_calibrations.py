"""What every calibration format must do, whichever it is: one suite over all of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.interchange.calibration.calibration import (
    GRID,
    CalibratedCamera,
    Calibration,
    CalibrationError,
)
from calm_edge.interchange.calibration.formats import FORMATS, format_of, read, write

OPTICS = 701.25, 703.5, 655.2, 352.8, 1280, 720
LENSES: dict[str, Camera] = {
    "pinhole": Perspective(*OPTICS),
    "radial": Perspective(*OPTICS, (-0.31, 0.09)),
    "tangential": Perspective(*OPTICS, (-0.31, 0.09, 0.0012, -0.0007)),
    "third radial": Perspective(*OPTICS, (-0.31, 0.12, 0.0012, -0.0007, -0.02)),
    "rational": Perspective(*OPTICS, (0.4, 0.1, 0.0003, -0.0002, 0.01, 0.71, 0.2, 0.03)),
    "fisheye": Fisheye(*OPTICS, (-0.013, 0.012, -0.004, 0.0008)),
}
# lenses of which a format has no terms
BEYOND = {"kalibr": ("third radial", "rational")}
HELD = [(f, lens) for f in FORMATS for lens in LENSES if lens not in BEYOND.get(f, ())]
T_P_A = se3.exp(np.array([0.52, -0.03, 0.05, 0.01, -0.04, 0.02]))


def of(*lenses: str, rig: bool = True) -> Calibration:
    cameras = tuple(CalibratedCamera(LENSES[lens], lens) for lens in lenses)
    rig = rig and len(cameras) == 2
    return Calibration(cameras, T_P_A if rig else None, metric=rig)


@pytest.mark.parametrize(("name", "lens"), HELD)
def test_both_cameras_and_the_rig_come_back(name: str, lens: str, tmp_path: Path) -> None:
    given = of(lens, "tangential")
    found = read(tuple(write(name, tmp_path / "out", given)[: 2 if name == "ros" else 1]))
    assert len(found.cameras) == 2 and found.T_p_a is not None
    assert np.allclose(found.T_p_a, T_P_A, atol=1e-9)
    for before, after in zip(given.cameras, found.cameras, strict=True):
        assert type(after.camera) is type(before.camera) and after.fit_px == 0
        rays = before.camera.rays(before.camera.pixel_grid(*GRID))
        assert np.allclose(after.camera.project(rays), before.camera.project(rays), atol=1e-9)


@pytest.mark.parametrize("name", FORMATS)
def test_one_camera_and_no_rig_come_back(name: str, tmp_path: Path) -> None:
    given = of("radial", rig=False)
    found = read(tuple(write(name, tmp_path / "out", given)))
    assert len(found.cameras) == 1 and found.T_p_a is None and found.spacing_m is None
    camera = found.cameras[0].camera
    assert camera.project(np.array([0.3, -0.2, 1.0])) == pytest.approx(
        LENSES["radial"].project(np.array([0.3, -0.2, 1.0]))
    )


@pytest.mark.parametrize(("name", "lens"), [(n, lens) for n in BEYOND for lens in BEYOND[n]])
def test_a_lens_that_a_format_cannot_hold_is_refused(name: str, lens: str, tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="use --format"):
        write(name, tmp_path / "out", of(lens, lens))


@pytest.mark.parametrize("name", FORMATS)
def test_notes_are_comments(name: str, tmp_path: Path) -> None:
    note = "focal of the primary: sigma 0.4 %"
    files = write(name, tmp_path / "out", of("radial", "radial"), (note,))
    assert f"# {note}" in files[0].read_text()


@pytest.mark.parametrize("name", FORMATS)
def test_the_format_is_recognised_by_content(name: str, tmp_path: Path) -> None:
    path = write(name, tmp_path / "out", of("radial", "radial"))[0]
    assert format_of(tmp_path / "any.name", path.read_bytes()) == name


@pytest.mark.parametrize("name", FORMATS)
def test_an_existing_file_is_not_overwritten(name: str, tmp_path: Path) -> None:
    (tmp_path / "kept").write_text("mine")
    with pytest.raises(CalibrationError, match="is not empty"):
        write(name, tmp_path, of("radial", "radial"))
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("part", [0.3, 0.6, 0.9])
def test_a_truncated_file_is_one_line_with_its_name(name: str, part: float, tmp_path: Path) -> None:
    path = write(name, tmp_path / "out", of("rational" if name != "kalibr" else "radial"))[0]
    whole = path.read_bytes()
    path.write_bytes(whole[: int(part * len(whole))])
    with pytest.raises(CalibrationError) as caught:
        # what is left may be a whole camera, but never a silently wrong one
        found = read((path,))
        assert found.cameras[0].camera == read_whole(path, whole)
        raise CalibrationError(f"{path}: complete")
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def read_whole(path: Path, whole: bytes) -> Camera:
    path.write_bytes(whole)
    return read((path,)).cameras[0].camera


@pytest.mark.parametrize("name", FORMATS)
def test_other_numbers_than_a_lens_are_refused(name: str, tmp_path: Path) -> None:
    path = write(name, tmp_path / "out", of("pinhole"))[0]
    text = path.read_text()
    for number, wrong in (("701.25", "-701.25"), ("701.25", "no"), ("1280", "640")):
        path.write_text(text.replace(number, wrong, 1))
        with pytest.raises(CalibrationError, match=path.name):
            read((path,))


@pytest.mark.parametrize("name", FORMATS)
def test_numbers_of_numpy_are_written_as_numbers(name: str, tmp_path: Path) -> None:
    optics = np.array([701.25, 703.5, 655.2, 352.8])
    lens = Perspective(*optics, 1280, 720, tuple(np.array([-0.31, 0.09])))
    calibration = Calibration((CalibratedCamera(lens, "radial"),))
    found = read(tuple(write(name, tmp_path / "out", calibration))).cameras[0].camera
    assert found.fx == 701.25 and found.distortion[:2] == (-0.31, 0.09)
