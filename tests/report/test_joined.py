"""Pages of a map of several drives."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.report import joined_page
from calm_edge.report.events import MarkedEvent
from calm_edge.report.joined_page import DriveRow, JoinedData, write_joined
from calm_edge.report.joined_view import PAUSE_S, joined
from calm_edge.report.keyframe_pictures import KeyframePictures
from calm_edge.report.map_page import MapView, write_map_page
from calm_edge.types import Float
from tests.evaluation.worlds import curve

N = 12


def view(points: int) -> MapView:
    """A drive with three sub-maps."""
    return MapView(
        "one",
        "m",
        0.1,
        np.zeros((points, 3), np.float32),
        np.zeros((points, 3), np.uint8),
        np.arange(points) % 3,
        np.array([0.0, 2.0, 4.0]),
        curve(N),
        np.arange(N) / 2,
        [KeyframePictures(3, b"a", b"b")],
        events=[MarkedEvent(2.0, "tram", 4, np.zeros(3))],
    )


def test_views_follow_each_other_and_the_path_is_cut_between_them(tmp_path: Path) -> None:
    both = joined("a + b", ["a", "b"], [view(30), view(20)])
    assert both.drives == (("a", 0), ("b", N)) and len(both.T_w_c) == 2 * N
    assert len(both.points_w) == 50 and both.submap.max() == 5
    assert np.bincount(both.submap)[3:].tolist() == [7, 7, 6]
    assert np.all(np.diff(both.t_s) > 0) and both.t_s[N] == 5.5 + PAUSE_S
    assert both.submap_s.tolist() == [0, 2, 4, 6.5, 8.5, 10.5]
    assert [picture.keyframe for picture in both.pictures] == [3, 15]
    assert [(event.keyframe, event.text) for event in both.events] == [
        (4, "tram (a)"),
        (N + 4, "tram (b)"),
    ]
    write_map_page(tmp_path / "map.html", both)
    found = re.search(r"<script>const DRIVE=(.*?);</script>", (tmp_path / "map.html").read_text())
    assert found and json.loads(found[1])["drives"] == [["a", 0], ["b", N]]


def row(name: str, T_w_c: Float, folder: Path, *, apart: bool = False) -> DriveRow:
    (folder / name).mkdir()
    (folder / name / "report.html").write_text("x")
    return DriveRow(name, T_w_c, apart, 1.01, folder / name / "report.html")


@pytest.fixture
def data(tmp_path: Path) -> JoinedData:
    """Two joined drives side by side and one that is apart."""
    T = curve(40)
    beside = se3.compose(np.eye(3), np.array([0.0, 0.0, 2.0])) @ T
    rows = (
        row("monday", T, tmp_path),
        row("<tuesday>", beside, tmp_path),
        row("friday", 50 * T, tmp_path, apart=True),
    )
    rng = np.random.default_rng(3)
    p = np.repeat(T[:, :3, 3], 50, axis=0) + rng.normal(0, 2, (2000, 3))
    colors = rng.integers(0, 255, (2000, 3)).astype(np.uint8)
    notes = ("friday: is apart: no place of the others was recognised in it",)
    closures = (("monday", "<tuesday>", 5),)
    return JoinedData("place", "m", rows, closures, p.astype(np.float32), colors, notes)


def test_the_report_names_drives_places_and_what_is_apart(data: JoinedData, tmp_path: Path) -> None:
    write_joined(tmp_path / "report.html", data)
    text = (tmp_path / "report.html").read_text()
    assert "2 drives," in text and "by 5 common places" in text
    assert "Apart, without a common place: friday." in text and "its own: apart" in text
    assert "&lt;tuesday&gt;" in text and "<tuesday>" not in text
    assert 'href="friday/report.html"' in text and "map from above" in text
    assert not re.search(r"https?://(?!www.w3.org)", text)
    # the plan is of the joined drives alone
    plan = text.partition("paths from above")[2].partition("</svg>")[0]
    assert "friday" not in plan


def test_drives_that_are_all_apart_are_said_to_be(data: JoinedData) -> None:
    alone = tuple(replace(drive, apart=drive.name != "monday") for drive in data.drives)
    text = joined_page.account(replace(data, drives=alone, closures=()))
    assert text == "No drive shows a place of another: the map is of monday alone."
