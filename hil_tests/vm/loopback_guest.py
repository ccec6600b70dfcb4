"""Runs in the guest: feeds pictures into two loopback devices and records them with `record`."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from calm_edge.recording.reader import Recording
from device.drivers.v4l2_ioctl import FIELD_NONE, FORMAT, S_FMT, LinuxVideoIO, code
from device.frame import Eye

OUT = Path("/run/loopback")
BUF_TYPE_VIDEO_OUTPUT = 2
SIZE = 320, 180
PERIOD_S = 0.2
# frames of each eye that the recording must hold
ENOUGH, LIMIT_S = 25, 240.0


def row(what: str, good: bool, seen: str) -> None:
    print(f"ROW {what}|{'pass' if good else 'FAIL'}|{seen}", flush=True)


def picture(eye: Eye, number: int) -> bytes:
    """Make a JPEG that no re-encoding reproduces: random pixels, a comment segment, and in some
    padding behind the end marker, as cameras send it.
    """
    random = np.random.default_rng((int(eye), number))
    pixels = random.integers(0, 256, (SIZE[1] // 4, SIZE[0] // 4, 3), np.uint8)
    image = cv2.resize(pixels, SIZE, interpolation=cv2.INTER_CUBIC)
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 50 + number % 45])[1].tobytes()
    comment = f"eye {int(eye)} number {number}".encode()
    segment = b"\xff\xfe" + (len(comment) + 2).to_bytes(2, "big") + comment
    return data[:2] + segment + data[2:] + b"\x2a" * (number % 7)


class PlayedCamera:
    """Writes pictures into the output side of a loopback device until `stop`."""

    def __init__(self, eye: Eye, path: str) -> None:
        self.sent: dict[bytes, int] = {}
        self._eye, self._io, self._ended = eye, LinuxVideoIO(), threading.Event()
        self._fd = os.open(path, os.O_RDWR)
        wanted = (BUF_TYPE_VIDEO_OUTPUT, *SIZE, code("MJPG"), FIELD_NONE, 0, SIZE[0] * SIZE[1] * 3)
        self._io.ioctl(self._fd, S_FMT, bytearray(FORMAT.pack(*wanted)))
        self._write(0)
        self._thread = threading.Thread(target=self._play, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._ended.set()
        self._thread.join()
        os.close(self._fd)

    def _play(self) -> None:
        number = 1
        while not self._ended.wait(PERIOD_S):
            self._write(number)
            number += 1

    def _write(self, number: int) -> None:
        data = picture(self._eye, number)
        self.sent[data] = number
        os.write(self._fd, data)


def recorded() -> dict[Eye, list[bytes]]:
    """Read the pictures of each eye back from the recording."""
    recording = Recording(OUT)
    return {eye: [f.image for f in recording.frames(eye)] for eye in Eye}  # type: ignore[misc]


def main() -> None:
    cameras = [PlayedCamera(eye, f"/dev/video{int(eye)}") for eye in Eye]
    settings = {
        **{f"capture.{e.name.lower()}": f"v4l2:platform:v4l2loopback-00{int(e)}" for e in Eye},
        "capture.width_px": SIZE[0],
        "capture.height_px": SIZE[1],
        "recording.keep_free_gib": 0.0,
        "capture.stale_after_ms": 5000,
    }
    words = [sys.executable, "-m", "calm_edge.cli", "record", "--out", str(OUT)]
    for name, value in settings.items():
        words += ["--set", f"{name}={value}"]
    with subprocess.Popen(words) as record:
        end_s = time.monotonic() + LIMIT_S
        while time.monotonic() < end_s and record.poll() is None:
            time.sleep(5)
            taken = sum(p.stat().st_size for p in OUT.glob("*.part"))
            # pictures differ in size: twice the bytes of ENOUGH holds ENOUGH of each
            if taken > 2 * len(Eye) * ENOUGH * len(picture(Eye.PRIMARY, 0)):
                break
        for _ in range(2):
            # the second one skips the windows still waiting
            record.send_signal(signal.SIGINT)
            time.sleep(2)
        code_of_record = record.wait()
    for camera in cameras:
        camera.stop()
    row("record ends", code_of_record in (0, 3), f"exit {code_of_record}")
    if not OUT.is_dir():
        return
    for eye, frames in recorded().items():
        sent = cameras[eye].sent
        numbers = [sent.get(frame, -1) for frame in frames]
        same = sum(n >= 0 for n in numbers)
        padded = bool(frames) and numbers[0] < 0
        if padded:
            # written before a reader was there: the device returns it with its whole buffer,
            # including what an earlier picture left there
            numbers[0] = next((n for data, n in sent.items() if frames[0].startswith(data)), -1)
        good = numbers[:1] != [-1] and same + padded == len(frames) >= ENOUGH
        ordered = all(b > a for a, b in pairwise(numbers))
        row(
            f"{eye.name.lower()}: bytes in the recording",
            good and ordered,
            f"{same} of {len(frames)} recorded pictures are byte for byte what was sent"
            + (", the first with the rest of the device's buffer behind it" if padded else ""),
        )


if __name__ == "__main__":
    main()
