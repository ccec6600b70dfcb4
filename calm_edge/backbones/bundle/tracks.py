"""Correspondences: corners followed through the primary keyframes and across to the assistant.

Sparse corners with a forward-backward check carry 0.2-0.45 px; dense classical flow is too biased
for bundle adjustment. A learned encoder can take this file's place: it only has to make a Tracks.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.flow import Gray, LucasKanade, away_from, follow
from calm_edge.types import Float, Float32, Int

CORNERS_PER_VIEW = 320
GRID = (8, 4)  # columns, rows: corners are spread over the picture
EPIPOLAR_PX = 1.0
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
    """Observations as rows: track (O,), view (O,) batch index, uv (O, 2) px."""

    track: Int
    view: Int
    uv: Float


def detect_corners(gray: Gray, known: Float32, count: int = CORNERS_PER_VIEW) -> Float32:
    """New Shi-Tomasi corners (N, 2), spread over a grid, away from `known` (M, 2)."""
    height, width = gray.shape
    distance = max(5.0, width / 110)
    mask = away_from((height, width), known, distance)
    columns, rows = GRID
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


def on_epipolar_lines(a: Float32, b: Float32, threshold_px: float) -> NDArray[np.bool_]:
    """Which matches (N, 2), (N, 2) one fundamental matrix explains; all when none is found."""
    if len(a) < 16:
        return np.ones(len(a), bool)
    try:
        F, mask = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, threshold_px, 0.999, 500)
    except cv2.error:  # its own assertion, where no sample gives a model
        return np.ones(len(a), bool)
    if F is None or mask is None:
        return np.ones(len(a), bool)
    return np.asarray(mask.ravel() > 0)


def _smoothed_guess(uv: Float32, flow: Float32, known: NDArray[np.bool_]) -> Float32:
    """Flow (N, 2) with unknown entries filled from the nearest known ones' median."""
    if not known.any():
        return np.zeros_like(flow)
    if known.all():
        return flow
    distance = np.linalg.norm(uv[~known][:, None] - uv[known][None], axis=2)
    k = min(5, int(known.sum()))
    nearest = np.argpartition(distance, k - 1, axis=1)[:, :k]
    filled = flow.copy()
    filled[~known] = np.median(flow[known][nearest], axis=1)
    return filled


def sift_homography(primary: Gray, assistant: Gray) -> Float | None:
    """Rough H_a_p (3, 3) taking primary pixels to assistant pixels, from wide-baseline matches.

    It stands for the rotation and the zoom between the eyes; parallax is LK's to find.
    """
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
    H, _ = cv2.findHomography(a[keep], b[keep], cv2.RANSAC, 0.03 * primary.shape[1])
    return None if H is None else np.asarray(H, np.float64)


def _apply(H: Float, uv: Float32) -> Float32:
    q = np.c_[uv, np.ones(len(uv))] @ H.T
    return np.asarray(q[:, :2] / q[:, 2:], np.float32)


def temporal_tracks(pictures: list[Gray]) -> list[tuple[Int, Float32]]:
    """Corner tracks through consecutive pictures: per view the track ids (n,) and uv (n, 2)."""
    uv = detect_corners(pictures[0], np.zeros((0, 2), np.float32))
    ids = np.arange(len(uv))
    flow = np.zeros_like(uv)
    known = np.zeros(len(uv), bool)
    n_tracks = len(uv)
    views = [(ids, uv)]
    for source, target in pairwise(pictures):
        moved, ok = follow(source, target, uv, uv + _smoothed_guess(uv, flow, known), MATCHING)
        if not known.any() and ok.sum() > 20:
            # the first pair had no guess: let its neighbours' flow give a second chance
            again, ok_again = follow(
                source, target, uv, uv + _smoothed_guess(uv, moved - uv, ok), MATCHING
            )
            moved, ok = np.where(ok[:, None], moved, again), ok | ok_again
        inlier = np.flatnonzero(ok)
        inlier = inlier[on_epipolar_lines(uv[inlier], moved[inlier], EPIPOLAR_PX)]
        flow, uv, ids = (moved - uv)[inlier], moved[inlier], ids[inlier]
        new = detect_corners(target, uv)
        ids = np.concatenate([ids, n_tracks + np.arange(len(new))])
        n_tracks += len(new)
        known = np.r_[np.ones(len(uv), bool), np.zeros(len(new), bool)]
        flow = np.concatenate([flow, np.zeros_like(new)])
        uv = np.concatenate([uv, new])
        views.append((ids, uv))
    return views


def across_eyes(
    primary: Gray, assistant: Gray, H_a_p: Float, uv: Float32, guess: Float32
) -> tuple[Float32, NDArray[np.bool_]]:
    """Primary corners uv (N, 2) found in the assistant -> (uv, ok).

    The assistant is warped by H_a_p to look like the primary first, so zoom and roll do not
    disturb the patches. guess: (N, 2) parallax left after the warp, px.
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
    keep = on_epipolar_lines(uv[index], there, EPIPOLAR_PX)
    out = np.zeros_like(uv)
    out[index] = there
    ok[index[~keep]] = False
    return out, ok


def window_tracks(
    primary: list[Gray], assistant: list[Gray], partner: list[int], H_a_p: Float | None
) -> Tracks:
    """All tracks of a window. partner: for each assistant view the primary index nearest in time.

    H_a_p: the infinite homography when the kit is known, else it is found by SIFT.
    """
    views = temporal_tracks(primary)
    track = [ids for ids, _ in views]
    view = [np.full(len(ids), i) for i, (ids, _) in enumerate(views)]
    uv = [p for _, p in views]
    if H_a_p is None:
        for j in _spread(len(assistant)):
            H_a_p = sift_homography(primary[partner[j]], assistant[j])
            if H_a_p is not None:
                break
    if H_a_p is not None:
        parallax: dict[int, Float32] = {}
        for j, gray in enumerate(assistant):
            ids, points = views[partner[j]]
            known = np.array([i in parallax for i in ids], bool)
            flow = np.zeros_like(points)
            if known.any():
                flow[known] = [parallax[i] for i in ids[known]]
            there, ok = across_eyes(
                primary[partner[j]], gray, H_a_p, points, _smoothed_guess(points, flow, known)
            )
            back = _apply(np.asarray(np.linalg.inv(H_a_p), np.float64), there[ok])
            parallax.update(zip(ids[ok].tolist(), back - points[ok], strict=True))
            track.append(ids[ok])
            view.append(np.full(int(ok.sum()), len(primary) + j))
            uv.append(there[ok])
    return Tracks(
        np.concatenate(track), np.concatenate(view), np.concatenate(uv).astype(np.float64)
    )


def _spread(n: int) -> list[int]:
    """Indices 0..n-1, middle first: where to look first when any will do."""
    return sorted(range(n), key=lambda i: abs(i - n // 2))
