"""A map's trajectory in east, north, up by fixes; the free one is not changed."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np

from calm_edge.evaluation.estimate import Estimate
from calm_edge.geometry import se3
from calm_edge.offline.georeference import ENU_TUM, GPS_SUMMARY, georeference
from calm_edge.offline.gps_fixes import GpsFixes
from calm_edge.trajectories import read_tum
from calm_edge.types import Metre

START_NS = 1_400_000_000 * 10**9
ORIGIN = np.array([48.0, 11.0, 500.0])
# metres of a degree of latitude and longitude there
METRES = np.array([6_371_229, 6_390_457 * np.cos(np.radians(48.0))]) * np.pi / 180


def drive(scale: float) -> tuple[Estimate, GpsFixes]:
    """Path to the north-east and then to the north; fixes 0.3 s late, with noise and outliers."""
    rng = np.random.default_rng(4)
    t = np.arange(0, 60, 0.3)
    heading = np.where(t < 30, 0.0, -np.pi / 4)
    step = 3.0 * np.stack([np.sin(heading), 0 * t, np.cos(heading)], 1)
    p = np.cumsum(step, axis=0)
    T = se3.compose(np.tile(np.eye(3), (len(t), 1, 1)), p)
    t_ns = START_NS + np.rint(t * 1e9).astype(np.int64)
    estimate = Estimate("map", t_ns, T, spacing_m=0.5, metre=Metre(0.01))
    fix_s = np.arange(1, 59, 0.5)
    at = np.stack([np.interp(fix_s - 0.3, t, p[:, k]) for k in range(3)], axis=1) * scale
    # the camera's z is north-east, its x south-east
    east, north = (at[:, 2] + at[:, 0]) / np.sqrt(2), (at[:, 2] - at[:, 0]) / np.sqrt(2)
    noise = rng.normal(0, 1.5, (len(fix_s), 3))
    noise[::12, :2] += 60
    flat = (np.stack([north, east], 1) + noise[:, :2]) / METRES
    lla = ORIGIN + np.concatenate([flat, noise[:, 2:]], axis=1)
    sigma = np.full((len(fix_s), 3), 1.5)
    fix_ns = START_NS + np.rint(fix_s * 1e9).astype(np.int64)
    return estimate, GpsFixes(Path("gps.csv"), fix_ns, lla, sigma, 0)


def test_poses_are_east_north_up_with_the_delay_and_the_refused_fixes_reported(
    tmp_path: Path,
) -> None:
    estimate, fixes = drive(1.0)
    lines: list[str] = []
    assert georeference(estimate, fixes, tmp_path, lines.append) is not None
    content = json.loads((tmp_path / GPS_SUMMARY).read_text())
    assert content["refused"] == len(fixes.t_ns[::12]) and content["scale_by"] == "spacing"
    assert abs(content["delay_s"] - 0.3) < 4 * content["delay_sigma_s"] < 0.4
    assert 1.5 < content["residual_rms_m"] < 2.7
    assert content["disagreement"] is None and len(lines) == 1 and "refused" in lines[0]
    t_ns, T_enu_c = read_tum(tmp_path / ENU_TUM)
    assert t_ns.tolist() == estimate.t_ns.tolist()
    moved = T_enu_c[-1, :3, 3] - T_enu_c[0, :3, 3]
    first, last = estimate.T_w_c[0, :3, 3], estimate.T_w_c[-1, :3, 3]
    x, _, z = last - first
    np.testing.assert_allclose(moved[:2], [(z + x) / 2**0.5, (z - x) / 2**0.5], atol=3)
    # the camera looks north-east, its y axis down
    np.testing.assert_allclose(T_enu_c[0, :3, 2], [0.5**0.5, 0.5**0.5, 0], atol=0.06)
    assert T_enu_c[0, 2, 1] < -0.99


def test_gps_gives_the_metre_without_a_spacing_and_contradicts_a_wrong_one(tmp_path: Path) -> None:
    lines: list[str] = []
    estimate, fixes = drive(1.08)
    assert georeference(estimate, fixes, tmp_path, lines.append) is not None
    assert "GPS disagrees with scale.spacing_m" in lines[-1] and "0.54" in lines[-1]
    estimate, fixes = drive(1.5)
    assert georeference(estimate, fixes, tmp_path, lines.append) is None
    assert "not aligned to GPS: GPS disagrees" in lines[-1]
    unknown = dataclasses.replace(estimate, spacing_m=None)
    found = georeference(unknown, fixes, tmp_path, lines.append)
    assert found is not None and abs(found.scale - 1.5) < 0.03
    assert json.loads((tmp_path / GPS_SUMMARY).read_text())["scale_by"] == "GPS"


def test_fixes_of_another_day_are_refused_in_a_line(tmp_path: Path) -> None:
    estimate, fixes = drive(1.0)
    other = dataclasses.replace(fixes, t_ns=fixes.t_ns + 10**15)
    lines: list[str] = []
    assert georeference(estimate, other, tmp_path, lines.append) is None
    assert "only 0 fixes during the path" in lines[0] and not list(tmp_path.iterdir())
