"""Training clips of calm-geo: lenses, rolling shutters and bonnets, and what is true of them.

The pictures need torch, which only training installs; the geometry does not.
"""

from __future__ import annotations

import importlib

import numpy as np
import pytest

from calm_edge.backbones.onnx.model_folder import EXPORTED
from calm_edge.geometry import se3

SIZE = (96, 176)


@pytest.fixture
def module(monkeypatch):
    """The import of a module of the training."""
    monkeypatch.syspath_prepend(str(EXPORTED / "calm-geo" / "train"))
    return importlib.import_module


def optics_of(optics, K, lens, motion, T=None):
    return optics.Optics.of([K, lens, np.eye(4) if T is None else T, motion], SIZE)


def test_every_camera_drawn_sees_in_all_its_pixels(module):
    optics, random = module("optics"), np.random.default_rng(0)
    drawn = []
    for _ in range(120):
        hfov = random.uniform(25, 115)
        K, lens = optics.drawn_camera(random, hfov, SIZE)
        view = optics_of(optics, K, lens, np.zeros(6))
        assert np.isfinite(view.rays()).all()
        middle = np.array([[-0.5, view.camera.cy], [SIZE[1] - 0.5, view.camera.cy]])
        a, b = view.camera.rays(middle)
        # the principal point is off the middle
        assert np.degrees(np.arccos(a @ b)) == pytest.approx(hfov, abs=3)
        drawn.append(("none", "webcam", "wide")[int(lens.any()) + int(lens[0])])
    assert min(drawn.count(kind) for kind in ("none", "webcam", "wide")) > 10


@pytest.mark.parametrize("lens", [(0, 0, 0), (0, -0.15, 0.0), (1, -0.03, 0.005)])
def test_a_pixel_goes_to_its_point_and_back_when_its_row_is_exposed(module, lens):
    optics = module("optics")
    K = np.array([[110.0, 0, 90], [0, 110, 45], [0, 0, 1]])
    motion = np.array([0.01, -0.01, 0.3, 0.01, -0.02, 0.01])
    T = se3.exp(np.array([1.0, 2, 3, 0.1, 0.2, -0.1]))
    view = optics_of(optics, K, np.array(lens, float), motion, T)
    uv = np.array([[3.0, 2], [170, 90], [88, 48], [20, 80]])
    p_w = view.points(uv, np.array([4.0, 5, 9, 3]))
    back, z = view.pixels(p_w)
    np.testing.assert_allclose(back, uv, atol=1e-3)
    np.testing.assert_allclose(z, [4, 5, 9, 3], rtol=1e-5)
    still = optics_of(optics, K, np.array(lens, float), np.zeros(6), T)
    assert np.linalg.norm(still.pixels(p_w)[0] - uv, axis=1).max() > 1
    behind, _ = view.pixels(T[:3, 3][None] - 5 * T[:3, 2])
    assert np.isnan(behind).all()


def test_a_bonnet_hides_the_lower_part_and_mirrors(module):
    bonnets, random = module("bonnet"), np.random.default_rng(1)
    for _ in range(20):
        bonnet = bonnets.Bonnet.drawn(random, SIZE)
        dark, light = (
            bonnet.over(np.full(SIZE, level, np.uint8)).astype(float) for level in (40, 200)
        )
        assert 0.01 < bonnet.covers.mean() < 0.4 and not bonnet.covers[: SIZE[0] // 2].any()
        assert (dark[~bonnet.covers] == 40).all()
        assert 4 < (light - dark)[bonnet.covers].mean() < 130


@pytest.mark.parametrize("lens", [(0, -0.15, 0.0), (1, -0.03, 0.005)])
@pytest.mark.parametrize("velocity", [(0, 0, 0), (9.0, 1.5, -9.0)])
def test_a_dot_is_drawn_where_it_is_when_its_row_is_exposed(module, lens, velocity):
    torch = pytest.importorskip("torch")
    world, optics = module("world"), module("optics")
    yy, xx = np.mgrid[0:256, 0:256]
    disc = (np.hypot(xx - 127.5, yy - 127.5) < 30).astype(np.uint8) * 255
    bank = world.TextureBank(disc[None], torch.device("cpu"))
    centre, readout_s = np.array([1.1, 0.9, 4.0]), 0.03

    def row(*values):
        return torch.tensor([values], dtype=torch.float32)

    scene = world.Scene(
        corner=row(*(centre - [0.5, 0.5, 0])), right=row(1, 0, 0), down=row(0, 1, 0),
        texture=torch.zeros(1, dtype=torch.long), repeats=row(1, 1), offset=row(0, 0),
        gain=torch.ones(1), bias=torch.zeros(1), kind=torch.zeros(1, dtype=torch.long),
        mask=torch.zeros(1, dtype=torch.long), velocity=row(*velocity),
        sky=0, sky_gain=(0.0, 0.0), masks=torch.zeros(world.MASKS, 64, 64, dtype=torch.bool),
    )  # fmt: skip
    K = np.array([[110.0, 0, 90], [0, 110, 45], [0, 0, 1]])
    motion = np.array([0.01, -0.01, 0.27, 0.012, -0.027, 0.015])
    view = optics_of(optics, K, np.array(lens, float), motion)
    grey = world.render(scene, bank, view, 0.0, readout_s).grey.numpy()
    rows, columns = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    found = np.array([(grey * columns).sum(), (grey * rows).sum()]) / grey.sum()
    at = view.pixels(centre[None])[0][0]
    for _ in range(8):
        late_s = readout_s * view.share(at[1])
        at = view.pixels(centre[None] + np.array(velocity) * late_s)[0][0]
    np.testing.assert_allclose(found, at, atol=0.1)
    still = optics_of(optics, K, np.array(lens, float), np.zeros(6))
    assert np.linalg.norm(still.pixels(centre[None])[0][0] - found) > 0.3


def test_views_of_a_clip_agree_where_they_see_the_same(module):
    torch = pytest.importorskip("torch")
    clips, pairs = module("clips"), module("pairs")
    random = np.random.default_rng(5)
    bank = module("world").TextureBank(
        random.integers(0, 255, (12, 16, 16)).astype(np.uint8).repeat(16, 1).repeat(16, 2),
        torch.device("cpu"),
    )
    lenses = rolling = bonnets = 0
    apart = []
    for seed in range(4):
        clip = clips.random_clip(np.random.default_rng(seed), bank, torch.device("cpu"))
        lenses += int(clip.lens.any())
        rolling += int(clip.motion.any())
        bonnets += int((clip.depth == 0).any())
        fields = [clip.K, clip.lens, clip.T_w_c, clip.motion]
        at = [clips.Optics.of([f[k] for f in fields], clips.SIZE) for k in range(6)]
        row, column = np.mgrid[8 : clips.SIZE[0] : 5, 8 : clips.SIZE[1] : 5].reshape(2, -1)
        uv = np.stack([column, row], -1)
        for a, b in ((0, 1), (1, 4), (5, 2)):
            uv_b, seen = pairs.truth(uv, at[a], at[b], clip.depth[a], clip.depth[b])
            seen &= clip.steady[a][row, column]
            x, y = np.round(uv_b[seen]).astype(int).T
            grey_a = clip.grey[a][row[seen], column[seen]].astype(float)
            apart.append(np.abs(clip.grey[b][y, x].astype(float) - grey_a))
    assert min(lenses, rolling, bonnets) > 0
    # what differs are the edges of the textures' squares
    assert len(np.concatenate(apart)) > 2000 and np.median(np.concatenate(apart)) < 5
