"""Wrong conventions are detected by inconsistent depth between views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.feedforward.decode.decoder import Decoded
from calm_edge.backbones.model_check.sanity import (
    check_numbers,
    check_poses,
    check_reprojection,
    reprojection,
)
from calm_edge.backbones.onnx.manifest import (
    ConfidenceOutput,
    GeometryOutput,
    IntrinsicsOutput,
    ManifestError,
    Outputs,
    PoseOutput,
)
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from tests.backbones.raw_scene import make_scene

SIZE = (96, 64)


def decoded_scene(shrunk: int = 1) -> Decoded:
    """Three views of the plane, with depth maps `shrunk` times smaller than the images."""
    scene = make_scene([SIZE] * 3)
    u = (np.arange(SIZE[0] // shrunk) + 0.5) * shrunk - 0.5
    v = (np.arange(SIZE[1] // shrunk) + 0.5) * shrunk - 0.5
    depth = np.stack([scene.z(i, *np.meshgrid(u, v)) for i in range(3)]).astype(np.float32)
    cameras = tuple(Perspective.from_matrix(K, *SIZE) for K in scene.K)
    return Decoded(cameras, scene.T_s_c(), depth, np.zeros_like(depth))


@pytest.mark.parametrize("shrunk", [1, 4])
def test_exact_depth_and_poses_agree(shrunk):
    result = reprojection(decoded_scene(shrunk))
    assert result.disagreement < 0.01 and result.covisible > 0.5
    assert result.inverted > 3 * result.disagreement
    check_reprojection(result)


def test_inverted_poses_are_named():
    scene = decoded_scene()
    wrong = replace(scene, T_s_c=se3.inverse(scene.T_s_c))
    with pytest.raises(ManifestError, match=r"output\.pose\.direction is wrong"):
        check_reprojection(reprojection(wrong))


def test_depth_of_another_scale_than_the_poses_is_an_error():
    scene = decoded_scene()
    scene.depth[1] *= 1.5
    scene.depth[2] *= 0.6
    with pytest.raises(ManifestError, match=r"between views, more than 20%"):
        check_reprojection(reprojection(scene))


def test_views_without_common_pixels_are_an_error():
    scene = decoded_scene()
    scene.T_s_c[1:, 0, 3] += 1000.0 * np.arange(1, 3)
    with pytest.raises(ManifestError, match=r"0% of the pixels fall into another view"):
        check_reprojection(reprojection(scene))


def test_a_single_view_passes():
    scene = decoded_scene()
    alone = Decoded(scene.cameras[:1], scene.T_s_c[:1], scene.depth[:1], scene.strength[:1])
    check_reprojection(reprojection(alone))


def test_outputs_must_be_finite_and_match_their_encoding():
    outputs = Outputs(
        PoseOutput("p", "mat3x4", "world_to_camera"),
        IntrinsicsOutput("pixels", "k"),
        GeometryOutput("d", "z_depth"),
        ConfidenceOutput("c", "expp1"),
    )
    raw = {name: np.ones(3) for name in "pkdc"}
    check_numbers(outputs, raw)
    with pytest.raises(ManifestError, match="output 'd' is not finite"):
        check_numbers(outputs, raw | {"d": np.array([1, np.nan])})
    with pytest.raises(ManifestError, match=r"'c' has a minimum of 0\.4, but expp1 is 1 \+ exp"):
        check_numbers(outputs, raw | {"c": np.array([2, 0.4])})
    logit = replace(outputs, confidence=ConfidenceOutput("c", "logit"))
    check_numbers(logit, raw | {"c": np.array([-2.0])})


def test_a_pose_must_be_rigid_and_no_mirror():
    scene = decoded_scene()
    check_poses(scene)
    for diagonal in ([-1, 1, 1, 1], [1.01, 1, 1, 1]):
        with pytest.raises(ManifestError, match=r"not rigid with det R = \+1"):
            check_poses(replace(scene, T_s_c=scene.T_s_c @ np.diag(diagonal)))
