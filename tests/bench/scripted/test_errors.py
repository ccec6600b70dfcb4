import numpy as np

from bench.scripted.errors import Errors, ScriptedErrors, focal_factor
from calm_edge.geometry import se3
from tests.bench.scripted.street_drive import batch, street
from tests.drives import circle

SCENE = street()


def draws(hints, n=300, **dials):
    """One draw a seed of one batch."""
    T = SCENE.T_w_c(hints.eyes, hints.t_ns)
    return [
        Errors(ScriptedErrors(seed=seed, **dials), SCENE.t_ns, SCENE.T_w_p).draw(hints, T)
        for seed in range(n)
    ]


def test_no_dial_no_error():
    (draw,) = draws(batch(), n=1)
    assert draw.scale == 1 and not draw.focal.any() and not draw.twists.any()
    assert not draw.depth.any()


def test_a_straight_road_has_the_larger_focal_error():
    straight, turn = np.tile(np.eye(4), (15, 1, 1)), circle(60)[:15]
    straight[:, 2, 3] = np.arange(15)
    assert focal_factor(straight) > 1.3 > 0.6 > focal_factor(turn)


def test_focals_err_by_what_the_dial_says_and_both_eyes_alike():
    T = SCENE.T_w_p[20:30]
    factor = focal_factor(T)
    for dial in ("focal_bias_log_sigma", "focal_log_sigma"):
        focal = np.array([draw.focal[[0, 10]] for draw in draws(batch(), **{dial: 0.05})])
        assert np.allclose(focal.std(0), 0.05 * factor, rtol=0.15)
        assert 0.003 < (focal[:, 0] - focal[:, 1]).std() < 0.02


def test_the_bias_is_the_drives_and_the_rest_the_batchs():
    def pair(**dials):
        errors = Errors(ScriptedErrors(**dials), SCENE.t_ns, SCENE.T_w_p)
        return [
            errors.draw(batch(first), SCENE.T_w_c(batch(first).eyes, batch(first).t_ns)).focal[0]
            for first in (10, 40)
        ]

    one, two = pair(focal_bias_log_sigma=0.05)
    assert np.isclose(one, two, rtol=0.1)
    one, two = pair(focal_log_sigma=0.05)
    assert abs(one - two) > 0.001


def test_scale_walks_with_the_path():
    def step(draw_a, draw_b):
        return np.log(draw_b.scale / draw_a.scale)

    near = [
        step(a, b)
        for a, b in zip(
            draws(batch(10), scale_walk=0.5), draws(batch(12), scale_walk=0.5), strict=True
        )
    ]
    far = [
        step(a, b)
        for a, b in zip(
            draws(batch(0), scale_walk=0.5), draws(batch(49), scale_walk=0.5), strict=True
        )
    ]
    assert np.isclose(np.std(far), 0.5 * np.sqrt(0.5), rtol=0.2)
    assert np.std(near) < 0.3 * np.std(far)


def test_depth_drifts_from_the_first_view_to_the_last():
    drift = np.array([draw.depth for draw in draws(batch(), depth_drift=0.1)])
    assert np.isclose((drift[:, 9] - drift[:, 0]).std(), 0.1, rtol=0.15)
    assert np.allclose(drift[:, 10:], drift[:, :10])
    assert np.allclose(drift[:, 0] + drift[:, 9], 0)


def test_a_bend_grows_from_the_first_view_to_the_last():
    bend = np.array([draw.bend for draw in draws(batch(), bend_sigma_rad=0.01)])
    assert not bend[:, 0].any()
    assert np.isclose(bend[:, 9].std(), 0.01, rtol=0.15)
    assert np.allclose(bend[:, 3] * 3, bend[:, 9])


def test_pose_noise_is_of_every_view():
    twists = np.concatenate(
        [draw.twists for draw in draws(batch(), rotation_sigma_rad=0.01, translation_sigma=0.02)]
    )
    assert np.allclose(twists.std(0), np.repeat([0.02, 0.01], 3), rtol=0.05)
    assert se3.exp(twists).shape == (len(twists), 4, 4)
