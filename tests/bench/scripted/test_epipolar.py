import numpy as np
import pytest

from bench.scripted import epipolar
from calm_edge.geometry import se3

F_PX = 500.0


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def pairs(rng, n=6, m=120):
    """T_b_a of motions ahead with a turn, and the exact rays of points 4 to 40 ahead."""
    twist = rng.standard_normal((n, 6)) * [0.1, 0.05, 0.1, 0.01, 0.04, 0.01]
    T_a_b = se3.exp(twist + np.array([0, 0, 1.2, 0, 0, 0]))
    p_a = np.stack(
        [rng.uniform(-8, 8, (n, m)), rng.uniform(-3, 2, (n, m)), rng.uniform(4, 40, (n, m))], -1
    )
    T_b_a = se3.inverse(T_a_b)
    p_b = p_a @ np.swapaxes(T_b_a[:, :3, :3], 1, 2) + T_b_a[:, None, :3, 3]
    return T_b_a, p_a, p_b


def matches(p_a, p_b, focal_ratio=1.0):
    """As seen by a model whose focal is focal_ratio times the true one."""
    shrink = np.array([1 / focal_ratio, 1 / focal_ratio, 1.0])
    f = np.full((len(p_a), 2), F_PX * focal_ratio)
    x_a, x_b = p_a / p_a[..., 2:] * shrink, p_b / p_b[..., 2:] * shrink
    return epipolar.Matches(x_a, x_b, f, f, np.ones(p_a.shape[:2]))


def cost(T, m):
    r = epipolar.sampson(epipolar.essential(T), m.x_a, m.x_b, m.f_a, m.f_b)
    return (m.weight * r**2).sum(1)


def test_sampson_is_the_distance_a_match_must_move(rng):
    T, p_a, p_b = pairs(rng)
    m = matches(p_a, p_b)
    E = epipolar.essential(T)
    assert np.abs(epipolar.sampson(E, m.x_a, m.x_b, m.f_a, m.f_b)).max() < 1e-9
    line = m.x_a @ np.swapaxes(E, 1, 2)
    across = line[..., :2] / np.linalg.norm(line[..., :2], axis=-1, keepdims=True)
    moved = m.x_b.copy()
    moved[..., :2] += 0.3 / F_PX * across
    r = epipolar.sampson(E, m.x_a, moved, m.f_a, m.f_b)
    # half of it is left to the match in the other view
    assert np.allclose(np.abs(r), 0.3 / np.sqrt(2), rtol=0.25)


def test_exact_matches_give_the_true_pose_from_a_wrong_start(rng):
    T, p_a, p_b = pairs(rng)
    start = se3.exp(rng.standard_normal((len(T), 6)) * 0.02) @ T
    solved = epipolar.solve(start, matches(p_a, p_b))
    true = T.copy()
    true[:, :3, 3] /= np.linalg.norm(true[:, :3, 3], axis=1, keepdims=True)
    assert np.abs(solved - true).max() < 1e-6


def test_under_a_wrong_focal_no_pose_nearby_fits_better(rng):
    T, p_a, p_b = pairs(rng)
    m = matches(p_a, p_b, 1.08)
    solved = epipolar.solve(T, m)
    best = cost(solved, m)
    assert np.all(best < 0.9 * cost(T, m))
    for size in (1e-5, 1e-4, 1e-3):
        for _ in range(20):
            near = se3.exp(rng.standard_normal((len(T), 6)) * size) @ solved
            assert np.all(cost(near, m) > best * (1 - 1e-7))


def test_matches_of_no_weight_do_not_count(rng):
    T, p_a, p_b = pairs(rng)
    m = matches(p_a, p_b)
    x_b = m.x_b.copy()
    x_b[:, :40, :2] += rng.standard_normal((len(T), 40, 2))
    weight = m.weight.copy()
    weight[:, :40] = 0
    solved = epipolar.solve(T, m._replace(x_b=x_b, weight=weight))
    assert np.abs(solved[:, :3, :3] - T[:, :3, :3]).max() < 1e-6


def test_resection_finds_pose_and_length(rng):
    n, J, m = 4, 3, 100
    T_s_a = se3.exp(np.zeros((n, J, 6)) + np.array([0, 0, 1.0, 0, 0.02, 0]) * np.arange(J)[:, None])
    T_s_b = se3.exp(np.array([0.54, 0.02, 0.9, 0.01, 0.05, 0]) + 0.02 * rng.standard_normal((n, 6)))
    p_s = np.stack(
        [rng.uniform(-8, 8, (n, m)), rng.uniform(-3, 2, (n, m)), rng.uniform(6, 40, (n, m))], -1
    )
    T_a_s = se3.inverse(T_s_a).reshape(-1, 4, 4)
    p_all = np.repeat(p_s, J, axis=0)
    p_a = p_all @ np.swapaxes(T_a_s[:, :3, :3], 1, 2) + T_a_s[:, None, :3, 3]
    T_b_s = se3.inverse(T_s_b)
    p_b = p_s @ np.swapaxes(T_b_s[:, :3, :3], 1, 2) + T_b_s[:, None, :3, 3]
    start = se3.exp(rng.standard_normal((n, 6)) * 0.02) @ T_b_s
    solved = epipolar.resect(start, T_s_a, matches(p_a, np.repeat(p_b, J, axis=0)))
    assert np.abs(solved - T_b_s).max() < 1e-6


def test_inverse_depth_is_exact_and_its_information_grows_with_parallax(rng):
    T, p_a, p_b = pairs(rng)
    m = matches(p_a, p_b)
    value, information = epipolar.inverse_depth(T, m.x_a, m.x_b)
    assert np.allclose(value, 1 / p_a[..., 2], atol=1e-9)
    away_from_the_centre = np.abs(m.x_a[..., 0]) > 0.5
    assert information[away_from_the_centre].mean() > 3 * information[~away_from_the_centre].mean()


def test_weighted_median_follows_the_weights():
    value = np.array([[3.0, 1.0, 2.0], [3.0, 1.0, 2.0]])
    weight = np.array([[1.0, 1.0, 1.0], [5.0, 1.0, 1.0]])
    assert epipolar.weighted_median(value, weight).tolist() == [2.0, 3.0]
