"""What both cameras see on a drive: through a lens, row by row, with bonnet and other cars."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from tests.synthetic.bonnet import Bonnet
from tests.synthetic.path import Drive
from tests.synthetic.render import render_view
from tests.synthetic.rows import Part, View, render_rows
from tests.synthetic.settings import Settings, camera
from tests.synthetic.traffic import cars
from tests.synthetic.world import World

Float = NDArray[np.float64]


def T_primary_assistant(settings: Settings) -> Float:
    """(4, 4) assistant -> primary, metres."""
    offset = np.array(settings.offset_m)
    offset *= settings.spacing_m / np.linalg.norm(offset)
    return se3.compose(se3.so3_exp(np.radians(settings.rotation_deg)), offset)


def our_drive(world: World, settings: Settings) -> Drive:
    """Once round the block, and a little further."""
    step = float(np.linalg.norm(world.loop[1] - world.loop[0]))
    again = world.loop[: round(settings.overlap_m / step)]
    return Drive(np.concatenate([world.loop, again]), settings.seed)


class Shots:
    """The pictures of a drive through a town, at any time t [s] from the line's beginning."""

    def __init__(self, world: World, settings: Settings) -> None:
        self.world, self.settings = world, settings
        self.drive = our_drive(world, settings)
        self.T_p_eye = np.eye(4), T_primary_assistant(settings)
        self.cameras = camera(settings, 0), camera(settings, 1)
        self.cars = cars(world.loop, settings)
        self.bonnets = [
            Bonnet.of(c, share, settings.seed + eye) if share else None
            for eye, (c, share) in enumerate(zip(self.cameras, settings.bonnet, strict=True))
        ]

    def row_times(self, eye: int, t: float) -> Float:
        """(H,) when each row is exposed of the picture whose middle row is exposed at t."""
        rows = np.arange(self.settings.height) / (self.settings.height - 1) - 0.5
        return np.asarray(t + self.settings.readout_s[eye] * rows)

    def poses(self, eye: int, t: Float) -> Float:
        """T_town_camera (N, 4, 4) at seconds t (N,)."""
        return np.asarray(self.drive.poses(t) @ self.T_p_eye[eye])

    def view(self, eye: int, t: float) -> View:
        """The picture of an eye; part 0 is what stands still, -1 sky and bonnet."""
        lens, times = self.cameras[eye], self.row_times(eye, t)
        if lens.is_pinhole and not self.cars and not self.settings.readout_s[eye]:
            image, depth = render_view(self.world.scene, self.poses(eye, np.array([t]))[0], lens)
            seen = View(image, depth, np.where(depth > 0, 0, -1).astype(np.int32))
        else:
            T = self.poses(eye, times)
            parts = [Part(self.world.scene, T), *(car.seen(times, T) for car in self.cars)]
            seen = render_rows(parts, lens)
        bonnet = self.bonnets[eye]
        if bonnet is None:
            return seen
        clear = bonnet.cover == 0
        return View(
            bonnet.over(seen.image),
            np.where(clear, seen.depth, np.float32(0)),
            np.where(clear, seen.part, np.int32(-1)),
        )
