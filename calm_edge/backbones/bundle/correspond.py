"""Match points between two pictures by learned features, without an initial guess.

A query (a point of the first picture) is compared with all coarse cells of the other picture; the
best cell must match back (mutual nearest neighbours). Finer features then refine the position and
give its sigma, coarse to fine as in LoFTR (Sun et al., CVPR 2021).
"""

from __future__ import annotations

import numpy as np

from calm_edge.backbones.bundle.features import FeatureNet, Features
from calm_edge.backbones.bundle.matching import Bool, Matches
from calm_edge.types import Float32, Int

STRIDE, FINE_STRIDE = 8, 4
# Half width, in fine cells, of the window around a guessed match that is correlated with a query.
RADIUS = 4
# A match is matched back to the first picture: largest distance [coarse cells] from its query.
RETURN_CELLS = 1.5
# Queries with a lower reliability, as the encoder predicts it, are not matched.
MIN_RELIABILITY = 0.05
# A match is ambiguous if a cell farther from it than NEAR_CELLS is similar to the query to within
# MIN_MARGIN. On fences, crash barriers and road markings most such matches are wrong by a period.
MIN_MARGIN, NEAR_CELLS = 0.07, 2
ROUNDS = 2
# Lower bound of a match's sigma [input px], whatever the network gives: the features' resolution.
MIN_SIGMA = 0.67


def find(
    net: FeatureNet, a: Features, b: Features, uv: Float32, corner: Bool | None = None
) -> Matches:
    """Match points uv (N, 2) px of a's picture to b's; raises BackboneError.

    corner: (N,) points whose ambiguous matches are rejected; None: no point.
    """
    if len(uv) == 0:
        none = np.zeros(0, bool)
        return Matches(uv, none, np.zeros(0, np.float32), none)
    uv_a = a.to_input(uv)
    query = sampled(a.coarse, uv_a, STRIDE)
    cells, guess, likeness = _best(query, b.coarse)
    columns_b = b.coarse.shape[1]
    there = b.coarse[cells // columns_b, cells % columns_b]
    _, back, _ = _best(there, a.coarse)
    sure = np.linalg.norm(back - uv_a, axis=1) < RETURN_CELLS * STRIDE
    sure &= _nearest(a.reliability, uv_a) > MIN_RELIABILITY
    if corner is not None:
        sure &= (_margin(likeness, cells, columns_b) > MIN_MARGIN) | ~corner
    sigma = np.full(len(uv), np.inf, np.float32)
    fine = sampled(a.fine, uv_a, FINE_STRIDE)
    here = correlations(a.fine, uv_a, fine)
    for _ in range(ROUNDS):
        offset, sigma = net.refined(correlations(b.fine, guess, fine), here)
        guess = np.asarray(guess + offset, np.float32)
    width, height = b.fit.input
    sure &= (guess >= 0).all(1) & (guess <= np.array([width - 1, height - 1])).all(1)
    sigma_px = np.maximum(sigma, MIN_SIGMA) * b.pixel
    none = np.zeros(len(uv), bool)
    return Matches(b.to_picture(guess), sure, np.asarray(sigma_px, np.float32), none)


def sampled(maps: Float32, uv: Float32, stride: int) -> Float32:
    """Sample a feature map (h, w, C) bilinearly at uv (N, 2) -> (N, C), of unit length.

    C: channels. uv: px of the network's input. stride: input pixels per cell of the map.
    """
    height, width = maps.shape[:2]
    at = np.clip((uv + 0.5) / stride - 0.5, 0, [width - 1, height - 1])
    low = np.minimum(np.floor(at).astype(np.int64), [width - 2, height - 2])
    fx, fy = np.asarray(at - low, np.float32).T[:, :, None]
    x, y = low.T
    top = maps[y, x] * (1 - fx) + maps[y, x + 1] * fx
    bottom = maps[y + 1, x] * (1 - fx) + maps[y + 1, x + 1] * fx
    out = top * (1 - fy) + bottom * fy
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True), np.float32)


def correlations(fine: Float32, uv: Float32, query: Float32) -> Float32:
    """Correlate features (N, C) with the 9 x 9 cells of a fine map (h, w, C) around uv (N, 2).

    C: channels. uv: px of the network's input. Returns (N, 81) dot products, row by row. As they
    are linear in the map, they are computed at whole cells and then interpolated.
    """
    height, width = fine.shape[:2]
    at = (uv + 0.5) / FINE_STRIDE - 0.5
    low = np.floor(at).astype(np.int64)
    part = np.asarray(at - low, np.float32)
    steps = np.arange(-RADIUS, RADIUS + 2)
    x = np.clip(low[:, :1] + steps, 0, width - 1)
    y = np.clip(low[:, 1:] + steps, 0, height - 1)
    cells = fine.reshape(height * width, -1)[y[:, :, None] * width + x[:, None, :]]
    side = len(steps)
    likeness = (cells.reshape(len(uv), side * side, -1) @ query[:, :, None])[..., 0]
    grid = likeness.reshape(len(uv), side, side)
    fx, fy = part[:, :1, None], part[:, 1:, None]
    rows = grid[:, :-1] * (1 - fy) + grid[:, 1:] * fy
    mixed = rows[:, :, :-1] * (1 - fx) + rows[:, :, 1:] * fx
    return np.asarray(mixed.reshape(len(uv), -1), np.float32)


def _best(query: Float32, maps: Float32) -> tuple[Int, Float32, Float32]:
    """Cell (N,) of a map (h, w, C) most similar to each query (N, C), and refined position (N, 2).

    With all similarities (N, h w).

    Cell: row * w + column. Position: px of the network's input, the mean of the 3 x 3 cells around
    it weighted by the softmax of their similarity.
    """
    height, width = maps.shape[:2]
    likeness = query @ maps.reshape(height * width, -1).T
    cell = likeness.argmax(1)
    x, y = cell % width, cell // width
    steps = np.arange(-1, 2)
    near_x = np.clip(x[:, None, None] + steps[None, None, :], 0, width - 1)
    near_y = np.clip(y[:, None, None] + steps[None, :, None], 0, height - 1)
    near = np.take_along_axis(likeness, (near_y * width + near_x).reshape(len(x), 9), 1)
    weight = np.exp((near - near.max(1, keepdims=True)) / TEMPERATURE)
    weight /= weight.sum(1, keepdims=True)
    centre = np.stack(
        [(weight * n.reshape(-1, 9)).sum(1) for n in (near_x + 0 * near_y, near_y + 0 * near_x)], 1
    )
    return cell, np.asarray((centre + 0.5) * STRIDE - 0.5, np.float32), likeness


def _margin(likeness: Float32, cell: Int, width: int) -> Float32:
    """By how much the similarity of the best cells (N,) exceeds that of all that are not near it.

    likeness: (N, cells) of a map that is `width` cells wide; the cells near the best are cleared.
    """
    best = np.take_along_axis(likeness, cell[:, None], 1)[:, 0]
    around = np.arange(-NEAR_CELLS, NEAR_CELLS + 1)
    y = np.clip((cell // width)[:, None, None] + around[:, None], 0, likeness.shape[1] // width - 1)
    x = np.clip((cell % width)[:, None, None] + around, 0, width - 1)
    np.put_along_axis(likeness, (y * width + x).reshape(len(cell), -1), -np.inf, 1)
    return np.asarray(best - likeness.max(1), np.float32)


# Temperature of the softmax over cosine similarities: the one used in the encoder's training.
TEMPERATURE = 0.05


def _nearest(values: Float32, uv: Float32) -> Float32:
    """Values (N,) of a map (h, w) in the cells that contain uv (N, 2) px of the network's input."""
    height, width = values.shape
    cell = np.clip(np.floor((uv + 0.5) / STRIDE).astype(np.int64), 0, [width - 1, height - 1])
    return values[cell[:, 1], cell[:, 0]]
