"""Plausibility checks of a feed-forward model's outputs, per view and between views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calm_edge.backbones.feedforward.decode import geometry
from calm_edge.backbones.feedforward.decode.decoder import Decoded
from calm_edge.backbones.onnx.manifest import ManifestError, Outputs
from calm_edge.backbones.onnx.session import Tensor
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.types import Float, Float32, Int

# Largest accepted median |log ratio| of depth between views; wrong conventions give far more.
MAX_DISAGREEMENT = 0.2
# Poses count as inverted if their inverses halve a disagreement above WORTH_COMPARING.
INVERSE_BETTER, WORTH_COMPARING = 0.5, 0.02
MIN_COVISIBLE = 0.05
SAMPLES = 2000


@dataclass(frozen=True, slots=True)
class Reprojection:
    """Consistency of depth between views.

    disagreement: median |log ratio| of depth projected from another view to the view's own depth.
    inverted: the same with all poses inverted. covisible: share of pixels that fall into the
    other view.
    """

    disagreement: float
    inverted: float
    covisible: float


def check_numbers(outputs: Outputs, raw: Mapping[str, Tensor]) -> None:
    """Raise ManifestError if an output is not finite, or below the minimum of its encoding.

    A confidence encoded as expp1, 1 + exp(x), is at least 1; the other encodings have no minimum.
    """
    for name in outputs.names():
        if not np.isfinite(raw[name]).all():
            raise ManifestError(f"output {name!r} is not finite")
    confidence = outputs.confidence
    if confidence is not None and confidence.encoding == "expp1":
        lowest = float(raw[confidence.name].min())
        if lowest < 1:
            raise ManifestError(
                f"output {confidence.name!r} has a minimum of {lowest:.3g}, but expp1 is 1 + exp(x)"
            )


def check_poses(decoded: Decoded) -> None:
    """Raise ManifestError unless all poses are rigid with det R = +1."""
    R = decoded.T_s_c[:, :3, :3]
    off = np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max()
    if off > 1e-6 or np.abs(np.linalg.det(R) - 1).max() > 1e-6:
        raise ManifestError("a decoded pose is not rigid with det R = +1")


def reprojection(decoded: Decoded) -> Reprojection:
    """Project the depth of each view into the first one and its predecessor, and compare.

    Depth and cameras are those of the network input.
    """
    n, (h, w) = len(decoded.cameras), decoded.depth.shape[1:]
    cameras = [camera.scaled(w / camera.width, h / camera.height) for camera in decoded.cameras]
    if n < 2:
        return Reprojection(0.0, 0.0, 1.0)
    pairs = sorted({(i, j) for i in range(n) for j in (0, i - 1) if 0 <= j != i})
    confidence = geometry.percentiles(decoded.strength, decoded.depth)
    views = [_sampled(decoded.depth[i], confidence[i]) for i in range(n)]
    found: dict[bool, list[Float]] = {False: [], True: []}
    total = 0
    for inverse in found:
        T = se3.inverse(decoded.T_s_c) if inverse else decoded.T_s_c
        for i, j in pairs:
            T_j_i = se3.inverse(T[j]) @ T[i]
            depths = decoded.depth[i], decoded.depth[j]
            errors = _disagreement(views[i], depths, (cameras[i], cameras[j]), T_j_i)
            found[inverse].append(errors)
            total += 0 if inverse else len(views[i])
    together = {inverse: np.concatenate(errors) for inverse, errors in found.items()}
    medians = {k: float(np.median(e)) if len(e) else np.inf for k, e in together.items()}
    shared = len(together[False]) / max(total, 1)
    return Reprojection(medians[False], medians[True], shared)


def check_reprojection(result: Reprojection) -> None:
    """Raise ManifestError if depth and poses contradict each other."""
    if result.covisible < MIN_COVISIBLE:
        raise ManifestError(
            f"reprojection: {result.covisible:.0%} of the pixels fall into another view; depth or "
            "poses are wrong, or the golden pictures do not show one scene (golden.scene = false)"
        )
    worse = result.inverted < INVERSE_BETTER * result.disagreement
    if worse and result.disagreement > WORTH_COMPARING:
        raise ManifestError(
            f"reprojection: depth disagrees by {result.disagreement:.1%} between views, with "
            f"inverted poses by {result.inverted:.1%}: output.pose.direction is wrong"
        )
    if result.disagreement > MAX_DISAGREEMENT:
        raise ManifestError(
            f"reprojection: depth disagrees by {result.disagreement:.1%} between views, more than "
            f"{MAX_DISAGREEMENT:.0%}: a convention of poses, intrinsics or depth is wrong"
        )


def _sampled(depth: Float32, confidence: Float32) -> Int:
    """Rows and columns (M, 2) of up to about SAMPLES pixels of the more confident half."""
    good = np.argwhere((depth > 0) & (confidence >= 0.5))
    return np.asarray(good[:: max(1, len(good) // SAMPLES)])


def _disagreement(
    pixels: Int, depth: tuple[Float32, Float32], cameras: tuple[Camera, Camera], T_j_i: Float
) -> Float:
    """|log ratio| of depth for those pixels (M, 2) of view i that fall into view j.

    depth, cameras: of views i and j.
    """
    h, w = depth[1].shape
    z = depth[0][tuple(pixels.T)].astype(np.float64)
    p = se3.transform(T_j_i, cameras[0].back_project(pixels[:, ::-1].astype(np.float64), z))
    p = p[p[:, 2] > 0]
    column, row = np.round(cameras[1].project(p)).T
    inside = (row >= 0) & (row < h) & (column >= 0) & (column < w)
    there = depth[1][row[inside].astype(np.int64), column[inside].astype(np.int64)]
    known = there > 0
    return np.asarray(np.abs(np.log(p[inside, 2][known] / there[known])))
