"""A pose for every primary frame against the newest sub-map's points: KLT + PnP.

The world of its poses is smooth odometry: a new sub-map moves `T_map_odom`, never a pose
(REP-105). Only after tracking was lost does the pose jump, and the epoch grows.
"""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import replace

import numpy as np

from calm_edge.config import FrontendConfig
from calm_edge.frontend import candidates, landmark_cloud
from calm_edge.frontend.candidates import Candidates
from calm_edge.frontend.remembered import MOST_REMEMBERED, REMEMBERED_NS, Past, Tracks, spaced
from calm_edge.frontend.velocity import RecentPath
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.flow import follow
from calm_edge.geometry.pnp import PoseFit, locate, reprojection
from calm_edge.types import Bytes, Float, Float32, LocalizerUpdate, PoseSample, PoseStatus

MIN_INLIERS, SAFE_INLIERS = 12, 80
# From one frame to the next, at ten a second four and one: the tolerance is for their jitter.
HOP_NS, CATCH_UP_NS = 390_000_000, 90_000_000
# Remembered frames tracked again with each new one: bounds what a late sub-map adds to latency.
# Without a pose there is nothing to be late.
CATCH_UP_FRAMES, CATCH_UP_FRAMES_LOST = 2, 3
INLIER_PX = 3.0
# of the logarithm of a length: beyond it the old track is not worth keeping
MAX_DISAGREEMENT = 0.2


class Tracker:
    """Owner of the live pose: primary frames to `track`, then `prepare`; updates to `attach`."""

    def __init__(self, config: FrontendConfig, epoch: int = 0) -> None:
        self.config = config
        self.T_map_odom: Float = np.eye(4)
        self.epoch = epoch
        self.lagging = False
        self._tracks: Tracks | None = None
        self._candidates = Candidates.none()
        self._unripe: tuple[Bytes, Float] | None = None
        self._past: deque[Past] = deque(maxlen=MOST_REMEMBERED)
        self._path = RecentPath()
        self._ever_tracked = False
        self._follower: Tracker | None = None
        self._followed_ns = 0

    def track(self, t_ns: int, gray: Bytes) -> PoseSample:
        """The pose of the frame exposed at t_ns; without a fresh track LOST, all NaN."""
        guess = self._predict(t_ns)
        fit = self._follow(gray, guess)
        T_m_c = None if fit is None else fit.T_w_c
        self._past.append(Past(t_ns, gray, None, T_m_c))
        while t_ns - self._past[0].t_ns >= REMEMBERED_NS:
            self._past.popleft()
        if fit is None:
            # a blurred frame or two may be bridged; after that the track is gone
            if self._path and t_ns - self._path.newest_ns > self.config.lost_after_ms * 1e6:
                self._tracks = None
                self._candidates = Candidates.none()
                self._path.clear()
            nothing = np.full((4, 4), np.nan), np.full(3, np.nan), np.full((6, 6), np.nan)
            return PoseSample(t_ns, *nothing, self.epoch, PoseStatus.LOST)
        T_o_c = se3.inverse(self.T_map_odom) @ fit.T_w_c
        self._path.add(t_ns, T_o_c, fit.covariance)
        twist, twist_covariance = self._path.twist()
        status = PoseStatus.LAGGING if self.lagging else PoseStatus.LIVE
        return PoseSample(
            t_ns,
            T_o_c,
            twist[:3],
            fit.covariance,
            self.epoch,
            status,
            turn_rate_c=twist[3:],
            twist_covariance=twist_covariance,
        )

    def prepare(self, keyframe_id: int | None = None, *, in_haste: bool = False) -> None:
        """What the next frame needs and this one's pose did not: call it when the pose has left.

        keyframe_id: of the frame just tracked, when it became a keyframe. in_haste: newer frames
        wait.
        """
        self._past[-1].keyframe_id = keyframe_id
        if self._unripe is not None and self._tracks is not None:
            self._tracks = self._ripened(self._tracks, *self._unripe)
        self._unripe = None
        if not in_haste or self._tracks is None:
            self._advance_follower()

    def attach(self, update: LocalizerUpdate) -> bool:
        """Takes over a new sub-map's points where its keyframes are remembered; False if it cannot.

        The points are followed from their keyframes to the newest frame in hops. When that fails
        the frames since are tracked again, a few with each frame to come, and the old points stay
        until then: an old track is better than none, and is said to be LOST in time.
        """
        newest_id = update.submap.primary_ids[-1]
        place = {p.keyframe_id: i for i, p in enumerate(self._past) if p.keyframe_id is not None}
        newest = self._past[place[newest_id]].gray if newest_id in place else None
        cloud = landmark_cloud.of_update(update, self.config.tracker_points, newest)
        T_w_c = dict(zip(update.submap.primary_ids, update.submap.T_w_c(), strict=False))
        starts = sorted({place[i] for i in cloud.keyframe_id.tolist() if i in place})
        if not starts:
            return False
        camera = update.submap.cameras[update.submap.n_primary - 1]
        born = np.array([place.get(i, -1) for i in cloud.keyframe_id.tolist()])
        known = {place[i]: T for i, T in T_w_c.items() if i in place}
        p_m, uv, T_now, gray = self._bring_forward(camera, cloud.p_w, cloud.uv, born, known)
        fit = locate(camera, p_m, uv, T_now, self._threshold(gray))
        if fit is None or fit.n_inliers < SAFE_INLIERS:
            newest_born = born == starts[-1]
            start = Tracks(camera, cloud.p_w[newest_born], cloud.uv[newest_born], gray)
            return self._catch_up(starts[-1], start, known)
        ratio = self._scale_ratio(starts[-1], known[starts[-1]], fit.T_w_c)
        self._follower = None
        T_new_old = self._switch(fit.T_w_c)
        p_m, uv = p_m[fit.inlier], uv[fit.inlier]
        old = self._tracks
        if T_new_old is not None and ratio is not None and old is not None and old.seen_in is gray:
            # what is already followed is still seen where it was: few new points may reach so far
            room = max(0, self.config.tracker_points - len(uv))
            centre = fit.T_w_c[:3, 3]
            followed = se3.transform(T_new_old, old.p_m[:room])
            p_m = np.concatenate([p_m, centre + ratio * (followed - centre)])
            uv = np.concatenate([uv, old.uv[:room]])
        self._tracks = Tracks(camera, p_m, uv, gray)
        return True

    def _catch_up(self, keyframe: int, start: Tracks, known: dict[int, Float]) -> bool:
        """Begins to track the remembered frames since a keyframe as if they came now.

        Dearer than hops, but new points replace those that leave the view on the way. False where
        one that already follows is nearer to now: begun again each time, none would ever arrive.
        """
        first, running = self._past[keyframe], self._follower
        if running is not None and running._tracks is not None and self._followed_ns >= first.t_ns:
            return False
        self._follower = Tracker(self.config)
        self._follower._tracks = replace(start, seen_in=first.gray)
        self._follower._path.add(first.t_ns, known[keyframe])
        self._followed_ns = first.t_ns
        return True

    def _advance_follower(self) -> None:
        """A few frames nearer to now; once it is there, it takes over."""
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
        """New lengths over old ones, from the way between a remembered keyframe and now.

        None when the old track does not know that way, or disagrees by more than MAX_DISAGREEMENT.
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
        return float(max(2.0, INLIER_PX * gray.shape[1] / self.config.flow_reference_width_px))

    def _follow(self, gray: Bytes, T_predicted: Float | None) -> PoseFit | None:
        tracks = self._tracks
        if tracks is None or T_predicted is None or len(tracks.p_m) < MIN_INLIERS:
            return None
        if tracks.seen_in.shape != gray.shape:
            return None
        moved, good = follow(tracks.seen_in, gray, tracks.uv, self._guess(T_predicted))
        p_m, uv = tracks.p_m[good], moved[good]
        step = np.linalg.norm(uv - tracks.uv[good], axis=1)
        fit = locate(tracks.camera, p_m, uv, T_predicted, self._threshold(gray))
        if fit is None or fit.n_inliers < MIN_INLIERS:
            return None
        # while nothing moves the image tracked from stays, so that noise cannot become drift
        if np.median(step) >= self.config.standstill_px:
            self._tracks = Tracks(tracks.camera, p_m[fit.inlier], uv[fit.inlier], gray)
            self._unripe = tracks.seen_in, fit.T_w_c
        return fit

    def _ripened(self, tracks: Tracks, previous: Bytes, T_m_c: Float) -> Tracks:
        """The tracks and the candidates that became points; new candidates where there is room."""
        self._candidates, p_m, uv = candidates.step(
            self._candidates, previous, tracks.seen_in, tracks.camera, T_m_c
        )
        p_m, uv = np.concatenate([tracks.p_m, p_m]), np.concatenate([tracks.uv, uv])
        room = self.config.tracker_points - len(uv)
        if len(self._candidates.uv) < room / 2:
            self._candidates = candidates.replenish(
                self._candidates, tracks.seen_in, uv, T_m_c, room
            )
        return Tracks(tracks.camera, p_m, uv, tracks.seen_in)

    def _guess(self, T_predicted: Float) -> Float32 | None:
        """Where the tracks should be: their shift under the predicted motion, (M, 2) px."""
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
        """The pose at t_ns at constant velocity, map frame."""
        T_o_c = self._path.predict(t_ns)
        return None if T_o_c is None else np.asarray(self.T_map_odom @ T_o_c)

    def _switch(self, T_w_c: Float) -> Float | None:
        """The newest frame has a pose in the new map: carry the odometry over to it.

        Returns new map<-old map, None when the old track was lost.
        """
        newest, T_new_old = self._past[-1], None
        if newest.T_m_c is not None:
            T_o_c = self._path.newest
            self.T_map_odom = T_w_c @ se3.inverse(T_o_c)
            T_new_old = T_w_c @ se3.inverse(newest.T_m_c)
            self._candidates = self._candidates.moved_to(T_new_old)
            for past in self._past:
                past.T_m_c = None if past.T_m_c is None else T_new_old @ past.T_m_c
        else:
            # the odometry was cut: its frame stays where it was, and the pose jumps
            self.epoch += self._ever_tracked
            self._candidates = Candidates.none()
            for past in self._past:
                past.T_m_c = None
            self._path.clear()
            self._path.add(newest.t_ns, se3.inverse(self.T_map_odom) @ T_w_c)
        newest.T_m_c = T_w_c
        self._ever_tracked = True
        return T_new_old

    def _bring_forward(
        self, camera: Camera, p_w: Float, uv: Float32, born: np.ndarray, known: dict[int, Float]
    ) -> tuple[Float, Float32, Float, Bytes]:
        """Points (M, 3) seen at uv (M, 2) in remembered frame `born` (M,), followed to the newest.

        known: world poses of remembered keyframes. Returns the survivors' points and pixels, a
        guess of the newest frame's pose, and its image.
        """
        past, last = list(self._past), len(self._past) - 1
        starts = sorted(set(born[born >= 0].tolist()))
        times = [frame.t_ns for frame in past]
        stops = sorted({*starts, *spaced(times, times[starts[-1]], HOP_NS), last})
        alive = np.zeros((0,), np.int64)
        now: Float32 = np.zeros((0, 2), np.float32)
        gray = past[stops[0]].gray
        T = known[stops[0]]
        for here, there in itertools.pairwise([*stops, last]):
            T = known.get(here, T)
            fresh = np.flatnonzero(born == here)
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
        """Steps from one remembered frame to another: one leap where both poses are known."""
        past = self._past
        if past[here].T_m_c is not None and past[there].T_m_c is not None:
            return [(here, there)]
        times = [frame.t_ns for frame in past]
        between = spaced(times[: there + 1], times[here], CATCH_UP_NS)
        return list(itertools.pairwise([here, *between]))
