"""Fixes of GPX files and of logs of NMEA."""

from __future__ import annotations

from pathlib import Path

import pytest

from device.errors import GpsError
from device.gps.fix import FixKind
from device.gps.gps_file import read_gps_file
from tests.device.gps.sentences import measurement

GPX = """<?xml version="1.0"?><gpx xmlns="http://www.topografix.com/GPX/1/1" version="1.1">
<trk><trkseg>
<trkpt lat="48.6" lon="11.25"><time>2014-05-13T18:53:21+02:00</time></trkpt>
<trkpt lat="48.5" lon="11.25"><ele>501.5</ele><time>2014-05-13T16:53:20.250Z</time>
<fix>dgps</fix><sat>7</sat><hdop>2.0</hdop></trkpt>
<trkpt lat="48.7" lon="11.25"><ele>501.5</ele></trkpt></trkseg></trk></gpx>"""


def test_gpx_is_read_in_order_in_any_time_zone_with_its_quality(tmp_path: Path) -> None:
    (tmp_path / "a.gpx").write_text(GPX)
    first, second = read_gps_file(tmp_path / "a.gpx")
    assert first.t_ns == first.utc_ns == 1_400_000_000_250_000_000
    assert second.t_ns == 1_400_000_001_000_000_000
    assert first.lla == (48.5, 11.25, 501.5) and first.kind is FixKind.DIFFERENTIAL
    assert first.hdop == 2.0 and first.satellites == 7
    assert first.sigma_m[0] == pytest.approx(1.5 * 2 / 2**0.5)
    assert second.sigma_m[2] > 1e3 and second.kind is FixKind.UNKNOWN


def test_a_log_of_nmea_is_read_with_what_a_logger_writes_before_a_sentence(tmp_path: Path) -> None:
    t_ns = 1_700_000_000 * 10**9
    text = "".join(measurement(t_ns + k * 10**9, 48.0, 11.0, 500.0) for k in range(3))
    (tmp_path / "a.nmea").write_text(text.replace("$", "12:00:01 $"))
    fixes = read_gps_file(tmp_path / "a.nmea")
    assert [fix.t_ns for fix in fixes] == [t_ns + k * 10**9 for k in range(3)]


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.gpx", "<gpx", "not a GPX file"),
        ("a.nmea", "hello\n", "no valid sentence"),
        ("a.log", measurement(10**18, 1, 1, 1).split("\r\n")[1] + "\n", "no RMC sentence"),
        ("b.nmea", None, "cannot be read"),
    ],
)
def test_other_files_are_refused(
    tmp_path: Path, name: str, content: str | None, reason: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(GpsError, match=reason):
        read_gps_file(tmp_path / name)
