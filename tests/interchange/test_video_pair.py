"""Two videos of one drive: their own stamps, their clocks, and what is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.base import Imported, ImportOptions
from calm_edge.interchange.video_pair import VideoPair
from calm_edge.recording.sequence_folder import ORIGIN_NS
from device.frame import Eye
from tests.interchange.moving import pictures, shaking, turn, uneven, write_video

OFFSET_S, SECONDS = 3.7, 14.0
Open = Callable[..., Imported]


@pytest.fixture
def opened(tmp_path: Path) -> Open:
    def made(*sources: Path, **options: object) -> Imported:
        (tmp_path / "scratch").mkdir(exist_ok=True)
        wanted = ImportOptions(**options)  # type: ignore[arg-type]
        return VideoPair().open(sources, wanted, tmp_path / "scratch", lambda text: None)

    return made


@pytest.fixture(scope="module")
def front(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The primary's video of the drive, with 29.97 pictures a second."""
    t = uneven(29.97, SECONDS, 1)
    return write_video(tmp_path_factory.mktemp("front") / "front.mp4", t, pictures(t))


def side(folder: Path, **seen: object) -> Path:
    """The assistant's, with 25 pictures a second by a clock that began OFFSET_S later."""
    t = uneven(25.0, SECONDS - OFFSET_S, 2)
    shown = pictures(t + OFFSET_S, **seen)  # type: ignore[arg-type]
    return write_video(folder / "side.mkv", t, shown)


def stamps(imported: Imported, eye: Eye) -> np.ndarray:
    return np.array([frame.t_ns for frame in imported.frames(eye)])


def test_the_clock_offset_is_found_from_the_motion(
    tmp_path: Path, front: Path, opened: Open
) -> None:
    """The requirement is 5 ms, with irregular stamps, different rates and focal lengths."""
    imported = opened(front, side(tmp_path, zoom=1.3))
    expected = uneven(25.0, SECONDS - OFFSET_S, 2) + OFFSET_S
    found = (stamps(imported, Eye.ASSISTANT) - ORIGIN_NS) / 1e9
    assert len(found) == len(expected)
    assert abs(found - expected).max() < 0.005
    assert (stamps(imported, Eye.PRIMARY) - ORIGIN_NS) / 1e9 == pytest.approx(
        uneven(29.97, SECONDS, 1), abs=1e-6
    )
    assert any(re.match(r"clock offset \+3\.(69|70)\d\d s .* sigma \d", t) for t in imported.took)


def test_an_upside_down_camera_is_rotated(tmp_path: Path, front: Path, opened: Open) -> None:
    imported = opened(front, side(tmp_path, roll_deg=180.0))
    assert any("upside down" in line for line in imported.assumed)
    first = next(imported.frames(Eye.ASSISTANT)).gray()
    upright = pictures(uneven(25.0, 1.0, 2)[:1] + OFFSET_S)[0]
    assert np.corrcoef(first.ravel(), upright.ravel())[0, 1] > 0.9


def test_a_camera_on_its_side_is_refused(tmp_path: Path, front: Path, opened: Open) -> None:
    with pytest.raises(InterchangeError, match=r"--rotate"):
        opened(front, side(tmp_path, roll_deg=90.0))


def test_a_stabilised_video_is_refused_unless_accepted(
    tmp_path: Path, front: Path, opened: Open
) -> None:
    videos = front, side(tmp_path, turn=lambda t: turn(t) - shaking(t))
    with pytest.raises(InterchangeError, match=r"assistant: shakes.*stabilised"):
        opened(*videos)
    assert opened(*videos, unsteady=True).eyes == (Eye.PRIMARY, Eye.ASSISTANT)


def test_videos_of_different_drives_are_refused(tmp_path: Path, front: Path, opened: Open) -> None:
    videos = front, side(tmp_path, turn=lambda t: turn(1.7 * t + 40))
    with pytest.raises(InterchangeError, match=r"cannot be related.*--offset-s"):
        opened(*videos)


def test_one_video_alone_is_refused_unless_single(front: Path, opened: Open) -> None:
    with pytest.raises(InterchangeError, match=r"no spacing.*--single"):
        opened(front)
    assert opened(front, single=True).eyes == (Eye.PRIMARY,)
