"""What hardware can do to us. The text is one line: the device, the fault, the mend."""

from __future__ import annotations


class DeviceError(Exception):
    """A device that cannot be used as asked."""


class CameraError(DeviceError):
    """A camera that cannot be found, opened or configured."""
