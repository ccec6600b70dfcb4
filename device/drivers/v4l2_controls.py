"""Set, lock and read back exposure, gain, white balance and focus of a V4L2 camera.

Autofocus changes the focal length, so it is an error unless it is requested.
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
# struct v4l2_queryctrl: id type name minimum maximum step default flags
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
    """A V4L2 control as described by QUERYCTRL; values in the driver's units."""

    id: int
    name: str
    minimum: int
    maximum: int
    step: int
    flags: int

    def nearest(self, value: int) -> int:
        """Return the nearest value that the control accepts."""
        step = max(1, self.step)
        clipped = min(max(value, self.minimum), self.maximum)
        return self.minimum + round((clipped - self.minimum) / step) * step


@dataclass(frozen=True, slots=True)
class ControlGroup:
    """The V4L2 controls for one key of CameraControls.

    switch: id of the control that selects the automatic mode; `on`: its values for automatic, tried
    in order; `off`: its value for manual. values: possible ids of the control with the manual
    value; a camera has one of them. unit: conversion factor, key units per control unit.
    """

    key: str
    switch: int
    on: tuple[int, ...]
    off: int
    values: tuple[int, ...]
    unit: int = 1


CONTROL_GROUPS = (
    # 3, aperture priority, is the automatic exposure of USB cameras
    ControlGroup("exposure_us", EXPOSURE_AUTO, (3, 0), 1, (EXPOSURE_ABSOLUTE,), unit=100),
    ControlGroup("gain", AUTOGAIN, (1,), 0, (GAIN, ANALOGUE_GAIN)),
    ControlGroup("white_balance_k", AUTO_WHITE_BALANCE, (1,), 0, (WHITE_BALANCE_TEMPERATURE,)),
    ControlGroup("focus", FOCUS_AUTO, (1,), 0, (FOCUS_ABSOLUTE,)),
)


def list_controls(io: VideoIO, fd: int) -> Iterator[Control]:
    """List the controls that are not disabled; raises OSError."""
    last = 0
    # bounded, since a faulty driver may never end its list
    for _ in range(512):
        argument = bytearray(QUERY.pack(last | FLAG_NEXT, 0, b"", 0, 0, 0, 0, 0))
        try:
            io.ioctl(fd, QUERYCTRL, argument)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return
            raise
        number, kind, name, least, most, step, _, flags = QUERY.unpack(argument)
        if number <= last:
            return
        last = number
        if kind != TYPE_CLASS and not flags & FLAG_DISABLED:
            yield Control(number, text(name), least, most, step, flags)


def get_control(io: VideoIO, fd: int, control: int) -> int | None:
    """Read a control; None if it cannot be read. Raises OSError if the camera is lost."""
    argument = bytearray(CONTROL.pack(control, 0))
    try:
        io.ioctl(fd, G_CTRL, argument)
    except OSError as error:
        if error.errno == errno.ENODEV:
            raise
        return None
    return int(CONTROL.unpack(argument)[1])


def set_control(io: VideoIO, fd: int, control: int, value: int) -> bool:
    """Write a control; False if the camera rejects it. Raises OSError if the camera is lost."""
    try:
        io.ioctl(fd, S_CTRL, bytearray(CONTROL.pack(control, value)))
    except OSError as error:
        if error.errno == errno.ENODEV:
            raise
        return False
    return True


class ControlKeeper:
    """Apply the controls of one camera, and restore the locked values after a reconnect.

    settings: key -> state read back from the camera: `auto`, a number in the unit of the key,
    `locked` if the value cannot be read, or `absent`. remarks: requests that were not fulfilled,
    one line each.
    """

    def __init__(self, name: str, wanted: CameraControls) -> None:
        self.settings: dict[str, int | str] = {}
        self.remarks: list[str] = []
        self._name, self._wanted = name, wanted
        self._locked: dict[str, int] = {}
        self._pending: list[ControlGroup] = []
        self._known: dict[int, Control] = {}

    @property
    def pending(self) -> bool:
        """True while `auto-then-lock` controls still have to be locked."""
        return bool(self._pending)

    def apply(self, io: VideoIO, fd: int) -> None:
        """Set all controls; raises CameraError if an unwanted autofocus cannot be switched off."""
        self._known = {c.id: c for c in list_controls(io, fd)}
        self._pending, self.remarks = [], []
        self._hold_rate(io, fd)
        for group in CONTROL_GROUPS:
            wanted = getattr(self._wanted, group.key)
            has_switch, value = group.switch in self._known, self._value_of(group)
            if not has_switch and value is None:
                self.settings[group.key] = "absent"
                if isinstance(wanted, int):
                    self.remarks.append(f"{self._name}: has no {group.key} control; not set")
                continue
            if group.key in self._locked:
                self._lock(io, fd, group, self._locked[group.key])
            elif wanted == LOCK:
                self._lock(io, fd, group, None)
            elif isinstance(wanted, int):
                self._lock(io, fd, group, wanted)
            elif has_switch:
                if not self._switch_on(io, fd, group):
                    self.remarks.append(f"{self._name}: {group.key} cannot be automatic")
                    self._read_back(io, fd, group)
                    continue
                self.settings[group.key] = AUTO
                if wanted == AUTO_THEN_LOCK:
                    self._pending.append(group)
            else:
                self._read_back(io, fd, group)

    def lock_settled(self, io: VideoIO, fd: int) -> None:
        """Lock the pending controls at their current values."""
        pending, self._pending = self._pending, []
        for group in pending:
            self._lock(io, fd, group, None)

    def _lock(self, io: VideoIO, fd: int, group: ControlGroup, wanted: int | None) -> None:
        """Switch to manual mode, at `wanted` in the key's unit, or at the current value if None."""
        control = self._value_of(group)
        current = None if control is None else get_control(io, fd, control.id)
        if group.switch in self._known and not self._switch_off(io, fd, group):
            if group.key == "focus":
                raise CameraError(
                    f"{self._name}: autofocus cannot be switched off, and it changes the focal "
                    'length; use another camera, or accept it with capture.focus = "auto"'
                )
            self.remarks.append(f"{self._name}: {group.key} cannot be locked, it stays automatic")
            self.settings[group.key] = AUTO
            return
        value = current if wanted is None else round(wanted / group.unit)
        if control is not None and value is not None:
            nearest = control.nearest(value)
            # also write an unchanged value: some cameras reset it when automatic is switched off
            fixed = bool(control.flags & FLAG_READ_ONLY)
            if not fixed and not set_control(io, fd, control.id, nearest):
                self.remarks.append(f"{self._name}: {group.key} was not accepted")
            elif wanted is None:
                pass
            elif (kept := get_control(io, fd, control.id)) is not None and kept != nearest:
                # some firmware accepts every value and keeps its own
                self.remarks.append(
                    f"{self._name}: {group.key} = {wanted} not applied, it is {kept * group.unit}"
                )
            elif nearest != value:
                self.remarks.append(
                    f"{self._name}: {group.key} = {wanted} is not a value the camera supports "
                    f"({control.minimum * group.unit} to {control.maximum * group.unit})"
                )
        self._read_back(io, fd, group)
        now = self.settings.get(group.key)
        if isinstance(now, int):
            self._locked[group.key] = now

    def _hold_rate(self, io: VideoIO, fd: int) -> None:
        """Forbid the camera to lower its frame rate for a longer automatic exposure."""
        if EXPOSURE_AUTO_PRIORITY not in self._known:
            # many cameras have no such control; the measured rate shows whether they slow down
            return
        set_control(io, fd, EXPOSURE_AUTO_PRIORITY, 0)
        if get_control(io, fd, EXPOSURE_AUTO_PRIORITY) != 0 and not isinstance(
            self._wanted.exposure_us, int
        ):
            self.remarks.append(
                f"{self._name}: may lower its frame rate in the dark, and this cannot be switched "
                "off; set capture.exposure_us to a number"
            )

    def _switch_on(self, io: VideoIO, fd: int, group: ControlGroup) -> bool:
        """Switch to automatic; False if the camera refuses or ignores it."""
        for on in group.on:
            if set_control(io, fd, group.switch, on):
                return get_control(io, fd, group.switch) in (on, None)
        return False

    def _switch_off(self, io: VideoIO, fd: int, group: ControlGroup) -> bool:
        written = set_control(io, fd, group.switch, group.off)
        return written and get_control(io, fd, group.switch) == group.off

    def _read_back(self, io: VideoIO, fd: int, group: ControlGroup) -> None:
        control = self._value_of(group)
        value = None if control is None else get_control(io, fd, control.id)
        self.settings[group.key] = "locked" if value is None else value * group.unit

    def _value_of(self, group: ControlGroup) -> Control | None:
        return next((self._known[v] for v in group.values if v in self._known), None)
