from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix

from calm_edge.config import CorrectionConfig
from calm_edge.correction import pose_model, rectify
from calm_edge.correction.rectify import rectified
from calm_edge.estimator import scale
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.types import GlobalIntrinsics, Submap

N = 7
FOCAL = 500.0
PERIOD_NS = 300_000_000
LATE_NS = 130_000_000
T_P_A = se3.exp(np.array([0.99, 0.03, 0.1, 0.02, -0.05, 0.02]))
CONFIG = CorrectionConfig()
# the paper's correction only
PLAIN = replace(CONFIG, general_translation=True, rigid_rig=False)
TRUE = Perspective(FOCAL, FOCAL, 320.0, 240.0, 640, 480)


def path():
    """T_s_p (N, 4, 4): steps of three spacings, turning by about 28 degrees in total."""
    k = np.arange(N - 1)
    zero = np.zeros(N - 1)
    yaw = 0.07 * (1 + np.sin(1.3 * k))
    steps = np.stack([0.1 * np.sin(k), zero, 3.0 + zero, 0.007 * np.cos(1.7 * k), yaw, zero], -1)
    T = [np.eye(4)]
    for step in se3.exp(steps):
        T.append(T[-1] @ step)
    return np.array(T)


def truth(late_ns):
    """Stamps (2N + 1,) and T_s_c of primary, assistant, and a loop view beside the fourth view."""
    T_s_p, t_p = path(), np.arange(N) * PERIOD_NS
    T_s_a = se3.interpolate_at(t_p.astype(float), T_s_p, t_p + float(late_ns)) @ T_P_A
    loop = T_s_p[3] @ se3.exp(np.array([0.7, 0.05, 0.6, 0, 0.05, 0]))
    t_ns = np.concatenate([t_p, t_p + late_ns, [-(10**12)]])
    return t_ns, np.concatenate([T_s_p, T_s_a, loop[None]])


@cache
def estimated_under(ratio, late_ns):
    """T_s_c (2N + 1, 4, 4) by bundle adjustment of exact pixels with focals wrong by `ratio`.

    Poses and points are free, the focals and the first view fixed.
    """
    rng = np.random.default_rng(0)
    _, T_s_c = truth(late_ns)
    near = np.repeat(np.arange(N), 12)
    p_c = rng.uniform([-8, -3, 6], [8, 3, 30], (len(near), 3))
    p_s = np.stack([se3.transform(T_s_c[i], p) for i, p in zip(near, p_c, strict=True)])
    T_c_s = se3.inverse(T_s_c)

    def camera_points(T_c_s, p_s, view, point):
        return (T_c_s[view, :3, :3] @ p_s[point, :, None])[..., 0] + T_c_s[view, :3, 3]

    view, point = (index.ravel() for index in np.indices((len(T_s_c), len(p_s))))
    q = camera_points(T_c_s, p_s, view, point)
    seen = (q[:, 2] > 1) & (np.abs(q[:, :2]) < q[:, 2:]).all(1)
    view, point, q = view[seen], point[seen], q[seen]
    rays = q[:, :2] / q[:, 2:] / ratio
    n_poses = 6 * (len(T_s_c) - 1)

    def unpacked(x):
        twists = np.concatenate([np.zeros((1, 6)), x[:n_poses].reshape(-1, 6)])
        return se3.exp(twists) @ T_c_s, p_s + x[n_poses:].reshape(-1, 3)

    def residuals(x):
        q = camera_points(*unpacked(x), view, point)
        return FOCAL * (q[:, :2] / q[:, 2:] - rays).ravel()

    sparsity = lil_matrix((2 * len(view), n_poses + p_s.size), dtype=int)
    for row, (i, j) in enumerate(zip(view, point, strict=True)):
        if i > 0:
            sparsity[2 * row : 2 * row + 2, 6 * (i - 1) : 6 * i] = 1
        sparsity[2 * row : 2 * row + 2, n_poses + 3 * j : n_poses + 3 * j + 3] = 1
    start = np.zeros(sparsity.shape[1])
    solution = least_squares(residuals, start, jac_sparsity=sparsity, x_scale="jac", max_nfev=60)
    return se3.inverse(unpacked(solution.x)[0])


def raw_submap(T_s_c, t_ns, ratio=1.0):
    cameras = (TRUE.with_focal(ratio * FOCAL),) * len(T_s_c)
    return Submap(
        id=0,
        primary_ids=tuple(range(N)),
        assistant_ids=tuple(range(N)),
        n_overlap=0,
        t_ns=t_ns,
        T_s_c_raw=T_s_c,
        cameras_raw=cameras,
        T_s_c=T_s_c,
        cameras=cameras,
        scale=1.0,
        T_w_s=np.eye(4),
        focal_log_sigma=np.ones(2),
    )


def optics_of(camera):
    return camera.fx, camera.fy, camera.cx, camera.cy


def optics(submap):
    """fx, fy, cx, cy (V, 4) of the views."""
    return np.array([optics_of(camera) for camera in submap.cameras])


def held_true(damping=(1.0, 1.0)):
    """The true intrinsics with the given damping."""
    return GlobalIntrinsics(
        cameras=(TRUE, TRUE),
        damping=np.array(damping),
        focal_log_sigma=np.full(2, 0.01),
    )


def spacings_a_path(submap):
    """Camera spacing over the length of the primary path, which determines its scale."""
    T, t_ns = submap.T_s_c, submap.t_ns
    spacing = scale.spacing(scale.rig_samples(t_ns[:N], T[:N], t_ns[N : 2 * N], T[N : 2 * N]))
    return spacing / np.linalg.norm(np.diff(T[:N, :3, 3], axis=0), axis=1).sum()


def placed_errors(submap, T_true):
    """Errors (2N + 1,) in spacings and degrees, after scaling by the camera spacing."""
    T = scale.rectify(submap, float(np.linalg.norm(T_P_A[:3, 3]))).T_s_c
    turned = se3.so3_log(np.swapaxes(T_true[:, :3, :3], -1, -2) @ T[:, :3, :3])
    apart = np.linalg.norm((T - T_true)[:, :3, 3], axis=1)
    return apart, np.degrees(np.linalg.norm(turned, axis=1))


@pytest.mark.parametrize("general", [True, False])
@pytest.mark.parametrize("late_ns", [0, LATE_NS])
@pytest.mark.parametrize("ratio", [1.15, 0.88])
def test_trajectory_and_spacing_are_corrected_for_a_wrong_focal(ratio, late_ns, general):
    t_ns, T_true = truth(late_ns)
    raw = raw_submap(estimated_under(ratio, late_ns), t_ns, ratio)
    config = replace(CONFIG, general_translation=general)
    out = rectified(raw, held_true(), config)
    right = spacings_a_path(raw_submap(T_true, t_ns))
    # a focal error changes the spacing, not the forward motion
    assert spacings_a_path(raw) / right == pytest.approx(1 / ratio, rel=0.015)
    assert spacings_a_path(out) / right == pytest.approx(1, abs=0.025)
    (far, off), (far_out, off_out) = placed_errors(raw, T_true), placed_errors(out, T_true)
    assert far[:N].max() > 2.0 and off[:N].max() > 3.0
    assert far_out.max() < 0.2 * far.max()
    assert off_out.max() < 0.2 * off.max()
    # the loop view stays beside the fourth view
    near = (se3.inverse(T[3]) @ T[-1] for T in (out.T_s_c, T_true))
    assert np.linalg.norm(np.subtract(*(T[:3, 3] for T in near))) < 0.05
    assert np.allclose(optics(out), optics_of(TRUE))
    assert out.scale == 1.0 and np.array_equal(out.T_s_c_raw, raw.T_s_c_raw)
    assert np.array_equal(out.T_s_c[0], raw.T_s_c[0])


@pytest.mark.parametrize("late_ns", [0, LATE_NS])
@pytest.mark.parametrize("ratio", [1.15, 0.88])
def test_the_rotation_between_the_cameras_is_corrected_along_the_travel(ratio, late_ns):
    t_ns, _ = truth(late_ns)
    raw = raw_submap(estimated_under(ratio, late_ns), t_ns, ratio)

    def rig(submap):
        T = submap.T_s_c
        return scale.rig_samples(t_ns[:N], T[:N], t_ns[N : 2 * N], T[N : 2 * N])

    def off(R):
        return np.degrees(np.linalg.norm(se3.so3_log(T_P_A[:3, :3].T @ R).mean(0)))

    R, t = rig(raw)[:, :3, :3], rig(raw)[:, :3, 3]
    S = pose_model.damped_scaling(raw.cameras[0], TRUE, 1.0)
    assert off(rig(rectified(raw, held_true(), CONFIG))[:, :3, :3]) < 0.25 * off(R)
    assert off(pose_model.corrected_rotation(t, R, S)) == pytest.approx(2 * off(R), rel=0.1)


def test_rotation_and_translation_correction_each_reduce_the_error():
    t_ns, T_true = truth(LATE_NS)
    raw = raw_submap(estimated_under(1.15, LATE_NS), t_ns, 1.15)
    turned = rectified(raw, held_true(), replace(PLAIN, translation=False))
    moved = rectified(raw, held_true(), replace(PLAIN, rotation=False))
    apart, off = placed_errors(raw, T_true)
    assert placed_errors(turned, T_true)[1].max() < 0.2 * off.max()
    assert spacings_a_path(turned) == pytest.approx(spacings_a_path(raw), rel=0.01)
    assert placed_errors(moved, T_true)[0].max() < 0.5 * apart.max()
    assert np.allclose(moved.T_s_c[:N, :3, :3], raw.T_s_c[:N, :3, :3], atol=1e-12)
    neither = rectified(raw, held_true(), replace(PLAIN, rotation=False, translation=False))
    assert np.allclose(neither.T_s_c, raw.T_s_c, atol=1e-12)
    assert np.allclose(optics(neither), optics_of(TRUE))


def test_the_correction_and_the_focal_change_with_damping():
    t_ns, T_true = truth(LATE_NS)
    raw = raw_submap(estimated_under(1.15, LATE_NS), t_ns, 1.15)
    assert rectified(raw, held_true((0.0, 0.0)), CONFIG) is raw
    runs = [rectified(raw, held_true((d, d)), CONFIG) for d in (0.0, 0.3, 0.7, 1.0)]
    worst = [placed_errors(run, T_true)[0].max() for run in runs]
    assert worst == sorted(worst, reverse=True)
    for run, damping in zip(runs, (0.0, 0.3, 0.7, 1.0), strict=True):
        assert np.allclose(optics(run)[:, 0], 1.15 * FOCAL / (1 + damping * 0.15))
        assert np.allclose(optics(run)[:, 2:], optics(raw)[:, 2:])


def test_each_camera_has_its_intrinsics_and_the_loop_view_those_of_the_primary():
    t_ns, T = truth(0)
    cameras = replace(TRUE, fx=400.0), replace(TRUE, fx=625.0)
    intrinsics = replace(held_true((1.0, 0.5)), cameras=cameras)
    out = rectified(raw_submap(T, t_ns), intrinsics, replace(CONFIG, general_translation=False))
    assert np.allclose(optics(out)[[0, -1], 0], 400)
    assert np.allclose(optics(out)[N : 2 * N, 0], 500 / 0.9)
    # s_x: 1.25 of the primary, 0.9 of the assistant, 1.075 of their mean
    T_p_a = se3.inverse(out.T_s_c[:N]) @ out.T_s_c[N : 2 * N]
    assert np.allclose(T_p_a[:, :3, 3], [1.075, 1, 1] * T_P_A[:3, 3])
    expected = (se3.inverse(T[3]) @ T[-1])[:3, 3]
    T_3_loop = se3.inverse(out.T_s_c[3]) @ out.T_s_c[-1]
    assert np.allclose(T_3_loop[:3, 3], [1.25, 1, 1] * expected)


@pytest.mark.parametrize("late_ns", [10**12, -(10**12)])
def test_assistant_stamps_outside_the_window_use_the_nearest_end(late_ns):
    t_ns, T = truth(0)
    t_ns = t_ns + np.repeat([0, late_ns, 0], [N, N, 1])
    out = rectified(raw_submap(T, t_ns, 1.2), held_true(), replace(PLAIN, rotation=False))
    end = N - 1 if late_ns > 0 else 0
    T_ref_a = se3.inverse(T[end]) @ T[N : 2 * N]
    expected = rectified_motion(T_ref_a, 1.2)
    assert np.allclose(se3.inverse(out.T_s_c[end]) @ out.T_s_c[N : 2 * N], expected, atol=1e-9)


def rectified_motion(T_a_b, ratio):
    S = np.diag([ratio, ratio, 1.0])
    R, t = T_a_b[..., :3, :3], T_a_b[..., :3, 3]
    return se3.compose(R, pose_model.translation_general(t, R, S))


def test_invalid_stamps_do_not_prevent_the_correction():
    t_ns, T = truth(0)
    t_ns[N - 1] = t_ns[N - 2]
    assert np.isfinite(rectified(raw_submap(T, t_ns, 1.1), held_true(), CONFIG).T_s_c).all()


@pytest.mark.parametrize("n_assistant", [0, 1])
def test_a_sub_map_of_one_primary_view(n_assistant):
    t_ns, T = truth(LATE_NS)
    whole = raw_submap(T, t_ns, 1.1)
    few = [0, N][: 1 + n_assistant]
    one = replace(
        whole, primary_ids=(0,), assistant_ids=(0,) * n_assistant,
        t_ns=t_ns[few], T_s_c=T[few], cameras=whole.cameras[: len(few)],
    )  # fmt: skip
    out = rectified(one, held_true(), replace(PLAIN, rotation=False))
    assert np.array_equal(out.T_s_c[0], T[0])
    assert np.allclose(out.T_s_c[1:], rectified_motion(T[few][1:], 1.1), atol=1e-12)


def test_a_linear_trend_of_the_rig_is_removed_and_the_rest_kept():
    rng = np.random.default_rng(3)
    rig = se3.exp(np.array([0.5, 0.0, 0.1, 0.0, 0.05, 0.0]))
    t = np.arange(15.0)[:, None]
    noise = 0.001 * rng.standard_normal((15, 6))
    even = (t - t.mean()) * np.array([0, 0, 0, 0, 0.001, 0])
    flat = rectify.without_trend(rig @ se3.exp(even), t)
    assert np.allclose(flat, rig, atol=1e-9)
    left = se3.log(se3.inverse(rig) @ rectify.without_trend(rig @ se3.exp(even + noise), t))
    assert np.abs(left - noise).max() < 0.002
    few = rig @ se3.exp(even[:4])
    assert rectify.without_trend(few, t[:4]) is few


def test_the_rigid_rig_follows_the_primary_in_a_turn():
    t_ns, _ = truth(LATE_NS)
    raw = raw_submap(estimated_under(1.15, LATE_NS), t_ns, 1.15)

    def uneven(config):
        out = rectified(raw, held_true(), config)
        rig = scale.rig_samples(
            out.t_ns[:N], out.T_s_c[:N], out.t_ns[N : 2 * N], out.T_s_c[N : 2 * N]
        )
        return np.degrees(se3.so3_log(rig[:, :3, :3])[:, 1]).std()

    assert uneven(CONFIG) < 0.7 * uneven(replace(CONFIG, rigid_rig=False))
