"""Exports of a georeferenced map: the path on the Earth, the cloud in UTM, levelled by GPS."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from calm_edge.cli import main
from calm_edge.geometry import local_enu
from calm_edge.interchange import InterchangeError
from calm_edge.interchange.export import cloud
from calm_edge.interchange.export.base import ExportOptions
from calm_edge.interchange.export.drive import read_drive
from calm_edge.interchange.export.georeference import read_georeference
from calm_edge.interchange.export.gpx import Gpx
from calm_edge.interchange.export.registry import EXPORTERS
from calm_edge.interchange.export.utm import utm
from calm_edge.mapping.cloud_file import CloudWriter
from calm_edge.types import Float, MapTile
from device.frame import Eye
from device.gps.gps_file import read_gps_file
from tests.interchange.export.drives import (
    ORIGIN,
    SCALE,
    SHIFT,
    R,
    georeferenced,
    with_map,
    write_recording,
)


@pytest.fixture
def placed(tmp_path: Path) -> Path:
    """A map with a cloud of three points and a georeference."""
    folder = with_map(write_recording(tmp_path / "rec"), tmp_path / "map")
    with CloudWriter(folder / "map.ply") as file:
        points = np.array([[0, 1.5, 10], [2, 0, 40], [-3, 1, 25]], np.float32)
        file.write(MapTile(points, np.full((3, 3), 100, np.uint8)))
    return georeferenced(folder)


def expected(folder: Path) -> Float:
    """Positions of the frames (N, 3) in east, north, up."""
    poses = read_drive(folder).frame_poses()[Eye.PRIMARY]
    return np.asarray(SCALE * poses.T_w_c[poses.known, :3, 3] @ R.T + SHIFT)


def test_geojson_gpx_and_kml_hold_the_path_of_every_frame(placed: Path, tmp_path: Path) -> None:
    for name in ("geojson", "gpx", "kml"):
        assert main(["export", str(placed), "--to", name, "--out", str(tmp_path / name)]) == 0
    wanted = expected(placed)
    (feature,) = json.loads((tmp_path / "geojson/track.geojson").read_text())["features"]
    assert feature["geometry"]["type"] == "MultiLineString"
    lines = [np.array(line) for line in feature["geometry"]["coordinates"]]
    found = local_enu.enu(np.concatenate(lines)[:, [1, 0, 2]], ORIGIN)
    np.testing.assert_allclose(found, wanted, atol=2e-3)
    assert feature["properties"]["residual_rms_m"] == 1.4
    root = ElementTree.parse(tmp_path / "gpx/track.gpx").getroot()
    points = root.findall(".//{http://www.topografix.com/GPX/1/1}trkpt")
    assert len(points) == len(wanted)
    lla = np.array([[float(p.attrib[k]) for k in ("lat", "lon")] for p in points])
    np.testing.assert_allclose(lla, np.concatenate(lines)[:, [1, 0]], atol=1e-8)
    kml = ElementTree.parse(tmp_path / "kml/track.kml").getroot()
    texts = [node.text or "" for node in kml.iter("{http://www.opengis.net/kml/2.2}coordinates")]
    places = np.array([[float(v) for v in row.split(",")] for row in " ".join(texts).split()])
    np.testing.assert_allclose(places[:, :2], np.concatenate(lines)[:, :2], atol=1e-8)


def test_dated_stamps_are_written_and_read_back_as_fixes(placed: Path, tmp_path: Path) -> None:
    drive = read_drive(placed)
    drive = replace(drive, stamp_ns=drive.stamp_ns + 1_700_000_000 * 10**9)
    Gpx().write(drive, tmp_path, ExportOptions())
    fixes = read_gps_file(tmp_path / "track.gpx")
    poses = drive.frame_poses()[Eye.PRIMARY]
    own = drive.own_ns(poses.t_ns[poses.known])
    assert [fix.t_ns // 1000 for fix in fixes] == [t // 1000 for t in own.tolist()]
    np.testing.assert_allclose(
        local_enu.enu(np.array([fix.lla for fix in fixes]), ORIGIN), expected(placed), atol=2e-3
    )


def test_laz_is_in_the_utm_zone_of_the_map(placed: Path, tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy", reason="laspy is not installed (laz extra)")
    pyproj = pytest.importorskip("pyproj", reason="pyproj is not installed (geo extra)")
    assert main(["export", str(placed), "--to", "laz", "--out", str(tmp_path / "out")]) == 0
    read = laspy.read(tmp_path / "out/map.laz")
    system = read.header.parse_crs()
    assert system.to_epsg() == 32632
    # by PROJ alone: topocentric -> earth-centred -> UTM
    points = np.array([[0, 1.5, 10], [2, 0, 40], [-3, 1, 25]])
    enu = SCALE * points @ R.T + SHIFT
    chain = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lat_0=48.1 +lon_0=11.55 "
        "+h_0=530 +step +inv +proj=cart +ellps=WGS84 +step +proj=utm +zone=32 +ellps=WGS84"
    )
    np.testing.assert_allclose(read.xyz, np.stack(chain.transform(*enu.T), 1), atol=2e-3)


def test_a_map_in_the_south_and_west_has_its_own_zone(placed: Path) -> None:
    pytest.importorskip("pyproj", reason="pyproj is not installed (geo extra)")
    place = read_georeference(placed)
    assert place is not None
    south = replace(place, origin=np.array([-33.9, -70.7, 500.0]))
    assert utm(south).name == "EPSG:32719, UTM zone 19S"


def test_ply_is_levelled_by_gps_heights_where_these_are_better(
    placed: Path, tmp_path: Path
) -> None:
    assert main(["export", str(placed), "--to", "ply", "--out", str(tmp_path / "out")]) == 0
    head = (tmp_path / "out/map.ply").read_bytes().partition(b"end_header")[0]
    assert b"levelled by GPS heights, sigma 0.3 deg" in head
    found = cloud.level_of(read_drive(placed))
    np.testing.assert_allclose(found.R_l_w[2], R[2], atol=1e-9)
    summary = json.loads((placed / "gps.json").read_text())
    (placed / "gps.json").write_text(json.dumps(summary | {"tilt_sigma_deg": 20.0}))
    assert cloud.level_of(read_drive(placed)).method != "GPS heights"


def test_what_is_not_georeferenced_is_refused_with_the_remedy(tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "rec")
    drive = read_drive(recording)
    for name in ("geojson", "gpx", "kml"):
        with pytest.raises(InterchangeError, match=r"not georeferenced; make a map .* GPS"):
            EXPORTERS[name].write(drive, tmp_path, ExportOptions())


@pytest.mark.parametrize("text", ["{", "[]", '{"T_enu_w": 1}', "{}"])
def test_a_damaged_summary_is_refused(placed: Path, text: str) -> None:
    (placed / "gps.json").write_text(text)
    with pytest.raises(InterchangeError, match=r"gps\.json: not readable"):
        read_drive(placed)
