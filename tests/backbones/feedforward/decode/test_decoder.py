"""All encodings of a known scene decode to that scene, in pixels of the images.

Raw outputs are computed from the definitions of the encodings (tests/backbones/raw_scene.py).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.feedforward.decode.decoder import decode, prediction
from calm_edge.backbones.feedforward.decode.pose import poses
from calm_edge.backbones.onnx.manifest import (
    ConfidenceOutput,
    GeometryOutput,
    InputSpec,
    IntrinsicsOutput,
    Outputs,
    PoseOutput,
)
from calm_edge.backbones.onnx.picture_input import fit_pictures
from tests.backbones.raw_scene import RawScene, make_scene, matrices, turn

# images of two sizes: the two cameras are placed differently in the input
SIZES = [(160, 96), (160, 96), (120, 90)]
INPUT = InputSpec("x", "NCHW", "rgb", "width", size_px=80, multiple=8)
PADDED = replace(INPUT, multiple_by="pad", multiple=32, size_px=64)
CROPPED = replace(INPUT, multiple_by="crop", common_by="crop", multiple=16)


def quaternion(R):
    """Quaternion x, y, z, w of a rotation with w not near 0."""
    w = np.sqrt(1 + R[0, 0] + R[1, 1] + R[2, 2]) / 2
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    return np.array([x / (4 * w), y / (4 * w), z / (4 * w), w])


def picture_pixels(scene: RawScene, fit, view: int, shape: tuple[int, int]):
    """Image coordinates u, v of the pixels (h, w) of a map over the input."""
    (h, w), (width, height) = shape, fit.input
    sx, sy = fit.resized[0] / scene.sizes[view][0], fit.resized[1] / scene.sizes[view][1]
    u = ((np.arange(w) + 0.5) * width / w - fit.offset[0]) / sx - 0.5
    v = ((np.arange(h) + 0.5) * height / h - fit.offset[1]) / sy - 0.5
    return np.meshgrid(u, v)


def raw_outputs(scene: RawScene, fits, reduced: int = 1) -> dict:
    """Outputs in all encodings; maps are `reduced` times smaller than the input."""
    n = len(fits)
    width, height = fits[0].input
    out: dict[str, list] = {name: [] for name in ("z", "points", "along", "rays", "K", "fov")}
    for view, fit in enumerate(fits):
        u, v = picture_pixels(scene, fit, view, (height // reduced, width // reduced))
        ray, z = scene.ray(view, u, v), scene.z(view, u, v)
        length = np.linalg.norm(ray, axis=-1)
        out["z"].append(z)
        out["points"].append(ray * z[..., None])
        out["along"].append(z * length)
        out["rays"].append(ray / length[..., None])
        sx, sy = fit.resized[0] / scene.sizes[view][0], fit.resized[1] / scene.sizes[view][1]
        K = scene.K[view]
        # corner origin: the centre of the first pixel is (0.5, 0.5)
        fx, fy = K[0, 0] * sx, K[1, 1] * sy
        cx, cy = (K[0, 2] + 0.5) * sx + fit.offset[0], (K[1, 2] + 0.5) * sy + fit.offset[1]
        out["K"].append([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        out["fov"].append([2 * np.arctan(height / 2 / fy), 2 * np.arctan(width / 2 / fx)])
    raw = {name: np.array(values, np.float32) for name, values in out.items()}
    T_w_c = scene.T_w_c
    T_c_w = np.linalg.inv(T_w_c)
    for name, T in (("w2c", T_c_w), ("c2w", T_w_c)):
        q = np.array([quaternion(t[:3, :3]) for t in T])
        raw[f"{name}_34"] = T[:, :3]
        raw[f"{name}_44"] = T
        raw[f"{name}_xyzw"] = np.concatenate([T[:, :3, 3], 3.0 * q], 1)
        raw[f"{name}_wxyz"] = np.concatenate([T[:, :3, 3], -q[:, [3, 0, 1, 2]]], 1)
        raw[f"{name}_9"] = np.concatenate([T[:, :3, 3], q, raw["fov"]], 1)
    log_odds = np.linspace(-3, 3, n * raw["z"][0].size).reshape(raw["z"].shape)
    raw["logit"], raw["expp1"], raw["score"] = log_odds, 1 + np.exp(log_odds), log_odds / 7 + 40
    return raw


POSES = [
    PoseOutput(f"{short}_{kind}", encoding, direction, quaternion=order)
    for short, direction in (("w2c", "world_to_camera"), ("c2w", "camera_to_world"))
    for kind, encoding, order in (
        ("9", "t_quatxyzw_fovhw", "xyzw"),
        ("34", "mat3x4", "xyzw"),
        ("44", "mat4x4", "xyzw"),
        ("xyzw", "t_quat", "xyzw"),
        ("wxyz", "t_quat", "wxyz"),
    )
]
DEPTH = GeometryOutput("z", "z_depth")
POINTS = GeometryOutput("points", "point_map")
ALONG = GeometryOutput("along", "ray_depth", rays="rays")
PIXELS = IntrinsicsOutput("pixels", "K")
SOLVED = IntrinsicsOutput("solved")
PLAIN = Outputs(POSES[1], PIXELS, DEPTH)


def decoded(outputs: Outputs, spec=INPUT, offset_px=(0.0, 0.0), reduced=1):
    scene = make_scene(SIZES, offset_px)
    fits = fit_pictures(spec, SIZES)
    return scene, fits, decode(outputs, raw_outputs(scene, fits, reduced), fits)


@pytest.mark.parametrize("pose", POSES, ids=lambda p: p.name)
def test_poses(pose):
    scene, _, out = decoded(replace(PLAIN, pose=pose))
    assert out.T_s_c == pytest.approx(scene.T_s_c(), abs=1e-6)
    assert np.array_equal(out.T_s_c[0], np.eye(4))
    assert np.linalg.det(out.T_s_c[:, :3, :3]) == pytest.approx(np.ones(3))


@pytest.mark.parametrize("stretch", [(1.9, 0.6, 0.3), (1.5, 1.0, -0.4)], ids=["skewed", "mirror"])
def test_nearest_rotation(stretch):
    """A = R P, P symmetric: R is the nearest rotation even if P's least eigenvalue is negative."""
    axes = turn(0, 25) @ turn(1, -40) @ turn(2, 10)
    scene = make_scene(SIZES)
    matrices = scene.T_w_c.copy()
    matrices[:, :3, :3] = matrices[:, :3, :3] @ axes @ np.diag(stretch) @ axes.T
    pose = PoseOutput("any", "mat4x4", "camera_to_world", rotation="nearest")
    assert poses(pose, matrices, len(SIZES)) == pytest.approx(scene.T_s_c(), abs=1e-9)
    with pytest.raises(BackboneError, match="no rotation"):
        poses(replace(pose, rotation="exact"), matrices, len(SIZES))


def test_a_matrix_without_a_unique_nearest_rotation_is_an_error():
    pose = PoseOutput("any", "mat4x4", "camera_to_world", rotation="nearest")
    flat = np.diag([1.0, 0.0, 0.0, 1.0])[None]
    with pytest.raises(BackboneError, match="no unique nearest rotation"):
        poses(pose, flat, 1)


@pytest.mark.parametrize("spec", [INPUT, PADDED, CROPPED], ids=["stretch", "pad", "crop"])
@pytest.mark.parametrize(
    ("intrinsics", "geometry"),
    [
        (PIXELS, DEPTH),
        (SOLVED, POINTS),
        (SOLVED, ALONG),
        (PIXELS, replace(ALONG, rays="")),
        (PIXELS, POINTS),
    ],
    ids=["pixels+z", "solved+points", "solved+rays", "pixels+along", "pixels+points"],
)
@pytest.mark.parametrize("reduced", [1, 2])
def test_intrinsics_and_depth(spec, intrinsics, geometry, reduced):
    """Off-centre principal points, two image sizes, maps at half the resolution."""
    outputs = Outputs(POSES[1], intrinsics, geometry)
    scene, fits, out = decoded(outputs, spec, (4.0, -3.0), reduced)
    assert pytest.approx(scene.K, rel=1e-4, abs=1e-3) == matrices(out.cameras)
    whole = prediction(out, fits)
    assert whole.depth.dtype == whole.confidence.dtype == np.float32
    h, w = whole.depth.shape[1:]
    for view, (width, height) in enumerate(SIZES):
        depth, known = whole.depth[view], whole.depth[view] > 0
        u = (np.arange(w) + 0.5) * width / w - 0.5
        v = (np.arange(h) + 0.5) * height / h - 0.5
        truth = scene.z(view, *np.meshgrid(u, v))
        # nearest neighbour: up to half a map pixel off
        same_grid = fits[view].resized == (w * reduced, h * reduced)
        assert np.abs(depth / truth - 1)[known].max() < (2e-5 if same_grid else 0.01)
        assert known.mean() > (0.75 if spec is CROPPED else 0.999)


@pytest.mark.parametrize("named", [True, False])
def test_intrinsics_of_a_field_of_view(named):
    """A field of view gives no principal point: it is the image centre, exact to half a pixel."""
    scene = make_scene(SIZES[:2])
    fits = fit_pictures(INPUT, SIZES[:2])
    intrinsics = IntrinsicsOutput("fov", "fov" if named else "")
    outputs = Outputs(POSES[0], intrinsics, DEPTH)
    out = decode(outputs, raw_outputs(scene, fits), fits)
    assert pytest.approx(scene.K, rel=1e-5, abs=1e-4) == matrices(out.cameras)


def test_pixels_may_count_from_the_centre():
    scene = make_scene(SIZES, (4.0, -3.0))
    fits = fit_pictures(INPUT, SIZES)
    raw = raw_outputs(scene, fits)
    raw["K"][:, :2, 2] -= 0.5
    outputs = replace(PLAIN, intrinsics=replace(PIXELS, pixel_origin="centre"))
    assert pytest.approx(scene.K, rel=1e-5) == matrices(decode(outputs, raw, fits).cameras)


def test_the_principal_point_can_be_fixed_at_the_centre():
    outputs = Outputs(POSES[1], replace(SOLVED, principal_point="centre"), POINTS)
    scene, _, out = decoded(outputs, offset_px=(4.0, -3.0))
    for camera, (width, height) in zip(out.cameras, SIZES, strict=True):
        assert (camera.cx, camera.cy) == pytest.approx(((width - 1) / 2, (height - 1) / 2))
    assert matrices(out.cameras)[:, 0, 0] == pytest.approx(scene.K[:, 0, 0], rel=0.05)


def test_padded_pixels_are_ignored():
    """More than half of the input is padding, where outputs are arbitrary."""
    spec = replace(PADDED, height_px=128)
    scene = make_scene(SIZES, (4.0, -3.0))
    fits = fit_pictures(spec, SIZES)
    raw = raw_outputs(scene, fits)
    for view, fit in enumerate(fits):
        top, bottom = fit.offset[1], fit.offset[1] + fit.resized[1]
        raw["points"][view, :top, :, :2] *= 0.5
        raw["points"][view, bottom:, :, :2] *= 0.5
    out = decode(Outputs(POSES[1], SOLVED, POINTS), raw, fits)
    assert pytest.approx(scene.K, rel=1e-4, abs=1e-3) == matrices(out.cameras)


def test_solving_is_robust_to_outliers_and_noise():
    """A tenth of the points are outliers, the others noisy: the focal length is unbiased."""
    scene = make_scene(SIZES)
    fits = fit_pictures(INPUT, SIZES)
    raw = raw_outputs(scene, fits)
    rng = np.random.default_rng(0)
    points = raw["points"] * (1 + 0.05 * rng.standard_normal(raw["points"].shape))
    wrong = rng.random(points.shape[:3]) < 0.1
    points[wrong] = rng.uniform(-5, 5, (int(wrong.sum()), 3))
    points[:, 0, :4] = np.nan
    raw["points"] = points
    out = decode(Outputs(POSES[1], SOLVED, POINTS), raw, fits)
    assert matrices(out.cameras)[:, [0, 1], [0, 1]] == pytest.approx(
        scene.K[:, [0, 1], [0, 1]], rel=0.02
    )


@pytest.mark.parametrize("encoding", ["expp1", "logit", "raw"])
def test_confidence_is_a_rank_over_the_whole_window(encoding):
    name = "score" if encoding == "raw" else encoding
    fits = fit_pictures(INPUT, SIZES[:2])
    raw = raw_outputs(make_scene(SIZES[:2]), fits)
    outputs = replace(PLAIN, confidence=ConfidenceOutput(name, encoding))
    confidence = prediction(decode(outputs, raw, fits), fits).confidence
    count = confidence.size
    assert confidence.ravel() == pytest.approx(np.arange(1, count + 1) / count, abs=1e-6)


def test_without_confidence_all_depth_has_confidence_one():
    _, fits, out = decoded(PLAIN)
    whole = prediction(out, fits)
    assert np.array_equal(whole.confidence, (whole.depth > 0).astype(np.float32))


def test_unknown_depth_has_no_confidence():
    scene = make_scene(SIZES[:2])
    fits = fit_pictures(INPUT, SIZES[:2])
    raw = raw_outputs(scene, fits)
    raw["z"][:, 0] = np.nan
    raw["z"][:, 1] = -1
    raw["logit"][:, 2] = np.nan
    outputs = replace(PLAIN, confidence=ConfidenceOutput("logit", "logit"))
    out = prediction(decode(outputs, raw, fits), fits)
    assert (out.depth[0, :2] == 0).all() and (out.confidence[0, :3] == 0).all()
    assert np.isfinite(out.depth).all() and (out.depth[0, 2:] > 0).all()


@pytest.mark.parametrize("views", [1, 3])
def test_axes_of_length_one_are_dropped(views):
    """A batch axis in front, a channel axis last or second, or both."""
    scene = make_scene(SIZES[:views])
    fits = fit_pictures(INPUT, SIZES[:views])
    raw = raw_outputs(scene, fits)
    expected = decode(PLAIN, raw, fits)
    channels = (lambda a: a, lambda a: a[..., None], lambda a: a[:, None])
    for batch in (lambda a: a[None], lambda a: a):
        for channel in channels:
            shaped = raw | {"z": batch(channel(raw["z"])), "w2c_34": batch(raw["w2c_34"])}
            out = decode(PLAIN, shaped, fits)
            assert np.array_equal(out.depth, expected.depth)
            assert np.array_equal(out.T_s_c, expected.T_s_c)


@pytest.mark.parametrize(
    ("name", "change", "line"),
    [
        ("w2c_34", lambda a: a[:2], r"output 'w2c_34' has the shape \(2, 3, 4\); expected \(3"),
        ("w2c_34", lambda a: a * np.nan, "a pose of the network is not finite"),
        ("w2c_34", lambda a: a * [-1, 1, 1, 1], "a pose matrix of the network is no rotation"),
        ("w2c_34", lambda a: 1.5 * a, "a pose matrix of the network is no rotation"),
        ("K", lambda a: -a, "intrinsics are not finite or a focal is not positive"),
        ("K", lambda a: a * np.inf, "intrinsics are not finite or a focal is not positive"),
        ("z", lambda a: -a, "depth is zero or not finite everywhere"),
        ("z", lambda a: a[..., :2, None, :], "output 'z' has the shape"),
    ],
)
def test_invalid_outputs_are_errors_of_one_line(name, change, line):
    scene = make_scene(SIZES)
    fits = fit_pictures(INPUT, SIZES)
    raw = raw_outputs(scene, fits)
    with np.errstate(invalid="ignore"):
        raw[name] = change(raw[name])
    with pytest.raises(BackboneError, match=line):
        decode(PLAIN, raw, fits)


def test_zero_quaternions_and_wide_fields_of_view_are_refused():
    scene = make_scene(SIZES)
    fits = fit_pictures(INPUT, SIZES)
    raw = raw_outputs(scene, fits)
    outputs = Outputs(POSES[0], IntrinsicsOutput("fov"), DEPTH)
    raw["w2c_9"][1, 8] = np.pi
    with pytest.raises(BackboneError, match="field of view is outside 0 to 180 degrees"):
        decode(outputs, raw, fits)
    raw = raw_outputs(scene, fits)
    raw["w2c_9"][1, 3:7] = 0
    with pytest.raises(BackboneError, match="a quaternion of zero"):
        decode(outputs, raw, fits)


def test_points_that_fit_no_camera_are_errors():
    scene = make_scene(SIZES)
    fits = fit_pictures(INPUT, SIZES)
    raw = raw_outputs(scene, fits)
    outputs = Outputs(POSES[1], SOLVED, POINTS)
    flipped = raw | {"points": raw["points"] * np.float32([-1, 1, 1])}
    with pytest.raises(BackboneError, match="fit no positive focal length"):
        decode(outputs, flipped, fits)
    behind = raw | {"points": -raw["points"]}
    with pytest.raises(BackboneError, match="too few points"):
        decode(outputs, behind, fits)
