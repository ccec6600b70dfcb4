"""Exported clouds: their level, normals, headers and memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calm_edge.cli import main
from calm_edge.geometry import se3
from calm_edge.interchange import InterchangeError
from calm_edge.interchange.export import cloud
from calm_edge.interchange.export.base import ExportOptions
from calm_edge.interchange.export.drive import read_drive
from calm_edge.interchange.export.level import best_level, level
from calm_edge.mapping.cloud_file import CloudWriter
from calm_edge.types import Float, MapTile
from tests.interchange.export.drives import with_map, write_recording


def driven(heading: Float, slope: Float, pitch: float, roll: float) -> tuple[Float, Float]:
    """T_w_c of a car with z up in the world, 1 m a step; its camera is pitched and rolled."""
    zero = np.zeros(len(heading))
    car = se3.so3_exp(np.stack([zero, zero, heading], 1))
    car = car @ se3.so3_exp(np.stack([zero, -slope, zero], 1))
    # camera axes x right, y down, z ahead in the car's x ahead, y left, z up
    axes = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    mount = axes @ se3.so3_exp(np.array([pitch, 0, roll]))
    p = np.concatenate([np.zeros((1, 3)), np.cumsum(car[:-1, :, 0], 0)])
    T = se3.compose(car @ mount, p)
    return np.asarray(se3.inverse(T[0]) @ T), T[0, :3, :3].T @ [0.0, 0, 1]


def tilt(T_w_c: Float, up: Float) -> float:
    return float(np.degrees(np.arccos(np.clip(level(T_w_c, 0.5).R_l_w[2] @ up, -1, 1))))


def test_a_round_trip_is_levelled_by_its_plane() -> None:
    heading = np.linspace(0, 2 * np.pi, 200)
    bumps = 0.01 * np.sin(np.arange(200))
    T, up = driven(heading, bumps, 0.15, 0.08)
    found = level(T, 0.5)
    assert found.method == "the plane through the path" and not found.doubt
    assert tilt(T, up) < 0.5 and found.sigma_deg < 1
    # x is ahead at the start, in the plane
    assert found.R_l_w @ T[0, :3, 2] == pytest.approx([np.cos(0.15), 0, np.sin(0.15)], abs=0.02)
    assert np.linalg.det(found.R_l_w) == pytest.approx(1)


@pytest.mark.parametrize("turn", [0.0, 0.9])
def test_an_open_drive_is_levelled_by_the_mount(turn: float) -> None:
    # a bend and back, by which the path stays narrow
    heading = turn * np.sin(np.linspace(0, 2 * np.pi, 150)) * (np.arange(150) < 20)
    T, up = driven(heading, np.zeros(150), 0.15, 0.08 if turn else 0.0)
    found = level(T, 0.5)
    assert found.method.startswith("the mount's pitch") and tilt(T, up) < 0.5
    assert "cannot be levelled" in found.doubt and 2 <= found.sigma_deg < 4


def test_a_steady_climb_is_within_the_stated_sigma_and_said() -> None:
    T, up = driven(np.zeros(150), np.full(150, 0.05), 0.1, 0.0)
    found = level(T, 0.5)
    assert tilt(T, up) == pytest.approx(np.degrees(0.05), abs=0.1)
    assert tilt(T, up) < 2 * found.sigma_deg and "climbs" in found.doubt


def test_a_standing_camera_is_not_levelled_by_its_path() -> None:
    T = np.tile(np.eye(4), (5, 1, 1))
    found = level(T, 0.5)
    assert "too short" in found.doubt and found.R_l_w[2] == pytest.approx([0, -1, 0])


# about the camera's axis: the travel is along the picture's vertical, or across it; the latter on a
# straight road is as of a camera that looks to the side
@pytest.mark.parametrize(("turn", "roll"), [(0.0, 0.0), (0.9, 0.0), (0.9, np.pi / 2)])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_camera_that_looks_straight_up_or_down_is_said(
    side: int, turn: float, roll: float
) -> None:
    heading = turn * np.sin(np.linspace(0, 2 * np.pi, 150))
    T, up = driven(heading, np.zeros(150), side * np.pi / 2, 0.0)
    T = T @ se3.compose(se3.so3_exp(np.array([0.0, 0.0, roll])), np.zeros(3))
    T = se3.inverse(T[0]) @ T
    up = se3.so3_exp(np.array([0.0, 0.0, -roll])) @ up
    found = level(T, 0.5)
    assert abs(found.R_l_w[2] @ up) > 0.99
    assert "straight up or down" in found.doubt and found.sigma_deg >= 90
    forward = T[1, :3, 3] / np.linalg.norm(T[1, :3, 3])
    assert found.R_l_w[0] @ forward == pytest.approx(1, abs=0.02)


def test_a_camera_that_looks_straight_up_is_levelled_by_gps_heights() -> None:
    T, _ = driven(np.zeros(150), np.zeros(150), np.pi / 2, 0.0)
    found = best_level(T, 0.5, np.eye(3), 0.3)
    assert found.method == "GPS heights"
    assert np.linalg.det(found.R_l_w) == pytest.approx(1)
    stood = best_level(np.tile(np.eye(4), (5, 1, 1)), 0.5, np.eye(3), 0.3)
    # the top of the picture
    assert stood.R_l_w[0] == pytest.approx([0, -1, 0])


@pytest.fixture
def mapped(tmp_path: Path) -> Path:
    """A map whose cloud is a wall at z = 40 and a road at y = 1.5, in the world."""
    folder = with_map(write_recording(tmp_path / "rec"), tmp_path / "map")
    rng = np.random.default_rng(5)
    wall = np.column_stack([rng.uniform(-5, 5, 3000), rng.uniform(-4, 1, 3000), np.full(3000, 40)])
    road = np.column_stack([rng.uniform(-5, 5, 3000), np.full(3000, 1.5), rng.uniform(3, 18, 3000)])
    with CloudWriter(folder / "map.ply") as file:
        for part, color in ((wall, (255, 0, 10)), (road, (90, 90, 90))):
            points = part.astype(np.float32)
            file.write(MapTile(points, np.tile(np.uint8(color), (3000, 1))))
    return folder


def test_ply_has_normals_towards_the_road_and_a_header(
    mapped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cloud, "TILE", 1000)
    assert main(["export", str(mapped), "--to", "ply", "--out", str(tmp_path / "out")]) == 0
    head, _, body = (tmp_path / "out/map.ply").read_bytes().partition(b"end_header\n")
    for text in ("z up", "metres, sigma", "levelled by", "calm-edge 0", "element vertex 6000"):
        assert text.encode() in head, text
    v = np.frombuffer(body, cloud.VERTEX)
    R = level(read_drive(mapped).keyframes.T_w_c, 0.5).R_l_w
    wall, road = v[:3000], v[3000:]
    assert wall["n"] @ R == pytest.approx(np.tile([0, 0, -1.0], (3000, 1)), abs=1e-3)
    assert road["n"] @ R == pytest.approx(np.tile([0, -1.0, 0], (3000, 1)), abs=1e-3)
    assert (wall["p"] @ R)[:, 2] == pytest.approx(np.full(3000, 40), abs=1e-4)
    assert road["color"][0].tolist() == [90, 90, 90]
    # up is up: the road is below the camera, the wall ahead
    assert road["p"][:, 2].max() < -0.7 and wall["p"][:, 0].mean() > 15


def test_laz_is_read_back(mapped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    laspy = pytest.importorskip("laspy", reason="laspy is not installed (laz extra)")
    monkeypatch.setattr(cloud, "TILE", 1000)
    (tmp_path / "out").mkdir()
    written = cloud.Laz().write(read_drive(mapped), tmp_path / "out", ExportOptions())
    read = laspy.read(tmp_path / "out" / "map.laz")
    assert str(read.header.version) == "1.4" and len(read.points) == 6000
    R = level(read_drive(mapped).keyframes.T_w_c, 0.5).R_l_w
    assert (read.xyz @ R)[:3000, 2] == pytest.approx(np.full(3000, 40), abs=2e-3)
    assert [read.red[0], read.green[0], read.blue[0]] == [65535, 0, 2570]
    assert any(b"levelled by" in v.record_data_bytes() for v in read.header.vlrs)
    assert any("not georeferenced" in line for line in written.left_out)


def test_a_recording_has_no_cloud(tmp_path: Path) -> None:
    drive = read_drive(write_recording(tmp_path / "rec"))
    with pytest.raises(InterchangeError, match="has no cloud; make one by calm-edge map"):
        cloud.levelled(drive)
