"""Two replayed cameras in front of a wall, in place of ones that are plugged in."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from calm_edge.config import Config
from calm_edge.daemon.source import Source, replayed
from calm_edge.types import Bytes
from device.camera import FoundCamera
from device.frame import Eye, Frame, jpeg
from tests.frontend.plane_world import PlaneWorld

LEFT = FoundCamera("v4l2:usb-1", "Left", "/dev/video0")
RIGHT = FoundCamera("v4l2:usb-2", "Right", "/dev/video2")
RATE_HZ, SECONDS = 20, 4
NEVER = SECONDS * RATE_HZ


def sharp_world(seed: int) -> PlaneWorld:
    """A wall with finer texture than usual."""
    world = PlaneWorld(seed)
    size = world.texture.shape
    noise = np.random.default_rng(seed).integers(0, 255, (size[0] // 2, size[1] // 2), np.uint8)
    fine = cv2.resize(noise, size, interpolation=cv2.INTER_CUBIC)
    world.texture = np.asarray(cv2.addWeighted(world.texture, 0.6, fine, 0.4, 0), np.uint8)
    return world


class Bench:
    """Two cameras in front of a wall, by address. alter: of a picture, by address."""

    def __init__(self) -> None:
        self.found = [RIGHT, LEFT]
        self.alter: dict[str, Callable[[Bytes], Bytes]] = {}
        self.dark_from: dict[str, int] = {}
        self.opened: list[tuple[str, str]] = []
        world = sharp_world(0)
        self.views = {}
        for address, x in ((LEFT.address, 0.0), (RIGHT.address, 0.5)):
            T_w_c = np.eye(4)
            T_w_c[0, 3] = x
            gray = world.render(T_w_c)
            self.views[address] = np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), np.uint8)

    def discover(self, details: bool) -> tuple[list[FoundCamera], list[str]]:
        return list(self.found), []

    def live(self, config: Config) -> Source:
        pair = config.capture.primary, config.capture.assistant
        self.opened.append(pair)

        def frames(eye: Eye) -> list[Frame]:
            address = pair[eye]
            bright = jpeg(self.alter.get(address, np.asarray)(self.views[address]))
            dark = jpeg(np.zeros((48, 64, 3), np.uint8))
            start = self.dark_from.get(address, NEVER)
            return [
                Frame(eye, k, k * 10**9 // RATE_HZ, dark if k >= start else bright)
                for k in range(SECONDS * RATE_HZ)
            ]

        return replayed(frames, 0, True, "two cameras")
