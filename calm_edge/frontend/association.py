"""Build windows of keyframes from two image streams, synchronous or not (paper IV-A)."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator

from calm_edge.config import FrontendConfig
from calm_edge.types import CalmEdgeError, Keyframe, SubmapWindow
from device.frame import Frame

MIN_PAIRS = 3


class WindowError(CalmEdgeError):
    """The configured windows cannot be built."""


def is_thin(window: SubmapWindow) -> bool:
    """Whether there are too few assistant keyframes (MIN_PAIRS) for a reliable scale."""
    return len(window.assistant) < MIN_PAIRS


class WindowBuilder:
    """Builder of windows: N_max primary keyframes with the assistant frames closest in time.

    Consecutive windows share N_overlap primary keyframes.

    A keyframe is associated once there is an assistant frame at or after its stamp, or the primary
    stream is `max_pair_gap_s` past it; so the result does not depend on the order of arrival. An
    assistant frame associated with two keyframes is one assistant keyframe (de-duplication).

    late_ns: how much later than their stamps the assistant's frames are exposed; may be set at any
    time.
    """

    def __init__(
        self, config: FrontendConfig, submap_id: int = 0, first_assistant_id: int = 0
    ) -> None:
        if not 0 < config.n_overlap < config.n_max:
            raise WindowError(
                f"frontend.n_overlap = {config.n_overlap}: must lie between 1 and n_max - 1 = "
                f"{config.n_max - 1}"
            )
        if config.first_window <= config.n_overlap:
            raise WindowError(
                f"frontend.first_window = {config.first_window}: must be above n_overlap = "
                f"{config.n_overlap}"
            )
        self.config = config
        self.n_assistant = first_assistant_id
        self.late_ns = 0
        self._gap_ns = int(config.max_pair_gap_s * 1e9)
        self._seen: deque[Frame] = deque()
        self._open: deque[Keyframe] = deque()
        self._paired: list[tuple[Keyframe, Keyframe | None]] = []
        self._n_overlap = 0
        self._submap_id = self._first_submap_id = submap_id
        self._last_assistant: Keyframe | None = None

    def add_assistant(self, frame: Frame) -> tuple[SubmapWindow, ...]:
        """Add an assistant frame; returns the windows that it completes."""
        if self._seen and frame.t_ns <= self._seen[-1].t_ns:
            return ()
        self._seen.append(frame)
        return self._settle(self._open[0].frame.t_ns if self._open else self._exposed_ns(frame))

    def add_keyframe(self, keyframe: Keyframe) -> tuple[SubmapWindow, ...]:
        """Add a primary keyframe; returns the windows that it completes."""
        self._open.append(keyframe)
        return self._settle(keyframe.frame.t_ns)

    def advance(self, t_ns: int) -> tuple[SubmapWindow, ...]:
        """Advance the primary stream to t_ns; returns the windows that this completes."""
        return self._settle(t_ns)

    def held(self) -> Iterator[Frame]:
        """All frames that a later window may contain; some are yielded twice."""
        yield from self._seen
        paired = itertools.chain(self._open, *self._paired)
        yield from (keyframe.frame for keyframe in paired if keyframe is not None)

    def flush(self) -> tuple[SubmapWindow, ...]:
        """End of the streams; returns the remaining windows.

        The last one is built if there is a keyframe without a window, and at least two in all. It
        has at least N_max / 2 + 1 primary keyframes if available, so that it is well conditioned.
        """
        while self._open:
            self._pair(self._open.popleft())
        windows = self._emit_full()
        n_new = len(self._paired) - self._n_overlap
        if n_new < 1 or len(self._paired) < 2:
            return windows
        reach = max(n_new + self.config.n_overlap, self.config.n_max // 2 + 1)
        return (*windows, self._emit(min(reach, len(self._paired)), n_new))

    def cut(self) -> tuple[SubmapWindow, ...]:
        """Flush, and begin anew: later windows share no frame with earlier ones."""
        windows = self.flush()
        self._seen.clear()
        self._paired.clear()
        self._n_overlap = 0
        self._first_submap_id = self._submap_id
        self._last_assistant = None
        return windows

    def _settle(self, t_ns: int) -> tuple[SubmapWindow, ...]:
        newest = self._exposed_ns(self._seen[-1]) if self._seen else None
        while self._open:
            stamp = self._open[0].frame.t_ns
            if (newest is None or newest < stamp) and t_ns - stamp < self._gap_ns:
                break
            self._pair(self._open.popleft())
        if not self._open:
            # later keyframes have stamps of at least t_ns: keep what can still be the closest
            end = t_ns - self._gap_ns
            while len(self._seen) > 1 and self._exposed_ns(self._seen[1]) <= end:
                self._seen.popleft()
        return self._emit_full()

    def _pair(self, keyframe: Keyframe) -> None:
        stamp, last = keyframe.frame.t_ns, self._last_assistant

        def off_ns(frame: Frame) -> int:
            return abs(self._exposed_ns(frame) - stamp)

        # never back in time, if `late_ns` has changed
        later = [f for f in self._seen if last is None or f.t_ns >= last.frame.t_ns]
        near = [f for f in later if off_ns(f) <= self._gap_ns]
        closest = min(near, key=lambda f: (off_ns(f), f.t_ns), default=None)
        assistant = None
        if closest is not None:
            assistant = self._last_assistant
            if assistant is None or assistant.frame.t_ns != closest.t_ns:
                assistant = Keyframe(self.n_assistant, closest)
                self.n_assistant += 1
                self._last_assistant = assistant
        self._paired.append((keyframe, assistant))

    def _exposed_ns(self, frame: Frame) -> int:
        return frame.t_ns + self.late_ns

    def _emit_full(self) -> tuple[SubmapWindow, ...]:
        windows: list[SubmapWindow] = []
        while True:
            n_primary, n_new = self._next_size()
            if len(self._paired) - self._n_overlap < n_new:
                return tuple(windows)
            end = self._n_overlap + n_new
            later, self._paired = self._paired[end:], self._paired[:end]
            windows.append(self._emit(n_primary, n_new))
            self._paired += later

    def _next_size(self) -> tuple[int, int]:
        """Number of primary keyframes of the next full window, and how many of them are new.

        The first window may have only `first_window` keyframes, so that the live pose has points
        seconds earlier. The second is a full one that begins with the same keyframes, so that all
        later windows are as without a short one.
        """
        n_max, early = self.config.n_max, self.config.first_window
        n_emitted = self._submap_id - self._first_submap_id
        if n_emitted == 0:
            return min(early, n_max), min(early, n_max)
        if n_emitted == 1 and early < n_max:
            return n_max, n_max - early
        return n_max, n_max - self.config.n_overlap

    def _emit(self, n_primary: int, n_new: int) -> SubmapWindow:
        used = self._paired[-n_primary:]
        assistant = {a.id: a for _, a in used if a is not None}
        window = SubmapWindow(
            self._submap_id,
            tuple(p for p, _ in used),
            tuple(assistant[i] for i in sorted(assistant)),
            n_primary - n_new,
        )
        # the last window may overlap by more than N_overlap
        self._paired = self._paired[-self.config.n_max :]
        self._n_overlap = len(self._paired)
        self._submap_id += 1
        return window
