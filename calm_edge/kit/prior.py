"""The belief from earlier drives of the same cameras, used while this drive agrees with it."""

from __future__ import annotations

import logging
from pathlib import Path

from calm_edge.config import Config
from calm_edge.kit import change, file
from calm_edge.kit.belief import product
from calm_edge.kit.observed import observed_part
from calm_edge.types import Int, KitBelief

log = logging.getLogger(__name__)

TRUSTED_AFTER = 3


class KitPrior:
    """Read, test and save the belief of earlier drives; there is none without `backbone.kit_file`.

    Windows solved under a wrong belief fail or reproduce it. So the first TRUSTED_AFTER sub-maps
    are solved without it, and `belief` returns it once they agree. The constructor reads the file,
    so that a damaged one stops the drive at its start; it raises KitFileError.
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
        """Belief of earlier drives once it is trusted, else None."""
        return self._remembered if self._compared >= TRUSTED_AFTER else None

    def open(self, sizes: Int | None) -> None:
        """Use the file's belief if it was stored for images of these sizes (2, 2) [px]."""
        if self._path is None or self._sizes is not None or sizes is None:
            return
        self._sizes = sizes
        self._remembered, reason = file.remembered(self._path, self._kept, self._cameras, sizes)
        if reason:
            log.info("kit memory: %s", reason)

    def contradicted(self, evidence: KitBelief | None) -> tuple[str, ...]:
        """Compare with the evidence of this drive: one line for each part that has changed.

        On any change the whole belief is dropped, since other parts may have changed as well.
        """
        if self._remembered is None or evidence is None:
            return ()
        texts = change.described(self._remembered, evidence)
        self._compared += 1
        if texts:
            self._remembered = None
        return tuple(
            f"the kit has changed since its last drive: {text}; it is learned again"
            for text in texts
        )

    def forget(self) -> None:
        """Drop the belief of earlier drives: the kit has changed since."""
        self._remembered = None

    def save(self, evidence: KitBelief | None) -> None:
        """Write what all drives have observed, for the next one; failures are logged.

        A file that cannot be parsed is never overwritten.
        """
        belief = product([self._remembered, evidence])
        if self._path is None or self._sizes is None or belief is None:
            return
        known = observed_part(belief)
        if known is None:
            return
        try:
            # the file may have been replaced since the drive began
            file.read(self._path)
            file.save(self._path, self._cameras, self._sizes, known)
        except file.KitFileError as error:
            log.error("%s", error)
