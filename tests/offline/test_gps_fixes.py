"""Reading GPS fixes: the CSV of an import and GPX."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calm_edge.interchange.bag_notes import BagNotes
from calm_edge.offline.gps_fixes import USUAL_SIGMA_M, GpsFileError, read_fixes

GPX = """<?xml version="1.0"?><gpx xmlns="http://www.topografix.com/GPX/1/1" version="1.1">
<trk><trkseg>
<trkpt lat="48.5" lon="11.25"><ele>501.5</ele><time>2014-05-13T16:53:20.250Z</time></trkpt>
<trkpt lat="48.6" lon="11.25"><time>2014-05-13T18:53:21+02:00</time></trkpt>
<trkpt lat="48.7" lon="11.25"><ele>501.5</ele></trkpt></trkseg></trk></gpx>"""


def test_the_csv_of_an_import_is_read_with_its_quality(tmp_path: Path) -> None:
    covariance = np.diag([1.0, 4.0, 9.0]).ravel().tolist()
    rows = [
        ("1400000000.000000001", 48.5, 11.25, 500.0, 0, *covariance),
        ("1400000001.5", 48.5, 11.25, 500.0, -1, *covariance),
        ("1400000002.5", 48.5, 11.25, float("nan"), "", *[0.0] * 9),
        ("1400000003.5", float("nan"), 11.25, 500.0, 0, *covariance),
    ]
    BagNotes(fixes={"/fix": rows}).write(tmp_path)
    fixes = read_fixes(tmp_path / "gps.csv")
    assert fixes.t_ns.tolist() == [1_400_000_000_000_000_001, 1_400_000_002_500_000_000]
    assert fixes.lla.tolist() == [[48.5, 11.25, 500.0], [48.5, 11.25, 0.0]]
    assert fixes.sigma_m[0].tolist() == [1, 2, 3]
    assert fixes.sigma_m[1, :2].tolist() == list(USUAL_SIGMA_M[:2]) and fixes.sigma_m[1, 2] > 1e3
    assert fixes.dropped == 2


def test_gpx_is_read_in_any_time_zone(tmp_path: Path) -> None:
    (tmp_path / "a.gpx").write_text(GPX)
    fixes = read_fixes(tmp_path / "a.gpx")
    assert fixes.t_ns.tolist() == [1_400_000_000_250_000_000, 1_400_000_001_000_000_000]
    assert fixes.lla[0].tolist() == [48.5, 11.25, 501.5] and fixes.dropped == 1


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.gpx", "<gpx", "not a file of GPS fixes"),
        ("a.gpx", "<gpx></gpx>", "holds no fix"),
        ("a.csv", "t_s,latitude_deg\n1.0,x\n", "not a file of GPS fixes"),
        ("a.csv", "", "holds no fix"),
        (".", None, "cannot be read"),
    ],
)
def test_other_files_are_refused(
    tmp_path: Path, name: str, content: str | None, reason: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(GpsFileError, match=reason):
        read_fixes(tmp_path / name)
