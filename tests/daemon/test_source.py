"""Sources of frames: what is refused before a camera is opened."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calm_edge.config import Config, GpsConfig, merge
from calm_edge.daemon.source import live, of_recording, of_sequence, with_gps
from calm_edge.recording.reader import Recording
from calm_edge.recording.writer import RecordingWriter
from calm_edge.types import CalmEdgeError
from device.errors import CameraError
from device.frame import Eye
from device.gps.gpsd import Gpsd
from device.gps.serial_gps import SerialGps
from tests.device.gps.sentences import measurement
from tests.recording import samples
from tests.replay.small_drive import write_drive

S = 1_000_000_000


@pytest.mark.parametrize("address", ["v4l2:usb-1", "v4l2:/dev/video0", "oak:ABC"])
def test_one_address_for_both_cameras_is_refused(address: str) -> None:
    config = merge(Config(), {"capture": {"primary": address, "assistant": address}})
    with pytest.raises(CameraError, match="is used for both cameras"):
        live(config)


def test_without_addresses_the_two_cameras_are_chosen_by_the_driver() -> None:
    assert live(Config()).description == "v4l2: v4l2:"


def recorded(folder: Path, stamps: dict[Eye, int]) -> Recording:
    """A recording of three frames a camera, from stamps[eye] on."""
    with RecordingWriter(folder, samples.config()) as writer:
        for k in range(3):
            for eye, first_ns in stamps.items():
                frame = samples.frame(eye, k)
                writer.write_frame(replace(frame, t_ns=first_ns + k * 100_000_000))
    return Recording(folder)


def test_recorded_cameras_without_common_time_are_refused_with_both_ranges(tmp_path: Path) -> None:
    recording = recorded(tmp_path, {Eye.PRIMARY: 5 * S, Eye.ASSISTANT: 69 * S})
    with pytest.raises(
        CalmEdgeError, match=r"primary 5\.000 to 5\.200 s, assistant 69\.000 to 69\.200 s"
    ):
        of_recording(recording, paced=False)


@pytest.mark.parametrize("first_s", [-9.0, -1.0, -0.5, 0.0])
def test_stamps_below_zero_are_replayed_on_a_positive_clock(tmp_path: Path, first_s: float) -> None:
    drive = write_drive(tmp_path / "drive", 3)
    for eye in (0, 1):
        rows = (f"{first_s + k / 10:.1f}\n" for k in range(3))
        (drive / f"times{eye}.txt").write_text("".join(rows))
    source = of_sequence(drive, paced=False)
    primary, _ = source.open()
    primary.start()
    frames = [frame for _ in range(3) if (frame := primary.read(1.0)) is not None]
    stamps = [frame.t_ns - source.time_base.origin_ns for frame in frames]
    assert stamps == [round(first_s * S) + k * S // 10 for k in range(3)]
    assert source.clock.now_ns() >= frames[0].t_ns > 0
    assert frames[0].t_ns + source.time_base.epoch_ns > 0


def test_an_unreadable_message_does_not_end_a_replay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = recorded(tmp_path, {Eye.PRIMARY: 5 * S, Eye.ASSISTANT: 5 * S})
    read = Recording._read

    def damaged(self: Recording, location: Any) -> bytes | None:
        data = read(self, location)
        return data[:-5] if data and location.sequence == 1 else data

    monkeypatch.setattr(Recording, "_read", damaged)
    primary, _ = of_recording(recording, paced=False).open()
    primary.start()
    frames = [frame for _ in range(3) if (frame := primary.read(1.0)) is not None]
    assert [frame.sequence for frame in frames] == [0, 2] and primary.exhausted
    assert "/primary/image 1: not an image" in recording.losses[0]


@pytest.mark.parametrize(
    ("name", "kind"), [("/dev/ttyUSB7", SerialGps), ("gpsd", Gpsd), ("gpsd:car:2948", Gpsd)]
)
def test_a_live_source_has_a_receiver(name: str, kind: type) -> None:
    source = with_gps(live(Config()), GpsConfig(source=name))
    assert [type(sensor) for sensor in source.sensors] == [kind]


def test_files_are_for_replays_with_dates_and_receivers_for_cameras(tmp_path: Path) -> None:
    with pytest.raises(CalmEdgeError, match="files are for replays"):
        with_gps(live(Config()), GpsConfig(source="a.gpx"))
    folder = write_drive(tmp_path / "drive", 4)
    source = of_sequence(folder, False)
    with pytest.raises(CalmEdgeError, match="have none; give stamps in Unix time"):
        with_gps(source, GpsConfig(source="a.gpx"))
    replay = with_gps(source, GpsConfig(source="/dev/ttyUSB7"))
    assert not replay.sensors and "not read in a replay" in replay.notes[-1]


def test_fixes_of_a_file_are_given_at_their_time(tmp_path: Path) -> None:
    folder = write_drive(tmp_path / "drive", 4)
    start = 1_700_000_000
    for eye in Eye:
        lines = "".join(f"{start + 0.1 * k:.6f}\n" for k in range(4))
        (folder / f"times{int(eye)}.txt").write_text(lines)
    text = "".join(measurement(start * S + k * S // 10, 48.0, 11.0, 5.0) for k in range(-1, 4))
    (tmp_path / "a.nmea").write_text(text)
    source = with_gps(of_sequence(folder, False), GpsConfig(source=str(tmp_path / "a.nmea")))
    (sensor,) = source.sensors
    first_ns = start * S + S
    assert len(sensor.take(first_ns)) == 2 and sensor.take(first_ns) == []
    assert [fix.t_ns for fix in sensor.take(first_ns + S)] == [
        first_ns + k * S // 10 for k in (1, 2, 3)
    ]
