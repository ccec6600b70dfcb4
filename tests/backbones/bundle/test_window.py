from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle import window
from calm_edge.backbones.bundle.problem import project
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.kit.lens import Family
from calm_edge.types import Hints, Prediction
from tests.backbones.bundle.exact_window import SIZE, theta_of, turn
from tests.backbones.bundle.exact_window import window as exact_window

N = 6


def hints_of(m):
    return Hints(eyes=m.eye, t_ns=1_000_000_000 + np.round(m.t * 1e9).astype(np.int64), sizes=SIZE)


def prediction_of(made):
    state = made.truth
    cameras = layout.cameras(state.theta, SIZE)
    return Prediction(
        cameras=tuple(cameras[e] for e in made.m.eye),
        T_s_c=se3.inverse(state.T_c_s),
        landmarks=window.to_landmarks(state, made.m),
    )


def test_a_solution_becomes_the_same_problem_again():
    made = exact_window(turn(N), theta_of())
    # some far, one at infinity, one beyond it
    made.truth.points[:2, 3] = 0, -1e-9
    made.truth.points[:2] /= np.linalg.norm(made.truth.points[:2], axis=1, keepdims=True)
    uv = project(made.truth, made.m)[0]
    made = replace(made, m=replace(made.m, uv=uv))
    theta = theta_of(hfov_deg=(70.0, 60.0))
    hints = hints_of(made.m)
    m, start = window.from_prediction(prediction_of(made), hints, theta)
    for name in ("view", "point", "eye", "size"):
        assert np.array_equal(getattr(m, name), getattr(made.m, name)), name
    assert np.allclose(m.t, made.m.t, atol=1e-9)
    assert np.allclose(m.uv, made.m.uv, atol=1e-4)
    assert np.array_equal(start.theta, theta)
    assert np.allclose(start.T_c_s, made.truth.T_c_s)
    assert np.allclose(start.points, made.truth.points, atol=1e-5)
    # same pixels under the same kit, far points included
    again = replace(start, theta=made.truth.theta)
    assert np.abs(project(again, m)[0] - uv).max() < 0.01


def test_only_observations_that_fit_are_landmarks():
    made = exact_window(turn(N), theta_of())
    uv = made.m.uv.copy()
    uv[3, 0] += window.KEPT_PX - 0.05
    uv[7, 0] += window.KEPT_PX + 0.05
    marks = window.to_landmarks(made.truth, replace(made.m, uv=uv))
    assert np.array_equal(marks.uv, np.delete(uv, 7, 0).astype(np.float32))
    assert np.array_equal(marks.index, np.delete(made.m.point, 7))
    assert np.array_equal(marks.view, np.delete(made.m.view, 7))
    X = made.truth.points
    assert np.allclose(marks.points_s, X[:, :3] / X[:, 3:])


def test_sigmas_stay_with_their_observations_and_equal_ones_are_omitted():
    made = exact_window(turn(N), theta_of())
    plain = prediction_of(made)
    assert plain.landmarks.sigma_px is None
    m, _ = window.from_prediction(plain, hints_of(made.m), theta_of())
    assert (m.sigma_px == window.FOLLOWED_PX).all()
    sigma = np.linspace(0.2, 3.0, len(made.m.uv)).astype(np.float32)
    uv = made.m.uv.copy()
    uv[7] += window.KEPT_PX
    weighed = replace(made, m=replace(made.m, uv=uv, sigma_px=sigma.astype(np.float64)))
    m, _ = window.from_prediction(prediction_of(weighed), hints_of(made.m), theta_of())
    assert np.array_equal(m.sigma_px, np.delete(sigma, 7))


@pytest.mark.parametrize("missing", ["landmarks", "sizes"])
def test_a_prediction_without_landmarks_or_sizes_cannot_be_solved_again(missing):
    made = exact_window(turn(N), theta_of())
    prediction, hints = prediction_of(made), hints_of(made.m)
    if missing == "landmarks":
        prediction = replace(prediction, landmarks=None)
    else:
        hints = replace(hints, sizes=None)
    with pytest.raises(BackboneError, match="cannot be solved again"):
        window.from_prediction(prediction, hints, theta_of())


def test_thinning_keeps_the_longest_tracks_whole():
    m = exact_window(turn(N), theta_of()).m
    count = np.bincount(m.point)
    thin = window.thinned(m, 30)
    assert np.array_equal(np.unique(thin.point), np.arange(30))
    assert np.array_equal(np.sort(np.bincount(thin.point)), np.sort(count)[-30:])
    assert set(map(tuple, thin.uv)) <= set(map(tuple, m.uv))
    assert len(thin.view) == len(thin.uv) == len(thin.sigma_px) == np.sort(count)[-30:].sum()
    assert len(window.thinned(m, 10_000).uv) == len(m.uv)


def test_a_known_kit_maps_far_points_to_the_other_eye():
    theta = theta_of(rotation_deg=(3.0, -8.0, 5.0))
    far = np.array([[0.2, 0.1, 1.0], [-0.4, -0.1, 1.0], [0.0, 0.0, 1.0]])
    lenses, T_p_a = layout.cameras(theta, SIZE), layout.rig(theta)
    K_p, K_a = (camera.matrix for camera in lenses)
    seen_p, seen_a = far @ K_p.T, far @ T_p_a[:3, :3] @ K_a.T
    there = seen_p @ window._infinite_homography(lenses, T_p_a).T
    assert np.allclose(there / there[:, 2:], seen_a / seen_a[:, 2:])
    # with distortion it is near
    theta[layout.DISTORTION] = -0.1, 0.02
    lenses = layout.cameras(theta, SIZE)
    seen_p, seen_a = lenses[0].project(far), lenses[1].project(far @ T_p_a[:3, :3])
    there = np.c_[seen_p, np.ones(3)] @ window._infinite_homography(lenses, T_p_a).T
    assert np.abs(there[:, :2] / there[:, 2:] - seen_a).max() < 4.0


def test_lenses_that_do_not_show_the_whole_picture_are_refused():
    made = exact_window(turn(N), theta_of())
    assert window.lenses(made.truth, made.m) == layout.cameras(made.truth.theta, SIZE)
    cornerless = replace(made.truth, theta=made.truth.theta.copy())
    cornerless.theta[layout.DISTORTION[0]] = -0.22, 0.0
    seen = window.lenses(cornerless, made.m)[0]
    assert np.isnan(seen.rays(np.array([[0.0, 0.0]]))).all()
    # what such a corner shows is no landmark
    m = replace(made.m, uv=made.m.uv.copy())
    m.uv[0] = 0.0
    cornerless.points[m.point[0]] = np.linalg.inv(cornerless.T_c_s[m.view[0]]) @ [-9, -3.4, 9, 0]
    cornerless.points[m.point[0]] /= np.linalg.norm(cornerless.points[m.point[0]])
    assert not (window.to_landmarks(cornerless, m).uv == 0).all(1).any()
    folding = replace(made.truth, theta=made.truth.theta.copy())
    folding.theta[layout.DISTORTION[0]] = -0.9, 0.0
    too_wide = replace(made.truth, theta=made.truth.theta.copy())
    too_wide.theta[layout.FAMILY], too_wide.theta[layout.LOG_FOCAL] = Family.FISHEYE, np.log(0.3)
    for state in (folding, too_wide):
        with pytest.raises(BackboneError, match=r"^bundle: .*lens"):
            window.lenses(state, made.m)


T_NS = np.array([0, 200, 400, 17, 217]) * 1_000_000


@pytest.mark.parametrize(
    ("eyes", "t_ns"),
    [
        ([1, 0, 0, 0, 1], T_NS),
        ([0, 0, 1, 0, 1], T_NS),
        ([0, 0, 0, 1, 1], T_NS[[1, 0, 2, 3, 4]]),
        ([0, 0, 0, 1, 1], T_NS[[0, 0, 2, 3, 4]]),
    ],
    ids=["assistant first", "mixed", "back in time", "twice"],
)
def test_views_out_of_order_raise(eyes, t_ns):
    with pytest.raises(BackboneError, match=r"^bundle: pictures must be in order"):
        window.split_eyes(Hints(eyes=np.array(eyes), t_ns=t_ns))


@pytest.mark.parametrize("eyes", [[0, 1, 1], [0, 0, 0]])
def test_both_eyes_are_needed(eyes):
    with pytest.raises(BackboneError, match="two primary pictures and one of the assistant"):
        window.split_eyes(Hints(eyes=np.array(eyes), t_ns=T_NS[:3]))


def test_too_few_points_are_counted():
    """A dozen blobs on black: each is followed, but they are no scene."""
    picture = np.zeros((128, 320, 3), np.uint8)
    for u in range(30, 300, 45):
        for v in (40, 88):
            picture[v : v + 7, u : u + 7] = 255
    hints = Hints(eyes=np.array([0, 0, 0, 1, 1]), t_ns=T_NS)
    with pytest.raises(BackboneError, match=r"^bundle: only (\d+) points could be foll") as error:
        window.with_enough_views(
            window.measure([picture] * 5, hints, [theta_of()], rig_known=False)
        )
    assert 5 < int(str(error.value).split()[2]) < window.MIN_POINTS


def test_landmarks_lie_where_they_would_without_sliding_along_edges():
    made = exact_window(turn(N), theta_of())
    edge = np.zeros_like(made.m.uv)
    edge[3] = edge[7] = [0.6, 0.8]
    uv = made.m.uv.copy()
    uv[3] += 20 * edge[3]
    uv[7] += [8.0, -6.0]
    slid = replace(made.m, uv=uv, edge=edge)
    marks = window.to_landmarks(made.truth, slid)
    assert np.allclose(marks.uv, np.delete(made.m.uv, 7, 0), atol=1e-3)
    prediction = replace(prediction_of(made), landmarks=marks)
    m, _ = window.from_prediction(prediction, hints_of(made.m), made.truth.theta)
    assert np.allclose(m.edge, np.delete(edge, 7, 0))


def test_thinning_prefers_points_that_are_corners():
    made = exact_window(turn(N), theta_of())
    first = np.flatnonzero(made.m.point == np.bincount(made.m.point).argmax())
    edge = np.zeros_like(made.m.uv)
    edge[first] = [1.0, 0.0]
    uv = made.m.uv[first]
    corners, lines = window.thinned(made.m, 10), window.thinned(replace(made.m, edge=edge), 10)
    assert len(lines.edge) == len(lines.uv) and corners.edge is None
    assert all((corners.uv == each).all(1).any() for each in uv)
    assert not any((lines.uv == each).all(1).any() for each in uv)
