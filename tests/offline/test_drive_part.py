"""A drive's part of a map of several: depth computed once, and complete or refused."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calm_edge.config import Config
from calm_edge.offline import drive_part
from calm_edge.offline.drive import Drive
from calm_edge.offline.drive_part import DONE, depth_of, read_part, write_part
from calm_edge.offline.shared_places import JoinError
from calm_edge.offline.unfinished import FOLDER, Unfinished, plan
from calm_edge.recording.writer import RecordingWriter
from device.frame import Eye, Frame, jpeg
from tests.offline.test_joined_drives import drive

PICTURE = jpeg(np.zeros((18, 32, 3), np.uint8))
VIEWS = 2


@pytest.fixture
def part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Writes the part of a drive; `computed` lists those whose depth was computed."""
    RecordingWriter(tmp_path / "rec", Config()).close()
    keyframes = [SimpleNamespace(frame=Frame(Eye.PRIMARY, k, k, PICTURE)) for k in range(VIEWS)]
    window: Any = SimpleNamespace(keyframes=lambda: keyframes)
    recording: Any = SimpleNamespace(path=tmp_path / "rec", window=lambda record: window)
    found = drive(0, 0).drive
    own = Drive([SimpleNamespace(submap_id=u.submap.id) for u in found.updates], found.updates)  # type: ignore[misc]
    computed: list[int] = []
    fails: set[int] = set()

    def densified(_path: Path, _config: Config, windows: Any, _updates: Any) -> Iterator[Any]:
        for record in windows:
            computed.append(record.submap_id)
            depth = np.full((VIEWS, 4, 8), float(record.submap_id + 1), np.float32)
            yield "sub-map lost" if record.submap_id in fails else (depth, depth / 10)

    monkeypatch.setattr(drive_part, "densified", densified)
    out = tmp_path / "part"
    out.mkdir()
    with Unfinished(out / FOLDER, Config(), plan(tmp_path / "rec", Config())) as work:

        def write() -> list[str]:
            return write_part(recording, Config(), own, out, work, lambda _: None)

        yield SimpleNamespace(
            write=write, out=out, computed=computed, fails=fails, recording=tmp_path / "rec"
        )


def test_depth_that_an_earlier_run_has_computed_is_not_computed_again(part: Any) -> None:
    part.fails.add(1)
    assert part.write() == ["sub-map lost"]
    part.fails.clear()
    part.computed.clear()
    assert part.write() == [] and part.computed == [1]


def test_a_part_is_complete_only_with_all_its_depth(
    part: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any) -> Iterator[Any]:
        raise KeyboardInterrupt
        yield

    with monkeypatch.context() as patched:
        patched.setattr(drive_part, "densified", interrupted)
        with pytest.raises(KeyboardInterrupt):
            part.write()
    with pytest.raises(JoinError, match=r"part: not complete; continue with --resume"):
        read_part(part.out, part.recording, Config())
    part.write()
    assert (part.out / DONE).is_file()
    # the sub-maps themselves were never kept here
    with pytest.raises(JoinError, match=r"holds no placed sub-maps; start anew with --force"):
        read_part(part.out, part.recording, Config())


def test_depth_is_read_as_it_was_written(part: Any) -> None:
    part.write()
    spool = drive_part.Spool(part.out / FOLDER / "spool")
    own: Any = SimpleNamespace(spool=spool)
    found = depth_of(own, 2)
    assert found is not None
    depth, confidence = found
    np.testing.assert_array_equal(depth, 3.0)
    np.testing.assert_allclose(confidence, 0.3, atol=1 / 255)
    assert depth_of(own, 99) is None
