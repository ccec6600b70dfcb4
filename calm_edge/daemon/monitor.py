"""Once a second: the state the daemon is in, what it has to leave out, and who is told."""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from calm_edge.daemon.camera_notes import CameraNotes
from calm_edge.daemon.estimator_link import LAGGING_WINDOWS
from calm_edge.daemon.health import Health
from calm_edge.daemon.ladder import Ladder, Load, Shed
from calm_edge.daemon.lateness import LatenessMeter
from calm_edge.daemon.state import Conditions, Standing, State, advance
from calm_edge.daemon.switchboard import Switchboard
from calm_edge.recording.schema import HEALTH
from device.camera_thread import CameraState, CameraThread
from device.service import Notifier
from device.thermal import Thermal, ThermalReader, ThermalWatch

PERIOD_S = 1.0


class SerialLine(Protocol):
    """What is asked of the serial port; its counts are a dataclass."""

    error: str | None

    def stats(self) -> Any:
        """`dropped` among them."""
        ...


class Monitor:
    """Owner of the state, of the ladder and of the capture loop's figures.

    It reads what others count and waits for nobody. Not used in lockstep, where time stands still
    and the same input has to give the same bytes.
    """

    def __init__(
        self, desk: Switchboard, notifier: Notifier, serial: SerialLine | None = None
    ) -> None:
        self._desk, self._notifier, self._serial = desk, notifier, serial
        degrade = desk.config.degrade
        self._thermal: ThermalWatch | None = None
        self._ladder = Ladder(degrade, depth=desk.config.recording.log_depth)
        self._threads: Sequence[CameraThread] = ()
        self._notes = CameraNotes(desk, ())
        self._looked_s = time.monotonic()
        self._loop_ms = {"frames": 0.0, "poses": 0.0}
        self.lateness = LatenessMeter()
        self.standing = Standing(State.STARTING)
        notifier.status(str(self.standing), self.standing.state.value)

    def watch(self, threads: Sequence[CameraThread]) -> None:
        """The cameras of this run, the primary first, and from now on the temperature."""
        self._threads = threads
        self._notes = CameraNotes(self._desk, [t.camera for t in threads])
        self._notes.look()
        reader = ThermalReader(Path(self._desk.config.degrade.thermal_root))
        self._thermal = ThermalWatch(reader, PERIOD_S)

    def stop(self) -> None:
        """No more frames: the last windows and the joint optimum are left."""
        if self._thermal is not None:
            self._thermal.stop()
        self._stand(advance(self.standing.state, Conditions(stopping=True)))
        if self._desk.publisher is not None:
            # nobody may come by for a while: what is left to do can be a window
            self._desk.publisher.publish(None, self._desk.source.clock.now_ns())
        self._notifier.stopping()
        self._notifier.status(str(self.standing), self.standing.state.value)
        self._desk.recording.write_log(logging.INFO, str(self.standing), "state")

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Adds to a stage of the capture loop."""
        start = time.perf_counter()
        yield
        self._loop_ms[stage] += 1e3 * (time.perf_counter() - start)

    def look(self, ticks_late: bool, skipped: int) -> None:
        """To be called each tick; does something once a second.

        ticks_late: ticks do not fit into their period. skipped: deadlines passed so far.
        """
        now_s = time.monotonic()
        if now_s - self._looked_s < PERIOD_S:
            return
        self._looked_s = now_s
        thermal = self._thermal.latest if self._thermal is not None else Thermal()
        self._notes.look()
        self._climb(now_s, thermal)
        standing = advance(self.standing.state, self._conditions(ticks_late))
        changed = standing.state is not self.standing.state
        self._stand(standing)
        health = self._health(standing, thermal, skipped)
        line = health.line()
        self._notifier.status(line, standing.state.value)
        self._desk.recording.write_status(health.message(), HEALTH)
        if changed:
            self._desk.recording.write_log(logging.INFO, line, "state")

    def _stand(self, standing: Standing) -> None:
        self.standing = standing
        if self._desk.publisher is not None:
            self._desk.publisher.report(standing.state.value, standing.reasons)

    def _climb(self, now_s: float, thermal: Thermal) -> None:
        before = self._desk.shed
        shed = self._ladder.update(now_s, self._load(thermal))
        if shed is not before:
            self._desk.leave_out(shed)
            why = ", ".join(self._ladder.reasons) or "cool and caught up"
            self._desk.say(f"{shed.words}: {why}; every frame is recorded")

    def _load(self, thermal: Thermal) -> Load:
        estimator = self._desk.estimator
        return Load(thermal, estimator.waiting, estimator.overtaken)

    def _conditions(self, ticks_late: bool) -> Conditions:
        waiting = self._desk.estimator.waiting
        late = [f"{waiting} windows wait"] if waiting > LAGGING_WINDOWS else []
        if ticks_late:
            late.append("ticks come late")
        return Conditions(False, self._pose(), tuple(self._faults()), tuple(late))

    def _pose(self) -> str:
        desk = self._desk
        if self.standing.state is State.STARTING and not desk.result.poses:
            return (
                "no sub-map yet: it needs the car to move"
                if not desk.result.submaps
                else ("waiting for the first pose")
            )
        silent_s = (desk.source.clock.now_ns() - desk.live_ns) / 1e9
        if desk.result.pose_lost or silent_s > desk.config.frontend.lost_after_ms / 1e3:
            return f"no pose for {silent_s:.0f} s"
        return ""

    def _faults(self) -> Iterator[str]:
        desk = self._desk
        now_ns = desk.source.clock.now_ns()
        stale_s = desk.config.capture.stale_after_ms / 1e3
        for eye, thread in enumerate(self._threads):
            silent_s = (now_ns - desk.frame_ns[eye]) / 1e9
            name = thread.camera.spec.name
            if thread.state is CameraState.FAILED:
                yield thread.error or f"{name}: failed"
            elif not thread.camera.connected and thread.state is CameraState.RUNNING:
                yield f"{name}: gone, looked for again"
            elif silent_s > stale_s and thread.state is CameraState.RUNNING:
                yield f"{name}: no frame for {silent_s:.1f} s"
        if desk.recording.health.error:
            yield desk.recording.health.error
        for name, link in (("estimator", desk.estimator), ("tracker", desk.tracker)):
            if link.given_up:
                yield f"{name} given up"
        if self._serial is not None and self._serial.error:
            yield self._serial.error
        if desk.shed is not Shed.NOTHING:
            why = ", ".join(self._ladder.reasons) or "cooling down, catching up"
            yield f"{desk.shed.words}: {why}"

    def _health(self, standing: Standing, thermal: Thermal, skipped: int) -> Health:
        desk, result = self._desk, self._desk.result
        age_ms, result.worst_age_ms = result.worst_age_ms, None
        loop_ms, self._loop_ms = self._loop_ms, dict.fromkeys(self._loop_ms, 0.0)
        return Health(
            standing=standing,
            shed=desk.shed.words,
            tick=self.lateness.take(),
            late_ticks=skipped,
            counts={
                "primary_frames": result.frames[0],
                "assistant_frames": result.frames[1],
                "keyframes": result.keyframes,
                "windows": result.windows,
                "submaps": result.submaps,
                "poses": result.poses,
                "lost_poses": result.lost_poses,
                "late_poses": result.late_poses,
            },
            drops=self._drops(),
            queues=self._queues(),
            stage_ms={**desk.stage_ms, **{f"loop_{k}": v for k, v in loop_ms.items()}},
            pose_age_ms=age_ms,
            writer=desk.recording.health,
            thermal=thermal,
        )

    def _drops(self) -> dict[str, int]:
        """What is missing so far, by cause; every one of them is counted where it happens."""
        desk, writer = self._desk, self._desk.recording.health
        drops = {
            "missed_by_the_cameras": 0,
            "stamps_moved": 0,
            "corrupt": 0,
            "overflowed": sum(t.overflow for t in self._threads),
            "images_not_recorded": writer.dropped_images,
            "others_not_recorded": writer.dropped_others + writer.unwritable,
            "not_tracked": desk.result.untracked + desk.tracker.frames_lost,
            "unreadable": desk.result.unreadable,
            "windows_left_to_map": len(desk.estimator.left_to_map),
            "windows_lost": len(desk.estimator.lost),
            "windows_unsolved": len(desk.estimator.unsolved),
        }
        for thread in self._threads:
            stats = thread.camera.stats()
            drops["missed_by_the_cameras"] += stats.drops
            drops["stamps_moved"] += stats.clamped
            drops["corrupt"] += stats.corrupt
        if self._serial is not None:
            drops["serial_messages"] = int(dataclasses.asdict(self._serial.stats())["dropped"])
        return drops

    def _queues(self) -> dict[str, float]:
        desk = self._desk
        return {
            "primary_frames": self._threads[0].waiting if self._threads else 0,
            "assistant_frames": self._threads[1].waiting if self._threads else 0,
            "tracker_frames": desk.tracker.in_flight,
            "tracker_submaps": desk.tracker.attaching,
            "estimator_windows": desk.estimator.waiting,
            "recording_fill": desk.recording.health.queue_fill,
        }
