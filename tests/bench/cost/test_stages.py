from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.__main__ import main
from bench.cost import circuit, joint_optimum, length, stages
from bench.cost.clock import Clock, Measured
from bench.cost.joint_optimum import Optimisation
from bench.cost.length import growth
from bench.cost.pieces import Piece
from bench.tables import kept
from calm_edge.config import Config, FrontendConfig
from calm_edge.estimator.localizer import Localizer
from calm_edge.geometry import se3
from calm_edge.geometry.camera import project_each
from calm_edge.recording.window_record import of_window
from calm_edge.types import CalmEdgeError

N = 12


@pytest.fixture(scope="module")
def course():
    return length.drive(N)


@pytest.fixture(scope="module")
def pieces():
    """Sub-maps of the circuit, with the scripted model's landmarks."""
    n = 7
    config = Config()
    scene = circuit.scene(circuit.n_keyframes(n, config.frontend))
    backbone = length.TeachingBackbone(length.ScriptedBackbone(scene))
    localizer = Localizer(config, backbone)
    made = []
    for window in circuit.windows(n, config.frontend):
        update = localizer.process(window)
        made.append(Piece(of_window(window), update, window))
    return made


def test_the_circuit_is_closed_level_on_average_and_a_metre_a_step():
    T = circuit.lap()
    steps = se3.inverse(T) @ np.roll(T, -1, 0)
    far = np.linalg.norm(steps[:, :3, 3], axis=1)
    assert far.min() > 0.9 and far.max() < 1.1
    # it moves along its optical axis
    assert (steps[:, 2, 3] / far > 0.999).all()
    assert np.linalg.norm(se3.so3_log(steps[:, :3, :3]), axis=1).max() < 0.1
    np.testing.assert_allclose(np.linalg.det(T[:, :3, :3]), 1.0, atol=1e-12)


def test_windows_overlap_as_the_front_end_cuts_them():
    config = FrontendConfig()
    made = list(circuit.windows(3, config))
    assert [len(w.primary) for w in made] == [15, 15, 15]
    assert [w.n_overlap for w in made] == [0, 3, 3]
    ids = [[k.id for k in w.primary] for w in made]
    assert ids[1] == list(range(12, 27)) and made[0].primary[-3:] == made[1].primary[:3]
    assert ids[-1][-1] + 1 == circuit.n_keyframes(3, config)
    assert not np.array_equal(made[0].primary[0].frame.bgr(), made[0].primary[1].frame.bgr())


def test_closures_join_what_is_one_place():
    n = 2 * circuit.LAP
    T, found = circuit.scene(n).T_w_p, circuit.closures(n, 60)
    assert len(found) == (circuit.LAP - 1) // 60
    for loop in found:
        true = se3.inverse(T[loop.match_id]) @ T[loop.query_id]
        off = se3.log(se3.inverse(true) @ loop.T_match_query)
        assert 0 < np.abs(off[:3]).max() < 0.3 and np.abs(off[3:]).max() < 0.03


def test_the_drive_counts_every_stage_but_the_model(course):
    assert {"loop", "search", "rectify", "place", "resolve", "rest"} <= set(course.stage_ms)
    assert "infer" not in course.stage_ms and (course.infer_ms > 0).all()
    assert course.live_ms.shape == (N,) and (course.live_ms > 0).all()
    assert len(course.submaps) == N and course.rss.min() > 1e7
    np.testing.assert_allclose(course.live_ms, sum(course.stage_ms.values()))


def test_the_landmarks_are_thinned_but_remain_matches():
    config = Config()
    n = circuit.n_keyframes(2, config.frontend)
    backbone = length.TeachingBackbone(length.ScriptedBackbone(circuit.scene(n)))
    localizer = Localizer(config, backbone)
    update = localizer.process(next(circuit.windows(2, config.frontend)))
    marks, submap = update.prediction.landmarks, update.submap
    assert 4000 < len(marks.uv) < 15000
    assert marks.index.max() < len(marks.points_s)
    T_c_s = se3.inverse(submap.T_s_c_raw[marks.view])
    seen = (T_c_s[:, :3, :3] @ marks.points_s[marks.index][..., None])[..., 0] + T_c_s[:, :3, 3]
    uv = project_each(submap.cameras_raw, marks.view, seen)
    assert np.abs(uv - marks.uv).max() < 1e-2


def test_too_short_a_drive_is_one_clear_line(capsys):
    assert main(["cost", "--submaps", "3"]) == 1
    said = capsys.readouterr().err.strip()
    assert said == "bench: --submaps 3: give at least 10"


def test_growth_is_over_the_whole_drive_and_ignores_its_start():
    values = np.concatenate([np.full(20, 500.0), 7 + 0.5 * np.arange(20, 100)])
    assert growth(values, 20) == pytest.approx(50.0)


def test_cost_that_grows_misses_its_requirement(course):
    def verdict(stage):
        checks = length.table(replace(course, stage_ms={"search": stage}), "").checks
        return checks[0].passed

    assert verdict(np.full(N, 80.0))
    assert not verdict(80.0 + 2 * np.arange(N))


def test_the_joint_optimum_is_taken_at_three_lengths_with_and_without_loops(course, monkeypatch):
    monkeypatch.setattr(circuit, "LAP", 60)
    runs = joint_optimum.optimisations(course)
    assert [r.keyframes for r in runs[:3]] == [39, 75, 147]
    assert [r.loops for r in runs] == [0, 0, 0, 0, 0, 1]
    assert all(min(r.cpu_s, r.snapshot_s, r.update_s) > 0 for r in runs)
    slow = Optimisation(1000, 0, 0, 0.6, 0.0, 0.0)
    fast = Optimisation(1000, 0, 0, 0.4, 0.0, 0.0)
    assert joint_optimum.table([fast], "", 1e8, 1e8).checks[0].passed
    assert not joint_optimum.table([fast, slow], "", 1e8, 1e8).checks[0].passed
    square = replace(fast, keyframes=4000, cpu_s=16 * fast.cpu_s)
    assert [c.passed for c in joint_optimum.table([fast, square], "", 1e8, 1e8).checks] == [
        False,
        False,
        True,
    ]
    assert not joint_optimum.table([fast], "", 4e8, 3e8).checks[2].passed
    line = replace(fast, keyframes=4000, cpu_s=4 * fast.cpu_s)
    assert [c.passed for c in joint_optimum.table([fast, line], "", 1e8, 1e8).checks] == [
        True,
        True,
        True,
    ]


def test_the_optimisers_own_process_is_weighed(course):
    assert 3e7 < joint_optimum.peak_bytes(course) < 6e8


def test_the_command_prints_keeps_and_plots(tmp_path, capsys):
    plot = tmp_path / "length.svg"
    arguments = ["--submaps", "10", "--out", str(tmp_path), "--plot", str(plot)]
    assert main(["cost", *arguments]) == 0
    assert {table.name for table in kept(tmp_path)} == {"bench_length", "bench_optimum"}
    assert plot.read_text().startswith("<svg xmlns") and "mean of 51" in plot.read_text()
    assert "bytes a keyframe" in capsys.readouterr().out


def test_a_clock_means_over_its_runs():
    clock = Clock()
    clock.add(2.0, 4.0)
    clock.add(4.0, 8.0, things=2)
    assert clock.run(lambda: 7) == 7
    said = clock.measured("x", target_s=1.0)
    assert said.n == 4 and 1.5 <= said.cpu_s < 1.6 and said.wall_s >= 3.0


def test_banks_and_search_on_landmarks(pieces):
    config = replace(Config().correction, n_group=2)
    rows, groups = stages.banks(pieces[:3], config, by_sift=False)
    assert rows[0].n == 6 and rows[1].n == 6 * (1 + config.group_every)
    assert all(len(of_eye) == 3 and len(of_eye[0].F) == 105 for of_eye in groups.values())
    guess, group = stages.search(pieces, groups, config)
    assert guess.n == 2 * stages.REPEATS and group.n == 4


def test_what_returns_without_depth_is_looked_up_and_not_verified(pieces):
    none, verified = stages.look_up(pieces, Config())
    assert none.n == 7 and verified.n == 0


def test_a_bank_by_sift_describes_the_pictures(pieces):
    rows, groups = stages.banks(pieces[:1], Config().correction, by_sift=True)
    # pictures of noise have no matches
    assert rows[0].n == 2 and not any(groups.values())


def test_rectification_and_placement(pieces):
    config = Config()
    assert stages.rectification(pieces, config).n == stages.REPEATS
    place, add, pgo = stages.placement(pieces, config)
    assert place.n == 6 * stages.REPEATS and add.n == 6
    assert pgo.n == circuit.n_keyframes(7, config.frontend)


def test_the_core_is_held_to_its_requirement():
    fast = Measured("core", 1.12, 0.35, 0.2, 1.0, 1, 0.0)
    none = Measured("never ran", None, 0.1, 0.0, 0.0, 0, 0.0)
    checks = stages.table([fast, replace(fast, cpu_s=0.4), none], "").checks
    assert [check.passed for check in checks] == [True, False]


def test_a_recording_too_short_is_one_clear_line(monkeypatch, tmp_path, capsys):
    def short(path, least):
        raise CalmEdgeError(f"{path}: 2 sub-maps")

    monkeypatch.setattr(stages, "read", short)
    assert main(["cost", str(tmp_path), "--submaps", "0"]) == 1
    assert capsys.readouterr().err.strip() == f"bench: {tmp_path}: 2 sub-maps"
