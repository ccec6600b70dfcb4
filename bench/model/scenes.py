"""Picture pairs from rendered drives, with their ground truth."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from bench.drives import HELD_OUT, Prepare, pictures, read_picture, simulated
from bench.model.simulator import DriveWorld, true_cameras
from bench.model.truth import PosedDepth
from calm_edge.config import FrontendConfig
from calm_edge.frontend.keyframes import KeyframeSelector
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.types import Bytes
from device.frame import Eye, Frame

GAPS = (1, 3, 8)
# Number of places along a drive, in ordinary and in hard scenes; and number of frames searched at a
# place for as many keyframes as GAPS, the intervals in keyframes of the pairs matched, requires.
PLACES, HARD_PLACES = 5, 6
SEARCHED = 60


@dataclass(frozen=True, slots=True)
class Scene:
    """A drive on which matchers are compared.

    hard: match only between the eyes, which differ strongly in focal length and roll.
    """

    name: str
    prepare: Prepare
    hard: bool = False


@dataclass(frozen=True, slots=True)
class Side:
    """One picture of a pair, (H, W, 3) BGR, its truth, and a seed unique to it."""

    image: Bytes
    truth: PosedDepth
    seed: int


@dataclass(frozen=True, slots=True)
class Pair:
    """A picture pair. Query points lie in a and are searched for in b.

    case: `eyes`, primary to assistant at one frame, with the difference of the cameras if large; or
    `K on`, a primary keyframe and the K-th after it. place: index of the pair's place along the
    drive.
    """

    case: str
    scene: str
    place: int
    a: Side
    b: Side


def _drive(name: str, *options: str) -> Scene:
    return Scene(name, simulated(name, *options))


_SHORT = ("--frames", "600", "--track")
DEVELOPMENT = (
    _drive("aalborg", *_SHORT, "aalborg"),
    _drive("street-1", *_SHORT, "street-1"),
    _drive("e-track-2", *_SHORT, "e-track-2", *["--hfov", "70", "85", "--baseline", "0.8"],
           *["--rot-deg", "1.5", "-4", "2", "--async", "0.02"]),
    _drive("alpine-1", *_SHORT, "alpine-1", "--seed", "3", "--async", "0.02"),
    _drive("brondehach", *_SHORT, "brondehach", *["--hfov", "95", "65", "--baseline", "0.35"],
           *["--rot-deg", "2", "4", "-2", "--async", "0.01", "--jitter-ms", "3", "--seed", "4"]),
)  # fmt: skip
UNSEEN = tuple(Scene(drive.name, drive.loose) for drive in HELD_OUT)

# Rig of the hard scenes: horizontal fields of view of 90 and 53.13 degrees, focal lengths of ratio
# two; the eyes are rotated by 20 degrees about one axis.
_TWICE = ["--frames", "60", "--hz", "4", "--hfov", "90", "53.13", "--rot-deg"]
_TURNS = {"roll": "0 0 20", "yaw": "0 20 0"}


def _hard(track: str, skip_m: int) -> tuple[Scene, ...]:
    return tuple(
        Scene(
            f"hard_{turn}_{track}",
            simulated(f"hard_{turn}_{track}", *_TWICE, *degrees.split(),
                      "--track", track, "--skip-s", str(skip_m)),
            hard=True,
        )
        for turn, degrees in _TURNS.items()
    )  # fmt: skip


HARD = (*_hard("street-1", 800), *_hard("e-track-2", 800))
HARD_UNSEEN = (*_hard("forza", 800), *_hard("e-track-6", 800))


def prepared(
    drives: Mapping[str, Prepare], only: Sequence[str] | None, out: Path, skipped: list[str]
) -> Iterator[tuple[str, Path]]:
    """Prepare the drives and yield their names and folders.

    only: names of drives, all if empty. Reasons why drives are missing are appended to `skipped`.
    """
    for name, prepare in drives.items():
        if only and name not in only:
            continue
        print(f"{name} ...", file=sys.stderr, flush=True)
        folder = prepare(out)
        if isinstance(folder, str):
            skipped.append(f"{name} skipped: {folder}")
        else:
            yield name, folder


class Pictures:
    """Pictures of a rendered drive with their ground truth; raises EvaluationError."""

    def __init__(self, folder: Path) -> None:
        self.sequence = SequenceFolder(folder)
        self._world = DriveWorld(folder)
        self._cameras = true_cameras(folder)
        self._files = [pictures(folder, int(eye)) for eye in Eye]

    def side(self, eye: int, frame: int) -> Side:
        """Read the picture of an eye at a frame, with its truth."""
        image = read_picture(self._files[eye][frame])
        z = self._world.z_depth(eye, frame)
        truth = PosedDepth(self._cameras[eye], self._world.T_w_c[eye][frame], z)
        return Side(image, truth, 2 * frame + eye)

    def keyframes(self, start: int) -> list[int]:
        """Frames that the front end selects as keyframes from `start` on; `start` is the first."""
        return keyframes(self.sequence, self._files[0], start)


def keyframes(sequence: SequenceFolder, files: Sequence[Path], start: int) -> list[int]:
    """Primary frames that the front end selects as keyframes from `start` on, up to max(GAPS) + 1.

    `start` is the first. files: pictures of the primary.
    """
    selector = KeyframeSelector(FrontendConfig())
    t_ns, chosen = sequence.t_ns(Eye.PRIMARY), []
    for k in range(start, min(start + SEARCHED, len(t_ns))):
        gray = cv2.imread(str(files[k]), cv2.IMREAD_GRAYSCALE)
        frame = Frame(Eye.PRIMARY, k, int(t_ns[k]), files[k].read_bytes())
        if selector.consider(frame, np.asarray(gray, np.uint8)) is not None:
            chosen.append(k)
        if len(chosen) > max(GAPS):
            break
    return chosen


def places(frames: int, count: int) -> list[int]:
    """Indices of `count` frames spread evenly over a drive of `frames`, away from its ends."""
    return [int(k) for k in np.linspace(0.12, 0.85, count) * frames]


def pairs(scene: Scene, folder: Path) -> Iterator[Pair]:
    """Yield the pairs of a drive in order of place; raises EvaluationError."""
    drive = Pictures(folder)
    n = min(drive.sequence.count(eye) for eye in Eye)
    for place, frame in enumerate(places(n, HARD_PLACES if scene.hard else PLACES)):
        primary, assistant = drive.side(0, frame), drive.side(1, frame)
        if scene.hard:
            turn = scene.name.split("_")[1]
            yield Pair(f"eyes, 20° {turn}, 2x", scene.name, place, primary, assistant)
            yield Pair(f"eyes, 20° {turn}, 1/2x", scene.name, place, assistant, primary)
            continue
        yield Pair("eyes", scene.name, place, primary, assistant)
        chosen = drive.keyframes(frame)
        for gap in (g for g in GAPS if g < len(chosen)):
            yield Pair(f"{gap} on", scene.name, place, primary, drive.side(0, chosen[gap]))
