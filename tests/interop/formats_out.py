"""Exports of every format, opened by readers of other makers."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np

from calm_edge.evaluation import trajectory
from calm_edge.evaluation.results import evaluate
from calm_edge.evaluation.truth import read_truth
from calm_edge.geometry import local_enu, se3
from calm_edge.geometry.similarity import align
from calm_edge.interchange.export.drive import read_drive
from calm_edge.interchange.ros_bag import RosBag
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.trajectories import read_kitti, write_kitti, write_tum
from calm_edge.types import Float
from device.frame import Eye
from tests.interop.format_row import Reading, Row, calm_edge

# of figures that evo prints with six decimals, of pixels, and of metres on the Earth
SAME_M, SAME_PX, SAME_PLACE_M = 2e-6, 0.01, 0.005
GPX, KML = "{http://www.topografix.com/GPX/1/1}", "{http://www.opengis.net/kml/2.2}"


@dataclass(frozen=True)
class Drive:
    """What is exported: a map, its recording, and a truth of both."""

    map: Path
    truth: Path

    @cached_property
    def recording(self) -> Path:
        return Path(json.loads((self.map / "summary.json").read_text())["recording"])

    def export(self, name: str, folder: Path, *options: str) -> Path:
        calm_edge("export", self.map, "--to", name, "--out", folder / "out", *options)
        return folder / "out"


def evo(*arguments: str | Path) -> float:
    """The RMS error that evo_ape prints; ImportError without evo."""
    if shutil.which("evo_ape") is None:
        raise ImportError("evo (evo_ape)")
    command = ["evo_ape", *(str(each) for each in arguments)]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    found = re.search(r"rmse\s+([\d.]+)", ran.stdout)
    assert found is not None, ran.stdout
    return float(found[1])


def tum(drive: Drive, option: str, key: str) -> Callable[[Path], Reading]:
    """Keyframes against the truth: evo_ape tum, and `calm-edge eval`."""

    def read(folder: Path) -> Reading:
        out = drive.export("tum", folder)
        truth = read_truth(drive.truth)
        write_tum(folder / "truth.tum", truth.t_ns - ORIGIN_NS, truth.T_w_c)
        theirs = evo("tum", folder / "truth.tum", out / "keyframes.tum", *option.split())
        ours = evaluate(drive.map, drive.truth)[key]
        words = f"{theirs:.6f} m, calm-edge eval {ours:.6f} m"
        return Reading(f"evo_ape tum {option}", words, abs(theirs - ours) <= SAME_M)

    return read


def kitti(drive: Drive, folder: Path) -> Reading:
    """Every frame against the truth: evo_ape kitti, and our own alignment of the same rows."""
    out = drive.export("kitti", folder)
    T, truth = read_kitti(out / "primary.txt"), read_truth(drive.truth)
    count = min(len(T), len(truth.T_w_c))
    write_kitti(folder / "truth.txt", truth.T_w_c[:count])
    write_kitti(folder / "found.txt", T[:count])
    theirs = evo("kitti", folder / "truth.txt", folder / "found.txt", "-a")
    p, p_true = T[:count, :3, 3], truth.T_w_c[:count, :3, 3]
    ours = trajectory.ate(align(p, p_true, with_scale=False).points(p), p_true)
    words = f"{theirs:.6f} m, ours {ours:.6f} m, {count} rows"
    return Reading("evo_ape kitti -a", words, abs(theirs - ours) <= SAME_M)


def table(drive: Drive, folder: Path) -> Reading:
    """Rows of both eyes."""
    out = drive.export("csv", folder)
    rows = []
    for eye in Eye:
        with (out / f"{eye.name.lower()}.csv").open() as file:
            rows.append(len(list(csv.DictReader(file))))
    recording = read_drive(drive.map).recording
    frames = [len(recording.frame_times(eye)) for eye in Eye]
    return Reading("csv", f"{rows} rows for {frames} frames", rows == frames)


def colmap(drive: Drive, *options: str) -> Callable[[Path], Reading]:
    """Images, points and the mean reprojection error by pycolmap."""

    def read(folder: Path) -> Reading:
        import pycolmap

        out = drive.export("colmap", folder, *options)
        model = pycolmap.Reconstruction(str(out / "sparse" / "0"))
        files = len(list((out / "images").rglob("*.jpg")))
        error = model.compute_mean_reprojection_error()
        words = f"{model.num_images()} images, {len(model.points3D)} points, {error:.3f} px"
        return Reading("pycolmap", words, model.is_valid() and model.num_images() == files)

    return read


def transforms(drive: Drive, folder: Path) -> Reading:
    """COLMAP's points projected by the cameras of transforms.json, and by pycolmap."""
    import pycolmap

    out = drive.export("transforms", folder)
    calm_edge("export", drive.map, "--to", "colmap", "--out", folder / "colmap")
    model = pycolmap.Reconstruction(str(folder / "colmap" / "sparse" / "0"))
    points = np.array([point.xyz for point in model.points3D.values()])
    frames = json.loads((out / "transforms.json").read_text())["frames"]
    named = {str(Path(f["file_path"]).relative_to("images")): f for f in frames}
    off, compared = 0.0, 0
    for image in model.images.values():
        frame = named[image.name]
        p = se3.transform(se3.inverse(np.array(frame["transform_matrix"])), points)
        ahead = p[:, 2] < -0.1
        u = frame["cx"] + frame["fl_x"] * p[ahead, 0] / -p[ahead, 2]
        v = frame["cy"] - frame["fl_y"] * p[ahead, 1] / -p[ahead, 2]
        for mine, point in zip(np.stack([u, v], 1), points[ahead], strict=True):
            theirs = image.project_point(point)
            if theirs is not None and (np.abs(theirs) < 1e4).all():
                off, compared = max(off, float(np.abs(mine - theirs).max())), compared + 1
    words = f"{compared} projections at most {off:.4f} px from pycolmap's"
    return Reading("json, OpenGL axes", words, compared > 0 and off <= SAME_PX)


def ply(drive: Drive, folder: Path) -> Reading:
    """Number of points and normals by OpenCV."""
    out = drive.export("ply", folder)
    vertices, normals = cv2.loadPointCloud(str(out / "map.ply"))[:2]
    head = (out / "map.ply").read_bytes()[:4096]
    count = int(re.search(rb"element vertex (\d+)", head)[1])  # type: ignore[index]
    found = np.asarray(vertices).reshape(-1, 3), np.asarray(normals).reshape(-1, 3)
    agrees = all(len(each) == count and np.isfinite(each).all() for each in found)
    return Reading("OpenCV", f"{len(found[0])} of {count} points, with normals", agrees)


def laz(drive: Drive, folder: Path) -> Reading:
    """Points and reference system by laspy, and the extent of the cloud as PLY."""
    import laspy

    out = drive.export("laz", folder)
    calm_edge("export", drive.map, "--to", "ply", "--out", folder / "ply")
    read = laspy.read(out / "map.laz")
    count = len(np.asarray(cv2.loadPointCloud(str(folder / "ply" / "map.ply"))[0]).reshape(-1, 3))
    system = read.header.parse_crs()
    place = "no reference system" if system is None else f"EPSG:{system.to_epsg()}"
    words = f"LAS {read.header.version}, {len(read.points)} of {count} points, {place}"
    return Reading("laspy", words, len(read.points) == count)


def ros2(drive: Drive, folder: Path) -> Reading:
    """Messages by topic, by rosbags."""
    bag = RosBag((drive.export("ros2", folder) / "bag",))
    counts = {topic.name: topic.count for topic in bag.topics()}
    recording = read_drive(drive.map).recording
    names = {eye: f"/{eye.name.lower()}/image_raw/compressed" for eye in Eye}
    agrees = all(counts[names[eye]] == len(recording.frame_times(eye)) for eye in Eye)
    shown = ", ".join(f"{name.split('/')[1]} {n}" for name, n in sorted(counts.items()))
    return Reading("rosbags", shown, agrees)


def places(path: Path) -> Float:
    """Longitude and latitude (N, 2) of a track."""
    if path.suffix == ".geojson":
        (feature,) = json.loads(path.read_text())["features"]
        lines = feature["geometry"]["coordinates"]
        return np.concatenate([np.array(line)[:, :2] for line in lines])
    root = ElementTree.parse(path).getroot()
    if path.suffix == ".gpx":
        points = root.findall(f".//{GPX}trkpt")
        return np.array([[float(p.attrib[k]) for k in ("lon", "lat")] for p in points])
    texts = [node.text or "" for node in root.iter(f"{KML}coordinates")]
    return np.array([[float(v) for v in row.split(",")[:2]] for row in " ".join(texts).split()])


def by_proj(drive: Drive) -> Float:
    """Longitude and latitude (N, 2) of the primary's poses, by PROJ from the map's gps.json."""
    import pyproj

    place = json.loads((drive.map / "gps.json").read_text())
    poses = read_drive(drive.map).frame_poses()[Eye.PRIMARY]
    T = np.array(place["T_enu_w"])
    enu = place["scale"] * poses.T_w_c[poses.known, :3, 3] @ T[:3, :3].T + T[:3, 3]
    latitude, longitude, height = place["origin_deg_deg_m"]
    chain = pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lat_0={latitude} "
        f"+lon_0={longitude} +h_0={height} +step +inv +proj=cart +ellps=WGS84"
    )
    return np.stack(chain.transform(*enu.T), 1)[:, :2]


def earth(drive: Drive, name: str) -> Callable[[Path], Reading]:
    """The track, and its distance from the poses placed by PROJ."""

    def read(folder: Path) -> Reading:
        found = places(drive.export(name, folder) / f"track.{name}")
        wanted = by_proj(drive)
        agrees, words = len(found) == len(wanted), f"{len(found)} of {len(wanted)} points"
        if agrees:
            lla = [np.column_stack([p[:, ::-1], np.zeros(len(p))]) for p in (found, wanted)]
            here, there = (local_enu.enu(each, lla[1][0]) for each in lla)
            most = float(np.abs(here - there).max())
            agrees, words = most <= SAME_PLACE_M, f"{words}, {1e3 * most:.2f} mm from PROJ's"
        return Reading("json" if name == "geojson" else "ElementTree", words, agrees)

    return read


def stored(drive: Drive, folder: Path) -> Reading:
    """Pictures as files, against those of the recording."""
    out = drive.export("pictures", folder)
    recording: Any = read_drive(drive.map).recording
    recorded = [bytes(f.image) for eye in Eye for f in recording.frames(eye)]
    files = [p for eye in range(2) for p in sorted((out / f"cam{eye}").iterdir())]
    same = sum(a.read_bytes() == b for a, b in zip(files, recorded, strict=False))
    words = f"{same} of {len(recorded)} pictures byte for byte"
    return Reading("files", words, same == len(recorded) == len(files))


def rows(drive: Drive) -> list[Row]:
    """Rows of all formats. Those on the Earth need a map with gps.json."""
    where = drive.map.name
    found = [
        Row("TUM", where, tum(drive, "-a", "ate_se3_m")),
        Row("TUM", where, tum(drive, "-a -s", "ate_sim3_m")),
        Row("KITTI", where, lambda folder: kitti(drive, folder)),
        Row("CSV", where, lambda folder: table(drive, folder)),
        Row("COLMAP, text", where, colmap(drive)),
        Row("COLMAP, binary", where, colmap(drive, "--binary")),
        Row("COLMAP, distorted", where, colmap(drive, "--distorted")),
        Row("COLMAP, every frame", where, colmap(drive, "--every-frame")),
        Row("transforms.json", where, lambda folder: transforms(drive, folder)),
        Row("PLY", where, lambda folder: ply(drive, folder)),
        Row("LAZ", where, lambda folder: laz(drive, folder)),
        Row("ROS 2 bag", where, lambda folder: ros2(drive, folder)),
        Row("pictures", where, lambda folder: stored(drive, folder)),
    ]
    if (drive.map / "gps.json").is_file():
        found += [
            Row(name.upper(), where, earth(drive, name)) for name in ("geojson", "gpx", "kml")
        ]
    return found
