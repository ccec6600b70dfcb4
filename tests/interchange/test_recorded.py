"""An import ends in a valid recording or in nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from calm_edge.config import Config, merge
from calm_edge.evaluation.truth import read_truth
from calm_edge.geometry.camera import Perspective
from calm_edge.interchange import InterchangeError, recorded
from calm_edge.interchange.base import GroundTruth, Imported
from calm_edge.interchange.calibration.calibration import CalibratedCamera, Calibration
from calm_edge.recording.reader import Recording
from calm_edge.recording.segment import segment_files
from calm_edge.recording.sensors import ImuSample
from calm_edge.recording.sequence_folder import ORIGIN_NS
from device.frame import Eye, Frame, jpeg
from device.gps.fix import FixKind, fix

CONFIG = merge(Config(), {"recording": {"keep_free_gib": 0.0, "keep_free_percent": 0.0}})
PICTURE = jpeg(np.zeros((16, 24, 3), np.uint8))


def frames(eye: Eye) -> Iterator[Frame]:
    for k in range(4):
        yield Frame(eye, k, ORIGIN_NS + k * 10**8 + int(eye) * 10**7, PICTURE)


def broken(eye: Eye) -> Iterator[Frame]:
    yield next(frames(eye))
    raise InterchangeError("a.mp4: damaged")


def test_the_recording_holds_every_frame_in_order_and_what_was_assumed(tmp_path: Path) -> None:
    truth = GroundTruth(np.arange(3) * 10**8 + ORIGIN_NS, np.tile(np.eye(4), (3, 1, 1)))
    lens = Perspective(20.0, 20.0, 11.5, 7.5, 24, 16, (-0.1, 0.01))
    cameras = CalibratedCamera(lens, "plumb_bob"), CalibratedCamera(lens.with_focal(18.0), "fitted")
    imported = Imported(
        tuple(Eye), frames, ("two",), (), ("no drift",), truth, Calibration(cameras)
    )
    with recorded.unfinished(tmp_path / "rec", print) as folder:
        recorded.write(imported, CONFIG, folder, "video")
    recording = Recording(tmp_path / "rec")
    assert recording.import_facts["assumed"] == '["no drift"]'
    read = list(recording.frames())
    first = [(Eye.PRIMARY, 0), (Eye.ASSISTANT, 10**7), (Eye.PRIMARY, 10**8)]
    assert [(f.eye, f.t_ns - ORIGIN_NS) for f in read[:3]] == first
    assert len(read) == 8 and read[0].image == PICTURE and not recording.losses
    found = read_truth(tmp_path / "rec" / recorded.TRUTH)
    assert found.t_ns.tolist() == truth.t_ns.tolist()
    assert found.cameras == (lens, lens.with_focal(18.0))
    assert not (tmp_path / "rec.importing").exists()


def test_fixes_and_imu_samples_lie_between_the_frames_of_their_time(tmp_path: Path) -> None:
    fixes = [
        fix(ORIGIN_NS + t, None, (48.0, 11.0, 1.0), FixKind.THREE_D) for t in (-(10**8), 10**9)
    ]
    imu = [ImuSample(ORIGIN_NS + k * 10**8, (0.0, 0.0, 0.1), (0.0, 0.0, 9.8)) for k in range(5)]
    samples = sorted([*fixes, *imu], key=lambda sample: sample.t_ns)
    with recorded.unfinished(tmp_path / "rec", print) as folder:
        recorded.write(Imported(tuple(Eye), frames, samples=samples), CONFIG, folder, "bag")
    recording = Recording(tmp_path / "rec")
    assert [found.t_ns for found in recording.fixes()] == [found.t_ns for found in fixes]
    assert list(recording.imu()) == imu and not recording.losses
    with segment_files(tmp_path / "rec")[0].open("rb") as file:
        log_ns = [message.log_time for _, _, message in make_reader(file).iter_messages()]
    assert log_ns == sorted(log_ns)


def test_a_failure_leaves_nothing(tmp_path: Path) -> None:
    with (
        pytest.raises(InterchangeError, match="damaged"),
        recorded.unfinished(tmp_path / "rec", print) as folder,
    ):
        recorded.write(Imported(tuple(Eye), broken), CONFIG, folder, "video")
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_import_is_begun_anew(tmp_path: Path) -> None:
    """A process that was killed leaves its folder, which its mark tells from others."""
    said: list[str] = []
    with pytest.raises(KeyError), recorded.unfinished(tmp_path / "rec", said.append) as folder:
        folder.rename(tmp_path / "left")
        raise KeyError
    (tmp_path / "left").rename(tmp_path / "rec.importing")
    with recorded.unfinished(tmp_path / "rec", said.append) as folder:
        recorded.write(Imported(tuple(Eye), frames), CONFIG, folder, "video")
    assert "interrupted import" in said[0] and Recording(tmp_path / "rec").losses == []


@pytest.mark.parametrize("name", ["rec", "rec.importing"])
def test_nothing_of_others_is_overwritten(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / name / "mine").touch()
    with (
        pytest.raises(InterchangeError, match=rf"{name}: exists"),
        recorded.unfinished(tmp_path / "rec", print),
    ):
        pass
    assert (tmp_path / name / "mine").exists()


def test_stamps_below_zero_are_kept(tmp_path: Path) -> None:
    def early(eye: Eye) -> Iterator[Frame]:
        return (replace(frame, t_ns=frame.t_ns - 9 * 10**9) for frame in frames(eye))

    sample = ImuSample(ORIGIN_NS - 9_500_000_000, (0.0, 0.0, 0.1), (0.0, 0.0, 9.8))
    truth = GroundTruth(np.array([-85, 5]) * 10**8 + ORIGIN_NS, np.tile(np.eye(4), (2, 1, 1)))
    imported = Imported(tuple(Eye), early, samples=[sample], truth=truth)
    with recorded.unfinished(tmp_path / "rec", print) as folder:
        recorded.write(imported, CONFIG, folder, "pictures")
    recording = Recording(tmp_path / "rec")
    assert recording.frame_times(Eye.PRIMARY)[0] - recording.origin_ns == -9 * 10**9
    assert next(recording.imu()).t_ns - recording.origin_ns == -9_500_000_000
    assert next(recording.imu()).t_ns > 0
    times = (tmp_path / "rec" / recorded.TRUTH / "times0.txt").read_text()
    assert times == "-8.500000000\n0.500000000\n"
