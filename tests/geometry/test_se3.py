import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from calm_edge.geometry import se3

numbers = st.floats(-5, 5, allow_nan=False)
vectors = st.lists(numbers, min_size=3, max_size=3).map(np.array)


@st.composite
def twists(draw: st.DrawFn, most: float = 3.0) -> np.ndarray:
    """Twists with a rotation below `most` rad, zero included."""
    axis = draw(vectors)
    angle = draw(st.floats(0, most) | st.sampled_from([0.0, 1e-9, 1e-6, 1e-4]))
    norm = np.linalg.norm(axis)
    return np.concatenate([draw(vectors), axis / norm * angle if norm > 1e-3 else np.zeros(3)])


def as_generator(xi: np.ndarray) -> np.ndarray:
    out = np.zeros((4, 4))
    out[:3, :3], out[:3, 3] = se3.hat(xi[3:]), xi[:3]
    return out


@given(vectors, vectors)
def test_hat_is_the_cross_product(a, b):
    np.testing.assert_allclose(se3.hat(a) @ b, np.cross(a, b), atol=1e-12)


@given(twists())
def test_exp_is_the_matrix_exponential(xi):
    np.testing.assert_allclose(se3.exp(xi), expm(as_generator(xi)), atol=1e-9)


@given(twists())
def test_log_undoes_exp(xi):
    np.testing.assert_allclose(se3.log(se3.exp(xi)), xi, atol=1e-7)


@given(vectors, st.floats(3.0, np.pi) | st.just(np.pi))
def test_so3_log_up_to_and_including_half_a_turn(axis, angle):
    norm = np.linalg.norm(axis)
    axis = axis / norm if norm > 1e-3 else np.array([0.0, 1.0, 0.0])
    R = se3.so3_exp(axis * angle)
    w = se3.so3_log(R)
    # at pi both signs of the axis give the same rotation
    np.testing.assert_allclose(se3.so3_exp(w), R, atol=1e-7)
    assert np.linalg.norm(w) == pytest.approx(angle, abs=1e-6)


@pytest.mark.parametrize("angle", [1e-12, 0.0099, 0.0101, 2.0943, 2.0945, 3.1])
def test_log_is_exact_on_both_sides_of_its_limits(angle):
    """At the angles at which formulas for small and for large rotations take over."""
    rng = np.random.default_rng(0)
    xi = rng.normal(size=(100, 6))
    xi[:, 3:] *= angle / np.linalg.norm(xi[:, 3:], axis=1, keepdims=True)
    np.testing.assert_allclose(se3.log(se3.exp(xi)), xi, atol=1e-13)


@given(vectors)
def test_quaternions_equal_scipys_with_nonnegative_w_last(w):
    R = se3.so3_exp(w)
    expected, found = Rotation.from_matrix(R).as_quat(canonical=True), se3.quaternions(R)
    assert found[3] >= 0
    # at half a turn both signs are valid
    assert abs(abs(found @ expected) - 1) < 1e-9
    np.testing.assert_allclose(se3.rotations(found), R, atol=1e-12)


def test_the_quaternions_of_no_rotation_and_of_half_a_turn():
    found = se3.quaternions(np.stack([np.eye(3), np.diag([1.0, -1, -1])]))
    np.testing.assert_allclose(found, [[0, 0, 0, 1], [1, 0, 0, 0]], atol=1e-15)


@given(twists(), twists())
def test_inverse_and_composition(a, b):
    T, S = se3.exp(a), se3.exp(b)
    np.testing.assert_allclose(se3.inverse(T) @ T, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(se3.inverse(T @ S), se3.inverse(S) @ se3.inverse(T), atol=1e-8)


@given(twists(), twists(1.0))
def test_adjoint_moves_a_twist_across_a_pose(a, b):
    T = se3.exp(a)
    np.testing.assert_allclose(
        T @ se3.exp(b) @ se3.inverse(T), se3.exp(se3.adjoint(T) @ b), atol=1e-7
    )


@given(twists(), vectors)
def test_transform_matches_homogeneous_coordinates(xi, p):
    T = se3.exp(xi)
    np.testing.assert_allclose(se3.transform(T, p), (T @ [*p, 1.0])[:3], atol=1e-9)


@given(twists(), twists(2.5), st.floats(0, 1))
def test_interpolation_runs_along_the_geodesic(a, b, alpha):
    T_0 = se3.exp(a)
    T_1 = T_0 @ se3.exp(b)
    np.testing.assert_allclose(se3.interpolate(T_0, T_1, 0.0), T_0, atol=1e-9)
    np.testing.assert_allclose(se3.interpolate(T_0, T_1, 1.0), T_1, atol=1e-6)
    np.testing.assert_allclose(
        se3.interpolate(T_0, T_1, alpha), T_0 @ se3.exp(alpha * b), atol=1e-6
    )


def test_interpolate_at_keeps_constant_velocity_inside_and_beyond():
    xi = np.array([1.0, 0.2, -0.3, 0.01, 0.05, -0.02])
    t = np.array([0.0, 1.0, 2.5])
    T = se3.exp(xi * t[:, None])
    query = np.array([-0.5, 0.0, 0.7, 1.0, 2.0, 2.5, 3.0])
    np.testing.assert_allclose(
        se3.interpolate_at(t, T, query), se3.exp(xi * query[:, None]), atol=1e-9
    )


@settings(max_examples=30)
@given(st.lists(twists(), min_size=2, max_size=4))
def test_stacks_agree_with_single_poses(xis):
    stack = np.array(xis)
    T = se3.exp(stack)
    for i, xi in enumerate(xis):
        np.testing.assert_allclose(T[i], se3.exp(xi), atol=1e-12)
        np.testing.assert_allclose(se3.inverse(T)[i], se3.inverse(T[i]), atol=1e-12)
        np.testing.assert_allclose(se3.log(T)[i], se3.log(T[i]), atol=1e-12)


@pytest.mark.parametrize("angle", [1e-8, 1e-3, 0.0316, 0.0317, 0.5, 2.5])
def test_right_jacobian_inverse_is_the_slope_of_the_log(angle):
    xi = np.array([0.4, -1.1, 0.7, 0.2, -0.5, 0.3])
    xi[3:] *= angle / np.linalg.norm(xi[3:])
    h = 1e-5
    slopes = [
        (se3.log(se3.exp(xi) @ se3.exp(d)) - se3.log(se3.exp(xi) @ se3.exp(-d))) / (2 * h)
        for d in np.eye(6) * h
    ]
    assert np.allclose(se3.right_jacobian_inverse(xi), np.stack(slopes, 1), atol=1e-6)


def test_the_mean_pose_has_no_mean_twist_and_moves_with_its_poses():
    rng = np.random.default_rng(2)
    centre = se3.exp(np.array([4.0, -2, 1, 0.5, 1.5, -1]))
    T = centre @ se3.exp(rng.normal(size=(9, 6)) * 0.2)
    mean = se3.mean(T)
    assert np.abs(se3.log(se3.inverse(mean) @ T).mean(0)).max() < 1e-12
    moved = se3.exp(np.array([1.0, 2, 3, 0.1, 0.2, 0.3]))
    assert np.allclose(se3.mean(moved @ T), moved @ mean, atol=1e-12)
    both = np.stack([T, moved @ T])
    assert np.allclose(se3.mean(both), [mean, moved @ mean], atol=1e-12)
