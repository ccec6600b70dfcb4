"""Sub-maps with the full number of keyframes, and their pictures, read from a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench import recorded
from calm_edge.config import Config
from calm_edge.recording.window_record import WindowRecord
from calm_edge.types import CalmEdgeError, Landmarks, LocalizerUpdate, Submap, SubmapWindow


@dataclass(frozen=True, slots=True)
class Piece:
    """A sub-map of a recording with its window of keyframes."""

    record: WindowRecord
    update: LocalizerUpdate
    window: SubmapWindow

    @property
    def submap(self) -> Submap:
        return self.update.submap

    @property
    def landmarks(self) -> Landmarks:
        marks = self.update.prediction.landmarks
        assert marks is not None
        return marks

    def images(self) -> list[NDArray[np.uint8]]:
        """Pictures (H, W, 3) BGR of the window in batch order."""
        return [keyframe.frame.bgr() for keyframe in self.window.keyframes()]


def read(path: Path, least: int) -> tuple[Config, list[Piece]]:
    """Read the sub-maps with all keyframes of both eyes, and the configuration of the recording.

    Raises CalmEdgeError if there are fewer than `least`.
    """
    _, recording, config, drive = recorded.read(path)
    most = config.frontend.n_max
    found = [
        Piece(record, update, recording.window(record))
        for record, update in zip(drive.windows, drive.updates, strict=True)
        if update.submap.n_primary == len(update.submap.assistant_ids) == most
        and update.prediction.landmarks is not None
    ]
    if len(found) < least:
        raise CalmEdgeError(
            f"{path}: {len(found)} sub-maps with {most} keyframes of each eye; "
            f"{least} are needed, record a longer drive"
        )
    return config, found
