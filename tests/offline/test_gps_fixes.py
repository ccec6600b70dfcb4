"""GPS fixes of a recording, of a file, and of the CSV of an earlier import."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calm_edge.config import Config
from calm_edge.offline.gps_fixes import GpsFileError, fixes_of, read_fixes
from calm_edge.recording.reader import Recording
from calm_edge.recording.time_base import TimeBase, WallClock
from calm_edge.recording.writer import RecordingWriter
from device.gps.fix import FixKind, fix
from tests.device.gps.sentences import measurement
from tests.device.gps.test_gps_file import GPX

CSV = """t_s,latitude_deg,longitude_deg,altitude_m,status,covariance_ee_m2,covariance_nn_m2,covariance_uu_m2
1400000000.000000001,48.5,11.25,500.0,0,1,4,9
1400000001.5,48.5,11.25,500.0,-1,1,4,9
1400000002.5,48.5,11.25,nan,,0,0,0
1400000003.5,nan,11.25,500.0,0,1,4,9
"""  # noqa: E501


def test_the_csv_of_an_earlier_import_is_read_with_its_quality(tmp_path: Path) -> None:
    (tmp_path / "gps.csv").write_text(CSV)
    fixes = read_fixes(tmp_path / "gps.csv")
    assert fixes.t_ns.tolist() == [1_400_000_000_000_000_001, 1_400_000_002_500_000_000]
    assert fixes.lla.tolist() == [[48.5, 11.25, 500.0], [48.5, 11.25, 0.0]]
    assert fixes.sigma_m[0].tolist() == [1, 2, 3]
    assert 2 < fixes.sigma_m[1, 0] < 3 and fixes.sigma_m[1, 2] > 1e3
    assert fixes.dropped == 2


def test_recorded_fixes_are_used_unless_a_file_is_given(tmp_path: Path) -> None:
    base = TimeBase(10**9, -(10**9), WallClock.SOURCE)
    start = 1_700_000_000 * 10**9
    rec = tmp_path / "rec"
    with RecordingWriter(rec, Config(), time_base=base, now_ns=lambda: start) as writer:
        for k in range(3):
            kind = FixKind.NONE if k == 1 else FixKind.THREE_D
            t_ns = start + k * 10**9
            writer.write_sample(fix(t_ns, None, (48.0, 11.0, 500.0), kind, (1.0, 2.0, 3.0)))
    recording = Recording(rec)
    fixes = fixes_of(recording, None)
    assert fixes is not None and fixes.path == rec and fixes.dropped == 1
    # the user's stamps
    assert fixes.t_ns.tolist() == [start - 10**9, start + 10**9]
    np.testing.assert_allclose(fixes.sigma_m, [[1, 2, 3]] * 2)
    (tmp_path / "a.nmea").write_text(measurement(start, 49.0, 11.0, 500.0))
    given = fixes_of(recording, tmp_path / "a.nmea")
    assert given is not None and given.lla[0, 0] == pytest.approx(49.0)
    with RecordingWriter(tmp_path / "none", Config(), now_ns=lambda: start):
        pass
    assert fixes_of(Recording(tmp_path / "none"), None) is None


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.gpx", "<gpx", "give GPX or NMEA"),
        ("a.gpx", "<gpx></gpx>", "holds no fix"),
        ("a.csv", "t_s,latitude_deg\n1.0,x\n", "not a table of fixes"),
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


def test_gpx_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.gpx").write_text(GPX)
    assert len(read_fixes(tmp_path / "a.gpx").t_ns) == 2
