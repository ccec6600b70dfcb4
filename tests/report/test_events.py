"""Events that were marked while driving: where they are on the path, and how they are shown."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

from calm_edge.report.events import marked_events, sentence, table, time
from calm_edge.report.map_page import MapView, write_map_page
from calm_edge.report.report import ReportData, render

S = 10**9


def path(n: int = 5) -> np.ndarray:
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, 2, 3] = 2.0 * np.arange(n)
    return T


def test_an_event_belongs_to_the_nearest_keyframe() -> None:
    t_ns = S * np.arange(100, 105)
    events = marked_events(
        [(103 * S + 4 * 10**8, "tram"), (99 * S, ""), (400 * S, "z")], t_ns, path()
    )
    assert [(e.t_s, e.keyframe, e.text) for e in events] == [
        (-1.0, 0, ""), (3.4, 3, "tram"), (300.0, None, "z")
    ]  # fmt: skip
    assert np.array_equal(events[1].p_w, [0, 0, 6])
    assert marked_events([(1, "lost")], t_ns[:0], path(0)) == ()


def test_they_are_counted_with_their_times() -> None:
    events = marked_events([(5 * S, ""), (65 * S, "x")], S * np.arange(70), path(70))
    assert sentence(events) == "2 events were marked: at 0:05, 1:05."
    assert sentence(9 * events[:1]).endswith("0:05, 0:05 and 3 more times.")
    assert sentence(events[:1]) == "1 event was marked: at 0:05." and sentence(()) == ""
    assert time(marked_events([(0, "")], S * np.arange(3, 5), path(2))[0]) == "-0:03"


def test_the_report_lists_them_and_leads_into_the_map() -> None:
    T = path()
    events = marked_events([(3 * S, "<b>tram")], S * np.arange(5), T)
    html = table(events, 2.0 * np.arange(5), "m", "map.html")
    assert '<a href="map.html#k=4">' in html and "6 m" in html and "&lt;b&gt;tram" in html
    lost = marked_events([(99 * S, "late")], S * np.arange(5), T)
    row = table(lost, 2.0 * np.arange(5), "m", "map.html")
    assert "not on the path" in row and "href" not in row
    assert "event</text>" not in render(ReportData("drive", T, events=lost))
    assert "href" not in table(events, 2.0 * np.arange(5), "m", "")
    page = render(ReportData("drive", T, events=events, map_page="map.html"))
    assert "Events" in page and "map.html#k=4" in page and page.count("event</text>") == 2


def test_the_map_page_holds_their_keyframes_and_texts(tmp_path: Path) -> None:
    T = path()
    events = marked_events([(3 * S, "</script>"), (4 * S, ""), (60 * S, "")], S * np.arange(5), T)
    points = np.zeros((1, 3), np.float32)
    view = MapView(
        "drive", "m", 0.1, points, np.zeros((1, 3), np.uint8), np.zeros(1, np.int64),
        np.zeros(1), T, np.arange(5.0), events=events,
    )  # fmt: skip
    write_map_page(tmp_path / "map.html", view)
    text = (tmp_path / "map.html").read_text()
    found = re.search(r"<script>const DRIVE=(.*?);</script>", text)
    assert found and json.loads(found[1])["events"] == [[3, "0:03 </script>"], [4, "0:04"]]
