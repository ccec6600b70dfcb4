"""Record hours of simulated time at high speed; measure memory growth and lost frames.

`python -m tests.faults.endurance_child HOURS SPEED FOLDER` prints the results as JSON. Images of
160x120 px slide over a textured wall, back and forth. The disk, if one can be mounted, is too small
for the drive, so that old drives and its own oldest segments are removed.
"""

from __future__ import annotations

import itertools
import json
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from calm_edge.config import Config, merge
from calm_edge.daemon.hub import Hub
from calm_edge.daemon.source import Source, TimelineClock
from calm_edge.recording.reader import Recording
from calm_edge.recording.retention import new_drive, set_kept
from device.camera import Camera, CameraSpec, open_camera
from device.frame import Eye, Frame
from tests.faults.row import resident_bytes, sequences
from tests.faults.storage_rows import small_disk
from tests.frontend.plane_world import texture
from tests.replay.daemon_run import record

WIDTH, HEIGHT, FOCAL_PX, WALL_M = 160, 120, 100.0, 10.0
RATE_HZ, PX_A_FRAME, SPACING_M = 10, 1, 0.5
TURN_FRAMES = 400
START_NS = 10**9
SAMPLE_S = 0.5
# size of two older drives: the first has to be removed, the second is marked to keep; large enough
# that two minutes of recording need its space, even if a busy computer drops frames
OLD_BYTES = 15 << 20


class FastClock(TimelineClock):
    """A timeline that runs `speed` times as fast as the host's clock."""

    def __init__(self, epoch_ns: int, speed: float) -> None:
        self._speed = speed
        super().__init__(epoch_ns)

    def now_ns(self) -> int:
        return self._epoch_ns + round((self._system.now_ns() - self._origin_ns) * self._speed)

    def sleep_until_ns(self, t_ns: int) -> None:
        elapsed_ns = (t_ns - self._epoch_ns) / self._speed
        self._system.sleep_until_ns(round(elapsed_ns) + self._origin_ns)


def offset_px(frame: int) -> int:
    """Position of the sliding image: back and forth."""
    there = frame % (2 * TURN_FRAMES)
    return PX_A_FRAME * min(there, 2 * TURN_FRAMES - there)


def pictures() -> list[tuple[bytes, bytes]]:
    """JPEGs of both eyes at each offset."""
    wall = texture()
    baseline = round(FOCAL_PX * SPACING_M / WALL_M)
    made = []
    for x in range(PX_A_FRAME * TURN_FRAMES + 1):
        pair = []
        # the assistant looks lower: pictures that equal earlier ones are those of one camera
        for start, top in ((x, 900), (x + baseline, 900 + HEIGHT // 4)):
            crop = wall[top : top + HEIGHT, 600 + start : 600 + start + WIDTH]
            pair.append(cv2.imencode(".jpg", crop, [cv2.IMWRITE_JPEG_QUALITY, 60])[1].tobytes())
        made.append((pair[0], pair[1]))
    return made


def frames_of(eye: Eye, n: int, made: list[tuple[bytes, bytes]]) -> Iterator[Frame]:
    """Generate `n` frames of an eye at RATE_HZ."""
    for k in range(n):
        t_ns = START_NS + k * 10**9 // RATE_HZ + int(eye) * 17_000_000
        yield Frame(eye, k, t_ns, made[offset_px(k)][eye])


def truth(folder: Path, n: int) -> None:
    """Write the ground truth that the scripted backbone plays."""
    folder.mkdir(parents=True)
    poses = np.tile(np.eye(4)[:3].ravel(), (n, 1))
    poses[:, 3] = [offset_px(k) * WALL_M / FOCAL_PX for k in range(n)]
    np.savetxt(folder / "poses0.txt", poses, fmt="%.6g")
    np.savetxt(folder / "times0.txt", START_NS / 1e9 + np.arange(n) / RATE_HZ, fmt="%.3f")
    rig = np.eye(4)
    rig[0, 3] = SPACING_M
    np.savetxt(folder / "T_p_a.txt", rig[:3].reshape(1, 12))
    row = [FOCAL_PX, FOCAL_PX, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, WIDTH, HEIGHT]
    np.savetxt(folder / "calib.txt", [row, row])


def settings(folder: Path, speed: float, own_disk: bool) -> Config:
    """Configuration, with time limits scaled by the speed of the frames' clock."""
    recording = {"segment_s": 2.0, "keep_free_percent": 0.0, "keep_free_gib": 0.03}
    return merge(
        Config(),
        {
            "backbone": {"name": f"scripted:{folder}", "resolve_windows": 20},
            "scale": {"spacing_m": SPACING_M},
            "capture": {"stale_after_ms": 500.0 * speed},
            "frontend": {"lost_after_ms": 300.0 * speed},
            "loops": {"enabled": False},
            "posegraph": {"optimise": False},
            "recording": recording if own_disk else {"segment_s": 5.0},
        },
    )


class Sampler:
    """Samples the resident memory of the three processes twice a second."""

    def __init__(self) -> None:
        self.samples: dict[str, list[int]] = {"capture": [], "tracker": [], "estimator": []}
        self._hub: Hub | None = None
        self._end = threading.Event()
        threading.Thread(target=self._run, daemon=True).start()

    def __call__(self, hub: Hub, _: str) -> None:
        self._hub = hub

    def end(self) -> None:
        self._end.set()

    def _run(self) -> None:
        while not self._end.wait(SAMPLE_S):
            if (hub := self._hub) is not None:
                pids = (None, hub.tracker.child.pid, hub.estimator.child.pid)
                for name, pid in zip(self.samples, pids, strict=True):
                    self.samples[name].append(resident_bytes(pid))

    def growth_mib(self, name: str) -> float:
        """Growth from the median of the second quarter of the run to that of the last."""
        values = [v for v in self.samples[name] if v]
        quarter = max(1, len(values) // 4)
        first, last = values[quarter : 2 * quarter] or values, values[-quarter:]
        return float(np.median(last) - np.median(first)) / (1 << 20)


def run(hours: float, speed: float, folder: Path) -> dict[str, object]:
    """Run the drive and return the results."""
    n = round(hours * 3600 * RATE_HZ)
    made = pictures()
    truth(folder / "truth", n)
    clock = FastClock(START_NS, speed)

    def cameras() -> tuple[Camera, Camera]:
        clock.restart()
        first, second = (
            open_camera(CameraSpec(eye, "replay", "wall"), clock, frames=frames_of(eye, n, made))
            for eye in Eye
        )
        return first, second

    source = Source(cameras, clock, True, "wall")
    sampler = Sampler()
    with small_disk(folder / "disk", "80m") as disk:
        root = disk or folder / "root"
        old, kept = new_drive(root), new_drive(root)
        for drive in (old, kept):
            (drive / "0000.mcap").write_bytes(b"\0" * OLD_BYTES)
        set_kept(kept, True)
        out = new_drive(root)
        result, lines = record(
            folder / "truth",
            out,
            lockstep=False,
            config=settings(folder / "truth", speed, disk is not None),
            during=sampler,
            source=source,
            root=root if disk else None,
        )
        sampler.end()
        recording = Recording(out)
        on_disk = [sequences(recording, eye) for eye in Eye]
        numbers = [int(p.name.split(".")[0]) for p in sorted(out.glob("*.mcap*"))]
        rest = {"old_gone": not old.exists(), "kept_there": (kept / "0000.mcap").exists()}
    unexplained = 2 * n - sum(result.frames) - result.overflowed - result.camera_drops
    for found in on_disk:
        gaps = sum(b - a - 1 for a, b in itertools.pairwise(found))
        unexplained += gaps + n - 1 - (found[-1] if found else -1)
    return {
        "frames": n,
        "unexplained": unexplained - result.unrecorded,
        "unrecorded": result.unrecorded,
        "overflowed": result.overflowed,
        "untracked": result.untracked,
        "windows": result.windows,
        "submaps": result.submaps,
        "poses": result.poses,
        "removed_segments": numbers[0],
        "own_disk": disk is not None,
        "growth_mib": {name: sampler.growth_mib(name) for name in sampler.samples},
        "losses": result.losses(),
        "lines": lines[-3:],
        **rest,
    }


if __name__ == "__main__":
    print(json.dumps(run(float(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3]))))
