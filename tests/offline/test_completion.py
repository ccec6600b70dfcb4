"""`map` solves what `record` left, and nothing else."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calm_edge.backbones.registry import open_backbone
from calm_edge.config import Config, merge
from calm_edge.daemon.finish import final_updates
from calm_edge.daemon.messages import Finished
from calm_edge.estimator.localizer import Localizer
from calm_edge.kit import layout
from calm_edge.offline import submaps
from calm_edge.offline.submaps import gather
from calm_edge.offline.unfinished import Unfinished, plan
from calm_edge.recording.reader import Recording
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.recording.window_record import of_window
from calm_edge.recording.writer import RecordingWriter
from calm_edge.types import Float, Hints, Keyframe, KitBelief, Prediction, SubmapWindow
from device.frame import Eye
from tests.replay.small_drive import SPACING_M, write_drive

N = 14
CUTS = (range(0, 6), range(4, 10), range(8, 14))


class Kit:
    """A scripted backbone that says to estimate a kit, known from two windows."""

    def __init__(self, config: Config) -> None:
        self.scripted = open_backbone(config)
        self.inferred: list[int] = []

    def kit_sigma(self, hints: Hints) -> Float:
        known = 0.0 if hints.kit is None else hints.kit.information[0, 0]
        return np.array([0.5, 0.3]) if known < 2 else np.array([0.01, 0.02])

    def infer(self, images: Sequence[Any], hints: Hints) -> Prediction:
        self.inferred.append(len(images))
        kit = KitBelief(np.zeros(layout.SIZE), np.eye(layout.SIZE))
        prediction = self.scripted.infer(images, hints)
        return dataclasses.replace(prediction, kit=kit, kit_sigma=self.kit_sigma(hints))

    def resolve(self, prediction: Prediction, hints: Hints) -> Prediction:
        return prediction

    def densify(self, images: Sequence[Any], hints: Hints, prediction: Prediction) -> Prediction:
        return prediction


@pytest.fixture(scope="module")
def small_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("completion") / "drive", N)


def recorded(
    drive: Path, out: Path, *, missing: Sequence[int] = (), hurried: bool = False
) -> Recording:
    """Three windows as `record` writes them. missing: no update. hurried: none solved again."""
    folder = SequenceFolder(drive)
    eyes = {e: [Keyframe(f.sequence, f) for f in folder.frames(e)] for e in Eye}
    config = merge(
        Config(),
        {
            "backbone": {"name": f"scripted:{drive}"},
            "scale": {"spacing_m": SPACING_M},
            "loops": {"enabled": False},
        },
    )
    localizer = Localizer(config, Kit(config), unhurried=not hurried)
    with RecordingWriter(out, config, lossless=True) as writer:
        for keyframe in (*eyes[Eye.PRIMARY], *eyes[Eye.ASSISTANT]):
            writer.write_frame(keyframe.frame)
        for k, cut in enumerate(CUTS):
            frames = (tuple(eyes[e][i] for i in cut) for e in Eye)
            window = SubmapWindow(k, *frames, n_overlap=2 * (k > 0))
            writer.write_window(of_window(window))
            update = None if k in missing else localizer.process(window)
            if update is not None:
                writer.write_update(update)
        trajectory = localizer.finish(0.0 if hurried else np.inf)
        finished = Finished(
            localizer.submaps,
            trajectory,
            localizer.metre,
            localizer.solved_again,
            kit=localizer.kit,
        )
        for update in final_updates(finished):
            writer.write_update(update)
        writer.write_status({"finished": True, "unsolved_windows": []})
    return Recording(out)


def gathered(
    recording: Recording, patch: pytest.MonkeyPatch, unfinished: Unfinished | None = None
) -> tuple[submaps.Drive, list[int], list[str]]:
    backbone, lines = Kit(recording.config), list[str]()
    patch.setattr(submaps, "open_backbone", lambda _: backbone)
    drive = gather(recording, recording.config, lines.append, unfinished)
    return drive, backbone.inferred, lines


def test_what_record_solved_is_not_solved_again(
    small_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive, inferred, lines = gathered(recorded(small_drive, tmp_path / "rec"), monkeypatch)
    assert inferred == [] and lines == [] and not drive.unsolved
    assert [update.submap.id for update in drive.updates] == [0, 1, 2]
    # the two first were solved again in time, and the recording says so
    marks = [update.prediction.kit_sigma for update in drive.updates]
    assert [mark is not None and mark[0] for mark in marks] == [0.01] * 3


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_only_a_missing_window_is_solved(
    small_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: int
) -> None:
    recording = recorded(small_drive, tmp_path / "rec", missing=[missing])
    drive, _, lines = gathered(recording, monkeypatch)
    # besides it the other two, which one window alone could not guide
    assert lines[0] == "1 of 3 windows have no sub-map yet and are solved now"
    assert lines[1].startswith("solving windows: 1 of ") and lines[-1] == "placing all sub-maps"
    assert [update.submap.id for update in drive.updates] == [0, 1, 2] and not drive.unsolved
    assert drive.trajectory is not None
    assert drive.trajectory.keyframe_ids.tolist() == list(range(N))
    truth = np.loadtxt(small_drive / "poses0.txt").reshape(-1, 3, 4)[:, :, 3]
    assert np.abs(drive.trajectory.T_w_c[:, :3, 3] - truth).max() < 0.01
    for record, update in zip(drive.windows, drive.updates, strict=True):
        assert len(record.ids) == len(update.prediction.T_s_c) == len(update.submap.T_s_c)


def test_windows_matched_before_the_kit_was_known_are_solved_again(
    small_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = recorded(small_drive, tmp_path / "rec", hurried=True)
    drive, inferred, lines = gathered(recording, monkeypatch)
    assert lines[0].startswith("solving windows: 1 of 2")
    assert len(inferred) == 2
    for update in drive.updates:
        assert update.prediction.kit_sigma is not None
        assert update.prediction.kit_sigma[0] == 0.01


def test_an_interrupted_run_is_continued(
    small_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = recorded(small_drive, tmp_path / "rec", missing=[0, 1, 2])
    config = recording.config
    whole, inferred, _ = gathered(recording, monkeypatch)
    made_of, attempts = plan(recording.path, config), iter([False, False, True])
    infer = Kit.infer

    def interrupted(self: Kit, images: Sequence[Any], hints: Hints) -> Prediction:
        if next(attempts):
            raise KeyboardInterrupt
        return infer(self, images, hints)

    with Unfinished(tmp_path / "work", config, made_of) as work, monkeypatch.context() as patch:
        patch.setattr(Kit, "infer", interrupted)
        with pytest.raises(KeyboardInterrupt):
            gathered(recording, monkeypatch, work)
    with Unfinished(tmp_path / "work", config, made_of) as work:
        assert [*work.solved()] == [0, 1] and work.placed() is None
        drive, again, lines = gathered(recording, monkeypatch, work)
        work.place(drive)
        kept = work.placed()
    assert lines[0] == "2 windows were solved by an interrupted run"
    assert len(again) < len(inferred)
    assert kept is not None
    for found in (drive, kept):
        assert [update.submap.id for update in found.updates] == [0, 1, 2]
        assert found.trajectory is not None and whole.trajectory is not None
        assert np.allclose(found.trajectory.T_w_c, whole.trajectory.T_w_c, atol=1e-6)
        assert [w.ids.tolist() for w in found.windows] == [w.ids.tolist() for w in whole.windows]
