"""Losses are reported with file, time and count."""

from __future__ import annotations

from pathlib import Path

from calm_edge.recording.reader import Recording
from calm_edge.recording.scan import scan
from device.frame import Eye
from tests.recording import samples


def test_the_loss_of_a_truncated_file_names_file_time_and_count(tmp_path: Path) -> None:
    folder = samples.small_recording(tmp_path / "rec")
    whole = folder / "0000.mcap"
    assert scan(whole).losses() == []
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:40_000])
    index = scan(cut)
    (line,) = index.losses()
    assert str(cut) in line
    newest = max(f.t_ns for f in Recording(cut).frames())
    assert newest < samples.frame(Eye.ASSISTANT, 11).t_ns
    assert f"t = {newest / 1e9:.3f} s" in line
    assert f"recovered: {index.n_messages} messages" in line
    assert 0 < index.n_messages < scan(whole).n_messages


def test_truncation_after_the_last_message_loses_nothing(tmp_path: Path) -> None:
    whole = samples.small_recording(tmp_path / "rec") / "0000.mcap"
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:-4])
    index = scan(cut)
    assert index.n_messages == scan(whole).n_messages
    (line,) = index.losses()
    assert "after the last message" in line
