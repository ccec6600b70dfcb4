"""Drives of one map are placed by the fixes of all."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calm_edge.evaluation.estimate import Estimate
from calm_edge.offline.georeference import place
from calm_edge.offline.gps_fixes import GpsFileError, GpsFixes
from calm_edge.offline.joined_gps import GpsDrive, fixes_of_drives, place_joined
from calm_edge.types import Int
from device.frame import Eye
from tests.offline.test_georeference import drive


def part(first: int, last: int, scale: float = 1.0, spacing_m: float = 0.5) -> GpsDrive:
    """Keyframes [first, last) of the drive and the fixes meanwhile; both begin at 0."""
    estimate, fixes = drive(scale)
    t_ns = estimate.t_ns[first:last]
    mine = (fixes.t_ns >= t_ns[0]) & (fixes.t_ns <= t_ns[-1] + 5 * 10**9)
    own = Estimate(
        "map",
        t_ns - t_ns[0],
        estimate.T_w_c[first:last],
        spacing_m=spacing_m,
        metre=estimate.metre,
    )
    seen = GpsFixes(
        Path(f"rec{first}"), fixes.t_ns[mine] - t_ns[0], fixes.lla[mine], fixes.sigma_m[mine], 0
    )
    return GpsDrive(f"drive{first}", own, seen)


def test_overlapping_stamps_of_two_drives_give_one_place_and_one_delay() -> None:
    lines: list[str] = []
    whole, alone = drive(1.0), part(0, 110)
    both = place_joined({0: alone, 2: part(90, 200)}, lines.append)
    assert both is not None and lines == [line for line in lines if "fixes used" in line]
    content = both.content
    assert abs(content["delay_s"] - 0.3) < 4 * content["delay_sigma_s"] < 0.6
    assert content["scale_by"] == "spacing" and content["disagreement"] is None
    assert [row["name"] for row in content["drives"]] == ["drive0", "drive90"]
    assert sum(row["used"] for row in content["drives"]) == content["used"]
    assert all(1.5 < row["residual_rms_m"] < 2.9 for row in content["drives"])
    # as by the whole drive at once
    one = place(*whole, lines.append)
    assert one is not None
    T = one.T_m_w @ whole[0].T_w_c
    moved = both.alignment.apply(T)[:, :3, 3] - one.alignment.apply(T)[:, :3, 3]
    # their origins are the medians of different fixes
    assert np.ptp(moved, axis=0) == pytest.approx([0, 0, 0], abs=2)


def test_a_drive_without_fixes_takes_part_and_alone_gives_none() -> None:
    lines: list[str] = []
    silent = dataclasses.replace(part(0, 110), fixes=None)
    found = place_joined({0: silent, 1: part(90, 200)}, lines.append)
    assert found is not None and [row["name"] for row in found.content["drives"]] == ["drive90"]
    assert place_joined({0: silent}, lines.append) is None and len(lines) == 1


def test_one_spacing_is_named_where_gps_disagrees_and_of_two_kits_none() -> None:
    lines: list[str] = []
    place_joined({0: part(0, 110, 1.08), 1: part(90, 200, 1.08)}, lines.append)
    assert "its lengths are +8." in lines[-1] and "the spacing would be 0.5" in lines[-1]
    place_joined({0: part(0, 110, 1.08), 1: part(90, 200, 1.08, 0.7)}, lines.append)
    assert "its lengths are +8." in lines[-1] and "would be" not in lines[-1]


class Stamped:
    """A recording with frames at the given seconds, shifted by its origin."""

    origin_ns, path = 10**9, Path("drive")

    def __init__(self, *seconds: float) -> None:
        self._t_ns = np.array([round(1e9 * s) for s in seconds], np.int64) + self.origin_ns

    def frame_times(self, _eye: Eye) -> Int:
        return self._t_ns


TRACK = """<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{}</trkseg></trk></gpx>"""
POINT = '<trkpt lat="48.1" lon="11.5"><ele>500</ele><time>1970-01-01T00:00:{:02}Z</time></trkpt>'


def track(path: Path, *seconds: int) -> Path:
    path.write_text(TRACK.format("".join(POINT.format(s) for s in seconds)))
    return path


def test_fixes_of_one_file_are_told_apart_by_their_times(tmp_path: Path) -> None:
    file = track(tmp_path / "all.gpx", 1, 10, 12, 19, 30, 31, 58)
    drives: dict[str, Any] = {"b": Stamped(28, 40), "a": Stamped(10, 14), "silent": Stamped(45, 50)}
    b, a, silent = fixes_of_drives(drives, [file])
    assert a is not None and (a.t_ns / 1e9).tolist() == [10, 12, 19]
    assert b is not None and (b.t_ns / 1e9).tolist() == [30, 31]
    assert silent is None
    with pytest.raises(GpsFileError, match="holds no fix of the times of these drives"):
        fixes_of_drives({"later": Stamped(1000, 1010), "last": Stamped(2000, 2010)}, [file])


def test_overlapping_drives_need_a_file_each(tmp_path: Path) -> None:
    files = [track(tmp_path / "a.gpx", 10, 12), track(tmp_path / "b.gpx", 11, 13)]
    drives: dict[str, Any] = {"a": Stamped(10, 14), "b": Stamped(14, 20)}
    with pytest.raises(GpsFileError, match=r"a and b overlap.*give --gps once for each"):
        fixes_of_drives(drives, files[:1])
    a, b = fixes_of_drives(drives, files)
    assert a is not None and b is not None
    assert (a.path, b.path) == tuple(files) and b.t_ns[0] == 11 * 10**9
