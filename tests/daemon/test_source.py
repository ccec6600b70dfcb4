"""Sources of frames: what is refused before a camera is opened."""

from __future__ import annotations

import pytest

from calm_edge.config import Config, merge
from calm_edge.daemon.source import live
from device.errors import CameraError


@pytest.mark.parametrize("address", ["v4l2:usb-1", "v4l2:/dev/video0", "oak:ABC"])
def test_one_address_for_both_cameras_is_refused(address: str) -> None:
    config = merge(Config(), {"capture": {"primary": address, "assistant": address}})
    with pytest.raises(CameraError, match="is used for both cameras"):
        live(config)


def test_without_addresses_the_two_cameras_are_chosen_by_the_driver() -> None:
    assert live(Config()).description == "v4l2: v4l2:"
