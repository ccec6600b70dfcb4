"""GPS fixes and IMU samples are recorded and read again."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

from calm_edge.config import Config
from calm_edge.recording import RecordingError, schema, sensors
from calm_edge.recording.reader import Recording
from calm_edge.recording.sensors import ImuSample
from calm_edge.recording.time_base import TimeBase, WallClock
from calm_edge.recording.writer import RecordingWriter
from device.gps.fix import Fix, FixKind, fix

UTC_NS = 1_700_000_000 * 10**9
HERE = (48.5, 11.25, 500.0)
SAMPLES = (
    fix(10 * 10**9, UTC_NS, HERE, FixKind.THREE_D, (1.0, 2.0, 3.0), 0.9, 1.3, 8),
    ImuSample(10_500_000_000, (0.1, 0.2, 0.3), (0.0, 0.0, 9.81)),
    fix(11 * 10**9, UTC_NS + 10**9, (math.nan,) * 3, FixKind.THREE_D),
    fix(12 * 10**9, UTC_NS + 2 * 10**9, (48.5, 11.25, math.nan), FixKind.UNKNOWN, satellites=4),
)


def recorded(folder: Path, base: TimeBase) -> Recording:
    with RecordingWriter(folder, Config(), time_base=base, now_ns=lambda: 12 * 10**9) as writer:
        for sample in SAMPLES:
            writer.write_sample(sample)
    return Recording(folder)


def test_samples_come_back_exactly_and_no_answer_without_a_position_is_a_fix(
    tmp_path: Path,
) -> None:
    recording = recorded(tmp_path / "rec", TimeBase())
    fixes = list(recording.fixes())
    assert fixes[0] == SAMPLES[0] and len(fixes) == 2
    assert isinstance(SAMPLES[3], Fix)
    assert fixes[1].sigma_m == pytest.approx(SAMPLES[3].sigma_m) and fixes[1].satellites == 4
    assert list(recording.imu()) == [SAMPLES[1]]
    assert recording.count(schema.GPS_QUALITY) == 3 and recording.count(schema.GPS) == 2


def test_messages_hold_no_nan_and_the_user_s_stamp() -> None:
    for sample in SAMPLES:
        for message in sensors.messages(sample, origin_ns=10**9):
            if message.topic == schema.GPS:
                location = LocationFix()
                location.ParseFromString(message.data)
                assert location.timestamp.ToNanoseconds() == sample.t_ns - 10**9
                assert all(map(math.isfinite, location.position_covariance))
            else:
                assert b"NaN" not in message.data
                json.loads(message.data)
    with pytest.raises(RecordingError, match="/imu"):
        sensors.read_imu(0, {"gyro_rad_s": {"x": 1}})


def test_gps_dates_a_drive_whose_clock_was_never_set(tmp_path: Path) -> None:
    unset = TimeBase(-5 * 10**9, 5 * 10**9, WallClock.UNSYNCHRONISED)
    recording = recorded(tmp_path / "rec", unset)
    synchronised = any(r["synchronised"] for r in recording.json_messages(schema.CLOCK))
    if synchronised:
        pytest.skip("the clock of this computer is synchronised")
    assert recording.origin_ns == 10 * 10**9 - UTC_NS
    known = TimeBase(-5 * 10**9, 5 * 10**9, WallClock.SYNCHRONISED)
    assert recorded(tmp_path / "known", known).origin_ns == -5 * 10**9
