"""Claimed covariance of the motion between two live poses."""

from __future__ import annotations

import numpy as np

from calm_edge.evaluation.motion_covariance import motion_covariance
from calm_edge.frontend.drift import Drift
from calm_edge.frontend.submap_errors import SubmapErrors
from calm_edge.geometry import se3
from calm_edge.types import Float, PoseSample, PoseStatus
from tests.evaluation.worlds import curve

ERRORS = SubmapErrors(0.02, 0.01, np.diag([1e-4] * 3 + [1e-6] * 3))


def driven(T: Float, noise: Float) -> list[PoseSample]:
    drift, out = Drift(), []
    for pose in T:
        drift.move(pose, ERRORS, noise, 0.1)
        out.append(
            PoseSample(
                0, pose, np.zeros(3), noise, 0, PoseStatus.LIVE, drift=drift.covariance,
                scale_log_sigma=0.02, scale_offset=drift.scale_offset,
                focal_offset=drift.focal_offset,
            )
        )  # fmt: skip
    return out


def test_what_was_before_the_first_pose_does_not_count() -> None:
    T, noise = curve(60), np.diag([1e-5] * 3 + [1e-7] * 3)
    whole, late = driven(T, noise), driven(T[30:], noise)
    first, then = whole[30], whole[-1]
    moved = se3.adjoint(se3.inverse(then.T_w_c) @ first.T_w_c)
    expected = late[-1].with_drift()[0] + moved @ noise @ moved.T
    # on a curve the scale's error along the chord differs a little from that along the path
    np.testing.assert_allclose(motion_covariance(first, then), expected, atol=2e-3, rtol=0.05)
    assert np.trace(expected) < np.trace(then.with_drift()[0])


def test_an_unknown_scale_leaves_the_rotation() -> None:
    first, then = driven(curve(2), np.eye(6))
    unknown = PoseSample(0, then.T_w_c, np.zeros(3), np.eye(6), 0, PoseStatus.LIVE)
    found = motion_covariance(first, unknown)
    assert np.isnan(found[:3, :3]).all() and np.isfinite(found[3:, 3:]).all()
    assert np.isfinite(motion_covariance(first, unknown, with_scale=False)).all()
