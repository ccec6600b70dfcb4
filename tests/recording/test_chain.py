"""When a segment ends and the next one begins."""

from __future__ import annotations

import os
from pathlib import Path

from calm_edge.config import RecordingConfig
from calm_edge.recording.chain import SegmentChain
from calm_edge.recording.schema import frame_message
from device.frame import Eye
from tests.recording import samples


def test_a_segment_without_messages_is_not_finished(tmp_path: Path) -> None:
    config = RecordingConfig(segment_s=0.0, keep_free_gib=0.0, keep_free_percent=0.0)
    chain = SegmentChain(tmp_path, config, {}, lambda: 0, os.write, print)
    chain.open()
    chain.sync()
    assert chain.is_open and chain.number == 1
    chain.write([frame_message(samples.frame(Eye.PRIMARY, 0))], 0)
    chain.sync()
    assert not chain.is_open and (tmp_path / "0000.mcap").is_file()
