"""Sources of frames: what is refused before a camera is opened."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calm_edge.config import Config, merge
from calm_edge.daemon.source import live, of_recording
from calm_edge.recording.reader import Recording
from calm_edge.recording.writer import RecordingWriter
from calm_edge.types import CalmEdgeError
from device.errors import CameraError
from device.frame import Eye
from tests.recording import samples

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
