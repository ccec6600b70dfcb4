from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.bundle import problem
from calm_edge.backbones.bundle.problem import State
from calm_edge.backbones.bundle.solver import solve
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.kit.lens import Family
from tests.backbones.bundle.exact_window import PERIOD_S, perturbed, theta_of, turn, window

H = 1e-6


@pytest.fixture(scope="module", params=[layout.PERSPECTIVE, (Family.FISHEYE, Family.PERSPECTIVE)])
def seen(request):
    """A window with lenses, off-centre optics and some points at or beyond infinity."""
    theta = theta_of(radial=(0.06, -0.04))
    theta[layout.DISTORTION[:, 1]] = -0.02, 0.03
    theta[layout.FAMILY] = request.param
    made = window(turn(4), theta, n_points=60)
    state = perturbed(made.truth)
    state.theta[layout.PRINCIPAL_POINT] = [0.01, -0.02], [0.015, 0.005]
    far = np.argsort(np.abs(state.points[:, 3]))[:4]
    state.points[far, 3] = [0, 0, -1e-4, 1e-5]
    state.points[:] /= np.linalg.norm(state.points, axis=1, keepdims=True)
    return made.m, state


def central_difference(stepped, m, size):
    """Derivative (O, 2, size) of the pixels along each axis of `stepped`(vector)."""
    columns = []
    for axis in np.eye(size):
        high, low = (problem.project(stepped(sign * H * axis), m)[0] for sign in (1, -1))
        columns.append((high - low) / (2 * H))
    return np.stack(columns, -1)


def assert_jacobian(analytic, numeric):
    """analytic: (size, 2, O), numeric: (O, 2, size)."""
    analytic = analytic.transpose(2, 1, 0)
    assert analytic.shape == numeric.shape
    assert np.abs(analytic - numeric).max() < 1e-6 * np.abs(numeric).max()


def test_pixels_by_pose(seen):
    m, state = seen
    basis = problem.tangent_basis(state.points)
    numeric = central_difference(lambda d: replace(state, T_c_s=se3.exp(d) @ state.T_c_s), m, 6)
    assert_jacobian(problem.reprojection(state, m, basis).camera[:6], numeric)


def test_pixels_by_the_terms_of_an_eye(seen):
    m, state = seen
    basis = problem.tangent_basis(state.points)

    def stepped(d):
        theta = state.theta.copy()
        theta[layout.EYE] += d
        return replace(state, theta=theta)

    numeric = central_difference(stepped, m, layout.EYE.shape[1])
    assert_jacobian(problem.reprojection(state, m, basis).camera[6:], numeric)


def rolling(T_s_p, theta, twist, readout_s):
    """Pixels of a window on a path of constant twist [per s], each row at its own instant."""
    made = window(T_s_p, theta, n_points=60, delay_s=0.0)
    m = made.m
    lenses = layout.cameras(theta, m.size)
    uv = m.uv.copy()
    for row, (view, point) in enumerate(zip(m.view, m.point, strict=True)):
        eye = m.eye[view]
        for _ in range(8):
            late = readout_s[eye] * (uv[row, 1] / (m.size[eye, 1] - 1) - 0.5)
            T_p_s = se3.inverse(se3.exp(twist * (m.t[view] + late)))
            T_c_s = T_p_s if eye == 0 else se3.inverse(layout.rig(theta)) @ T_p_s
            uv[row] = lenses[eye].project((T_c_s @ made.truth.points[point])[:3])
    return replace(m, uv=uv), made.truth


def test_a_rolling_shutter_sees_each_row_at_its_own_instant():
    twist = np.array([0.4, 0.1, 9.0, 0.05, 0.25, 0.02])
    T_s_p = se3.exp(twist * PERIOD_S * np.arange(5)[:, None])
    readout_s, theta = (0.03, 0.018), theta_of(radial=(-0.1, -0.05))
    m, truth = rolling(T_s_p, theta, twist, readout_s)
    still, _ = problem.project(truth, m)
    theta[layout.READOUT] = readout_s
    moved, _ = problem.project(replace(truth, theta=theta), m)
    assert np.percentile(np.linalg.norm(still - m.uv, axis=1), 90) > 1.0
    # what is left is of second order in the readout time
    assert np.linalg.norm(moved - m.uv, axis=1).max() < 0.05


def test_a_window_shows_the_difference_of_the_readout_times():
    twist = np.array([0.4, 0.1, 9.0, 0.05, 0.25, 0.02])
    T_s_p = se3.exp(twist * PERIOD_S * np.arange(6)[:, None])
    m, truth = rolling(T_s_p, theta_of(), twist, (0.03, 0.018))
    found = solve(truth, m, problem.rig_ties(m), layout.prior((76.0, 66.0)), max_iterations=20)
    # what both have in common is hardly seen at a constant velocity, since all pictures are read
    # out in one direction (Albl et al., Degeneracies in Rolling Shutter SfM, ECCV 2016)
    primary, assistant = found.state.theta[layout.READOUT]
    assert primary - assistant == pytest.approx(0.012, abs=5e-4)
    assert abs(primary - 0.03) < abs(layout.READOUT_S - 0.03)


@pytest.mark.parametrize("eye_of", [[0, 0, 0, 0, 1, 1], [0, 0, 0, 0, 0, 1]])
def test_view_rates_are_exact_for_a_constant_acceleration(eye_of):
    made = window(turn(3), theta_of(), n_points=30).m
    t = np.array([0.0, 0.2, 0.5, 0.6, 0.1, 0.3])
    m = replace(made, eye=np.array(eye_of), t=t if eye_of[4] else np.sort(t))
    T_c_s = se3.exp(np.outer(1.5 * m.t + 2.0 * m.t**2, [0, 0, 0, 0, 0.1, 0]))
    rate = problem.view_rates(T_c_s, m)
    several = np.array([np.sum(m.eye == eye) > 2 for eye in m.eye])
    assert np.allclose(rate[several, 4], 0.1 * (1.5 + 4.0 * m.t[several]))
    alone = np.array([np.sum(m.eye == eye) == 1 for eye in m.eye])
    assert not rate[alone].any()


def test_pixels_by_point_tangent(seen):
    m, state = seen
    basis = problem.tangent_basis(state.points)

    def stepped(d):
        every = np.broadcast_to(d, (len(state.points), 3))
        return replace(state, points=problem.move_points(state.points, basis, every))

    numeric = central_difference(stepped, m, 3)
    assert_jacobian(problem.reprojection(state, m, basis).point, numeric)


def test_pixels_are_those_of_the_cameras(seen):
    m, state = seen
    p_c, cameras = problem.camera_points(state, m).T, layout.cameras(state.theta, m.size)
    front = p_c[:, 2] > 0.1
    expected = [cameras[eye].project(p) for eye, p in zip(m.eye[m.view], p_c, strict=True)]
    assert np.allclose(problem.project(state, m)[0][front], np.array(expected)[front])


def test_without_distortion_pixels_are_a_pinholes():
    made = window(turn(3), theta_of(), n_points=30)
    uv, z = problem.project(made.truth, made.m)
    p_c = problem.camera_points(made.truth, made.m).T
    right = made.m.eye[made.m.view] == 1
    K = layout.camera(made.truth.theta, 1, 480, 200).matrix
    expected = (p_c[right] / p_c[right, 2:]) @ K.T
    assert np.allclose(uv[right], expected[:, :2]) and np.array_equal(z, p_c[:, 2])
    assert np.allclose(made.m.uv, uv)


def test_a_radial_term_pushes_pixels_out_by_the_square_of_their_radius():
    m = window(turn(3), theta_of(), n_points=30).m
    flat, bent = (window(turn(3), theta_of(radial=(k, 0)), n_points=30).truth for k in (0, 0.1))
    bent = replace(bent, points=flat.points, T_c_s=flat.T_c_s)
    left = m.eye[m.view] == 0
    K = layout.camera(flat.theta, 0, 640, 240).matrix
    before = (problem.project(flat, m)[0] - K[:2, 2]) / K[0, 0]
    after = (problem.project(bent, m)[0] - K[:2, 2]) / K[0, 0]
    r2 = (before**2).sum(1, keepdims=True)
    assert np.allclose(after[left], (before * (1 + 0.1 * r2))[left])
    assert np.allclose(after[~left], before[~left])


@pytest.mark.parametrize(
    "points",
    [
        [[0, 0, 0, 1.0]],
        [[0, 0, 0, -1.0]],
        [[0, 0, 1.0, 0]],
        [[0.6, 0, 0.8, -0.0]],
        np.random.default_rng(0).normal(size=(20, 4)),
    ],
    ids=["near", "beyond", "far", "far aside", "any"],
)
def test_tangent_bases_are_orthonormal(points):
    points = np.array(points, float)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    whole = np.concatenate([problem.tangent_basis(points), points[:, :, None]], 2)
    assert np.allclose(whole.transpose(0, 2, 1) @ whole, np.eye(4), atol=1e-12)


def test_a_far_point_passes_through_infinity_smoothly():
    made = window(turn(4), theta_of(), n_points=40)
    points = np.tile([0.1, 0.0, 1.0, 0.0], (len(made.truth.points), 1))
    pixels = []
    for w in (2e-6, 0.0, -2e-6):
        points[:, 3] = w
        state = replace(made.truth, points=points / np.linalg.norm(points, axis=1, keepdims=True))
        jac = problem.reprojection(state, made.m, problem.tangent_basis(state.points))
        assert jac.in_front.all()
        pixels.append(jac.predicted)
    assert np.allclose(pixels[0] - pixels[1], pixels[1] - pixels[2], atol=1e-6)
    assert 0 < np.abs(pixels[0] - pixels[1]).max() < 0.1


def test_a_point_behind_its_view_is_marked():
    made = window(turn(4), theta_of(), n_points=40)
    behind = made.m.point == 0
    made.truth.points[0] *= -1
    jac = problem.reprojection(made.truth, made.m, problem.tangent_basis(made.truth.points))
    assert np.array_equal(jac.in_front, ~behind)


def residuals(state: State, ties):
    T = state.T_c_s
    views = T[ties.before], T[ties.after], T[ties.assistant]
    return problem.tie_residuals(
        *views, layout.rig(state.theta), state.theta[layout.TIME_OFFSET], ties
    )


@pytest.mark.parametrize("delay_s", [0.0, 0.017, 0.12, -0.05])
def test_ties_vanish_on_a_rig_that_follows_the_geodesic(delay_s):
    made = window(turn(5), theta_of(), n_points=10, delay_s=delay_s)
    ties = made.ties
    assert np.array_equal(ties.assistant, np.arange(5, 10))
    assert np.abs(residuals(made.truth, ties)).max() < 1e-7
    # an interpolated tie is a softer one
    at_rest = problem.rig_ties(window(turn(5), theta_of(), n_points=10, delay_s=0.0).m)
    softer = (ties.information_root < at_rest.information_root).all()
    assert softer == (delay_s != 0)


def test_a_tie_softens_with_the_error_of_constant_velocity():
    m = window(turn(3), theta_of(), n_points=10, delay_s=0.1).m
    # a third of the way through 0.3 s: 0.33 x 0.67 / 2 x 0.09 s^2, the last one beyond the end
    bend = np.array([0.01, 0.01, 0.02])
    ties = problem.rig_ties(m)
    assert ties.alpha == pytest.approx([1 / 3, 1 / 3, 4 / 3])
    assert np.array_equal(ties.before, [0, 1, 1]) and np.array_equal(ties.after, [1, 2, 2])
    sigma = 1 / ties.information_root
    assert np.allclose(sigma[:, :3], np.hypot(2e-3, 3.0 * bend)[:, None])
    assert np.allclose(sigma[:, 3:], np.hypot(1e-4, 0.3 * bend)[:, None])


def test_a_tie_measures_how_far_the_assistant_is_off_its_rig():
    made = window(turn(4), theta_of(), n_points=10)
    ties, T = made.ties, made.truth.T_c_s.copy()
    off = np.array([0.01, -0.02, 0.005, 0.002, 0.001, -0.003])
    T[5] = se3.exp(-off) @ T[5]
    found = residuals(replace(made.truth, T_c_s=T), ties) / ties.information_root
    assert np.allclose(found, np.outer(np.arange(4) == 1, off), atol=1e-9)


def test_tie_derivatives_predict_the_residual_of_a_step():
    made = window(turn(4), theta_of(), n_points=10)
    ties, state = made.ties, perturbed(made.truth, pose=0.003)
    residual, J = problem.tie_jacobians(state, ties)
    assert J.shape == (4, 6, 25)
    assert np.allclose(residual, residuals(state, ties))
    rng = np.random.default_rng(2)
    by_view, by_rig = 1e-5 * rng.normal(size=(8, 6)), 1e-5 * rng.normal(size=7)
    theta = state.theta.copy()
    theta[layout.RIG] += by_rig[:6]
    theta[layout.TIME_OFFSET] += by_rig[6]
    stepped = State(se3.exp(by_view) @ state.T_c_s, state.points, theta)
    step = np.concatenate(
        [by_view[ties.before], by_view[ties.after], by_view[ties.assistant],
         np.tile(by_rig, (4, 1))], 1,
    )  # fmt: skip
    change = residuals(stepped, ties) - residual
    assert np.allclose((J @ step[..., None])[..., 0], change, atol=2e-3 * np.abs(change).max())
