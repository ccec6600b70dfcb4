"""The belief from before this drive: of earlier drives and of a known calibration."""

from __future__ import annotations

import logging
from pathlib import Path

from calm_edge.config import Config
from calm_edge.kit import change, file, layout
from calm_edge.kit.belief import product
from calm_edge.kit.calibrated import CalibratedKit
from calm_edge.kit.observed import observed_part
from calm_edge.types import Int, KitBelief

log = logging.getLogger(__name__)

TRUSTED_AFTER = 3


class KitPrior:
    """Read, test and save the belief of earlier drives; there is none without `backbone.kit_file`.

    Besides it a calibration is used, see `CalibratedKit`. Windows solved under a wrong belief fail
    or reproduce it. So the first TRUSTED_AFTER sub-maps are solved without that of earlier drives,
    and `belief` includes it once they agree. The constructor reads the file, so that a damaged one
    stops the drive at its start; it raises KitFileError, ConfigError.
    """

    def __init__(self, config: Config) -> None:
        name = config.backbone.kit_file
        self._path = Path(name) if name else None
        self._cameras = (config.capture.primary, config.capture.assistant)
        self._kept = file.read(self._path) if self._path is not None else None
        self._sizes: Int | None = None
        self._remembered: KitBelief | None = None
        self._compared = 0
        # log odds of the masks of an earlier drive
        self.ego: file.EgoLogOdds = (None, None)
        self._calibrated = CalibratedKit(config.calibration)

    @property
    def belief(self) -> KitBelief | None:
        """Product of the calibration and, once it is trusted, of the belief of earlier drives."""
        calibrated, earlier = self._calibrated.belief, self._remembered
        if self._compared < TRUSTED_AFTER or earlier is None:
            return calibrated
        if calibrated is not None and not layout.alike(calibrated, earlier):
            return calibrated
        return product([calibrated, earlier])

    @property
    def earlier(self) -> KitBelief | None:
        """The belief of earlier drives, which counts until this drive contradicts it."""
        return self._remembered

    def open(self, sizes: Int | None) -> None:
        """Use what was stored, or calibrated, for images of these sizes (2, 2) [px].

        Within a drive only the first call does; later ones note the sizes that `save` writes.
        """
        if sizes is None:
            return
        first, self._sizes = self._sizes is None, sizes
        if not first:
            return
        self._calibrated.open(sizes)
        if self._path is None:
            return
        self._remembered, reason = file.remembered(self._path, self._kept, self._cameras, sizes)
        if self._remembered is not None and self._kept is not None:
            self.ego = self._kept.ego
        if reason:
            log.info("kit memory: %s", reason)

    def contradicted(self, evidence: KitBelief | None) -> tuple[str, ...]:
        """Compare with the evidence of this drive: one line for each part that has changed.

        On any change the whole belief of earlier drives is dropped, since other parts may have
        changed as well.
        """
        lines = self._calibrated.contradicted(evidence)
        if self._remembered is None or evidence is None:
            return lines
        texts = change.described(self._remembered, evidence)
        self._compared += 1
        if texts:
            self._remembered = None
        return lines + tuple(
            f"the kit has changed since its last drive: {text}; it is learned again"
            for text in texts
        )

    def forget(self, *, lens: bool) -> KitBelief | None:
        """Drop the belief of earlier drives: the kit has changed since, its lenses if `lens`.

        Returns what holds of a calibration.
        """
        self._remembered = None
        return self._calibrated.after_change(lens=lens)

    def save(self, evidence: KitBelief | None, ego: file.EgoLogOdds = (None, None)) -> None:
        """Write what all drives have observed, for the next one; failures are logged.

        ego: log odds of the masks. A file that cannot be parsed is never overwritten.
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
            file.save(self._path, self._cameras, self._sizes, known, ego)
        except file.KitFileError as error:
            log.error("%s", error)
