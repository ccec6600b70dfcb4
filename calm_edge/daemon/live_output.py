"""Output to the live page: what is newest of everything, over a Unix socket."""

from __future__ import annotations

import base64
import logging
import queue
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import calm_edge
from calm_edge.config import Config
from calm_edge.daemon.fan_out import Output
from calm_edge.daemon.health import Health, time_left
from calm_edge.daemon.messages import Attached, Event, Keep
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.state import Standing
from calm_edge.geometry import se3
from calm_edge.live.board import Board
from calm_edge.live.kit_content import KitContent
from calm_edge.live.link import Link
from calm_edge.live.plan import Plan, moved
from calm_edge.live.socket_path import check_length
from calm_edge.live.wire import Message
from calm_edge.recording.display import landmarks
from calm_edge.types import Bytes, Float, Float32, LocalizerUpdate, PoseSample, PoseStatus
from device.frame import Eye, Frame

# two pictures a second; without a pose for POSE_GONE_S they come without tracks
PICTURE_S, POSE_S, POSE_GONE_S = 0.45, 0.25, 1.0
# primary frames that wait for the tracker's points of one of them
WAITING_FRAMES = 40
ASSISTANT_POINTS, NOTES, EVENTS, TEXT_LENGTH, REQUESTS = 150, 20, 100, 200, 50
CLOSE_S = 0.8


class LiveOutput(Output):
    """Keeps the newest results on a board, from which the page's process is sent what is new.

    now_ns: the clock of the frames' stamps.
    """

    name = "live"

    def __init__(self, config: Config, now_ns: Callable[[], int]) -> None:
        path = Path(config.live.socket)
        check_length(path)
        self._now_ns = now_ns
        self._board: Board[bytes] = Board()
        self._requests: queue.Queue[Event | Keep] = queue.Queue(REQUESTS)
        self._plan, self._kit = Plan(config.pose_output), KitContent()
        self._frames: deque[Frame] = deque(maxlen=WAITING_FRAMES)
        self._T_map_odom: Float = np.eye(4)
        self._sample: PoseSample | None = None
        self._update: LocalizerUpdate | None = None
        self._points_w: Float = np.zeros((0, 3))
        self._shown_s = dict.fromkeys(Eye, 0.0)
        self._posed_s = self._moves_s = self._updated_s = 0.0
        self._health: dict[str, Any] = {}
        self._events: deque[dict[str, Any]] = deque(maxlen=EVENTS)
        self._notes: deque[str] = deque(maxlen=NOTES)
        unit = "m" if config.scale.spacing_m else "spacings"
        self._put("drive", {"version": calm_edge.__version__, "unit": unit})
        self._link = Link(path, self._board, self._ask)

    @property
    def fault(self) -> str:
        return self._link.fault

    @property
    def wants_frames(self) -> bool:  # type: ignore[override]
        return self._link.readers > 0

    @property
    def readers(self) -> int:
        """Number of pages that are connected."""
        return self._link.readers

    @property
    def dropped_readers(self) -> int:
        """Number of pages that took nothing for too long."""
        return self._link.dropped

    def requests(self) -> Sequence[Event | Keep]:
        found: list[Event | Keep] = []
        while not self._requests.empty():
            found.append(self._requests.get_nowait())
        return found

    def frame(self, frame: Frame) -> None:
        if frame.eye is Eye.ASSISTANT:
            if self._due(Eye.ASSISTANT):
                self._picture(frame, points=self._assistant_points(frame))
            return
        self._frames.append(frame)
        # with the tracker's points, if such come
        gone = time.monotonic() - self._moves_s > POSE_GONE_S
        if gone and self._due(Eye.PRIMARY):
            self._picture(frame)

    def moves(self, t_ns: int, moves: Float32) -> None:
        if len(moves):
            self._moves_s = time.monotonic()
        for frame in self._frames:
            if frame.t_ns == t_ns:
                self._shown_s[Eye.PRIMARY] = time.monotonic()
                self._picture(frame, moves=moves)
                self._frames.clear()
                return

    def pose(self, sample: PoseSample, now_ns: int) -> None:
        lost = sample.status is PoseStatus.LOST or not np.isfinite(sample.T_w_c).all()
        self._sample = None if lost else sample
        now_s = time.monotonic()
        if now_s - self._posed_s < POSE_S:
            return
        self._posed_s = now_s
        content: dict[str, Any] = {"status": sample.status.value}
        if not lost:
            content |= self._plan.pose(self._T_map_odom @ sample.T_w_c, sample.velocity_c)
        self._put("pose", content)

    def attached(self, attached: Attached) -> None:
        self._T_map_odom = attached.T_map_odom

    def update(self, update: LocalizerUpdate) -> None:
        self._plan.update(update)
        now_s = time.monotonic()
        if update.prediction.landmarks is None and now_s - self._updated_s < POSE_S:
            # the end of a drive gives all its sub-maps once more, within a moment
            return
        self._updated_s = now_s
        self._put("plan", self._plan.content())
        self._put("kit", self._kit.update(update))
        if update.masks is not None:
            masks = {eye.name.lower(): _cells(update.masks.of_eye(eye)) for eye in Eye}
            self._put("masks", masks)
        if update.prediction.landmarks is not None and update.submap.assistant_ids:
            self._update, self._points_w = update, landmarks(update)

    def cameras(self, settings: Mapping[str, str]) -> None:
        self._put("cameras", dict(settings))

    def status(self, standing: Standing, health: Health | None) -> None:
        if not self._link.readers:
            self._frames.clear()
        if health is not None:
            self._health = health.message() | {"left": time_left(health.writer)}
        now = {"state": standing.state.value, "reasons": list(standing.reasons)}
        self._put("health", self._health | now)

    def event(self, event: Event) -> None:
        self._events.append({"text": event.text, "unix_s": time.time()})
        self._put("events", {"events": list(self._events)})

    def say(self, level: int, text: str, name: str) -> None:
        if level >= logging.WARNING:
            self._notes.append(text)
            self._put("notes", {"notes": list(self._notes)})

    def close(self, result: RecordResult) -> None:
        self._put("plan", self._plan.content())
        self._put("end", {"error": result.error, "losses": result.losses()})
        self._link.close(CLOSE_S)

    def _put(self, kind: str, content: Mapping[str, Any], data: bytes = b"") -> None:
        self._board.put(kind, Message(kind, content, data).encoded())

    def _ask(self, message: Message) -> None:
        """Queue a request of the page; called from another thread. More than fit are dropped."""
        request: Event | Keep
        if message.kind == "event":
            text = " ".join(str(message.content.get("text", "")).split())[:TEXT_LENGTH]
            request = Event(self._now_ns(), text)
        elif message.kind == "keep":
            request = Keep(bool(message.content.get("kept")))
        else:
            return
        if not self._requests.full():
            self._requests.put(request)

    def _due(self, eye: Eye) -> bool:
        now_s = time.monotonic()
        if now_s - self._shown_s[eye] < PICTURE_S:
            return False
        self._shown_s[eye] = now_s
        return True

    def _picture(
        self, frame: Frame, moves: Float32 | None = None, points: Float | None = None
    ) -> None:
        """Put a picture: with the tracker's points, or with those expected in it."""
        assert isinstance(frame.image, bytes)
        content: dict[str, Any] = {"t_ns": frame.t_ns}
        if moves is not None:
            content["moves"] = moves.round(1).tolist()
        if points is not None:
            content["points"] = points.round(1).tolist()
        self._put(frame.eye.name.lower(), content, frame.image)

    def _assistant_points(self, frame: Frame) -> Float | None:
        """Pixels (N, 2) at which the newest sub-map's points are expected in an assistant frame.

        By pose, rig and lens; None without a pose.
        """
        sample, update = self._sample, self._update
        if sample is None or update is None:
            return None
        seconds = (frame.t_ns + update.submap.late_ns - sample.t_ns) / 1e9
        if abs(seconds) > POSE_GONE_S:
            return None
        T_w_p = self._T_map_odom @ moved(
            sample.T_w_c, sample.velocity_c, sample.turn_rate_c, seconds
        )
        T_a_w = se3.inverse(T_w_p @ update.trajectory.T_p_a)
        camera = update.submap.cameras[update.submap.n_primary]
        p_a = se3.transform(T_a_w, self._points_w)
        p_a = p_a[(p_a[:, 2] > 0) & camera.within_reach(p_a)]
        uv = camera.project(p_a)
        inside = ((uv >= 0) & (uv < [camera.width, camera.height])).all(1)
        uv = uv[inside]
        return np.asarray(uv[:: max(1, -(-len(uv) // ASSISTANT_POINTS))])


def _cells(mask: Bytes | None) -> dict[str, Any] | None:
    """Cells of a picture that are left out, a bit each; None if there are none.

    Each row begins with a byte of its own.
    """
    if mask is None or not mask.any():
        return None
    height, width = mask.shape
    bits = base64.b64encode(np.packbits(mask > 0, axis=1).tobytes()).decode()
    return {"width": width, "height": height, "bits": bits}
