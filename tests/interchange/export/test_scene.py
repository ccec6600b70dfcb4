"""Exported pictures, cameras and landmarks, read by pycolmap and by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.interchange.calibration import formats
from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.drive import read_drive
from calm_edge.interchange.export.registry import EXPORTERS
from tests.interchange.export.drives import (
    EVERY,
    FRAMES,
    LENSES,
    MARKERS,
    T_P_A,
    assistant_poses,
    live_poses,
    true_poses,
    write_recording,
)

FISHEYES: tuple[Camera, Camera] = (
    Fisheye(120.0, 120.0, 94.5, 66.5, 192, 128, (0.02, -0.01, 0.0, 0.0)),
    Fisheye(140.0, 140.0, 99.5, 61.5, 192, 128, (0.01, 0.0, 0.0, 0.0)),
)
N = FRAMES // EVERY


@pytest.fixture(scope="module", params=["perspective", "fisheye"])
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    lenses = FISHEYES if request.param == "fisheye" else LENSES
    live = live_poses(1.0, exact=True)
    return write_recording(tmp_path_factory.mktemp("drive") / "rec", lenses=lenses, live=live)


def export(name: str, source: Path, folder: Path, options: ExportOptions) -> Written:
    folder.mkdir()
    return EXPORTERS[name].write(read_drive(source), folder, options)


def spot(picture: Path, near: np.ndarray) -> np.ndarray | None:
    """Centre of the bright spot next to `near`, px; None if it is at the border or not alone."""
    gray = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE).astype(float)
    x, y = np.rint(near).astype(int)
    if not (8 <= x < gray.shape[1] - 8 and 8 <= y < gray.shape[0] - 8):
        return None
    part = gray[y - 6 : y + 7, x - 6 : x + 7]
    ring = np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])
    if ring.max() > 12:
        return None
    weight = np.where(part > 12, part, 0)
    dy, dx = np.mgrid[-6:7, -6:7]
    return np.array([x, y]) + [(weight * d).sum() / weight.sum() for d in (dx, dy)]


def markers_on_pixels(model: Any, pictures: Path, most_px: float) -> int:
    """Count markers seen in the pictures, each projected by pycolmap to within most_px of it."""
    found = 0
    for image in model.images.values():
        for marker in MARKERS:
            uv = image.project_point(marker)
            at = None if uv is None else spot(pictures / image.name, uv - 0.5)
            if at is not None:
                assert at + 0.5 == pytest.approx(uv, abs=most_px), image.name
                found += 1
    return found


@pytest.mark.parametrize("options", [
    ExportOptions(quality=98),
    ExportOptions(quality=98, binary=True),
    ExportOptions(distorted=True, binary=True),
], ids=["pinhole text", "pinhole binary", "distorted"])  # fmt: skip
def test_pycolmap_projects_markers_onto_their_pixels(
    options: ExportOptions, recording: Path, tmp_path: Path
) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed (dev extra)")
    written = export("colmap", recording, tmp_path / "out", options)
    model = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse" / "0"))
    assert model.is_valid() and model.num_images() == 2 * N
    names = {camera.model.name for camera in model.cameras.values()}
    assert names <= ({"OPENCV", "OPENCV_FISHEYE"} if options.distorted else {"PINHOLE"})
    assert markers_on_pixels(model, tmp_path / "out/images", 0.1) >= 2 * N
    assert any(f"{2 * N} frames of the rig" in line for line in written.wrote)


def test_poses_rig_and_landmarks_are_those_of_the_drive(recording: Path, tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed (dev extra)")
    export("colmap", recording, tmp_path / "out", ExportOptions())
    model = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse" / "0"))
    true = {1: true_poses()[::EVERY], 2: assistant_poses()[::EVERY]}
    for camera_id, poses in true.items():
        images = [i for i in model.images.values() if i.camera_id == camera_id]
        images.sort(key=lambda image: image.name)
        made = np.array([image.cam_from_world().matrix() for image in images])
        assert made == pytest.approx(se3.inverse(poses)[:, :3], abs=1e-3)
    (rig,) = model.rigs.values()
    a = next(s for s in model.cameras if not rig.is_ref_sensor(model.cameras[s].sensor_id))
    T_a_p = rig.sensor_from_rig(model.cameras[a].sensor_id).matrix()
    assert T_a_p == pytest.approx(se3.inverse(T_P_A)[:3], abs=1e-12)
    assert len(model.points3D) == len(MARKERS)
    for number, point in model.points3D.items():
        # recorded 0.5 m beside, and triangulated from the final poses
        assert point.xyz == pytest.approx(MARKERS[number - 1], abs=0.01)
        assert point.error < 0.1 and point.color.min() > 100
        assert point.track.length() >= 4
    assert model.compute_mean_reprojection_error() < 0.1


def test_text_and_binary_are_read_alike_by_our_reader(recording: Path, tmp_path: Path) -> None:
    calibrations = []
    for binary in (False, True):
        out = tmp_path / str(binary)
        export("colmap", recording, out, ExportOptions(binary=binary))
        suffix = "bin" if binary else "txt"
        calibrations.append(formats.read((out / f"sparse/0/cameras.{suffix}",)))
        assert {f.name for f in (out / "sparse/0").iterdir()} == {
            f"{name}.{suffix}" for name in ("cameras", "rigs", "frames", "images", "points3D")
        }
    text, packed = calibrations
    assert text.cameras == packed.cameras
    assert text.T_p_a == pytest.approx(T_P_A, abs=1e-12)
    assert packed.T_p_a == pytest.approx(T_P_A, abs=1e-12)


def test_transforms_have_opengl_axes_and_the_pictures(recording: Path, tmp_path: Path) -> None:
    export("transforms", recording, tmp_path / "out", ExportOptions(quality=98))
    content: dict[str, Any] = json.loads((tmp_path / "out/transforms.json").read_text())
    assert len(content["frames"]) == 2 * N
    found = 0
    for frame in content["frames"]:
        T_w_gl = np.array(frame["transform_matrix"])
        p = se3.transform(se3.inverse(T_w_gl), MARKERS)
        assert (p[:, 2] < 0).all()  # OpenGL looks along -z
        u = frame["cx"] + frame["fl_x"] * p[:, 0] / -p[:, 2]
        v = frame["cy"] - frame["fl_y"] * p[:, 1] / -p[:, 2]
        for uv in np.stack([u, v], 1):
            at = spot(tmp_path / "out" / frame["file_path"], uv - 0.5)
            if at is not None:
                assert at + 0.5 == pytest.approx(uv, abs=0.1)
                found += 1
    assert found >= 2 * N


def test_pictures_that_need_no_undistortion_are_copied(recording: Path, tmp_path: Path) -> None:
    export("colmap", recording, tmp_path / "out", ExportOptions(distorted=True))
    drive = read_drive(recording)
    stored = {bytes(frame.image) for frame in drive.recording.frames()}
    pictures = sorted((tmp_path / "out" / "images").rglob("*.jpg"))
    assert len(pictures) == 2 * N and all(p.read_bytes() in stored for p in pictures)


def test_every_frame_has_its_picture_with_the_pose_of_the_trajectory(
    recording: Path, tmp_path: Path
) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed (dev extra)")
    written = export("colmap", recording, tmp_path / "out", ExportOptions(every_frame=True))
    model = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse" / "0"))
    assert model.is_valid() and len(model.points3D) == len(MARKERS)
    poses = read_drive(recording).frame_poses()
    known = sum(int(each.known.sum()) for each in poses.values())
    assert 2 * N < known == model.num_images() and known > 1.5 * FRAMES
    # between keyframes: by the exact live poses
    assert markers_on_pixels(model, tmp_path / "out/images", 0.3) >= known
    assert any("tracked" in line and "keyframes alone" in line for line in written.assumed)
    assert any("without a pose" in line for line in written.left_out) == (known < 2 * FRAMES)


def test_an_unobserved_focal_length_is_called_a_guess(tmp_path: Path) -> None:
    source = write_recording(tmp_path / "rec", sigma=0.3)
    written = export("colmap", source, tmp_path / "out", ExportOptions())
    assert any("sigma 30.0 %, not observed in this drive: a guess" in a for a in written.assumed)
