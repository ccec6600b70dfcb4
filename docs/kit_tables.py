"""Print the tables of kit.md: `.venv/bin/python docs/kit_tables.py demo/drive`.

What two cameras see of a street is a matter of geometry: the cloud and the path of a rendered drive
are looked at through pairs of pinhole cameras of given fields of view, spacing and angle. Occlusion
is left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calm_edge.evaluation.truth import read_truth
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.types import Float

WIDTH, HEIGHT = 640, 360
# poses that are looked from, and how far a point may be [m]
POSES, REACH_M = 12, 60.0
# parallax below which a point says nothing of the spacing [px]
MIN_PARALLAX_PX = 2.0
FOV_DEG = (50, 70, 90, 110)
SPACINGS_M = (0.12, 0.25, 0.5, 1.0)
ANGLES_DEG = (0, 5, 10, 20, 30)


def seen_by_both(
    points: Float, T_w_p: Float, fov_deg: float, spacing_m: float, angle_deg: float
) -> tuple[float, float, float]:
    """Means over poses T_w_p (N, 4, 4) of what the pair sees of points (P, 3) in the world.

    The share of the primary's points that the assistant sees too; their median parallax [px]: the
    distance of a point's place in the assistant's picture from where a point infinitely far away in
    the same direction would be; and the share of them with MIN_PARALLAX_PX or more.
    """
    camera = Perspective.from_hfov(fov_deg, WIDTH, HEIGHT)
    T_p_a = se3.exp(np.array([0, 0, 0, 0, np.radians(angle_deg), 0]))
    T_p_a[:3, 3] = [spacing_m, 0, 0]
    R_a_p = T_p_a[:3, :3].T
    rows = []
    for T in T_w_p:
        p_p = se3.transform(se3.inverse(T), points)
        p_p = p_p[inside(camera, p_p) & (np.linalg.norm(p_p, axis=1) < REACH_M)]
        p_a = se3.transform(se3.inverse(T_p_a), p_p)
        both = inside(camera, p_a)
        apart = camera.project(p_a[both]) - camera.project(p_p[both] @ R_a_p.T)
        parallax = np.linalg.norm(apart, axis=1)
        rows.append((both.mean(), np.median(parallax), (parallax >= MIN_PARALLAX_PX).mean()))
    shared, median, near = np.mean(rows, axis=0)
    return float(shared), float(median), float(near)


def inside(camera: Perspective, p_c: Float) -> np.ndarray:
    """Whether points (P, 3) in camera axes are in front of the camera and in its picture."""
    uv = camera.project(np.where(p_c[:, 2:] > 0.1, p_c, 1.0))
    size = np.array([camera.width, camera.height])
    return (p_c[:, 2] > 0.1) & ((uv >= -0.5) & (uv < size - 0.5)).all(1)


def tables(points: Float, T_w_p: Float) -> Iterator[str]:
    """Lines of the tables in Markdown."""
    cases: tuple[tuple[str, str, tuple[tuple[float, float, float], ...], int], ...] = (
        ("spacing, 70 degrees, parallel", "m", tuple((70, b, 0) for b in SPACINGS_M), 1),
        ("field of view, 0.5 m, parallel", "degrees", tuple((f, 0.5, 0) for f in FOV_DEG), 0),
        ("angle between, 70 degrees, 0.5 m", "degrees", tuple((70, 0.5, a) for a in ANGLES_DEG), 2),
    )
    for title, unit, rigs, varied in cases:
        yield f"| {title} | seen by both | median parallax | with 2 px or more |"
        yield "|---|---|---|---|"
        for rig in rigs:
            yield row(f"{rig[varied]:g} {unit}", seen_by_both(points, T_w_p, *rig))
        yield ""


def row(name: str, values: tuple[float, float, float]) -> str:
    """A row of a table."""
    shared, median, near = values
    return f"| {name} | {100 * shared:.0f} % | {median:.1f} px | {100 * near:.0f} % |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drive", type=Path, help="a sequence folder with poses0.txt and cloud.npy")
    truth = read_truth(parser.parse_args().drive)
    if truth.cloud is None or not len(truth.T_w_c):
        raise SystemExit("poses0.txt and cloud.npy are needed")
    chosen = np.linspace(0, len(truth.T_w_c) - 1, POSES).astype(int)
    for line in tables(np.asarray(truth.cloud, np.float64), truth.T_w_c[chosen]):
        print(line)


if __name__ == "__main__":
    main()
