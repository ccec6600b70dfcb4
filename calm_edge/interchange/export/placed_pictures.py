"""Pictures of a drive that have a pose: its keyframes, or all frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.export.base import ExportOptions
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.types import Float
from device.frame import Eye


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture. T_w_c: (4, 4). name: of its file in the folder IMAGES."""

    eye: Eye
    t_ns: int
    T_w_c: Float
    name: str


def placed_pictures(
    drive: ExportedDrive,
    eyes: set[Eye],
    options: ExportOptions,
    assumed: list[str],
    left_out: list[str],
) -> tuple[Picture, ...]:
    """Keyframes, or all frames, of the given eyes that have poses."""
    wanted: dict[Eye, set[int]] = {eye: set() for eye in eyes}
    wanted[Eye.PRIMARY] |= set(drive.keyframes.t_ns.tolist())
    for update in drive.solved.updates():
        submap = update.submap
        end = submap.n_primary + len(submap.assistant_ids)
        if Eye.ASSISTANT in eyes:
            wanted[Eye.ASSISTANT] |= set(submap.t_ns[submap.n_primary : end].tolist())
    found = []
    for eye, poses in drive.frame_poses().items():
        if eye not in eyes:
            continue
        name, shown = eye.name.lower(), poses.known
        if options.every_frame:
            assumed.append(f"{name}: poses {poses.counts()}; landmarks are seen in keyframes alone")
        else:
            shown = shown & np.isin(poses.t_ns, list(wanted[eye]))
        chosen = np.flatnonzero(shown)
        found += [
            Picture(eye, int(poses.t_ns[i]), poses.T_w_c[i], f"{name}/{k:06d}.jpg")
            for k, i in enumerate(chosen.tolist())
        ]
        why = "without a pose" if options.every_frame else "not keyframes (--every-frame)"
        if missing := len(poses.t_ns) - len(chosen):
            left_out.append(f"{missing} frames of the {name}: {why}")
    if not found:
        raise InterchangeError(f"{drive.path}: no frame has a pose; run calm-edge map first")
    return tuple(found)
