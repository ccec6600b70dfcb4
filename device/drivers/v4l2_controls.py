"""Exposure, gain, white balance and focus of a V4L2 camera: set, locked, read back.

A focus that moves is a focal length that moves, so autofocus is refused unless it is asked for.
"""

from __future__ import annotations

import errno
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from device.camera import AUTO, AUTO_THEN_LOCK, LOCK, CameraControls
from device.drivers.v4l2_ioctl import VideoIO, text
from device.errors import CameraError

QUERYCTRL = 0xC0445624
G_CTRL = 0xC008561B
S_CTRL = 0xC008561C
# id type name minimum maximum step default flags
QUERY = struct.Struct("=II32siiiiI8x")
CONTROL = struct.Struct("=Ii")
FLAG_DISABLED = 0x0001
FLAG_READ_ONLY = 0x0004
FLAG_NEXT = 0x80000000
TYPE_CLASS = 6

AUTO_WHITE_BALANCE = 0x0098090C
AUTOGAIN = 0x00980912
GAIN = 0x00980913
WHITE_BALANCE_TEMPERATURE = 0x0098091A
EXPOSURE_AUTO = 0x009A0901
EXPOSURE_ABSOLUTE = 0x009A0902
EXPOSURE_AUTO_PRIORITY = 0x009A0903
FOCUS_ABSOLUTE = 0x009A090A
FOCUS_AUTO = 0x009A090C
ANALOGUE_GAIN = 0x009E0903


@dataclass(frozen=True, slots=True)
class Control:
    """One control of a camera, as the driver describes it; values in the driver's own units."""

    id: int
    name: str
    minimum: int
    maximum: int
    step: int
    default: int
    flags: int

    def nearest(self, value: int) -> int:
        """The value the control can take that is nearest."""
        step = max(1, self.step)
        clipped = min(max(value, self.minimum), self.maximum)
        return self.minimum + round((clipped - self.minimum) / step) * step


@dataclass(frozen=True, slots=True)
class Knob:
    """What a key of CameraControls is made of. unit: of the key in one of the control's."""

    key: str
    switch: int
    on: tuple[int, ...]
    off: int
    values: tuple[int, ...]
    unit: int = 1


KNOBS = (
    # aperture priority is what USB cameras call automatic
    Knob("exposure_us", EXPOSURE_AUTO, (3, 0), 1, (EXPOSURE_ABSOLUTE,), unit=100),
    Knob("gain", AUTOGAIN, (1,), 0, (GAIN, ANALOGUE_GAIN)),
    Knob("white_balance_k", AUTO_WHITE_BALANCE, (1,), 0, (WHITE_BALANCE_TEMPERATURE,)),
    Knob("focus", FOCUS_AUTO, (1,), 0, (FOCUS_ABSOLUTE,)),
)


def list_controls(io: VideoIO, fd: int) -> Iterator[Control]:
    """Every control that is not disabled; none where the driver has no controls at all."""
    last = 0
    # a driver that never ends its list must not end us
    for _ in range(512):
        argument = bytearray(QUERY.pack(last | FLAG_NEXT, 0, b"", 0, 0, 0, 0, 0))
        try:
            io.ioctl(fd, QUERYCTRL, argument)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return
            raise
        number, kind, name, least, most, step, default, flags = QUERY.unpack(argument)
        if number <= last:
            return
        last = number
        if kind != TYPE_CLASS and not flags & FLAG_DISABLED:
            yield Control(number, text(name), least, most, step, default, flags)


def get(io: VideoIO, fd: int, control: int) -> int | None:
    """Its value; None where it has none that can be read. Raises OSError of a lost camera."""
    argument = bytearray(CONTROL.pack(control, 0))
    try:
        io.ioctl(fd, G_CTRL, argument)
    except OSError as error:
        if error.errno == errno.ENODEV:
            raise
        return None
    return int(CONTROL.unpack(argument)[1])


def put(io: VideoIO, fd: int, control: int, value: int) -> bool:
    """Whether the camera took the value; raises OSError of a lost camera."""
    try:
        io.ioctl(fd, S_CTRL, bytearray(CONTROL.pack(control, value)))
    except OSError as error:
        if error.errno == errno.ENODEV:
            raise
        return False
    return True


class ControlKeeper:
    """Owner of what one camera is set to; a camera that comes back gets what it was locked to.

    settings: key -> what was read back: `auto`, a number in the unit of the key, or `absent`.
    remarks: what could not be done as asked, a line each.
    """

    def __init__(self, name: str, wanted: CameraControls) -> None:
        self.settings: dict[str, int | str] = {}
        self.remarks: list[str] = []
        self._name, self._wanted = name, wanted
        self._locked: dict[str, int] = {}
        self._pending: list[Knob] = []
        self._known: dict[int, Control] = {}

    @property
    def pending(self) -> bool:
        """Something still has to be locked, once it has settled."""
        return bool(self._pending)

    def apply(self, io: VideoIO, fd: int) -> None:
        """Sets all of it; raises CameraError where the focus would move on its own."""
        self._known = {c.id: c for c in list_controls(io, fd)}
        self._pending, self.remarks = [], []
        if EXPOSURE_AUTO_PRIORITY in self._known:
            # else the camera drops to half its rate when it gets dark
            put(io, fd, EXPOSURE_AUTO_PRIORITY, 0)
        for knob in KNOBS:
            wanted = getattr(self._wanted, knob.key)
            has_switch, value = knob.switch in self._known, self._value_of(knob)
            if not has_switch and value is None:
                self.settings[knob.key] = "absent"
                if isinstance(wanted, int):
                    self.remarks.append(f"{self._name}: has no {knob.key}, it stays as it is")
                continue
            if knob.key in self._locked:
                self._fix(io, fd, knob, self._locked[knob.key])
            elif wanted == LOCK:
                self._fix(io, fd, knob, None)
            elif isinstance(wanted, int):
                self._fix(io, fd, knob, wanted)
            elif has_switch:
                if not any(put(io, fd, knob.switch, on) for on in knob.on):
                    self.remarks.append(f"{self._name}: {knob.key} cannot be automatic")
                self.settings[knob.key] = AUTO
                if wanted == AUTO_THEN_LOCK:
                    self._pending.append(knob)
            else:
                self._read_back(io, fd, knob)

    def settle(self, io: VideoIO, fd: int) -> None:
        """Locks what was to be locked once the camera had found its values."""
        pending, self._pending = self._pending, []
        for knob in pending:
            self._fix(io, fd, knob, None)

    def _fix(self, io: VideoIO, fd: int, knob: Knob, wanted: int | None) -> None:
        """By hand from now on: at `wanted` in the key's unit, or where it stands."""
        control = self._value_of(knob)
        stands = None if control is None else get(io, fd, control.id)
        if knob.switch in self._known and not self._switch_off(io, fd, knob):
            if knob.key == "focus":
                raise CameraError(
                    f"{self._name}: its autofocus cannot be switched off; a focus that moves is "
                    'a focal length that moves; use another camera, or set capture.focus = "auto"'
                )
            self.remarks.append(f"{self._name}: {knob.key} cannot be locked, it stays automatic")
            self.settings[knob.key] = AUTO
            return
        value = stands if wanted is None else round(wanted / knob.unit)
        if control is not None and value is not None and not control.flags & FLAG_READ_ONLY:
            nearest = control.nearest(value)
            # some cameras jump to a default as the automatic goes off: set even what stands
            if not put(io, fd, control.id, nearest):
                self.remarks.append(f"{self._name}: {knob.key} was not accepted")
            elif wanted is not None and nearest != value:
                self.remarks.append(
                    f"{self._name}: {knob.key} = {wanted} is outside of what the camera can "
                    f"({control.minimum * knob.unit} to {control.maximum * knob.unit})"
                )
        self._read_back(io, fd, knob)
        now = self.settings.get(knob.key)
        if isinstance(now, int):
            self._locked[knob.key] = now

    def _switch_off(self, io: VideoIO, fd: int, knob: Knob) -> bool:
        return put(io, fd, knob.switch, knob.off) and get(io, fd, knob.switch) == knob.off

    def _read_back(self, io: VideoIO, fd: int, knob: Knob) -> None:
        control = self._value_of(knob)
        value = None if control is None else get(io, fd, control.id)
        self.settings[knob.key] = "locked" if value is None else value * knob.unit

    def _value_of(self, knob: Knob) -> Control | None:
        return next((self._known[v] for v in knob.values if v in self._known), None)
