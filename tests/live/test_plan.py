"""The path from above."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calm_edge.config import PoseOutputConfig
from calm_edge.geometry import se3
from calm_edge.live import plan as plan_module
from calm_edge.live.plan import Plan, moved
from calm_edge.types import Float, LocalizerUpdate, Trajectory
from tests.recording import samples


def at(x: float, y: float, z: float, turn: float = 0.0) -> Float:
    """Camera pose at x (right), y (down), z (forward), turned to the right [rad]."""
    return se3.compose(se3.so3_exp(np.array([0, turn, 0])), np.array([x, y, z]))


def update(T_w_c: list[Float], first: int = 0) -> LocalizerUpdate:
    base = samples.update()
    ids = np.arange(first, first + len(T_w_c))
    trajectory = Trajectory(ids, ids * 10, np.stack(T_w_c), np.eye(4), 0)
    prediction = dataclasses.replace(base.prediction, landmarks=None)
    return dataclasses.replace(base, trajectory=trajectory, prediction=prediction)


def test_the_path_is_seen_from_above_with_forward_up_and_its_length() -> None:
    plan = Plan(PoseOutputConfig())
    assert plan.content() == {"path": [], "points": [], "length": 0.0}
    plan.update(update([at(0, 0, 0), at(0, 0, 3), at(4, 0, 3)]))
    assert plan.content()["path"] == [[0, 0], [0, 3], [4, 3]] and plan.length == 7
    # keyframes that have moved replace what was known
    plan.update(update([at(4, 0, 6)], first=2))
    assert plan.content()["path"][-1] == [4, 6] and plan.length == pytest.approx(8)


def test_a_camera_that_looks_down_gives_the_same_plan() -> None:
    plan = Plan(PoseOutputConfig(mounting_rpy_deg=(0.0, -20.0, 0.0)))
    a = np.radians(20)
    plan.update(update([at(0, 0, 0), at(0, -10 * np.sin(a), 10 * np.cos(a))]))
    np.testing.assert_allclose(plan.content()["path"][1], [0, 10], atol=0.01)


def test_a_pose_has_place_heading_and_speed() -> None:
    pose = Plan(PoseOutputConfig()).pose(at(1, 0, 2, np.pi / 2), np.array([0, 3.0, 4.0]))
    assert pose == {"x": 1.0, "y": 2.0, "heading_deg": 90.0, "speed": 5.0}


def test_long_paths_and_many_points_are_thinned_and_the_newest_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(plan_module, "PATH_POINTS", 10)
    plan = Plan(PoseOutputConfig())
    plan.update(update([at(0, 0, z) for z in range(95)]))
    path = plan.content()["path"]
    assert len(path) == 10 and path[-1] == [0, 94] and plan.length == 94


def test_points_of_the_newest_sub_map_are_shown() -> None:
    plan = Plan(PoseOutputConfig())
    plan.update(samples.update())
    points = np.array(plan.content()["points"])
    assert points.ndim == 2 and 0 < len(points) <= 7 and np.isfinite(points).all()


def test_a_pose_is_moved_by_its_velocity() -> None:
    T = moved(at(0, 0, 0), np.array([0, 0, 10.0]), np.array([0, 0.0, 0]), 0.5)
    np.testing.assert_allclose(T[:3, 3], [0, 0, 5])
    turned = moved(at(0, 0, 0), np.zeros(3), np.array([0, 1.0, 0]), 0.1)
    np.testing.assert_allclose(se3.so3_log(turned[:3, :3]), [0, 0.1, 0], atol=1e-12)
    still = at(1, 2, 3)
    assert moved(still, np.full(3, np.nan), np.zeros(3), 0.5) is still
