"""Corner tracks through the primary keyframes and across to the assistant.

Shi-Tomasi corners and pyramidal Lucas-Kanade with a forward-backward check reach 0.2-0.45 px; dense
classical flow is too biased for bundle adjustment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.bundle.edges import edges
from calm_edge.backbones.bundle.first_sight import FirstSights
from calm_edge.backbones.bundle.matching import FOLLOWED_PX, Matching
from calm_edge.geometry.brightness import evened
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.flow import (
    Gray,
    LucasKanade,
    away_from,
    follow,
    long_side,
    neighbouring_flow,
)
from calm_edge.types import Float, Float32, Int

CORNERS_PER_VIEW = 320
# columns, rows of cells that get equal numbers of corners, if the picture is not upright
GRID = (8, 4)
EPIPOLAR_PX = 1.0
# If more matches than this share fit one homography, they are too far to show the epipole, and a
# fundamental matrix leaves out near points that are right.
MOSTLY_FAR = 0.6
# A track that cannot be registered against its first sight any more ends after so many views.
YOUNG_VIEWS = 2
MATCHING = LucasKanade(
    window_px=17,
    levels=4,
    iterations=30,
    step_px=0.01,
    backward_levels=1,
    backward_px=0.3,
    margin_px=2.0,
)


@dataclass(frozen=True, slots=True)
class Tracks:
    """Observations as rows: track (O,), view (O,) batch index, uv (O, 2) px, sigma_px (O,).

    edge: (O, 2), as `edges.edges` gives it; 0 for the first of a track, which the others follow.
    """

    track: Int
    view: Int
    uv: Float
    sigma_px: Float
    edge: Float


# track (n,), view (n,), uv (n, 2) px, sigma (n,) px, edge (n, 2) of one view
Rows = tuple[Int, Int, Float32, Float32, Float32]


def detect_corners(
    gray: Gray, known: Float32, count: int = CORNERS_PER_VIEW, used: Gray | None = None
) -> Float32:
    """New Shi-Tomasi corners (N, 2) px, spread over a grid, away from `known` (M, 2) px.

    count: number of corners wanted, the known ones included. used: (H, W), 0 in parts left out.
    """
    height, width = gray.shape
    distance = max(5.0, max(width, height) / 110)
    mask = away_from((height, width), known, distance)
    if used is not None:
        mask &= used
    columns, rows = GRID if width >= height else GRID[::-1]
    per_cell = -(-count // (columns * rows))
    found = []
    for r in range(rows):
        for c in range(columns):
            ys = slice(r * height // rows, (r + 1) * height // rows)
            xs = slice(c * width // columns, (c + 1) * width // columns)
            inside = (known[:, 0] // (width / columns) == c) & (known[:, 1] // (height / rows) == r)
            wanted = per_cell - int(inside.sum())
            if wanted <= 0:
                continue
            p = cv2.goodFeaturesToTrack(
                gray[ys, xs], wanted, 0.01, distance, mask=mask[ys, xs], blockSize=5
            )
            if p is not None:
                found.append(p.reshape(-1, 2) + np.array([xs.start, ys.start], np.float32))
    new = np.concatenate(found) if found else np.zeros((0, 2), np.float32)
    margin = MATCHING.window_px // 2
    inside = (new > margin).all(1) & (new < np.array([width, height], np.float32) - 1 - margin).all(
        1
    )
    return np.asarray(new[inside], np.float32)


def on_epipolar_lines(
    a: Float32, b: Float32, threshold_px: float, lenses: Sequence[tuple[Camera, Camera]] = ()
) -> NDArray[np.bool_]:
    """Inliers of matches (N, 2), (N, 2) px for one fundamental matrix; all where none is found.

    cv2.findFundamentalMat with USAC_MAGSAC. lenses: of either picture, whose distortion is undone;
    distances from the epipolar lines are then angles, in pixels of the middle of the picture. Of
    several pairs of lenses that may be right the one with most inliers counts.
    """
    if len(lenses) > 1:
        found = [on_epipolar_lines(a, b, threshold_px, [pair]) for pair in lenses]
        return max(found, key=np.count_nonzero)
    if lenses and not all(lens.is_pinhole for lens in lenses[0]):
        return _on_epipolar_planes(a, b, threshold_px, lenses[0])
    if len(a) < 16:
        return np.ones(len(a), bool)
    model = _fundamental(a, b, threshold_px)
    return np.ones(len(a), bool) if model is None else model[1]


def _on_epipolar_planes(
    a: Float32, b: Float32, threshold_px: float, lenses: tuple[Camera, Camera]
) -> NDArray[np.bool_]:
    seen_by = zip(lenses, (a, b), strict=True)
    ray_a, ray_b = (lens.rays(uv.astype(np.float64)) for lens, uv in seen_by)
    seen = np.isfinite(ray_a[:, 0]) & np.isfinite(ray_b[:, 0])
    if seen.sum() < 16:
        return np.ones(len(a), bool)
    f = np.sqrt(lenses[0].fx * lenses[1].fx)
    flat = [f * ray[seen, :2] / ray[seen, 2:] for ray in (ray_a, ray_b)]
    found = _fundamental(flat[0], flat[1], threshold_px)
    if found is None:
        return np.ones(len(a), bool)
    F = found[0] * np.array([f, f, 1.0]) * np.array([[f], [f], [1.0]])
    distance = np.zeros(len(a))
    for there, normal in ((ray_b, ray_a @ F.T), (ray_a, ray_b @ F)):
        sine = (there * normal).sum(1) / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
        distance = np.maximum(distance, np.abs(sine) * f)
    return np.asarray(seen & (distance < threshold_px))


def _fundamental(
    a: Float | Float32, b: Float | Float32, threshold_px: float
) -> tuple[Float, NDArray[np.bool_]] | None:
    """F (3, 3) and its inliers (N,); None if the matches do not determine it."""
    try:
        F, mask = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, threshold_px, 0.999, 500)
    except cv2.error:  # raised if no sample gives a model
        return None
    if F is None or mask is None:
        return None
    _, far = cv2.findHomography(a, b, cv2.USAC_MAGSAC, threshold_px, None, 500, 0.99)
    if far is not None and far.mean() > MOSTLY_FAR:
        return None
    return np.asarray(F, np.float64), np.asarray(mask.ravel() > 0)


def sift_homography(primary: Gray, assistant: Gray) -> Float | None:
    """Rough H_a_p (3, 3) from primary to assistant pixels, from SIFT matches (Lowe, IJCV 2004).

    It covers rotation and zoom between the cameras; parallax is left to Lucas-Kanade.
    """
    primary, assistant = evened(primary, assistant)
    sift = cv2.SIFT.create(nfeatures=1500)
    ka, da = sift.detectAndCompute(primary, None)
    kb, db = sift.detectAndCompute(assistant, None)
    if da is None or db is None or len(ka) < 8 or len(kb) < 8:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(da, db, k=2)
    good = [p[0] for p in pairs if len(p) == 2 and p[0].distance < 0.75 * p[1].distance]
    if len(good) < 12:
        return None
    a = np.array([ka[g.queryIdx].pt for g in good], np.float32)
    b = np.array([kb[g.trainIdx].pt for g in good], np.float32)
    keep = on_epipolar_lines(a, b, 2.0)
    if keep.sum() < 12:
        return None
    H, _ = cv2.findHomography(a[keep], b[keep], cv2.RANSAC, 0.03 * long_side(primary))
    return None if H is None else np.asarray(H, np.float64)


def _apply(H: Float, uv: Float32) -> Float32:
    q = np.c_[uv, np.ones(len(uv))] @ H.T
    return np.asarray(q[:, :2] / q[:, 2:], np.float32)


def temporal_tracks(
    pictures: list[Gray],
    matching: Matching | None = None,
    lenses: Sequence[Camera] = (),
    used: Gray | None = None,
) -> Iterator[tuple[Int, Float32, Float32]]:
    """Corner tracks through consecutive pictures. lenses: that may be right. used: 0 if left out.

    Yields for each picture the track ids (n,), uv (n, 2) px and sigma (n,) px.
    """
    pairs = [(lens, lens) for lens in lenses]
    uv = detect_corners(pictures[0], np.zeros((0, 2), np.float32), used=used)
    ids, sights = np.arange(len(uv)), FirstSights()
    sights.add(pictures[0], uv)
    born = np.zeros(len(uv), np.int64)
    flow = np.zeros_like(uv)
    known = np.zeros(len(uv), bool)
    n_tracks = len(uv)
    sigma = np.full(len(uv), FOLLOWED_PX, np.float32)
    yield ids, uv, sigma
    for view, (source, target) in enumerate(pairwise(pictures), 1):
        if matching is None:
            moved, ok = _followed(source, target, uv, flow, known)
            sigma = np.full(len(uv), FOLLOWED_PX, np.float32)
        else:
            found = matching.along(source, target, uv)
            moved, ok, sigma = found.uv, found.sure, found.sigma_px
        inlier = np.flatnonzero(ok)
        inlier = inlier[on_epipolar_lines(uv[inlier], moved[inlier], EPIPOLAR_PX, pairs)]
        sights.keep(inlier)
        at, registered = sights.corrected(target, moved[inlier])
        # while young a track has not drifted yet, and its last step may be blurred
        kept = registered | (view - born[ids[inlier]] <= YOUNG_VIEWS)
        kept &= _in_used(used, at)
        inlier = inlier[kept]
        sights.keep(np.flatnonzero(kept))
        flow, uv, ids = at[kept] - uv[inlier], at[kept], ids[inlier]
        new = detect_corners(target, uv, used=used)
        ids = np.concatenate([ids, n_tracks + np.arange(len(new))])
        n_tracks += len(new)
        born = np.concatenate([born, np.full(len(new), view)])
        sights.add(target, new)
        known = np.r_[np.ones(len(uv), bool), np.zeros(len(new), bool)]
        flow = np.concatenate([flow, np.zeros_like(new)])
        uv = np.concatenate([uv, new])
        sigma = np.concatenate([sigma[inlier], np.full(len(new), FOLLOWED_PX, np.float32)])
        yield ids, uv, sigma


def _in_used(used: Gray | None, uv: Float32) -> NDArray[np.bool_]:
    """Whether uv (N, 2) px, inside the picture, are in a part that is not left out."""
    if used is None:
        return np.ones(len(uv), bool)
    height, width = used.shape
    column, row = np.clip(np.round(uv).astype(int), 0, [width - 1, height - 1]).T
    return np.asarray(used[row, column] > 0)


def _followed(
    source: Gray, target: Gray, uv: Float32, flow: Float32, known: NDArray[np.bool_]
) -> tuple[Float32, NDArray[np.bool_]]:
    """Track uv (N, 2) px by Lucas-Kanade: positions (N, 2) px and whether found (N,).

    Started from the `flow` (N, 2) px of the previous step where `known`, else from neighbours'.
    """
    moved, ok = follow(source, target, uv, uv + neighbouring_flow(uv, flow, known), MATCHING)
    if not known.any() and ok.sum() > 20:
        # the first pair of pictures had no guess: try lost points again from their neighbours' flow
        guess = uv + neighbouring_flow(uv, moved - uv, ok)
        again, ok_again = follow(source, target, uv, guess, MATCHING)
        moved, ok = np.where(ok[:, None], moved, again), ok | ok_again
    return moved, ok


def across_eyes(
    primary: Gray,
    assistant: Gray,
    H_a_p: Float,
    uv: Float32,
    guess: Float32,
    lenses: Sequence[tuple[Camera, Camera]] = (),
) -> tuple[Float32, NDArray[np.bool_]]:
    """Match primary corners uv (N, 2) px to the assistant: (N, 2) px and whether found (N,).

    The assistant is first warped by H_a_p to look like the primary, so that patches match in zoom
    and roll. guess: (N, 2) px, expected motion from primary to warped picture, i.e. parallax.
    lenses: of primary and assistant, that may be right.
    """
    height, width = primary.shape
    warped = cv2.warpPerspective(
        assistant, H_a_p, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    )
    seen = cv2.warpPerspective(
        np.full(assistant.shape, 255, np.uint8), H_a_p, (width, height),
        flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
    )  # fmt: skip
    seen = cv2.erode(seen, np.ones((MATCHING.window_px, MATCHING.window_px), np.uint8))
    moved, ok = follow(primary, np.asarray(warped, np.uint8), uv, uv + guess, MATCHING)
    xy = np.round(moved).astype(int)
    xy = np.clip(xy, 0, [width - 1, height - 1])
    ok &= seen[xy[:, 1], xy[:, 0]] > 0
    index = np.flatnonzero(ok)
    there = _apply(H_a_p, moved[index])
    keep = on_epipolar_lines(uv[index], there, EPIPOLAR_PX, lenses)
    out = np.zeros_like(uv)
    out[index] = there
    ok[index[~keep]] = False
    return out, ok


def window_tracks(
    primary: list[Gray],
    assistant: list[Gray],
    partner: list[int],
    H_a_p: Float | None,
    matching: Matching | None = None,
    lenses: Sequence[tuple[Camera, Camera]] = (),
    used: tuple[Gray | None, Gray | None] = (None, None),
) -> Tracks:
    """All tracks of a window. partner: for each assistant view the primary index nearest in time.

    H_a_p: the infinite homography of a known kit (Hartley and Zisserman, "Multiple View Geometry",
    13.4); None to estimate it from matches. lenses: of primary and assistant, that may be right.
    used: (H, W) of either, 0 where the picture is left out; None: all of it is used.
    """
    if matching is not None:
        matching.expect(primary, assistant, H_a_p)
    if H_a_p is None:
        H_a_p = _first_homography(primary, assistant, partner, matching)
    parallax: dict[int, Float32] = {}
    own_lenses = list(dict.fromkeys(pair[0] for pair in lenses))

    def across(j: int, ids: Int, points: Float32, H_a_p: Float) -> Rows:
        eyes = primary[partner[j]], assistant[j]
        if matching is None:
            there, ok = _across_from(parallax, ids, *eyes, H_a_p, points, lenses)
            sigma = np.full(len(ids), FOLLOWED_PX, np.float32)
        else:
            found = matching.across(*eyes, H_a_p, points)
            there, ok, sigma = found.uv, found.sure, found.sigma_px
            index = np.flatnonzero(ok)
            kept = on_epipolar_lines(points[index], there[index], EPIPOLAR_PX, lenses)
            ok[index[~kept]] = False
        index = np.flatnonzero(ok)
        ok[index[~_in_used(used[1], there[index])]] = False
        view = np.full(int(ok.sum()), len(primary) + j)
        return ids[ok], view, there[ok], sigma[ok], edges(assistant[j], there[ok])

    rows: list[Rows] = []
    # a view's points are matched across the eyes while they are tracked to the next view
    with ThreadPoolExecutor(1, "across") as beside:
        found_across, n_before = [], 0
        followed = temporal_tracks(primary, matching, own_lenses, used[0])
        for i, (ids, uv, sigma) in enumerate(followed):
            edge = edges(primary[i], uv)
            edge[ids >= n_before] = 0
            n_before = max(n_before, int(ids.max(initial=-1)) + 1)
            rows.append((ids, np.full(len(ids), i), uv, sigma, edge))
            if H_a_p is not None:
                own = [j for j, primary_view in enumerate(partner) if primary_view == i]
                found_across += [beside.submit(across, j, ids, uv, H_a_p) for j in own]
        rows += [each.result() for each in found_across]
    track, view, *columns = (np.concatenate(column) for column in zip(*rows, strict=True))
    return Tracks(track, view, *(column.astype(np.float64) for column in columns))


def _first_homography(
    primary: list[Gray], assistant: list[Gray], partner: list[int], matching: Matching | None
) -> Float | None:
    """H_a_p (3, 3) of the first pair with enough matches, tried from the middle of the window."""
    homography = sift_homography if matching is None else matching.homography
    tried = (homography(primary[partner[j]], assistant[j]) for j in _spread(len(assistant)))
    return next((H_a_p for H_a_p in tried if H_a_p is not None), None)


def _across_from(
    parallax: dict[int, Float32],
    ids: Int,
    primary: Gray,
    assistant: Gray,
    H_a_p: Float,
    points: Float32,
    lenses: Sequence[tuple[Camera, Camera]],
) -> tuple[Float32, NDArray[np.bool_]]:
    """`across_eyes` from points with track ids `ids`, started from their parallax in earlier views.

    parallax: (2,) px by track id; the result is stored in it.
    """
    known = np.array([i in parallax for i in ids], bool)
    flow = np.zeros_like(points)
    if known.any():
        flow[known] = [parallax[i] for i in ids[known]]
    guess = neighbouring_flow(points, flow, known)
    there, ok = across_eyes(primary, assistant, H_a_p, points, guess, lenses)
    back = _apply(np.asarray(np.linalg.inv(H_a_p), np.float64), there[ok])
    parallax.update(zip(ids[ok].tolist(), back - points[ok], strict=True))
    return there, ok


def _spread(n: int) -> list[int]:
    """Indices 0..n-1, middle first."""
    return sorted(range(n), key=lambda i: abs(i - n // 2))
