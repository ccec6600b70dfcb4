"""The report page is self-contained and shows the given data."""

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np

from calm_edge.evaluation.estimate import from_updates
from calm_edge.evaluation.results import compare
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry.camera import Perspective
from calm_edge.report.drive_report import report_data, unobserved
from calm_edge.report.report import ReportData, render, write_report
from calm_edge.types import LocalizerUpdate, Masks
from tests.evaluation.worlds import curve, stamps, update

N = 160


def _updates(sigma: float = 0.01) -> list[LocalizerUpdate]:
    T, t = curve(N), stamps(N)
    return [
        update(
            T[: 40 * (k + 1) : 4],
            t[: 40 * (k + 1) : 4],
            sigma=(0.01, sigma),
            submap_id=k,
            scale=2.0 + k,
            stage_ms={"infer": 120.0},
        )
        for k in range(4)
    ]


def _street() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    base = curve(N)[rng.integers(0, N, 6000), :3, 3]
    points = (base + rng.normal(0, [3, 0.02, 3], (6000, 3)) + [0, 1.5, 0]).astype(np.float32)
    return points, np.full((6000, 3), (200, 30, 30), np.uint8)


class _Closed(HTMLParser):
    """Parser that collects all links and checks that tags are closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in {"meta", "img"}:
            self.open.append(tag)
        self.links += [v or "" for k, v in attrs if k in {"src", "href", "srcset", "data"}]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [v or "" for k, v in attrs if k in {"src", "href"}]


def test_a_full_page_has_no_external_links(tmp_path: Path) -> None:
    points, color = _street()
    estimate = replace(from_updates("r", _updates(), N, 0.5), points_w=points)
    cameras = tuple(Perspective(f, f, 319.5, 119.5, 640, 240) for f in (500.0, 610.0))
    truth = Truth(stamps(N), curve(N), cameras)
    data = report_data("A drive <1>", estimate, _updates(), color, truth, compare(estimate, truth))
    write_report(tmp_path / "report.html", data)
    text = (tmp_path / "report.html").read_text()
    page = _Closed()
    page.feed(text)
    assert page.open == []
    assert page.links and all(link.startswith("data:image/") for link in page.links)
    assert all("://" not in link for link in page.links)
    assert "<script" not in text and "A drive &lt;1&gt;" in text and "<1>" not in text
    for heading in (
        "from above",
        "along the street",
        "Scale over",
        "Focal length over",
        "Time by stage",
    ):
        assert heading in text
    assert text == render(data)  # the same drive gives the same bytes
    photos = [
        cv2.imdecode(np.frombuffer(base64.b64decode(link.split(",")[1]), np.uint8), 1)
        for link in page.links
        if link.startswith("data:image/webp")
    ]
    assert len(photos) == 3
    for photo in photos:
        red = (photo[..., 2] > 150) & (photo[..., 1] < 90)
        assert red.mean() > 0.005


def test_curves_hold_the_truth_only_when_given() -> None:
    data = report_data("t", from_updates("r", _updates(), N, 0.5), _updates())
    assert data.truth_w is None and data.scale_windows is None and data.truth_focal_px is None
    assert "No truth was given" in render(data)
    assert np.allclose(data.scale, [1, 1.5, 2, 2.5])
    assert data.focal_px.tolist() == [[500, 600]] * 4
    truth = Truth(stamps(N), curve(N))
    data = report_data("t", from_updates("r", _updates(), N), _updates(), truth=truth)
    assert data.truth_w is not None and data.scale_windows is not None
    # the truth is aligned to the estimate's world, which here is the same
    assert np.allclose(data.truth_w, curve(N)[: len(data.truth_w), :3, 3], atol=1e-6)
    assert np.allclose(data.scale_windows[:, 1], 1, atol=1e-3)


def test_the_parts_left_out_are_shown_in_the_pictures() -> None:
    masks = Masks(None, np.array([[0], [1]], np.uint8))
    updates = [*_updates()[:-1], replace(_updates()[-1], masks=masks)]
    grey = np.full((360, 640, 3), 90, np.uint8)
    data = report_data("t", from_updates("r", updates, N), updates, pictures=[grey, grey])
    (picture,) = data.left_out
    assert picture.shape == (270, 480, 3)
    assert (picture[:130] == 90).all() and (picture[140:, :, 0] > 120).all()
    assert "Left out of the pictures" in render(data)
    without = report_data("t", from_updates("r", updates, N), _updates(), pictures=[grey, grey])
    assert "Left out" not in render(without)


def test_a_revised_sub_map_is_drawn_once_as_first_placed() -> None:
    again = [replace(u, submap=replace(u.submap, scale=9.0)) for u in _updates()]
    data = report_data("t", from_updates("r", _updates(), N, 0.5), [*_updates(), *again])
    assert np.allclose(data.scale, [1, 1.5, 2, 2.5])


def test_notes_name_what_is_unobserved() -> None:
    (focal, spacing) = unobserved(from_updates("r", _updates(sigma=0.11)))
    assert "assistant" in focal and "11.0 %" in focal and "unobserved" in focal
    assert "spacings" in spacing
    assert unobserved(from_updates("r", _updates(), spacing_m=0.5)) == ()
    page = render(report_data("t", from_updates("r", _updates(0.11)), _updates(0.11)))
    assert "Not observed" in page and "11.0 %" in page


def test_a_drive_without_sub_maps_still_has_a_page() -> None:
    data = report_data("nothing", from_updates("r", [], 12), [], notes=("3 frames were lost.",))
    page = render(data)
    assert "No sub-map could be placed" in page and "3 frames were lost." in page
    assert "Scale over" not in page


def test_a_straight_or_standing_drive_is_drawn() -> None:
    straight = np.tile(np.eye(4), (12, 1, 1))
    straight[:, 2, 3] = np.arange(12)
    for T in (straight, straight[:1], np.tile(np.eye(4), (3, 1, 1))):
        page = render(ReportData("t", T))
        assert re.search(r"<polyline points=\"[\d.,\- ]+\"", page) and "nan" not in page
