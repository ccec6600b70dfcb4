"""map.html: one page without anything from elsewhere; what does not fit lies beside it."""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calm_edge.recording.window_record import WindowRecord
from calm_edge.report import map_page
from calm_edge.report.keyframe_pictures import KeyframePictures, even, pairs
from calm_edge.report.map_page import MapView, write_map_page
from calm_edge.report.point_records import RECORD, Box, unpacked
from tests.evaluation.worlds import curve

N = 30


def _view(points: int = 500) -> MapView:
    rng = np.random.default_rng(0)
    T = curve(N)
    p = (T[rng.integers(0, N, points), :3, 3] + rng.normal(0, 3, (points, 3))).astype(np.float32)
    return MapView(
        "drives/</script><b>",
        "m",
        0.1,
        p,
        rng.integers(0, 256, (points, 3)).astype(np.uint8),
        np.arange(points) * 3 // points,
        np.array([0.0, 2.0, 4.0]),
        T,
        np.arange(N) / 3,
        [
            KeyframePictures(3, b"\xff\xd8a", b"\xff\xd8b", 12_000_000),
            KeyframePictures(9, b"c", None),
        ],
    )


def _drive(text: str) -> dict[str, object]:
    found = re.search(r"<script>const DRIVE=(.*?);</script>", text)
    assert found
    drive: dict[str, object] = json.loads(found[1])
    return drive


def _points(*texts: str) -> np.ndarray:
    pieces = [p for t in texts for p in re.findall(r'calmEdgeMap\.points\("([^"]*)"\)', t)]
    return np.frombuffer(b"".join(base64.b64decode(p) for p in pieces), RECORD)


def test_the_page_holds_points_path_and_pictures(tmp_path: Path) -> None:
    view = _view()
    written = write_map_page(tmp_path / "map.html", view)
    assert [p.name for p in tmp_path.iterdir()] == ["map.html"]
    text = (tmp_path / "map.html").read_text()
    assert written.page == len(text.encode()) and written.beside == 0
    assert str(written) == f"500 points, {written.page / 1e6:.1f} MB"
    drive, records = _drive(text), _points(text)
    assert drive["count"] == len(records) == 500 and drive["title"] == view.title
    box = Box(np.array(drive["low"]), float(str(drive["step"])))
    shown, path = unpacked(records, box), np.array(drive["path"])
    # the level frame is a rotation of the world: distances to the path stay
    for p, position in ((path, view.T_w_c[:, :3, 3]),):
        ours = np.linalg.norm(shown[:, None] - p, axis=-1)
        truth = np.linalg.norm(view.points_w[:, None] - position, axis=-1)
        assert np.allclose(np.sort(ours.min(1)), np.sort(truth.min(1)), atol=1e-3)
    assert np.array_equal(np.bincount(records["submap"]), np.bincount(view.submap))
    a, b = (base64.b64encode(x).decode() for x in (b"\xff\xd8a", b"\xff\xd8b"))
    assert f'[3,"{a}","{b}",0.012]' in text and ",null,0.0]" in text


def test_nothing_comes_from_elsewhere_and_no_title_breaks_out(tmp_path: Path) -> None:
    write_map_page(tmp_path / "map.html", _view())
    text = (tmp_path / "map.html").read_text()
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(|fetch\(|XMLHttpRequest", text)
    assert "</script><b>" not in text


def test_points_that_are_not_finite_are_left_out(tmp_path: Path) -> None:
    view = _view()
    view.points_w[7] = np.nan
    assert write_map_page(tmp_path / "map.html", view).points == 499


def test_a_map_without_points_has_a_page(tmp_path: Path) -> None:
    none = replace(_view(0), submap_s=np.zeros(0), pictures=())
    assert write_map_page(tmp_path / "map.html", none).points == 0


def test_a_large_map_lies_partly_beside_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("LIMIT", 400), ("EMBEDDED", 150), ("FIRST", 100), ("PIECE", 200)):
        monkeypatch.setattr(map_page, name, value)
    (tmp_path / map_page.FOLDER).mkdir()
    (tmp_path / map_page.FOLDER / "0009.js").write_text("of an earlier map")
    written = write_map_page(tmp_path / "map.html", _view())
    text = (tmp_path / "map.html").read_text()
    files = sorted((tmp_path / map_page.FOLDER).iterdir())
    assert [f.name for f in files] == ["0000.js", "0001.js"]
    assert _drive(text)["files"] == ["map_points/0000.js", "map_points/0001.js"]
    assert len(_points(text)) == 150 and len(_points(text, *(f.read_text() for f in files))) == 500
    assert written.beside == sum(f.stat().st_size for f in files)
    assert "map_points" in str(written)


def test_each_keyframe_gets_the_assistants_nearest_picture() -> None:
    def window(stamps: list[int], late: list[int]) -> WindowRecord:
        t = np.array(stamps + late, np.int64)
        eyes = np.array([0] * len(stamps) + [1] * len(late), np.int64)
        return WindowRecord(0, len(stamps), 0, False, np.arange(len(t)), eyes, t // 10, t)

    windows = [window([100, 200], [120, 190]), window([200, 300], [190, 280])]
    found = pairs(windows, np.array([100, 200, 250, 300]))
    assert found == [
        (0, (0, 10, 100), (1, 12, 120)),
        (1, (0, 20, 200), (1, 19, 190)),
        (3, (0, 30, 300), (1, 28, 280)),
    ]
    assert pairs([window([100], [])], np.array([100])) == [(0, (0, 10, 100), None)]


def test_pictures_are_spread_evenly() -> None:
    assert even(5, 400).tolist() == [0, 1, 2, 3, 4]
    assert even(1001, 5).tolist() == [0, 250, 500, 750, 1000]


def test_seams_are_in_the_level_frame_and_at_most_so_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = _view()
    R = map_page.map_image.level_rotation(view.T_w_c)
    p = view.points_w[:90]
    marked = replace(view, seams=np.column_stack([p, np.arange(90)]).astype(np.float32))
    monkeypatch.setattr(map_page, "MAX_SEAM_MARKS", 40)
    write_map_page(tmp_path / "map.html", marked)
    found = re.search(r'calmEdgeMap\.seams\("([^"]*)"\)', (tmp_path / "map.html").read_text())
    assert found
    marks = np.frombuffer(base64.b64decode(found[1]), "<f4").reshape(-1, 4)
    assert marks[:, 3].tolist() == list(range(0, 90, 3))
    assert np.allclose(marks[:, :3], p[::3] @ R.T, atol=1e-4)
    write_map_page(tmp_path / "map.html", view)
    assert 'calmEdgeMap.seams("' not in (tmp_path / "map.html").read_text()
