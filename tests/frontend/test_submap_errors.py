"""What a window's covariance says of motion along it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.frontend.submap_errors import SubmapErrors, motion_given_length
from calm_edge.geometry import se3
from tests.frontend.plane_world import PlaneWorld, drive

WORLD = PlaneWorld()


def test_of_an_error_of_the_scale_nothing_is_left_given_the_length() -> None:
    """Poses that are all too far apart by one factor, and turned about each their own axes."""
    rng = np.random.default_rng(0)
    n = 6
    T = se3.compose(
        se3.so3_exp(0.1 * rng.normal(size=(n, 3))), np.arange(n)[:, None] * np.array([0.1, 0, 2.0])
    )
    T = se3.inverse(T[0]) @ T
    stretched = np.zeros((n, 6))
    stretched[:, :3] = (np.swapaxes(T[:, :3, :3], -1, -2) @ T[:, :3, 3:])[..., 0]
    turned = np.zeros((n, 6))
    turned[1:, 3:] = rng.normal(size=(n - 1, 3))
    covariance = 0.01**2 * np.outer(stretched, stretched) + 1e-6 * np.outer(turned, turned)
    motion, length = motion_given_length(T, covariance)
    np.testing.assert_allclose(length, (n - 1) * np.hypot(0.1, 2.0))
    np.testing.assert_allclose(motion[:3], 0, atol=1e-12)
    np.testing.assert_allclose(motion[3:, 3:], 1e-6 * np.outer(turned[-1, 3:], turned[-1, 3:]))


def test_a_submap_of_another_unit_has_the_same_errors_in_world_units() -> None:
    poses = drive(4)
    ids, stamps = [0, 1, 2, 3], [0, 1, 2, 3]
    found = []
    for unit in (0.5, 2.0):
        update = WORLD.update(0, ids, stamps, poses, raw_scale=unit)
        covariance = update.prediction.covariance
        assert covariance is not None
        in_unit = np.tile(np.repeat([1 / unit, 1.0], 3), 4)
        scaled = (covariance * np.outer(in_unit, in_unit)).astype(np.float32)
        prediction = replace(update.prediction, covariance=scaled)
        found.append(SubmapErrors.of_update(replace(update, prediction=prediction)))
    np.testing.assert_allclose(found[0].by_length, found[1].by_length, rtol=1e-5)
    assert found[0].scale_log_sigma == 0.01 and found[0].metric


def test_without_a_covariance_the_errors_are_unknown() -> None:
    update = WORLD.update(0, [0, 1], [0, 1], drive(2))
    bare = replace(update, prediction=replace(update.prediction, covariance=None))
    assert np.isnan(SubmapErrors.of_update(bare).by_length).all()
