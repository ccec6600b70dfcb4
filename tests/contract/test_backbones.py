"""Contract that all registered backbones must fulfil (backbones/base.py)."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.scripted import ScriptedBackbone
from calm_edge.backbones.base import Backbone, BackboneError
from calm_edge.backbones.registry import BACKBONES, open_backbone
from calm_edge.config import Config, merge
from calm_edge.geometry import se3
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.types import Float, Hints, Prediction
from tests.backbones.painted_model import centres, paint, write_model
from tests.drives import curved
from tests.synthetic.drive import make_rig
from tests.synthetic.render import render_views
from tests.synthetic.settings import Settings
from tests.synthetic.world import make_world

N = 6


@dataclass(frozen=True)
class Batch:
    """A backbone and N primary then N assistant images of a car driving forward."""

    backbone: Backbone
    images: list[NDArray[np.uint8]]
    hints: Hints

    def infer(self) -> Prediction:
        return self.backbone.infer(self.images, self.hints)

    def densify(self, prediction: Prediction) -> Prediction:
        return self.backbone.densify(self.images, self.hints, prediction)


def played_drive(folder) -> Batch:
    """Batch of the scripted backbone, which plays poses of a folder and ignores the images."""
    np.savetxt(folder / "poses0.txt", curved(3 * N)[:, :3].reshape(-1, 12), fmt="%.17g")
    (folder / "calib.txt").write_text("200 200 159.5 79.5 320 160\n180 180 159.5 79.5 320 160\n")
    config = merge(Config(), {"backbone": {"name": f"scripted:{folder}"}})
    t_ns = ORIGIN_NS + 200_000_000 * np.arange(N)
    hints = Hints(eyes=np.repeat([0, 1], N), t_ns=np.concatenate([t_ns, t_ns + 17_000_000]))
    return Batch(open_backbone(config), [np.zeros((160, 320, 3), np.uint8)] * (2 * N), hints)


def rendered_drive(name: str) -> Batch:
    """Batch of rendered images of a turn in a street, a keyframe every third frame."""
    settings = Settings(frames=3 * N, width=448, height=176, start_s=6.0, density=24.0)
    world = make_world(settings.seed, settings.density)
    rig = make_rig(world, settings)
    images: list[NDArray[np.uint8]] = []
    times: list[Float] = []
    for eye in (0, 1):
        T_w_c = rig.T_w_c[eye][::3]
        images += render_views(world.scene, T_w_c, rig.cameras[eye], oversample=1)[0]
        times.append(rig.times[eye][::3])
    t_ns = ORIGIN_NS + np.round(np.concatenate(times) * 1e9).astype(np.int64)
    hints = Hints(eyes=np.repeat([0, 1], N), t_ns=t_ns, hfov_deg=settings.hfov_deg)
    return Batch(open_backbone(merge(Config(), {"backbone": {"name": name}})), images, hints)


def painted_drive(folder) -> Batch:
    """Batch of the feed-forward backbone with the model of `painted_model`, 8 views per run."""
    name = f"feedforward:{write_model(folder, max_views=8)}"
    config = merge(Config(), {"backbone": {"name": name}})
    t_ns = ORIGIN_NS + 200_000_000 * np.arange(N)
    hints = Hints(eyes=np.repeat([0, 1], N), t_ns=np.concatenate([t_ns, t_ns + 17_000_000]))
    return Batch(open_backbone(config), paint(centres(N)), hints)


@pytest.fixture(scope="module", params=sorted(BACKBONES))
def batch(request, tmp_path_factory) -> Batch:
    if request.param == "scripted":
        return played_drive(tmp_path_factory.mktemp("scripted"))
    if request.param == "feedforward":
        return painted_drive(tmp_path_factory.mktemp("painted"))
    return rendered_drive(request.param)


@pytest.fixture(scope="module")
def prediction(batch) -> Prediction:
    return batch.infer()


@pytest.fixture(scope="module")
def dense(batch, prediction) -> Prediction:
    return batch.densify(prediction)


def test_every_view_has_a_rigid_pose(prediction):
    T = prediction.T_s_c
    assert T.shape == (2 * N, 4, 4)
    assert np.isfinite(T).all()
    R = T[:, :3, :3]
    assert np.allclose(R @ R.swapaxes(1, 2), np.eye(3), atol=1e-9)
    assert np.allclose(np.linalg.det(R), 1.0)
    assert np.array_equal(T[:, 3], np.tile([0, 0, 0, 1.0], (2 * N, 1)))


def test_every_view_has_a_camera(batch, prediction):
    assert isinstance(prediction.cameras, tuple) and len(prediction.cameras) == 2 * N
    for image, camera in zip(batch.images, prediction.cameras, strict=True):
        width, height = camera.width, camera.height
        assert np.isfinite(camera.matrix).all() and camera.fx > 0 and camera.fy > 0
        assert 0 < camera.cx < width and 0 < camera.cy < height
        # a scripted drive has no pictures
        assert image.shape[1::-1] == (width, height) or isinstance(batch.backbone, ScriptedBackbone)


def test_focal_sigma_is_positive_where_given(prediction):
    sigma = prediction.focal_log_sigma
    assert sigma is None or (sigma.shape == (2 * N,) and (sigma > 0).all())


def test_poses_take_the_camera_to_the_submap(prediction):
    """Driving forward moves the camera along +z; inverted poses would give -z."""
    moved = se3.inverse(prediction.T_s_c[0]) @ prediction.T_s_c[N - 1]
    spacing = np.linalg.norm((prediction.T_s_c[N] - prediction.T_s_c[0])[:3, 3])
    assert moved[2, 3] > spacing
    assert moved[2, 3] > abs(moved[1, 3])
    # the assistant is on the right
    assert (se3.inverse(prediction.T_s_c[0]) @ prediction.T_s_c[N])[0, 3] > 0


def test_depth_is_positive_where_there_is_confidence(dense):
    depth, confidence = dense.depth, dense.confidence
    assert depth is not None and confidence is not None
    assert depth.shape == confidence.shape and len(depth) == 2 * N and depth.ndim == 3
    assert depth.dtype == confidence.dtype == np.float32
    assert np.isfinite(depth).all() and (depth >= 0).all()
    assert (confidence >= 0).all() and (confidence <= 1).all()
    assert (depth[confidence > 0] > 0).all()
    assert (confidence > 0).mean() > 0.1


def test_densifying_keeps_the_poses_and_happens_once(batch, prediction, dense):
    assert np.array_equal(dense.T_s_c, prediction.T_s_c)
    assert dense.cameras == prediction.cameras
    assert batch.densify(dense) is dense


def test_landmarks_point_into_the_batch(batch, prediction):
    marks = prediction.landmarks
    if marks is None:
        pytest.skip("this backbone has none")
    assert marks.points_s.shape[1:] == (3,) and np.isfinite(marks.points_s).all()
    assert len(marks.index) == len(marks.view) == len(marks.uv) > 0
    assert marks.uv.shape[1:] == (2,) and marks.uv.dtype == np.float32
    assert marks.index.min() >= 0 and marks.index.max() < len(marks.points_s)
    assert set(marks.view) == set(range(2 * N))
    sizes = np.array([image.shape[1::-1] for image in batch.images])
    assert (marks.uv >= -1).all() and (marks.uv <= sizes[marks.view]).all()


def test_kit_evidence_is_a_gaussian_where_given(prediction):
    kit = prediction.kit
    if kit is None:
        pytest.skip("this backbone has none")
    n = len(kit.mean)
    assert kit.information.shape == (n, n)
    assert np.allclose(kit.information, kit.information.T)
    values = np.linalg.eigvalsh(kit.information)
    assert values[0] > -1e-9 * values[-1]


def test_the_same_call_gives_the_same_answer(batch, prediction):
    other = Hints(eyes=batch.hints.eyes[::2], t_ns=batch.hints.t_ns[::2])
    # a call with half the views, which may fail, must not change the state
    with contextlib.suppress(BackboneError):
        batch.backbone.infer(batch.images[::2], other)
    again = batch.infer()
    assert again.T_s_c.tobytes() == prediction.T_s_c.tobytes()
    assert again.cameras == prediction.cameras
