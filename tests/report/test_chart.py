"""Charts: ticks, limits, clipping, and curves where they belong."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from calm_edge.report import chart
from calm_edge.report.chart import Chart, limits, ticks
from calm_edge.types import Float

SVG = "{http://www.w3.org/2000/svg}"


def polylines(svg: str) -> list[Float]:
    """Points (N, 2) [px] of the curves, in the plotting area."""
    found = ElementTree.fromstring(svg).iter(f"{SVG}polyline")
    return [np.array([p.split(",") for p in e.attrib["points"].split()], float) for e in found]


@pytest.mark.parametrize(
    ("low", "high", "count", "expected"),
    [
        (0, 10, 5, [0, 2, 4, 6, 8, 10]),
        (-0.31, 0.42, 5, [-0.2, 0, 0.2, 0.4]),
        (99.7, 100.2, 5, [99.7, 99.8, 99.9, 100, 100.1, 100.2]),
        (0, 44_000, 4, [0, 10_000, 20_000, 30_000, 40_000]),
    ],
)
def test_ticks_are_round_numbers_within_the_limits(
    low: float, high: float, count: int, expected: list[float]
) -> None:
    assert ticks(low, high, count) == pytest.approx(expected)


def test_limits_leave_a_margin_and_never_collapse() -> None:
    assert limits(np.array([0.0, 10.0]), margin=0.1) == (-1, 11)
    assert limits(np.full(3, 7.0)) == (6.5, 7.5)
    assert limits(np.array([np.nan, 1, 3]), margin=0) == (1, 3)
    assert limits(np.full(2, np.nan)) == limits(np.zeros(0)) == (0, 1)


def test_a_curve_is_at_its_place_and_broken_where_unknown() -> None:
    figure = Chart((0, 4), (0, 2), ("x", "y"), 200 + chart.BOTTOM + chart.LEGEND)
    figure.line(np.arange(5), np.array([0, 2, np.nan, 1, 1.0]), "red", "a & b")
    svg = figure.svg("what")
    first, second = polylines(svg)
    wide = chart.WIDTH - chart.LEFT - chart.RIGHT
    assert first == pytest.approx(np.array([[0, 200], [wide / 4, 0]]), abs=0.1)
    assert second == pytest.approx(np.array([[0.75 * wide, 100], [wide, 100]]), abs=0.1)
    assert "a &amp; b" in svg and "nan" not in svg


def test_both_axes_have_one_scale_if_asked() -> None:
    figure = Chart((0, 100), (0, 1), ("m", "m"), 400, equal=True)
    figure.line(np.array([0, 100.0]), np.array([0, 100.0]), "red")
    (line,) = polylines(figure.svg("square"))
    across, up = np.abs(line[1] - line[0])
    assert across == pytest.approx(up, abs=0.2)


def test_what_is_outside_the_limits_is_clipped() -> None:
    figure = Chart((0, 1), (0, 1), ("x", "y"), 300)
    figure.band(np.array([0, 1.0]), np.full(2, -50.0), np.full(2, 50.0), "red", 0.1)
    area = ElementTree.fromstring(figure.svg("band")).find(f"{SVG}g/{SVG}svg")
    assert area is not None and area.find(f"{SVG}polygon") is not None


def test_charts_stack_and_follow_the_colours_of_the_page() -> None:
    figures = [Chart((0, 1), (0, 1), ("x", "y"), height) for height in (200, 100)]
    for figure in figures:
        figure.level(0.5, chart.ESTIMATE, "level")
        figure.dot(0.5, 0.5, chart.TRUTH, "dot", square=True)
    svg = chart.stacked(figures, "two")
    parts = ElementTree.fromstring(svg).findall(f"{SVG}svg")
    assert [part.attrib["y"] for part in parts] == ["0", "200"]
    assert re.search(r"viewBox=\"0 0 \d+ 300\"", svg)
    # a fallback for a file of its own, where the page's properties are not defined
    assert set(re.findall(r"var\((--[a-z]+),#[0-9a-f]{6}\)", svg)) >= {"--estimate", "--truth"}


def test_a_narrow_chart_keeps_its_text_and_wraps_its_legend() -> None:
    charts = [Chart((0, 130), (0, 1), ("x", "y"), 300, width=w, clock=True) for w in (960, 400)]
    for figure in charts:
        for name in ("the first of the curves", "the second of the curves", "the third one"):
            figure.line(np.array([0, 130.0]), np.array([0, 1.0]), "red", name)
    wide, narrow = (figure.svg("both") for figure in charts)
    assert 'viewBox="0 0 960 300"' in wide and 'viewBox="0 0 400 328"' in narrow
    assert 'font-size="13"' in wide and 'font-size="13"' in narrow
    ends = [
        float(e.attrib["x"]) + 7 * len(e.text or "")
        for e in ElementTree.fromstring(narrow).iter(f"{SVG}text")
        if "the " in (e.text or "")
    ]
    assert len(ends) == 3 and max(ends) <= 400


def test_seconds_are_labelled_as_on_a_clock() -> None:
    figure = Chart((0, 130), (0, 1), ("x", "y"), 300, width=400, clock=True)
    labels = [e.text for e in ElementTree.fromstring(figure.svg("t")).iter(f"{SVG}text")]
    assert labels[:5] == ["0:00", "0:30", "1:00", "1:30", "2:00"]
    assert [chart.minutes(s) for s in (0, 59.9, 3600, 7325)] == [
        "0:00",
        "0:59",
        "1:00:00",
        "2:02:05",
    ]
    figure.span(10, 10.001, "red", "a short time")
    assert float(re.findall(r'<rect x="[\d.]+" y="0" width="([\d.]+)"', figure.svg("t"))[0]) == 2
