"""Live pose of every primary frame by KLT and PnP against the points of the newest sub-map.

The poses are continuous in an odometry frame: a new sub-map changes `T_map_odom` (ROS REP 105).
Only after tracking was lost the pose jumps, and the epoch is incremented.
"""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import replace

import numpy as np

from calm_edge.config import FrontendConfig
from calm_edge.frontend import candidates, landmark_cloud
from calm_edge.frontend.candidates import Candidates
from calm_edge.frontend.drift import Drift
from calm_edge.frontend.remembered import MAX_REMEMBERED, REMEMBERED_NS, PastFrame, Tracks, spaced
from calm_edge.frontend.submap_errors import SubmapErrors
from calm_edge.frontend.velocity import RecentPath
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.flow import follow, long_side
from calm_edge.geometry.pnp import PoseFit, locate, reprojection
from calm_edge.geometry.shutter import at_middle_row
from calm_edge.kit.estimated import readout_s
from calm_edge.types import Bytes, Float, Float32, LocalizerUpdate, PoseSample, PoseStatus

MIN_INLIERS, SAFE_INLIERS = 12, 80
# Time between frames used for tracking a new sub-map to the newest frame, and when catching up:
# four frames and one at 10 Hz, less a tolerance for jitter.
HOP_NS, CATCH_UP_NS = 390_000_000, 90_000_000
# Past frames tracked per new frame while catching up: bounds the added latency. More are tracked
# while there is no pose that could be delayed.
CATCH_UP_FRAMES, CATCH_UP_FRAMES_LOST = 2, 3
INLIER_PX = 3.0
# Largest |log ratio| of the distances between the same frames in the new sub-map and in the old
# track; if it is larger, the old track is dropped.
MAX_DISAGREEMENT = 0.2


class Tracker:
    """Computes the live pose: `track` and `prepare` each primary frame, `attach` each sub-map."""

    def __init__(self, config: FrontendConfig, epoch: int = 0) -> None:
        self.config = config
        self.T_map_odom: Float = np.eye(4)
        self.epoch = epoch
        self.lagging = False
        self._tracks: Tracks | None = None
        self._readout_s = 0.0
        self._candidates = Candidates.none()
        self._pending: tuple[Bytes, Float] | None = None
        self._past: deque[PastFrame] = deque(maxlen=MAX_REMEMBERED)
        self._path = RecentPath()
        self._ever_tracked = False
        self._follower: Tracker | None = None
        self._followed_ns = 0
        self._drift = Drift()
        self._replaced = 0.0
        self._mask: Bytes | None = None
        # of the last pose: pixels of its points now, and in the frame they were tracked from (M, 4)
        self.moves = np.zeros((0, 4), np.float32)

    def track(self, t_ns: int, gray: Bytes, *, own_stamp: bool = True) -> PoseSample:
        """Pose of the frame exposed at t_ns; LOST and NaN if it cannot be localised.

        own_stamp: False if t_ns is not measured: the sample has no velocity then, and later
        velocities do not use it.
        """
        self.moves = self.moves[:0]
        guess = self._predict(t_ns)
        fit = self._follow(gray, guess, t_ns if own_stamp else None)
        T_m_c = None if fit is None else fit.T_w_c
        self._past.append(PastFrame(t_ns, gray, None, T_m_c))
        while t_ns - self._past[0].t_ns >= REMEMBERED_NS:
            self._past.popleft()
        tracks = self._tracks
        if fit is None or tracks is None:
            # short gaps, e.g. blurred frames, are bridged
            if self._path and t_ns - self._path.newest_ns > self.config.lost_after_ms * 1e6:
                self._tracks = None
                self._candidates = Candidates.none()
                self._path.clear()
            nothing = np.full((4, 4), np.nan), np.full(3, np.nan), np.full((6, 6), np.nan)
            return PoseSample(t_ns, *nothing, self.epoch, PoseStatus.LOST)
        T_o_c = se3.inverse(self.T_map_odom) @ fit.T_w_c
        self._path.add(t_ns, T_o_c, fit.covariance, own_stamp=own_stamp)
        twist, twist_covariance = self._path.twist()
        errors, drift = tracks.errors, self._drift
        slower = errors.of_turn(twist[3:])
        metric = tracks.submap_errors.metric
        if not metric:
            drift.restart()
        elif self._pending is not None:
            drift.move(T_o_c, errors, fit.covariance, self._replaced)
        status = PoseStatus.LAGGING if self.lagging else PoseStatus.LIVE
        if not metric:
            status = PoseStatus.UNSCALED
        return PoseSample(
            t_ns,
            T_o_c,
            twist[:3],
            fit.covariance,
            self.epoch,
            status,
            turn_rate_c=twist[3:],
            twist_covariance=twist_covariance + np.outer(slower, slower),
            scale_log_sigma=errors.scale_log_sigma,
            scale_offset=drift.scale_offset,
            focal_offset=drift.focal_offset,
            drift=drift.covariance,
        )

    def prepare(self, keyframe_id: int | None = None, *, behind: bool = False) -> None:
        """Prepare for the next frame; call it after the pose has been published.

        keyframe_id: of the frame just tracked, if it is a keyframe. behind: newer frames are
        waiting, so that catching up is put off.
        """
        self._past[-1].keyframe_id, self._replaced = keyframe_id, 0.0
        if self._pending is not None and self._tracks is not None:
            self._tracks = self._triangulated(self._tracks, *self._pending)
        self._pending = None
        if not behind or self._tracks is None:
            self._advance_follower()

    def restart(self) -> None:
        """Forget all frames and points: the pictures that follow are of another size."""
        self._tracks = self._pending = self._follower = None
        self._candidates = Candidates.none()
        self._past.clear()
        self._path.clear()

    def attach(self, update: LocalizerUpdate) -> bool:
        """Switch to the points of a new sub-map; False if its keyframes are no longer kept.

        The points are tracked from their keyframes to the newest frame in hops of several frames.
        If that fails, the frames since are tracked one by one, some with each new frame, and the
        old points are used until then.
        """
        self._readout_s = readout_s(update)
        self._mask = None if update.masks is None else update.masks.primary
        newest_id, errors = update.submap.primary_ids[-1], SubmapErrors.of_update(update)
        place = {p.keyframe_id: i for i, p in enumerate(self._past) if p.keyframe_id is not None}
        newest = self._past[place[newest_id]].gray if newest_id in place else None
        cloud = landmark_cloud.of_update(update, self.config.tracker_points, newest)
        T_w_c = dict(zip(update.submap.primary_ids, update.submap.T_w_c(), strict=False))
        starts = sorted({place[i] for i in cloud.keyframe_id.tolist() if i in place})
        if not starts:
            return False
        camera = update.submap.cameras[update.submap.n_primary - 1]
        origin = np.array([place.get(i, -1) for i in cloud.keyframe_id.tolist()])
        known = {place[i]: T for i, T in T_w_c.items() if i in place}
        p_m, uv, T_now, gray = self._track_to_newest(camera, cloud.p_w, cloud.uv, origin, known)
        fit = self._locate(camera, p_m, uv, T_now, gray)
        if fit is None or fit.n_inliers < SAFE_INLIERS:
            newest_only = origin == starts[-1]
            start = Tracks(camera, cloud.p_w[newest_only], cloud.uv[newest_only], gray, errors)
            return self._catch_up(starts[-1], start, known)
        ratio = self._scale_ratio(starts[-1], known[starts[-1]], fit.T_w_c)
        self._follower = None
        T_new_old = self._switch(fit.T_w_c)
        p_m, uv = p_m[fit.inlier], uv[fit.inlier]
        old = self._tracks
        if T_new_old is not None and ratio is not None and old is not None and old.seen_in is gray:
            # add the old points: only few of the new ones may still be visible
            room = max(0, self.config.tracker_points - len(uv))
            centre = fit.T_w_c[:3, 3]
            followed = se3.transform(T_new_old, old.p_m[:room])
            p_m = np.concatenate([p_m, centre + ratio * (followed - centre)])
            uv = np.concatenate([uv, old.uv[:room]])
        self._tracks = Tracks(camera, p_m, uv, gray, errors)
        return True

    def _catch_up(self, keyframe: int, start: Tracks, known: dict[int, Float]) -> bool:
        """Begin to track the past frames since a keyframe one by one, in a second tracker.

        Slower than tracking over spaced frames, but new points replace those that leave the view.
        False if a second tracker is already nearer to the newest frame: restarted each time, none
        would finish.
        """
        first, running = self._past[keyframe], self._follower
        if running is not None and running._tracks is not None and self._followed_ns >= first.t_ns:
            return False
        self._follower = Tracker(self.config)
        self._follower._readout_s = self._readout_s
        self._follower._mask = self._mask
        self._follower._tracks = replace(start, seen_in=first.gray)
        self._follower._path.add(first.t_ns, known[keyframe])
        self._followed_ns = first.t_ns
        return True

    def _advance_follower(self) -> None:
        """Track some more frames in the second tracker; take its tracks when it has caught up."""
        follower = self._follower
        if follower is None:
            return
        times = [past.t_ns for past in self._past]
        ahead = [self._past[i] for i in spaced(times, self._followed_ns, CATCH_UP_NS)]
        count = CATCH_UP_FRAMES_LOST if self._tracks is None else CATCH_UP_FRAMES
        for past in ahead[:count]:
            follower.track(past.t_ns, past.gray)
            follower.prepare()
            self._followed_ns = past.t_ns
        if len(ahead) <= count:
            self._follower = None
            T_w_c = follower._past[-1].T_m_c if follower._past else None
            if T_w_c is not None:
                self._switch(T_w_c)
                self._tracks, self._candidates = follower._tracks, follower._candidates

    def _scale_ratio(self, keyframe: int, T_w_k: Float, T_w_c: Float) -> float | None:
        """Ratio of lengths in the new map to those in the old one.

        Compares the distance from a past keyframe (pose T_w_k) to the newest frame (T_w_c). None
        if the old map lacks either pose, or if |log ratio| exceeds MAX_DISAGREEMENT.
        """
        T_old_k, T_old_c = self._past[keyframe].T_m_c, self._past[-1].T_m_c
        if T_old_k is None or T_old_c is None:
            return None
        old = float(np.linalg.norm(T_old_c[:3, 3] - T_old_k[:3, 3]))
        new = float(np.linalg.norm(T_w_c[:3, 3] - T_w_k[:3, 3]))
        if min(old, new) <= 0 or abs(np.log(new / old)) > MAX_DISAGREEMENT:
            return None
        return new / old

    def _threshold(self, gray: Bytes) -> float:
        return float(max(2.0, INLIER_PX * long_side(gray) / self.config.flow_reference_width_px))

    def _follow(self, gray: Bytes, T_predicted: Float | None, t_ns: int | None) -> PoseFit | None:
        """Pose by the tracks; None without one that a car can have at t_ns (None: not measured)."""
        tracks = self._tracks
        if tracks is None or T_predicted is None or len(tracks.p_m) < MIN_INLIERS:
            return None
        if tracks.seen_in.shape != gray.shape:
            return None
        moved, good = follow(tracks.seen_in, gray, tracks.uv, self._guess(T_predicted))
        p_m, uv = tracks.p_m[good], moved[good]
        step = np.linalg.norm(uv - tracks.uv[good], axis=1)
        fit = self._locate(tracks.camera, p_m, uv, T_predicted, gray)
        if fit is None or fit.n_inliers < MIN_INLIERS:
            return None
        T_o_c = se3.inverse(self.T_map_odom) @ fit.T_w_c
        # such as by tracks that jumped by a period of a barrier
        if t_ns is not None and tracks.submap_errors.metric and self._path.jumps(t_ns, T_o_c):
            return None
        self.moves = np.hstack([moved[good], tracks.uv[good]])[fit.inlier]
        # at standstill the image tracked from is kept, so that noise does not cause drift
        if np.median(step) >= self.config.standstill_px:
            seen = p_m[fit.inlier], uv[fit.inlier]
            self._tracks = Tracks(tracks.camera, *seen, gray, tracks.submap_errors, tracks.own)
            self._pending = tracks.seen_in, fit.T_w_c
        return fit

    def _locate(
        self, camera: Camera, p_m: Float, uv: Float32, T_m_c: Float, gray: Bytes
    ) -> PoseFit | None:
        """Pose of the middle row by PnP, from a predicted pose; see `locate`."""
        seen: Float | Float32 = uv
        twist = self._path.twist()[0] if self._path else np.full(6, np.nan)
        if self._readout_s and np.isfinite(twist).all():
            p_c = se3.transform(se3.inverse(T_m_c), p_m)
            seen = at_middle_row(camera, p_c, uv, twist, self._readout_s)
        return locate(camera, p_m, seen.astype(np.float32), T_m_c, self._threshold(gray))

    def _triangulated(self, tracks: Tracks, previous: Bytes, T_m_c: Float) -> Tracks:
        """Add triangulated candidates to the tracks, and detect new candidates if there is room."""
        self._candidates, p_m, uv = candidates.step(
            self._candidates, previous, tracks.seen_in, tracks.camera, T_m_c
        )
        self._replaced = len(p_m) / max(1, len(p_m) + len(tracks.p_m))
        p_m, uv = np.concatenate([tracks.p_m, p_m]), np.concatenate([tracks.uv, uv])
        room = self.config.tracker_points - len(uv)
        if len(self._candidates.uv) < room / 2:
            self._candidates = candidates.replenish(
                self._candidates, tracks.seen_in, uv, T_m_c, room, self._mask
            )
        own = tracks.own + self._replaced * (1 - tracks.own)
        return replace(tracks, p_m=p_m, uv=uv, own=own)

    def _guess(self, T_predicted: Float) -> Float32 | None:
        """Predicted pixels (M, 2) of the tracks, shifted by the predicted motion."""
        tracks, last = self._tracks, self._path.newest if self._path else None
        if tracks is None or last is None:
            return None
        there, _ = reprojection(tracks.camera, tracks.p_m, T_predicted)
        here, _ = reprojection(tracks.camera, tracks.p_m, self.T_map_odom @ last)
        with np.errstate(invalid="ignore"):
            shift = there - here
        shift[~np.isfinite(shift).all(1)] = 0.0
        return np.asarray(tracks.uv + shift, np.float32)

    def _predict(self, t_ns: int) -> Float | None:
        """Predicted pose at t_ns by constant velocity, map frame."""
        T_o_c = self._path.predict(t_ns)
        return None if T_o_c is None else np.asarray(self.T_map_odom @ T_o_c)

    def _switch(self, T_w_c: Float) -> Float | None:
        """Switch to a new map, in which the newest frame has pose T_w_c.

        Returns the transform old map->new map, None if tracking was lost.
        """
        newest, T_new_old = self._past[-1], None
        if newest.T_m_c is not None:
            T_o_c = self._path.newest
            self.T_map_odom = T_w_c @ se3.inverse(T_o_c)
            T_new_old = T_w_c @ se3.inverse(newest.T_m_c)
            self._candidates = self._candidates.moved_to(T_new_old)
            for past in self._past:
                past.T_m_c = None if past.T_m_c is None else T_new_old @ past.T_m_c
            if self._tracks is not None and not self._tracks.submap_errors.metric:
                # in another unit: no velocity must be computed across
                self._path.clear()
                self._path.add(newest.t_ns, T_o_c)
        else:
            # odometry was interrupted: T_map_odom is kept, and the pose jumps
            self.epoch += self._ever_tracked
            self._drift.restart()
            self._candidates = Candidates.none()
            for past in self._past:
                past.T_m_c = None
            self._path.clear()
            self._path.add(newest.t_ns, se3.inverse(self.T_map_odom) @ T_w_c)
        newest.T_m_c = T_w_c
        self._ever_tracked = True
        return T_new_old

    def _track_to_newest(
        self, camera: Camera, p_w: Float, uv: Float32, origin: np.ndarray, known: dict[int, Float]
    ) -> tuple[Float, Float32, Float, Bytes]:
        """Track points (M, 3), observed at uv (M, 2) in past frame `origin` (M,), to the newest.

        known: world poses of past keyframes. Returns the remaining points and their pixels, the
        predicted pose of the newest frame, and its image.
        """
        past, last = list(self._past), len(self._past) - 1
        starts = sorted(set(origin[origin >= 0].tolist()))
        times = [frame.t_ns for frame in past]
        stops = sorted({*starts, *spaced(times, times[starts[-1]], HOP_NS), last})
        alive = np.zeros((0,), np.int64)
        now: Float32 = np.zeros((0, 2), np.float32)
        gray = past[stops[0]].gray
        T = known[stops[0]]
        for here, there in itertools.pairwise([*stops, last]):
            T = known.get(here, T)
            fresh = np.flatnonzero(origin == here)
            alive, now = np.concatenate([alive, fresh]), np.concatenate([now, uv[fresh]])
            if here == there:
                break
            for a, b in self._hops(here, there):
                T_a, T_b = past[a].T_m_c, past[b].T_m_c
                guess = None
                if T_a is not None and T_b is not None:
                    T = T @ se3.inverse(T_a) @ T_b
                    seen, _ = reprojection(camera, p_w[alive], T)
                    guess = np.where(np.isfinite(seen), seen, now).astype(np.float32)
                ahead = past[b].gray
                now, good = follow(gray, ahead, now, guess)
                alive, now, gray = alive[good], now[good], ahead
        return p_w[alive], now, T, gray

    def _hops(self, here: int, there: int) -> list[tuple[int, int]]:
        """Pairs of past frames to track between, from `here` to `there`; one if both have poses."""
        past = self._past
        if past[here].T_m_c is not None and past[there].T_m_c is not None:
            return [(here, there)]
        times = [frame.t_ns for frame in past]
        between = spaced(times[: there + 1], times[here], CATCH_UP_NS)
        return list(itertools.pairwise([here, *between]))
