from __future__ import annotations

import numpy as np

from calm_edge.frontend.scale_offset import ScaleOffset
from calm_edge.geometry import se3


def test_steps_count_with_their_sigma_and_in_the_axes_of_the_camera() -> None:
    offset = ScaleOffset()
    turned = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, np.pi / 2, 0.0]))[:3, :3]
    poses = [se3.compose(turned, np.array([0.0, 0.0, z])) for z in (5.0, 15.0, 115.0, 125.0)]
    assert not offset.move(poses[0], 0.01).any()
    # 10 m at 1 %, 100 m that are not metric, 10 m at 2 %
    np.testing.assert_allclose(turned @ offset.move(poses[1], 0.01), [0, 0, 0.1], atol=1e-12)
    np.testing.assert_allclose(turned @ offset.move(poses[2], 0.5), [0, 0, 0.1], atol=1e-12)
    np.testing.assert_allclose(turned @ offset.move(poses[3], 0.02), [0, 0, 0.3], atol=1e-12)


def test_driving_back_cancels_the_error() -> None:
    offset = ScaleOffset()
    for z in (0.0, 10.0, 20.0, 10.0, 0.0):
        moved = offset.move(se3.compose(np.eye(3), np.array([0.0, 0.0, z])), 0.02)
    np.testing.assert_allclose(moved, 0.0, atol=1e-12)
