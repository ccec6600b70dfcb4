"""What `map` computes again names the batch it was computed from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from calm_edge.config import Config, merge
from calm_edge.offline.submaps import gather
from calm_edge.recording.reader import Recording
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.recording.window_record import of_window
from calm_edge.recording.writer import RecordingWriter
from calm_edge.types import Keyframe, SubmapWindow
from device.frame import Eye
from tests.replay.small_drive import SPACING_M, write_drive

CUTS = (range(0, 6), range(4, 10))


@pytest.fixture(scope="module")
def small_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("offline") / "drive", 10)


def unsolved(drive: Path, out: Path, lost: int = -1) -> Recording:
    """Two windows that `record` never solved, the second with a picture of the first's start.

    lost: the sequence of a primary frame that is not there.
    """
    folder = SequenceFolder(drive)
    eyes = {e: [Keyframe(f.sequence, f) for f in folder.frames(e)] for e in Eye}
    config = merge(
        Config(),
        {"backbone": {"name": f"scripted:{drive}"}, "scale": {"spacing_m": SPACING_M}},
    )
    with RecordingWriter(out, config, lossless=True) as writer:
        for keyframe in (*eyes[Eye.PRIMARY], *eyes[Eye.ASSISTANT]):
            if (keyframe.frame.eye, keyframe.id) != (Eye.PRIMARY, lost):
                writer.write_frame(keyframe.frame)
        for k, cut in enumerate(CUTS):
            window = SubmapWindow(
                k,
                *(tuple(eyes[e][i] for i in cut) for e in Eye),
                n_overlap=2 * k,
                loop_keyframe=eyes[Eye.PRIMARY][0] if k else None,
            )
            writer.write_window(of_window(window))
    return Recording(out)


@pytest.mark.parametrize("loops", [True, False])
def test_a_window_computed_again_is_recorded_as_it_was_solved(
    small_drive: Path, tmp_path: Path, loops: bool
) -> None:
    recording = unsolved(small_drive, tmp_path / "rec")
    config = merge(recording.config, {"loops": {"enabled": loops}})
    drive = gather(recording, config, lambda _: None)
    assert not drive.losses and not drive.unsolved
    assert [record.has_loop for record in drive.windows] == [False, loops]
    for record, update in zip(drive.windows, drive.updates, strict=True):
        assert len(record.ids) == len(update.prediction.T_s_c) == len(update.submap.T_s_c)
        assert (update.loop is not None) == record.has_loop


def test_a_loop_to_a_place_that_was_lost_is_not_in_the_record(
    small_drive: Path, tmp_path: Path
) -> None:
    recording = unsolved(small_drive, tmp_path / "rec", lost=2)
    drive = gather(recording, recording.config, lambda _: None)
    assert len(drive.losses) == 1
    (record,), (update,) = drive.windows, drive.updates
    assert not record.has_loop and len(record.ids) == 12 == len(update.prediction.T_s_c)


def test_the_loop_of_a_window_is_kept_though_its_final_update_has_none(
    small_drive: Path, tmp_path: Path
) -> None:
    first = unsolved(small_drive, tmp_path / "rec")
    solved = gather(first, first.config, lambda _: None)
    assert solved.updates[1].loop is not None
    with RecordingWriter(tmp_path / "done", first.config, lossless=True) as writer:
        for eye in Eye:
            for frame in first.frames(eye):
                writer.write_frame(frame)
        for record, update in zip(solved.windows, solved.updates, strict=True):
            writer.write_window(record)
            writer.write_update(replace(update, loop_keyframe=None))
        for update in solved.updates:
            writer.write_update(replace(update, loop=None, loop_keyframe=None))
        writer.write_status({"finished": True})
    recording = Recording(tmp_path / "done")
    drive = gather(recording, recording.config, lambda _: None)
    assert [update.loop is not None for update in drive.updates] == [False, True]
