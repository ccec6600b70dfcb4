"""Determine the state of the daemon and the load shedding once a second, and report both."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from calm_edge.config import Config
from calm_edge.daemon.estimator_link import LAGGING_WINDOWS
from calm_edge.daemon.fan_out import FanOut
from calm_edge.daemon.health import Health
from calm_edge.daemon.hub_status import HubStatus
from calm_edge.daemon.ladder import Ladder, Load, Shed
from calm_edge.daemon.state import Conditions, Standing, State, advance
from calm_edge.daemon.tick_latency import TickLatencyMeter
from device.camera_thread import CameraState, CameraThread
from device.service import Notifier
from device.thermal import Thermal, ThermalReader, ThermalWatch

PERIOD_S = 1.0


class Monitor:
    """Determines the daemon's state and the load-shedding step, and times the capture loop.

    Not updated in a lockstep replay, where results must not depend on time or load.
    """

    def __init__(self, config: Config, notifier: Notifier, outputs: FanOut) -> None:
        self._config, self._notifier, self._outputs = config, notifier, outputs
        self._thermal: ThermalWatch | None = None
        self._ladder = Ladder(config.degrade, depth=config.recording.log_depth)
        self._threads: Sequence[CameraThread] = ()
        self._looked_s = time.monotonic()
        self._loop_ms = {"frames": 0.0, "poses": 0.0}
        self.latency = TickLatencyMeter()
        self.standing = Standing(State.STARTING)
        notifier.status(str(self.standing), self.standing.state.value)

    def watch(self, threads: Sequence[CameraThread]) -> None:
        """Start to monitor the cameras of this run, the primary first, and the temperature."""
        self._threads = threads
        reader = ThermalReader(Path(self._config.degrade.thermal_root))
        self._thermal = ThermalWatch(reader, PERIOD_S)

    def stop(self, now_ns: int) -> None:
        """Report STOPPING: capturing has ended, the last windows and the joint optimum remain."""
        if self._thermal is not None:
            self._thermal.stop()
        self.standing = standing = advance(self.standing.state, Conditions(stopping=True))
        self._outputs.give(lambda output: output.status(standing, None))
        # report at once: the capture loop, which sends it otherwise, has ended
        self._outputs.tick(now_ns)
        self._notifier.stopping()
        self._notifier.status(str(standing), standing.state.value)
        self._log(str(standing))

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Context that adds its duration to that of a stage of the capture loop."""
        start = time.perf_counter()
        yield
        self._loop_ms[stage] += 1e3 * (time.perf_counter() - start)

    def due(self) -> bool:
        """Whether PERIOD_S has passed since the call that last returned True."""
        now_s = time.monotonic()
        if now_s - self._looked_s < PERIOD_S:
            return False
        self._looked_s = now_s
        return True

    def update(self, status: HubStatus, ticks_late: bool, skipped: int) -> tuple[Shed, str]:
        """Determine and report the state; return the load-shedding step from now on and its reason.

        ticks_late: the capture loop takes longer than its period. skipped: deadlines missed so far.
        """
        thermal = self._thermal.latest if self._thermal is not None else Thermal()
        load = Load(thermal, status.windows_waiting, status.windows_overtaken)
        shed = self._ladder.update(self._looked_s, load)
        standing = advance(self.standing.state, self._conditions(status, shed, ticks_late))
        changed = standing.state is not self.standing.state
        self.standing = standing
        health = self._health(status, shed, thermal, skipped)
        line = health.line()
        self._outputs.give(lambda output: output.status(standing, health))
        self._notifier.status(line, standing.state.value)
        if changed:
            self._log(line)
        return shed, ", ".join(self._ladder.reasons) or "cool and caught up"

    def _log(self, line: str) -> None:
        self._outputs.give(lambda output: output.say(logging.INFO, line, "state"))

    def _conditions(self, status: HubStatus, shed: Shed, ticks_late: bool) -> Conditions:
        waiting = status.windows_waiting
        late = [f"{waiting} windows wait to be solved"] if waiting > LAGGING_WINDOWS else []
        if ticks_late:
            late.append("capture loop is late")
        faults = [*self._camera_faults(status), *status.faults, *filter(None, [status.no_metre])]
        if shed is not Shed.NOTHING:
            why = ", ".join(self._ladder.reasons) or "cooling down, catching up"
            faults.append(f"{shed.words}: {why}")
        return Conditions(False, self._pose(status), tuple(faults), tuple(late))

    def _pose(self, status: HubStatus) -> str:
        """Reason why there is no live pose; empty if there is one."""
        posed = status.counts["poses"] + status.counts["unscaled_poses"]
        if self.standing.state is State.STARTING and not posed:
            if status.counts["submaps"]:
                return "waiting for the first pose"
            return "no sub-map yet: the car has to move"
        silent_s = (status.now_ns - status.pose_ns) / 1e9
        if status.pose_lost or silent_s > self._config.frontend.lost_after_ms / 1e3:
            return f"no pose for {silent_s:.0f} s"
        return ""

    def _camera_faults(self, status: HubStatus) -> Iterator[str]:
        stale_s = self._config.capture.stale_after_ms / 1e3
        for thread, frame_ns in zip(self._threads, status.frame_ns, strict=False):
            silent_s = (status.now_ns - frame_ns) / 1e9
            name = thread.camera.spec.name
            if thread.state is CameraState.FAILED:
                yield thread.error or f"{name}: failed"
            elif not thread.camera.connected and thread.state is CameraState.RUNNING:
                yield f"{name}: disconnected, waiting for it"
            elif silent_s > stale_s and thread.state is CameraState.RUNNING:
                yield f"{name}: no frame for {silent_s:.1f} s"

    def _health(self, status: HubStatus, shed: Shed, thermal: Thermal, skipped: int) -> Health:
        loop_ms, self._loop_ms = self._loop_ms, dict.fromkeys(self._loop_ms, 0.0)
        cameras = [thread.camera.stats() for thread in self._threads]
        names = ("primary_frames", "assistant_frames")
        waiting = {name: thread.waiting for name, thread in zip(names, self._threads, strict=False)}
        return Health(
            standing=self.standing,
            shed=shed.words,
            tick=self.latency.take(),
            late_ticks=skipped,
            counts=status.counts,
            drops={
                "missed_by_the_cameras": sum(camera.drops for camera in cameras),
                "stamps_moved": sum(camera.clamped for camera in cameras),
                "corrupt": sum(camera.corrupt for camera in cameras),
                "overflowed": sum(thread.overflow for thread in self._threads),
                **status.drops,
            },
            queues={**waiting, **status.queues},
            stage_ms={**status.stage_ms, **{f"loop_{k}": v for k, v in loop_ms.items()}},
            pose_age_ms=status.pose_age_ms,
            writer=status.writer,
            thermal=thermal,
        )
