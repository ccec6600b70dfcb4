"""Focal lengths from different parts of one drive against each other, by their statistical sigmas.

For real clips, whose published calibration is not exact. What all windows of a drive have in common
(lens, shutter, principal point) does not make its parts differ, so the common part of the
covariance of the evidence is left out: the sigmas here are statistical.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from heapq import merge
from pathlib import Path
from typing import Any

import numpy as np

from bench.drives import DATA
from bench.normalised import COLUMNS, Normalised, normalised
from bench.tables import Check, Table
from calm_edge.backbones.base import Backbone
from calm_edge.backbones.registry import open_backbone
from calm_edge.config import Config
from calm_edge.config import merge as merged
from calm_edge.estimator.localizer import Localizer
from calm_edge.frontend.association import WindowBuilder
from calm_edge.frontend.keyframes import KeyframeSelector
from calm_edge.kit import layout
from calm_edge.kit.belief import covariance, product
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.types import Float, Hints, KitBelief, Prediction, SubmapWindow
from device.frame import Eye

# A part with a larger sigma of the log focal has nothing to be compared.
LARGEST_SIGMA = 0.10
EYES = ("primary", "assistant")


@dataclass(frozen=True, slots=True)
class Clip:
    """A real clip with turns. spacing_m: between the cameras."""

    folder: Path
    spacing_m: float


CLIPS = (Clip(DATA / "karlsruhe_town", 0.5712), Clip(DATA / "kitti_raw_0001", 0.5372))


class Witness:
    """Backbone that keeps the newest evidence of each window on the kit, by its first stamp."""

    def __init__(self, backbone: Backbone) -> None:
        self._backbone = backbone
        self.evidence: dict[int, KitBelief] = {}

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._backbone, name)
        return self._noting(value) if callable(value) else value

    def _noting(self, method: Any) -> Any:
        def called(*arguments: Any, **named: Any) -> Any:
            result = method(*arguments, **named)
            hints = [a for a in (*arguments, *named.values()) if isinstance(a, Hints)]
            if isinstance(result, Prediction) and hints and result.kit is not None:
                self.evidence[int(hints[0].t_ns[0])] = result.kit
            return result

        return called


def windows(folder: Path, config: Config) -> Iterator[SubmapWindow]:
    """Windows of a sequence folder, as `record` would make them."""
    selector, builder = KeyframeSelector(config.frontend), WindowBuilder(config.frontend)
    sequence = SequenceFolder(folder)
    for frame in merge(*(sequence.frames(eye) for eye in Eye), key=lambda f: (f.t_ns, f.eye)):
        if frame.eye is Eye.ASSISTANT:
            yield from builder.add_assistant(frame)
            continue
        keyframe = selector.consider(frame, frame.gray())
        yield from builder.advance(frame.t_ns)
        if keyframe is not None:
            yield from builder.add_keyframe(keyframe)
    yield from builder.flush()


def evidence(clip: Clip) -> list[KitBelief]:
    """Final evidence of each window of a clip, in order of time."""
    known = {"scale": {"spacing_m": clip.spacing_m}, "loops": {"enabled": False}}
    config = merged(Config(), known)
    witness: Any = Witness(open_backbone(config))
    localizer = Localizer(config, witness)
    for window in windows(clip.folder, config):
        localizer.process(window)
        print(f"{clip.folder.name}: window {window.submap_id}", file=sys.stderr, flush=True)
    localizer.finish()
    kept: Mapping[int, KitBelief] = witness.evidence
    return [kept[t] for t in sorted(kept)]


def focals(beliefs: Iterable[KitBelief]) -> tuple[Float, Float]:
    """Log focals (2,) of the product of beliefs with the prior of an unknown kit, and sigmas."""
    beliefs = list(beliefs)
    families = [layout.families(belief.mean) for belief in beliefs] or [layout.PERSPECTIVE]
    joint = product([layout.prior((None, None), families=families[-1]), *beliefs])
    assert joint is not None
    statistical = covariance(replace(joint, common=0.0))
    return joint.mean[layout.LOG_FOCAL], np.sqrt(np.diag(statistical)[layout.LOG_FOCAL])


def differences(parts: Sequence[tuple[Sequence[KitBelief], Sequence[KitBelief]]]) -> Float:
    """Differences (D, 2) of log focals between two parts, with their sigmas.

    parts: pairs of disjoint sets of windows. Pairs in which either has a sigma above LARGEST_SIGMA
    are left out, for each eye by itself.
    """
    rows = []
    for one, other in parts:
        (a, sigma_a), (b, sigma_b) = focals(one), focals(other)
        known = np.maximum(sigma_a, sigma_b) <= LARGEST_SIGMA
        rows += np.stack([a - b, np.hypot(sigma_a, sigma_b)], 1)[known].tolist()
    return np.array(rows).reshape(-1, 2)


def halves(windows: Sequence[KitBelief]) -> Float:
    """The first half of the windows against the second."""
    middle = len(windows) // 2
    return differences([(windows[:middle], windows[middle:])])


def one_left_out(windows: Sequence[KitBelief]) -> Float:
    """Each window against all others."""
    return differences(
        [([one], [*windows[:k], *windows[k + 1 :]]) for k, one in enumerate(windows)]
    )


def agreement(command: str, clips: Sequence[Clip]) -> Table:
    """Table of the agreement within clips; a note names those not on disk."""
    shown: list[Normalised] = []
    checks: list[Check] = []
    notes = ["log focals, both eyes; sigmas of the evidence alone, see bench/kit_agreement"]
    for clip in clips:
        name = clip.folder.name
        if not (clip.folder / "cam1").is_dir():
            notes.append(f"{name} is not here")
            continue
        found = evidence(clip)
        of_halves = normalised(f"{name}, halves", *halves(found).T)
        left_out = normalised(f"{name}, one left out", *one_left_out(found).T)
        shown += [of_halves, left_out]
        # two differences, one an eye, have no rms to speak of
        if len(left_out.ratio):
            checks += [*of_halves.checks()[1:], *left_out.checks()]
            said = "windows with evidence on the kit"
        else:
            said = "windows with evidence, none of which determines a focal"
        notes.append(f"{name}: {len(found)} {said}")
    rows = tuple(one.row() for one in shown)
    title = "Focals of the parts of a real clip"
    return Table("honesty_clips", title, command, COLUMNS, rows, tuple(checks), tuple(notes))
