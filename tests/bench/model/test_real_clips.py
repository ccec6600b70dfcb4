import cv2
import numpy as np
import pytest

from bench.__main__ import main
from bench.model import real_clips
from bench.model.matchers import KltMatcher
from bench.model.protocols import Matches
from bench.model.real_clips import (
    COLUMNS,
    Clip,
    LineScore,
    judge,
    line_distances,
    measure_pair,
    pairs,
    requirements,
    rows,
    table,
)
from bench.model.truth import transfer
from calm_edge.geometry import epipolar, se3
from tests.bench.model.pictures import SIZE, camera, pose, texture, view

SPACING = 0.4
FRAMES = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A rectified clip that drives along a textured plane."""
    out, of_eyes, plane = tmp_path_factory.mktemp("clip"), camera(), texture()
    poses = [pose(z=0.05 * k) for k in range(FRAMES)]
    for eye in (0, 1):
        (out / f"cam{eye}").mkdir()
        for k, T in enumerate(poses):
            image, _ = view(of_eyes, T @ pose(x=SPACING * eye), plane)
            cv2.imwrite(str(out / f"cam{eye}" / f"{k:06d}.png"), image)
        (out / f"times{eye}.txt").write_text("".join(f"{0.4 * k}\n" for k in range(FRAMES)))
    np.savetxt(out / "poses0.txt", [T[:3].ravel() for T in poses])
    row = [of_eyes.fx, of_eyes.fy, of_eyes.cx, of_eyes.cy, *SIZE]
    np.savetxt(out / "calib.txt", [row, row])
    return out


def test_the_distance_to_a_line_is_the_larger_one_of_both_pictures():
    # the second camera sees everything twice as large, and so the error
    K_a, K_b = camera(200.0), camera(400.0)
    T_b_a = se3.inverse(pose(x=0.5))
    _, a = view(K_a, pose(), texture())
    _, b = view(K_b, pose(x=0.5), texture())
    uv = np.array([[150.0, 90.0], [170.0, 120.0]])
    there, _ = transfer(a, b, uv)
    F = epipolar.from_motion(K_a, K_b, T_b_a)
    assert line_distances(F, uv, there) == pytest.approx(0, abs=1e-3)
    assert line_distances(F, uv, there + np.array([7, 2])) == pytest.approx(2, abs=1e-3)
    swapped = line_distances(F.T, there + np.array([7, 2]), uv)
    assert swapped == pytest.approx(2, abs=1e-3)


def test_judging_counts_only_what_is_found():
    F = epipolar.from_motion(camera(), camera(), se3.inverse(pose(x=1.0)))
    uv = np.full((4, 2), 100.0)
    there = uv + np.array([[-9, 0.5], [-9, 2.0], [-9, 8.0], [-9, 0.0]])
    matches = Matches(there, np.array([True, True, True, False]), np.full(4, np.nan))
    found, within, error = judge(matches, uv, F)
    assert (found, within) == (3, (1, 2)) and error == pytest.approx(1.25)


def test_truth_of_a_clip_is_met_across_the_eyes_and_along_the_drive(folder):
    scores = []
    for pair in pairs(Clip("clip", SPACING, posed=True), folder):
        scores += measure_pair(pair, {"KLT": KltMatcher()})
    cases = {score.case for score in scores}
    assert {"eyes", "1 on"} <= cases
    for row in rows(scores):
        figures = dict(zip(COLUMNS, row, strict=True))
        assert figures["of found 1 px %"] > 95 and figures["found %"] > 60


def test_poses_that_are_not_the_camera_s_are_not_used(folder):
    cases = {pair.case for pair in pairs(Clip("clip", SPACING, posed=False), folder)}
    assert cases == {"eyes"}


def scored(ours, other):
    return [
        LineScore(name, clip, "eyes", place, 100, near + 5, (near, near + 2), 0.3)
        for clip in ("a", "b")
        for place in range(3)
        for name, near in (("ours", ours), ("KLT", other))
    ]


def test_requirements_go_to_who_finds_more():
    assert all(check.passed for check in requirements(scored(90, 60), ["KLT"]))
    assert not any(check.passed for check in requirements(scored(60, 90), ["KLT"]))
    assert not table([s for s in scored(90, 60) if s.matcher == "KLT"], ()).checks


def test_without_the_data_every_clip_is_skipped(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(real_clips, "contestant", lambda spec, method: (None, "no model"))
    arguments = ["--data", str(tmp_path), "--out", str(tmp_path / "out")]
    assert main(["model.clips", *arguments]) == 0
    said = capsys.readouterr().out
    assert said.count("skipped") == len(real_clips.CLIPS) and "no model" in said
