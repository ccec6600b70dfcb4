"""Pictures of a recording as a sequence folder; a recording of one camera is of use too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calm_edge.cli import main
from calm_edge.config import Config
from calm_edge.recording.reader import Recording
from calm_edge.recording.sequence_folder import ORIGIN_NS as ADDED_NS
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.recording.time_base import ORIGIN_KEY
from calm_edge.recording.writer import RecordingWriter
from device.frame import Eye, Frame, jpeg
from tests.interchange.export.drives import ORIGIN_NS, true_times, write_recording


def test_the_folder_holds_the_same_pictures_with_the_users_stamps(tmp_path: Path) -> None:
    recording = Recording(write_recording(tmp_path / "rec"))
    out = tmp_path / "out"
    assert main(["export", str(recording.path), "--to", "pictures", "--out", str(out)]) == 0
    read = SequenceFolder(out)
    for eye in Eye:
        assert read.t_ns(eye).tolist() == (true_times() - ORIGIN_NS + ADDED_NS).tolist()
        kept = [read.file(eye, i).read_bytes() for i in range(read.count(eye))]
        assert kept == [frame.image for frame in recording.frames(eye)]


@pytest.fixture
def single(tmp_path: Path) -> Path:
    """A recording of one camera, as `import --single` makes it."""
    with RecordingWriter(tmp_path / "rec", Config(), {ORIGIN_KEY: str(ORIGIN_NS)}) as writer:
        for i, t in enumerate(true_times()[:5].tolist()):
            data = jpeg(np.full((64, 96, 3), 20 * i, np.uint8))
            writer.write_frame(Frame(Eye.PRIMARY, i, t, data))
    return tmp_path / "rec"


def test_pictures_of_one_camera_are_exported(
    single: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["export", str(single), "--to", "pictures", "--out", str(out)]) == 0
    assert "cam0: 5 pictures of the primary" in capsys.readouterr().out
    names = sorted(p.name for p in out.iterdir())
    assert names == ["cam0", "times0.txt"] and len(list((out / "cam0").iterdir())) == 5
    assert main(["validate", str(single)]) == 0


@pytest.mark.parametrize(
    "command",
    [
        ["map", "REC"],
        ["map", "REC", "OTHER"],
        ["record", "--pace", "lockstep", "--replay", "REC"],
        ["export", "REC", "--to", "tum"],
    ],
)
def test_what_needs_two_cameras_says_so_in_a_line(
    single: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    RecordingWriter(tmp_path / "other", Config()).close()
    places = {"REC": str(single), "OTHER": str(tmp_path / "other")}
    named = [places.get(word, word) for word in command]
    assert main([*named, "--out", str(tmp_path / "out")]) == 1
    shown = capsys.readouterr().err.splitlines()
    assert "rec: holds pictures of the primary camera alone; poses and maps need two" in shown[-1]
    assert "--to pictures" in shown[-1] and not (tmp_path / "out").exists()
