"""Errors of hardware. The text is one line that names the device, the fault and the remedy."""

from __future__ import annotations


class DeviceError(Exception):
    """A device cannot be used as requested."""


class CameraError(DeviceError):
    """A camera cannot be found, opened or configured."""


class GpsError(DeviceError):
    """GPS fixes cannot be read."""
