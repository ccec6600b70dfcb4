import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from calm_edge.correction import pose_model
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective

EYE = np.eye(3)
vectors = st.tuples(*[st.floats(-3, 3) for _ in range(3)]).map(np.array)
rotations = st.tuples(*[st.floats(-0.4, 0.4) for _ in range(3)]).map(
    lambda w: se3.so3_exp(np.array(w))
)
scalings = st.tuples(st.floats(0.7, 1.4), st.floats(0.7, 1.4)).map(lambda s: np.diag([*s, 1.0]))


def degrees_between(R_1, R_2):
    return np.degrees(np.linalg.norm(se3.so3_log(R_1.T @ R_2)))


def angle(t_1, t_2):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(t_1, t_2)), t_1 @ t_2))


def best_under_wrong_focal(x_a, x_b, T_start):
    """R and unit t that minimise the Sampson distances of matches (N, 3)."""
    t_0, R_0 = T_start[:3, 3] / np.linalg.norm(T_start[:3, 3]), T_start[:3, :3]
    tangent = np.linalg.svd(t_0[None])[2][1:]

    def pose(p):
        t = t_0 + p[:2] @ tangent
        return se3.so3_exp(p[2:]) @ R_0, t / np.linalg.norm(t)

    def sampson(p):
        R, t = pose(p)
        E = se3.hat(t) @ R
        l_a, l_b = x_b @ E.T, x_a @ E
        gradient = np.sqrt((l_a[:, :2] ** 2).sum(1) + (l_b[:, :2] ** 2).sum(1))
        return (x_a * l_a).sum(1) / gradient

    return pose(least_squares(sampson, np.zeros(5), xtol=1e-15, ftol=1e-15, gtol=1e-15).x)


def errors(ratios, yaw_deg, t, seed):
    """Errors [deg] of rotation and translation: estimated, corrected, with the opposite sign."""
    rng = np.random.default_rng(seed)
    R = se3.so3_exp(np.radians([rng.normal(), yaw_deg, rng.normal()]))
    p_b = rng.uniform([-8, -3, 5], [8, 3, 30], (200, 3))
    p_a = p_b @ R.T + t
    S = np.diag([*ratios, 1.0])
    S_inverse = np.linalg.inv(S)
    rays = [(p / p[:, 2:]) @ S_inverse for p in (p_a, p_b)]
    R_est, t_est = best_under_wrong_focal(*rays, se3.compose(R, t))
    flipped = se3.so3_exp(pose_model.rotation_error(t_est, R_est, S)) @ R_est
    return {
        "R estimated": degrees_between(R, R_est),
        "R corrected": degrees_between(R, pose_model.corrected_rotation(t_est, R_est, S)),
        "R flipped": degrees_between(R, flipped),
        "t estimated": angle(t, t_est),
        "t simple": angle(t, pose_model.translation_simple(t_est, S)),
        "t general": angle(t, pose_model.translation_general(t_est, R_est, S)),
        "t flipped": angle(t, S_inverse @ t_est),
    }


def mean_errors(ratios, t):
    """Mean of `errors` over four scenes and motions, turning left and right."""
    runs = [errors(ratios, yaw, np.array(t), seed) for yaw in (-5, 5) for seed in range(4)]
    return {name: np.mean([run[name] for run in runs]) for name in runs[0]}


@pytest.mark.parametrize("ratios", [(1.15, 1.20), (1.15, 1.15), (0.85, 0.85), (1.04, 1.04)])
def test_forward_motion_is_corrected_and_the_opposite_sign_doubles_the_error(ratios):
    error = mean_errors(ratios, [0.1, 0.02, 1.0])
    size = abs(ratios[0] - 1) / 0.15
    assert error["R estimated"] > 0.6 * size
    assert error["R corrected"] < 0.06 * error["R estimated"]
    assert error["R flipped"] == pytest.approx(2 * error["R estimated"], rel=0.02)
    assert error["t estimated"] > 0.6 * size
    assert error["t simple"] < 0.5 * error["t estimated"]
    # the general form assumes a correct rotation, so its error is larger otherwise
    assert error["t simple"] < error["t general"] < error["t estimated"]
    assert error["t flipped"] > 1.75 * error["t estimated"]


def test_sideways_motion_is_partly_corrected():
    error = mean_errors((1.15, 1.15), [1.0, 0.0, 0.05])
    assert error["R corrected"] < 0.4 * error["R estimated"]
    assert error["t general"] < 0.7 * error["t estimated"]
    assert error["t general"] < error["t simple"]


@given(vectors, scalings)
def test_without_rotation_the_general_form_is_the_simple_one(t, S):
    expected = [S[0, 0] * t[0], S[1, 1] * t[1], t[2]]
    assert np.allclose(pose_model.translation_simple(t, S), expected, atol=1e-12)
    assert np.allclose(pose_model.translation_general(t, EYE, S), expected, atol=1e-12)
    assert np.allclose(pose_model.corrected_rotation(t, EYE, S), EYE, atol=1e-12)


@given(vectors, scalings)
def test_the_general_form_is_continuous_in_rotation_even_where_nothing_moves_forward(t, S):
    t[2] = 0
    for tilt in (1e-6, 1e-9):
        R = se3.so3_exp(np.array([tilt, -tilt, tilt]))
        general = pose_model.translation_general(t, R, S)
        assert np.allclose(general, S @ t, atol=20 * tilt, rtol=0)


@given(vectors, rotations, scalings)
def test_the_correction_does_not_depend_on_the_length_of_t(t, R, S):
    general = pose_model.translation_general(t, R, S)
    assert np.allclose(pose_model.translation_general(2.5 * t, R, S), 2.5 * general, atol=1e-12)
    theta = pose_model.rotation_error(t, R, S)
    assert abs(theta @ t) < 1e-12
    # no underflow for t shorter by a hundred orders of magnitude
    if np.linalg.norm(t) > 1e-50:
        assert np.allclose(pose_model.rotation_error(1e-100 * t, R, S), theta, atol=1e-9)


@given(vectors, rotations)
def test_a_correct_focal_changes_nothing(t, R):
    assert np.allclose(pose_model.translation_simple(t, EYE), t, atol=0)
    assert np.allclose(pose_model.translation_general(t, R, EYE), t, atol=1e-12)
    assert np.allclose(pose_model.corrected_rotation(t, R, EYE), R, atol=1e-15)


@given(rotations, scalings)
def test_without_translation_the_rotation_is_kept(R, S):
    assert np.array_equal(pose_model.rotation_error(np.zeros(3), R, S), np.zeros(3))
    assert np.allclose(pose_model.corrected_rotation(np.zeros(3), R, S), R, atol=1e-15)
    assert np.array_equal(pose_model.translation_general(np.zeros(3), R, S), np.zeros(3))


def test_stacks_are_corrected_like_single_poses():
    rng = np.random.default_rng(4)
    t, R = rng.normal(size=(2, 5, 3)), se3.so3_exp(rng.normal(size=(2, 5, 3)))
    t[1, 2] = 0
    S = EYE + rng.uniform(-0.2, 0.2, (5, 1, 1)) * np.diag([1, 1.1, 0])
    together = pose_model.translation_general(t, R, S), pose_model.corrected_rotation(t, R, S)
    for i in np.ndindex(2, 5):
        assert np.allclose(together[0][i], pose_model.translation_general(t[i], R[i], S[i[1]]))
        assert np.allclose(together[1][i], pose_model.corrected_rotation(t[i], R[i], S[i[1]]))


ESTIMATED = Perspective(600, 660, 330, 240, 640, 480), Perspective(400, 410, 300, 200, 640, 480)
HELD = Perspective(500, 600, 310, 250, 640, 480), Perspective(440, 410, 300, 200, 640, 480)


def test_the_scaling_is_the_ratio_of_focals_with_linear_damping():
    cases = [(1.0, 0, [1.2, 1.1, 1]), (1.0, 1, [1 / 1.1, 1, 1])]
    cases += [(0.5, 0, [1.1, 1.05, 1]), (0.2, 1, [1 - 0.2 / 11, 1, 1]), (0.0, 0, [1, 1, 1])]
    for damping, eye, expected in cases:
        S = pose_model.damped_scaling(ESTIMATED[eye], HELD[eye], damping)
        assert np.allclose(S, np.diag(expected), atol=1e-15)


def test_the_effective_focal_lies_between_and_the_principal_point_stays():
    for estimated, held in zip(ESTIMATED, HELD, strict=True):
        for damping in (0.0, 0.3, 1.0):
            S = pose_model.damped_scaling(estimated, held, damping)
            effective = pose_model.effective_camera(estimated, S)
            assert (effective.cx, effective.cy) == (estimated.cx, estimated.cy)
            delta = estimated.fx / held.fx - 1
            assert effective.fx == pytest.approx(estimated.fx / (1 + damping * delta))
        assert (effective.fx, effective.fy) == pytest.approx((held.fx, held.fy))
