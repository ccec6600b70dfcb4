"""Data sets as published: pictures, stamps, calibration and true poses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.interchange.base import Imported, ImportOptions
from calm_edge.interchange.registry import importer
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.types import CalmEdgeError, Float
from device.frame import Eye
from tests.interchange import layouts

T = np.arange(6) / 10
Tree = Callable[[Path, Float], Path]
TREES: dict[str, Tree] = {
    "KITTI odometry": layouts.kitti_odometry,
    "KITTI raw": layouts.kitti_raw,
    "KITTI raw, not rectified": lambda root, t: layouts.kitti_raw(root, t, "extract"),
    "EuRoC": layouts.euroc,
}


def opened(source: Path) -> Imported:
    return importer((source,)).open((source,), ImportOptions(), source, lambda text: None)


@pytest.mark.parametrize("tree", sorted(TREES))
def test_stamps_calibration_and_true_poses(tmp_path: Path, tree: str) -> None:
    imported = opened(TREES[tree](tmp_path, T))
    start = ORIGIN_NS + (0 if tree == "KITTI odometry" else layouts.START_NS)
    for eye in Eye:
        stamps = [f.t_ns for f in imported.frames(eye)]
        assert stamps == [start + round(1e9 * t) for t in T]
    assert imported.calibration is not None and imported.truth is not None
    assert imported.calibration.spacing_m == pytest.approx(layouts.SPACING_M)
    T_p_a = imported.calibration.T_p_a
    assert T_p_a is not None
    np.testing.assert_allclose(T_p_a[:3, 3], [layouts.SPACING_M, 0, 0], atol=1e-9)
    camera = imported.calibration.cameras[1].camera
    assert (camera.fx, camera.cx) == (layouts.FOCAL, layouts.CENTRE[0])
    assert camera.is_pinhole == (tree in ("KITTI odometry", "KITTI raw"))
    found = se3.inverse(imported.truth.T_w_c[0]) @ imported.truth.T_w_c
    assert len(found) == len(T)
    np.testing.assert_allclose(found, layouts.primary(T), atol=2e-4)


def test_pictures_are_the_files_themselves(tmp_path: Path) -> None:
    source = layouts.euroc(tmp_path, T)
    frame = next(opened(source).frames(Eye.ASSISTANT))
    first = sorted((source / "mav0" / "cam1" / "data").iterdir())[0]
    assert frame.image == first.read_bytes()


def test_missing_pictures_are_dropped_and_said(tmp_path: Path) -> None:
    source = layouts.euroc(tmp_path, T)
    sorted((source / "mav0" / "cam1" / "data").iterdir())[2].unlink()
    imported = opened(source)
    assert len(list(imported.frames(Eye.ASSISTANT))) == len(T) - 1
    assert "1 rows without a picture" in imported.dropped[0]


def test_without_true_poses_there_is_no_truth(tmp_path: Path) -> None:
    source = layouts.kitti_odometry(tmp_path, T)
    (tmp_path / "poses" / "03.txt").unlink()
    assert opened(source).truth is None


@pytest.mark.parametrize(
    ("tree", "file", "text", "message"),
    [
        ("EuRoC", "mav0/cam0/data.csv", "a,b\n", "has no stamp in ns"),
        ("EuRoC", "mav0/cam1/sensor.yaml", "intrinsics: [1]\n", "intrinsics"),
        ("EuRoC", "mav0/cam1/sensor.yaml", ": :\n", "not valid YAML"),
        ("KITTI raw", "../calib_cam_to_cam.txt", "P_rect_02: 1 2\n", "12 are expected"),
        ("KITTI raw", "image_03/timestamps.txt", "2011-09-26 13:02:25.9\n", "too few"),
        ("KITTI raw", "image_03/timestamps.txt", "now\n", "not a date and time"),
        ("KITTI odometry", "times.txt", "0.0\n", "numbers should be equal"),
    ],
)
def test_what_is_wrong_is_named(
    tmp_path: Path, tree: str, file: str, text: str, message: str
) -> None:
    source = TREES[tree](tmp_path, T)
    (source / file).write_text(text)
    with pytest.raises(CalmEdgeError, match=message):
        opened(source)
