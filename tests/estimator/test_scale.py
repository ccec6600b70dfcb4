import numpy as np
import pytest

from calm_edge.estimator import scale
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.types import Submap
from tests.drives import PERIOD_NS, START_NS, T_P_A, curved

CAMERA = Perspective(500.0, 500.0, 319.5, 119.5, 640, 240)
N = 12
T_S_P = curved(N)
T_P_NS = START_NS + PERIOD_NS * np.arange(N)
SPACING = float(np.linalg.norm(T_P_A[:3, 3]))


def assistant(late_ns):
    at = np.arange(N) + late_ns / PERIOD_NS
    return T_P_NS + late_ns, se3.interpolate_at(np.arange(N), T_S_P, at) @ T_P_A


def test_matched_stamps_give_the_pairs_own_spacing():
    t_a, T_s_a = assistant(0)
    samples = scale.rig_samples(T_P_NS, T_S_P, t_a, T_s_a)
    assert np.allclose(samples, T_P_A, atol=1e-12)
    assert scale.spacing(samples) == pytest.approx(SPACING, abs=1e-12)


@pytest.mark.parametrize("late_ns", [-33_000_000, 17_000_000, 50_000_000])
def test_unsynchronised_stamps_are_compared_with_the_interpolated_primary(late_ns):
    t_a, T_s_a = assistant(late_ns)
    assert np.allclose(scale.rig_samples(T_P_NS, T_S_P, t_a, T_s_a), T_P_A, atol=1e-9)
    # without interpolation the forward motion would count as spacing
    naive = np.linalg.norm((T_S_P - T_s_a)[:, :3, 3], axis=1).mean()
    assert abs(naive - SPACING) > 0.01


def test_assistant_frames_more_than_a_gap_outside_are_left_out():
    query = np.array([-PERIOD_NS - 1, -PERIOD_NS, 0, PERIOD_NS * N, PERIOD_NS * N + 1]) + START_NS
    poses, valid = scale.resampled(T_P_NS, T_S_P, query)
    assert valid.tolist() == [1, 2, 3]
    assert np.allclose(poses[1], T_S_P[0])


def test_a_single_frame_matches_its_own_stamp_only():
    poses, valid = scale.resampled(T_P_NS[:1], T_S_P[3:4], T_P_NS[:3])
    assert valid.tolist() == [0]
    assert np.array_equal(poses, T_S_P[3:4])


def test_frames_without_common_time_raise():
    t_a, T_s_a = assistant(0)
    with pytest.raises(scale.ScaleError, match="both clocks"):
        scale.rig_samples(T_P_NS, T_S_P, t_a + 10**12, T_s_a)
    with pytest.raises(scale.ScaleError, match="both clocks"):
        scale.rig_samples(T_P_NS, T_S_P, t_a[:0], T_s_a[:0])


@pytest.mark.parametrize("eye", [0, 1])
def test_a_repeated_stamp_raises(eye):
    t_a, T_s_a = assistant(0)
    stamps = [T_P_NS.copy(), t_a.copy()]
    stamps[eye][4] = stamps[eye][3]
    with pytest.raises(scale.ScaleError, match="share a stamp"):
        scale.rig_samples(stamps[0], T_S_P, stamps[1], T_s_a)


def test_factor_brings_the_spacing_to_one_unit_or_to_metres():
    assert scale.factor(0.25, 1.0) == 4.0
    assert scale.factor(0.25, 0.5) == 2.0
    for nothing in (0.0, np.nan, np.inf):
        with pytest.raises(scale.ScaleError, match="undetermined"):
            scale.factor(nothing, 0.5)


@pytest.mark.parametrize("spacing_world", [1.0, SPACING])
def test_rectify_undoes_any_scale_and_leaves_the_loop_view_in_the_batch(spacing_world):
    t_a, T_s_a = assistant(17_000_000)
    T = np.concatenate([T_S_P, T_s_a, T_S_P[:1]])
    raw = Submap(
        id=0,
        primary_ids=tuple(range(N)),
        assistant_ids=tuple(range(N)),
        n_overlap=0,
        t_ns=np.concatenate([T_P_NS, t_a, [17]]),
        T_s_c_raw=scale.rectified(T, 3.7),
        cameras_raw=(CAMERA,) * len(T),
        T_s_c=scale.rectified(T, 3.7),
        cameras=(CAMERA,) * len(T),
        scale=1.0,
        T_w_s=np.eye(4),
        focal_log_sigma=np.ones(2),
    )
    submap = scale.rectify(raw, spacing_world)
    world_units = spacing_world / SPACING
    assert submap.scale == pytest.approx(world_units / 3.7, rel=1e-9)
    assert np.allclose(submap.T_s_c, scale.rectified(T, world_units), atol=1e-9)
    assert np.array_equal(submap.T_s_c_raw, raw.T_s_c_raw)


def test_placement_is_by_the_first_common_frame():
    T_w_s = se3.exp(np.array([5.0, 1, -3, 0.3, -0.8, 0.2]))
    T_w_f = T_w_s @ T_S_P[:3]
    assert np.allclose(scale.placement(T_w_f, T_S_P[:3]), T_w_s, atol=1e-12)
    T_w_f[1:] = T_w_f[1:] @ se3.exp(np.array([0.3, 0, 0, 0, 0.02, 0]))
    assert np.allclose(scale.placement(T_w_f, T_S_P[:3]), T_w_s, atol=1e-12)
    # two of three frames are displaced: the average moves by two thirds
    average = scale.placement(T_w_f, T_S_P[:3], average=True)
    asked = T_w_f @ se3.inverse(T_S_P[:3])
    residual = se3.log(se3.inverse(average) @ asked)
    assert np.abs(residual.mean(0)).max() < 1e-12
    assert np.linalg.norm(se3.log(se3.inverse(T_w_s) @ average)[3:]) == pytest.approx(
        0.04 / 3, 0.01
    )


def test_scatter_of_the_samples_is_the_sigma_of_their_mean():
    rng, sigma, errors, claimed = np.random.default_rng(3), 0.02, [], []
    for _ in range(200):
        T_s_a = T_S_P @ T_P_A
        T_s_a[:, :3, 3] += T_S_P[:, :3, :3] @ T_P_A[:3, 3] * rng.normal(0, sigma, (N, 1))
        T = np.concatenate([T_S_P, T_s_a])
        ids, cameras = tuple(range(N)), (CAMERA,) * len(T)
        raw = Submap(
            0, ids, ids, 0, np.tile(T_P_NS, 2), T, cameras, T, cameras, 1.0, np.eye(4), np.ones(2)
        )
        errors.append(np.log(scale.rectify(raw, SPACING).scale))
        claimed.append(scale.scatter(raw))
    assert np.std(errors) == pytest.approx(sigma / np.sqrt(N), rel=0.15)
    assert np.mean(claimed) == pytest.approx(np.std(errors), rel=0.15)
