"""Places that several drives show: loop closures between their keyframes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calm_edge.backbones.base import LocatesViews
from calm_edge.backbones.registry import open_backbone
from calm_edge.config import Config
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.loops.descriptor import DescribesPlaces
from calm_edge.loops.finder import LoopCandidate, PlaceLoops
from calm_edge.loops.same_place import KnownKit
from calm_edge.offline.drive import Drive
from calm_edge.offline.progress import Progress
from calm_edge.recording.reader import Recording
from calm_edge.types import (
    CalmEdgeError,
    Hints,
    Keyframe,
    LocalizerUpdate,
    LoopClosure,
    SubmapWindow,
)

# ids of keyframes and sub-maps of drive n begin at n times this
STRIDE = 1_000_000


class JoinError(CalmEdgeError):
    """Drives cannot be joined."""


@dataclass(frozen=True, slots=True)
class PlacedDrive:
    """A recording and its sub-maps, placed in the drive's own world."""

    recording: Recording
    drive: Drive


def drive_of(number: int) -> int:
    """Drive that an id of a keyframe or sub-map of several drives belongs to."""
    return number // STRIDE


def closures(
    drives: Sequence[PlacedDrive], config: Config, say: Callable[[str], None]
) -> list[LoopClosure]:
    """Find places of earlier drives in each later one, and measure the poses between both.

    The ids of the closures are those of the drives' keyframes plus STRIDE times the number of the
    drive; world units. Raises JoinError for a backbone that cannot place single pictures.
    """
    backbone = open_backbone(config)
    if not isinstance(backbone, LocatesViews):
        raise JoinError(
            f"backbone.name = {config.backbone.name}: cannot place pictures of other drives; "
            "record with bundle"
        )
    descriptor = None
    if config.loops.descriptor != "gradients" and isinstance(backbone, DescribesPlaces):
        descriptor = backbone.places
    cameras = {
        id_ + STRIDE * n: update.submap.cameras[view]
        for n, placed in enumerate(drives)
        for update in placed.drive.updates
        for view, id_ in enumerate(update.submap.primary_ids)
    }
    finder = PlaceLoops(config.loops, descriptor, cameras.__getitem__)
    found = []
    total = sum(len(placed.drive.windows) for placed in drives)
    progress = Progress("comparing places of the drives", total, say)
    for n, placed in enumerate(drives):
        described = []
        for window, update in _windows(placed, n):
            images = [keyframe.frame.bgr() for keyframe in window.keyframes()]
            kit = _kit(placed.drive, update) if n else None
            candidate = finder.find(window, images, kit)
            if candidate is not None:
                closure = _measured(window, images, update, candidate, backbone, config, cameras)
                if closure is not None:
                    found.append(closure)
            described.append((window, finder.taken()))
            progress.step()
        # only then, so that the drive is compared with others and not with itself
        for window, vectors in described:
            finder.remember(window, vectors)
    return found


def _windows(placed: PlacedDrive, number: int) -> Iterator[tuple[SubmapWindow, LocalizerUpdate]]:
    """Windows without loop keyframes, and their updates; ids are unique over all drives."""
    shift = STRIDE * number
    for record, update in zip(placed.drive.windows, placed.drive.updates, strict=True):
        window = placed.recording.window(record)
        yield (
            replace(
                window,
                submap_id=window.submap_id + shift,
                primary=tuple(Keyframe(k.id + shift, k.frame) for k in window.primary),
                loop_keyframe=None,
            ),
            update,
        )


def _kit(drive: Drive, update: LocalizerUpdate) -> KnownKit:
    submap = update.submap
    assert drive.trajectory is not None
    cameras = submap.cameras[0], submap.cameras[submap.n_primary]
    return KnownKit(cameras, drive.trajectory.T_p_a)


def _measured(
    window: SubmapWindow,
    images: list[np.ndarray],
    update: LocalizerUpdate,
    candidate: LoopCandidate,
    backbone: LocatesViews,
    config: Config,
    cameras: dict[int, Camera],
) -> LoopClosure | None:
    """Closure by the points of the whole window; None where the picture cannot be placed."""
    submap, prediction, place = update.submap, update.prediction, candidate.keyframe
    n = submap.n_primary + len(submap.assistant_ids)
    if len(prediction.cameras) > n:
        prediction = prediction.without_loop()
    hints = Hints(
        np.repeat([0, 1, 0], [submap.n_primary, len(submap.assistant_ids), 1]),
        np.append(submap.t_ns[:n], place.frame.t_ns),
        loop=True,
        masks=update.masks,
    )
    pictures = [*images, place.frame.bgr()]
    T_s_place = backbone.locate_view(pictures, hints, prediction, cameras[place.id])
    if T_s_place is None:
        return None
    T_s_place = np.array(T_s_place)
    T_s_place[:3, 3] *= submap.scale
    T_place_query = se3.inverse(T_s_place) @ submap.T_s_c[candidate.query_view]
    if not candidate.agrees(se3.inverse(T_place_query), config.scale.spacing):
        return None
    return LoopClosure(window.primary[candidate.query_view].id, place.id, T_place_query)
