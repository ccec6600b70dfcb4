"""A fake kernel with video nodes for the V4L2 driver.

Struct offsets are those printed by a C program that includes <linux/videodev2.h>, independent of
the driver's own structs.
"""

from __future__ import annotations

import errno
import os
import struct
from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np

from device.drivers.v4l2_identity import NodeFacts
from tests.manual_clock import ManualClock

# a JPEG with a number of four digits in its comment: JPEG % 7
JPEG = b"\xff\xd8\xff\xfe\x00\x06%04d" + bytes(
    cv2.imencode(".jpg", np.full((8, 8, 3), 90, np.uint8))[1][2:]
).replace(b"%", b"%%")
MONOTONIC = 0x2000
ERROR = 0x40


@dataclass
class Shot:
    """A buffer that the camera will fill when it is due, with its stamp and buffer flags."""

    due_ns: int
    sequence: int
    data: bytes
    stamp_ns: int
    flags: int = MONOTONIC


@dataclass
class Knob:
    """A control of a fake camera. stuck: accepts writes without changing its value.

    refused: rejects writes as a busy camera does.
    """

    name: str
    value: int
    minimum: int = 0
    maximum: int = 255
    step: int = 1
    flags: int = 0
    stuck: bool = False
    refused: bool = False


@dataclass
class FakeCamera:
    bus_info: str
    card: str = "Fake"
    fourccs: tuple[str, ...] = ("YUYV", "MJPG")
    capabilities: int = 0x85200001
    device_caps: int = 0x04200001
    stride: int = 0
    size: tuple[int, int] | None = None
    refused: tuple[str, ...] = ()
    sizes: tuple[tuple[int, int], ...] = ()
    intervals: tuple[tuple[int, int], ...] = ()
    stepwise: bool = False
    controls: dict[int, Knob] = field(default_factory=dict)
    serial: str = ""
    port: str = ""
    held_by: list[str] = field(default_factory=list)
    fails: dict[int, int] = field(default_factory=dict)
    open_errno: int = 0
    shots: deque[Shot] = field(default_factory=deque)
    gone: bool = False
    asked: dict[str, object] = field(default_factory=dict)
    queued: deque[int] = field(default_factory=deque)
    memory: list[bytearray] = field(default_factory=list)
    streaming: bool = False

    def film(self, start_ns: int, n: int, period_ns: int, sequence: int = 0) -> None:
        """Schedule n JPEGs from start_ns on, each stamped with its due time."""
        for k in range(n):
            t_ns = start_ns + k * period_ns
            self.shots.append(Shot(t_ns, sequence + k, JPEG % (sequence + k), t_ns))


class FakeVideoIO:
    def __init__(self, clock: ManualClock, cameras: dict[str, FakeCamera]) -> None:
        self.clock = clock
        self.cameras = cameras
        self.open_fds: dict[int, FakeCamera] = {}
        self._next_fd = 100

    def nodes(self) -> list[str]:
        return sorted(path for path, camera in self.cameras.items() if not camera.gone)

    def facts(self, path: str) -> NodeFacts:
        return NodeFacts(self.cameras[path].serial, self.cameras[path].port)

    def holders(self, path: str) -> list[str]:
        return self.cameras[path].held_by

    def open(self, path: str) -> int:
        camera = self.cameras.get(path)
        if camera is None or camera.gone:
            raise OSError(errno.ENOENT, "No such file or directory")
        if camera.open_errno:
            raise OSError(camera.open_errno, os.strerror(camera.open_errno))
        self._next_fd += 1
        self.open_fds[self._next_fd] = camera
        return self._next_fd

    def close(self, fd: int) -> None:
        del self.open_fds[fd]

    def map(self, fd: int, length: int, offset: int) -> bytearray:
        memory = self.open_fds[fd].memory[offset // 0x1000]
        assert len(memory) == length
        return memory

    def unmap(self, memory: object) -> None:
        pass

    def wait(self, fd: int, timeout_s: float) -> bool:
        camera = self.open_fds[fd]
        if camera.gone:
            return True
        limit_ns = self.clock.now_ns() + int(timeout_s * 1e9)
        due_ns = camera.shots[0].due_ns if camera.shots else limit_ns + 1
        self.clock.sleep_until_ns(min(due_ns, limit_ns))
        return due_ns <= limit_ns

    def ioctl(self, fd: int, request: int, argument: bytearray) -> None:
        camera = self.open_fds[fd]
        if camera.gone:
            raise OSError(errno.ENODEV, "No such device")
        assert len(argument) == (request >> 16) & 0x3FFF
        number = request & 0xFF
        if number in camera.fails:
            raise OSError(camera.fails[number], os.strerror(camera.fails[number]))
        handlers = {
            0x00: self._querycap,
            0x02: self._enum_fmt,
            0x05: self._s_fmt,
            0x16: self._s_parm,
            0x08: self._reqbufs,
            0x09: self._querybuf,
            0x0F: self._qbuf,
            0x11: self._dqbuf,
            0x12: self._streamon,
            0x13: self._streamoff,
            0x1B: self._g_ctrl,
            0x1C: self._s_ctrl,
            0x24: self._queryctrl,
            0x4A: self._enum_framesizes,
            0x4B: self._enum_frameintervals,
        }
        handlers[number](camera, argument)

    def _querycap(self, camera: FakeCamera, a: bytearray) -> None:
        a[0:4], a[16 : 16 + len(camera.card)] = b"fake", camera.card.encode()
        a[48 : 48 + len(camera.bus_info)] = camera.bus_info.encode()
        struct.pack_into("=II", a, 84, camera.capabilities, camera.device_caps)

    def _enum_fmt(self, camera: FakeCamera, a: bytearray) -> None:
        index, kind = struct.unpack_from("=II", a, 0)
        assert kind == 1
        if index >= len(camera.fourccs):
            raise OSError(errno.EINVAL, "Invalid argument")
        a[44:48] = camera.fourccs[index].encode()

    def _s_fmt(self, camera: FakeCamera, a: bytearray) -> None:
        kind, _, width, height = struct.unpack_from("=IIII", a, 0)
        assert kind == 1
        fourcc = a[16:20].decode()
        if fourcc in camera.refused:
            a[16:20] = b"NV12"
        width, height = camera.size or (width, height)
        struct.pack_into("=II", a, 8, width, height)
        struct.pack_into("=I", a, 24, camera.stride if fourcc == "YUYV" else 0)
        camera.asked["format"] = (fourcc, width, height)

    def _s_parm(self, camera: FakeCamera, a: bytearray) -> None:
        camera.asked["rate"] = struct.unpack_from("=II", a, 12)

    def _queryctrl(self, camera: FakeCamera, a: bytearray) -> None:
        (asked,) = struct.unpack_from("=I", a, 0)
        assert asked & 0x80000000
        later = [number for number in sorted(camera.controls) if number > asked & 0x7FFFFFFF]
        if not later:
            raise OSError(errno.EINVAL, "Invalid argument")
        knob = camera.controls[later[0]]
        struct.pack_into("=II", a, 0, later[0], 1)
        a[8 : 8 + len(knob.name)] = knob.name.encode()
        limits = knob.minimum, knob.maximum, knob.step, knob.value, knob.flags
        struct.pack_into("=iiiiI", a, 40, *limits)

    def _knob(self, camera: FakeCamera, a: bytearray) -> Knob:
        (asked,) = struct.unpack_from("=I", a, 0)
        if asked not in camera.controls:
            raise OSError(errno.EINVAL, "Invalid argument")
        return camera.controls[asked]

    def _g_ctrl(self, camera: FakeCamera, a: bytearray) -> None:
        struct.pack_into("=i", a, 4, self._knob(camera, a).value)

    def _s_ctrl(self, camera: FakeCamera, a: bytearray) -> None:
        knob = self._knob(camera, a)
        (value,) = struct.unpack_from("=i", a, 4)
        if knob.refused:
            raise OSError(errno.EBUSY, "Device or resource busy")
        if not knob.minimum <= value <= knob.maximum:
            raise OSError(errno.ERANGE, "Numerical result out of range")
        if not knob.stuck:
            knob.value = value

    def _enum_framesizes(self, camera: FakeCamera, a: bytearray) -> None:
        (index,) = struct.unpack_from("=I", a, 0)
        if index >= (1 if camera.stepwise else len(camera.sizes)):
            raise OSError(errno.EINVAL, "Invalid argument")
        if camera.stepwise:
            (w0, h0), (w1, h1) = camera.sizes
            struct.pack_into("=IIIIIII", a, 8, 3, w0, w1, 2, h0, h1, 2)
        else:
            struct.pack_into("=III", a, 8, 1, *camera.sizes[index])

    def _enum_frameintervals(self, camera: FakeCamera, a: bytearray) -> None:
        (index,) = struct.unpack_from("=I", a, 0)
        if index >= (1 if camera.stepwise else len(camera.intervals)):
            raise OSError(errno.EINVAL, "Invalid argument")
        if camera.stepwise:
            least, most = camera.intervals
            struct.pack_into("=IIIIIII", a, 16, 3, *least, *most, 1, 100)
        else:
            struct.pack_into("=III", a, 16, 1, *camera.intervals[index])

    def _reqbufs(self, camera: FakeCamera, a: bytearray) -> None:
        (count, kind, memory) = struct.unpack_from("=III", a, 0)
        assert (kind, memory) == (1, 1)
        camera.memory = [bytearray(0x1000 * 4) for _ in range(count)]
        camera.queued.clear()

    def _querybuf(self, camera: FakeCamera, a: bytearray) -> None:
        (index,) = struct.unpack_from("=I", a, 0)
        struct.pack_into("=I", a, 64, index * 0x1000)
        struct.pack_into("=I", a, 72, len(camera.memory[index]))

    def _qbuf(self, camera: FakeCamera, a: bytearray) -> None:
        index, kind = struct.unpack_from("=II", a, 0)
        assert kind == 1 and struct.unpack_from("=I", a, 60) == (1,)
        assert index not in camera.queued and index < len(camera.memory)
        camera.queued.append(index)

    def _dqbuf(self, camera: FakeCamera, a: bytearray) -> None:
        if not camera.shots or camera.shots[0].due_ns > self.clock.now_ns():
            raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")
        assert camera.streaming and camera.queued
        shot, index = camera.shots.popleft(), camera.queued.popleft()
        camera.memory[index][: len(shot.data)] = shot.data
        struct.pack_into("=IIII", a, 0, index, 1, len(shot.data), shot.flags)
        seconds, rest_ns = divmod(shot.stamp_ns, 10**9)
        struct.pack_into("=qq", a, 24, seconds, rest_ns // 1000)
        struct.pack_into("=I", a, 56, shot.sequence)

    def _streamon(self, camera: FakeCamera, a: bytearray) -> None:
        assert camera.queued
        camera.streaming = True

    def _streamoff(self, camera: FakeCamera, a: bytearray) -> None:
        camera.streaming = False
        camera.queued.clear()


def system(**cameras: FakeCamera) -> FakeVideoIO:
    """A system whose /dev holds these nodes."""
    return FakeVideoIO(ManualClock(), {f"/dev/{name}": c for name, c in cameras.items()})


def yuyv(rgb_gray: int, width: int, height: int, stride: int) -> bytes:
    """A uniform grey YUYV image (limited range) with padded rows."""
    rows = np.full((height, stride), 77, np.uint8)
    rows[:, 0 : 2 * width : 2] = round(16 + rgb_gray * 219 / 255)
    rows[:, 1 : 2 * width : 2] = 128
    return rows.tobytes()
