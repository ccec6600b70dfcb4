"""Test 1: both cameras and the serial port are present, under names that survive a reboot."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from device.drivers.v4l2_nodes import SERIAL, list_devices
from device.errors import DeviceError
from hil_tests.kit import Kit
from hil_tests.report import Row, judged, skipped

NAME = "1 enumerate"


def rows(kit: Kit) -> Iterator[Row]:
    """Yield a row for each camera, one for each eye, one for the port."""
    try:
        nodes = list_devices()
    except DeviceError as error:
        yield judged(NAME, "cameras", False, str(error), "can be opened")
        return
    for node in nodes:
        yield judged(NAME, node.path, True, f"{node.card}, {node.driver}, {node.address}", "")
    if not nodes:
        yield skipped(NAME, "cameras", "no V4L2 camera on this machine")
    for eye, text in (
        ("primary", kit.config.capture.primary),
        ("assistant", kit.config.capture.assistant),
    ):
        driver, _, address = text.partition(":")
        if driver != "v4l2":
            yield skipped(NAME, eye, f"{text}: not V4L2")
            continue
        wanted = "an address by USB port, of a camera that is present"
        if not address:
            yield skipped(NAME, eye, f"capture.{eye} names no port: the first camera found is used")
        else:
            here = [
                node for node in nodes if address in (node.address, node.path, SERIAL + node.serial)
            ]
            good = len(here) == 1 and not address.startswith("/dev/video")
            yield judged(
                NAME, eye, good, f"{address}: {here[0].path if here else 'not present'}", wanted
            )
    port = kit.config.pose_output.port
    if not port:
        yield skipped(NAME, "serial port", "pose_output.port is empty")
    else:
        usable = Path(port).exists() and os.access(port, os.R_OK | os.W_OK)
        yield judged(NAME, "serial port", usable, port, "exists and can be written (group dialout)")
