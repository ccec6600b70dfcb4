"""`calm-edge cameras`: what could be written into `capture.primary` and `capture.assistant`."""

from __future__ import annotations

import argparse
import sys

from calm_edge.commands.exit_codes import ERROR, OK


def configure(parser: argparse.ArgumentParser) -> None:
    """It has no arguments."""


def run(arguments: argparse.Namespace) -> int:
    """Prints an address a line."""
    from device.drivers.v4l2_nodes import list_devices

    devices = list_devices()
    for device in devices:
        print(f"v4l2:{device.address}  {device.card}  {device.path}")
    if not devices:
        print("calm-edge: no V4L2 camera found; plug one in, see: ls /dev/video*", file=sys.stderr)
        return ERROR
    return OK
