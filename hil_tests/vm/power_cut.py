"""Cut the power ten times while recording onto ext4; measure what is lost and what is damaged.

Nine times the machine is paused, its disk copied, and the machine resumed; the tenth time the
emulator is killed. The host caches nothing of the disk, so either way what the guest did not sync
is lost.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from calm_edge.recording.reader import Recording
from device.frame import Eye
from hil_tests.report import Row, judged
from hil_tests.vm.kernel import MachineError
from hil_tests.vm.machine import Machine, Outcome

NAME = "power cut"
VIVID = "vivid n_devs=2 node_types=0x1,0x1 num_inputs=1,1 input_types=0x0,0x0"
CUTS = 10
MOST_LOST_S = 2.0
BOOT_LIMIT_S = 240.0
BETWEEN_S = (4.0, 9.0)
ROOT = Path(__file__).resolve().parents[2]
SEGMENT_S = 10

# /proc/uptime is the clock of the frames' timestamps; written by the shell alone, since starting a
# program is slow in emulation
GUEST = f"""
mkdir -p /tmp/data && mount /dev/vda /tmp/data
cd {ROOT}
mkfifo /tmp/never; exec 9<>/tmp/never
(while true; do read -r up rest < /proc/uptime; echo $up > /mnt/clock; read -t 0.05 -u 9; done) &
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
exec .venv/bin/python -m calm_edge.cli record --out /tmp/data/drive \\
    --set capture.primary=v4l2:platform:vivid-000 --set capture.assistant=v4l2:platform:vivid-001 \\
    --set capture.width_px=320 --set capture.height_px=180 --set capture.rate_hz=5 \\
    --set recording.segment_s={SEGMENT_S} --set recording.keep_free_gib=0.05
"""


@dataclass(frozen=True, slots=True)
class Cut:
    """A copy of the disk, and the guest's clock at that moment [s]."""

    image: Path
    clock_s: float


class GuestClock:
    """The guest's clock, estimated on the host from the times that the guest writes into a file.

    Both run at the same rate and a time is read late, never early: the smallest difference holds.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._behind_s = float("inf")

    def watch(self, duration_s: float) -> None:
        """Read the file for a while."""
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            text = self._file.read_text() if self._file.exists() else ""
            if text.endswith("\n"):
                self._behind_s = min(self._behind_s, time.monotonic() - float(text))
            time.sleep(0.005)

    def now_s(self) -> float:
        """Return the guest's clock now [s]."""
        return time.monotonic() - self._behind_s


def rows(out: Path) -> Iterator[Row]:
    """Yield a row for each cut; raises MachineError."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    disk = out / "disk.img"
    with disk.open("wb") as file:
        file.truncate(1 << 30)
    tool("mke2fs", "-q", "-F", "-t", "ext4", disk)
    for number, cut in enumerate(cuts(disk, out), 1):
        yield judge(cut, f"cut {number} of {CUTS}", out / f"read{number}")
        cut.image.unlink()


def cuts(disk: Path, out: Path) -> list[Cut]:
    """Record in the guest and cut its power; raises MachineError."""
    pid_file, found = out / "qemu.pid", []
    machine = Machine((VIVID,), disks=(disk,), extra=("-pidfile", str(pid_file)))
    ended: list[Outcome] = []

    def boot() -> None:
        ended.append(machine.run(GUEST, out, timeout_s=900))

    thread = threading.Thread(target=boot, daemon=True)
    thread.start()
    limit_s = time.monotonic() + BOOT_LIMIT_S
    while not tool("debugfs", "-R", "ls /drive", disk).count(".mcap"):
        if time.monotonic() > limit_s or ended:
            kill(pid_file, signal.SIGKILL)
            thread.join()
            raise MachineError(f"nothing was recorded; see {out / 'guest.log'}")
        time.sleep(1.0)
    moments, clock = random.Random(0), GuestClock(out / "clock")
    for number in range(1, CUTS + 1):
        clock.watch(moments.uniform(*BETWEEN_S))
        last = number == CUTS
        kill(pid_file, signal.SIGKILL if last else signal.SIGSTOP)
        clock_s = clock.now_s()
        if last:
            thread.join()
        copy = out / f"cut{number}.img"
        tool("cp", "--sparse=always", disk, copy)
        found.append(Cut(copy, clock_s))
        if not last:
            kill(pid_file, signal.SIGCONT)
    return found


def judge(cut: Cut, what: str, folder: Path) -> Row:
    """Repair the file system as a boot would, and read the recording."""
    repaired = subprocess.run(["e2fsck", "-p", cut.image], capture_output=True, check=False)
    clean = subprocess.run(["e2fsck", "-f", "-n", cut.image], capture_output=True, check=False)
    folder.mkdir()
    tool("debugfs", "-R", f"rdump /drive {folder}", cut.image)
    drive = Recording(folder / "drive")
    ends_s = [drive.frame_times(eye).max() / 1e9 for eye in Eye]
    lost_s = cut.clock_s - min(ends_s)
    finished = sorted((folder / "drive").glob("*.mcap"))
    damaged = [path.name for path in finished if Recording(path).losses]
    good = lost_s <= MOST_LOST_S and clean.returncode == 0 and repaired.returncode <= 1
    text = (
        f"{lost_s:.2f} s lost; e2fsck -p {repaired.returncode}, then -fn {clean.returncode}; "
        f"{len(finished)} earlier segments, {len(damaged)} damaged"
    )
    wanted = f"at most {MOST_LOST_S:g} s, clean, none damaged"
    shutil.rmtree(folder)
    return judged(NAME, what, good and not damaged, text, wanted)


def kill(pid_file: Path, number: signal.Signals) -> None:
    os.kill(int(pid_file.read_text()), number)


def tool(*command: str | Path) -> str:
    """Return what a command prints, whatever its exit status."""
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout
