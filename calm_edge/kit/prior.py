"""What earlier drives of the same cameras taught, as long as this drive fits it."""

from __future__ import annotations

import logging
from pathlib import Path

from calm_edge.config import Config
from calm_edge.kit import change, file
from calm_edge.kit.belief import product
from calm_edge.types import Int, KitBelief

log = logging.getLogger(__name__)

TRUSTED_AFTER = 3


class KitPrior:
    """Owns the belief read from `backbone.kit_file`; without that key it keeps nothing.

    Windows solved under a wrong belief fail, or agree with it: so it is compared with what
    TRUSTED_AFTER sub-maps teach without it, and only then is it there as `belief`.

    The file is read at once, so that one which cannot be understood stops the drive at its start:
    the constructor raises KitFileError.
    """

    def __init__(self, config: Config) -> None:
        name = config.backbone.kit_file
        self._path = Path(name) if name else None
        self._cameras = (config.capture.primary, config.capture.assistant)
        self._kept = file.read(self._path) if self._path is not None else None
        self._sizes: Int | None = None
        self._remembered: KitBelief | None = None
        self._compared = 0

    @property
    def belief(self) -> KitBelief | None:
        """What is remembered, once it is trusted."""
        return self._remembered if self._compared >= TRUSTED_AFTER else None

    def open(self, sizes: Int | None) -> None:
        """Takes what was kept once the pictures' sizes (2, 2) are known, if it is of these."""
        if self._path is None or self._sizes is not None or sizes is None:
            return
        self._sizes = sizes
        self._remembered, reason = file.remembered(self._path, self._kept, self._cameras, sizes)
        if reason:
            log.info("kit memory: %s", reason)

    def contradicted(self, taught: KitBelief | None) -> tuple[str, ...]:
        """What moved since, in words, against what this drive `taught`; then all of it is dropped.

        A kit that was touched in one place may have been touched in others.
        """
        if self._remembered is None or taught is None:
            return ()
        compared = change.changes(self._remembered, taught)
        moved = [change for change in compared if change.noticed]
        self._compared += 1
        if moved:
            self._remembered = None
        return tuple(
            f"the kit has changed since its last drive: {change.text}; it is learned anew"
            for change in moved
        )

    def save(self, taught: KitBelief | None) -> None:
        """Keeps what is now known for the next drive; a failure is logged and costs nothing.

        Never over a file that is not understood.
        """
        known = product([self._remembered, taught])
        if self._path is None or self._sizes is None or known is None:
            return
        try:
            # it may have been put there since the drive began
            file.read(self._path)
            file.save(self._path, self._cameras, self._sizes, known)
        except file.KitFileError as error:
            log.error("%s", error)
