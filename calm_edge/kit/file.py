"""Kit file: stores the kit belief of a drive for the next drive with the same cameras."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calm_edge.kit import earlier, layout
from calm_edge.kit.change import faded
from calm_edge.types import CalmEdgeError, Float, Int, KitBelief
from device.atomic_file import replace_text

FORMAT = "calm-edge kit"
VERSION = 1

# Rounding allowed in the symmetry and definiteness of the information, scaled to unit diagonal.
_ROUNDING = 1e-6

# Log odds (2, rows, columns) of the mask of each eye, see `ego_mask.EgoMask`; None: none learned.
EgoLogOdds = tuple[Float | None, Float | None]


class KitFileError(CalmEdgeError):
    """A kit file that cannot be read, parsed or written."""


def save(
    path: Path,
    cameras: tuple[str, str],
    sizes: Int,
    belief: KitBelief,
    ego: EgoLogOdds = (None, None),
) -> None:
    """Write the belief atomically, safe against power cuts; raises KitFileError.

    cameras: the capture address of each eye. sizes: (2, 2) width, height [px] of each eye. ego: log
    odds of each eye's mask, see `ego_mask.EgoMask`.
    """
    content = {
        "format": FORMAT,
        "version": VERSION,
        "cameras": list(cameras),
        "sizes": np.asarray(sizes).tolist(),
        "mean": belief.mean.tolist(),
        "information": belief.information.tolist(),
        "ego_log_odds": [None if each is None else each.round(2).tolist() for each in ego],
    }
    try:
        text = json.dumps(content, indent=1, allow_nan=False)
    except ValueError:
        raise KitFileError(f"{path}: not written: the kit belief is not finite") from None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_text(path, text + "\n")
    except OSError as error:
        raise KitFileError(f"{path}: cannot be written ({error.strerror})") from None


@dataclass(frozen=True, slots=True)
class KitFile:
    """Content of a kit file. cameras, sizes: as in `save`, not validated.

    belief: as saved; None if another version of the program saved it in another layout, which
    `unknown` then describes. ego: as in `save`.
    """

    cameras: Any = None
    sizes: Any = None
    belief: KitBelief | None = None
    unknown: str = ""
    ego: EgoLogOdds = (None, None)


def read(path: Path) -> KitFile | None:
    """Read a kit file, of whichever cameras; None if there is no file yet.

    Raises KitFileError if the file is damaged or not a kit file; it must not be overwritten then.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise KitFileError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise _damaged(path, "not text") from None
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        raise _damaged(path, "not JSON") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise KitFileError(f"{path}: not a kit file; set backbone.kit_file to another path")
    if content.get("version") != VERSION:
        return KitFile(unknown=f"version {content.get('version')!r}, this program reads {VERSION}")
    mean = _numbers(path, content, "mean", 1)
    information = _numbers(path, content, "information", 2)
    if information.shape != (len(mean), len(mean)):
        raise _damaged(path, "mean and information differ in size")
    if len(mean) == earlier.SIZE:
        mean, information = earlier.converted(mean), earlier.converted(information)
    if len(mean) != layout.SIZE:
        return KitFile(unknown=f"holds {len(mean)} entries of a kit, this program {layout.SIZE}")
    if not _is_information(information):
        raise _damaged(path, "its information matrix is not positive semidefinite")
    belief = KitBelief(mean=mean, information=information)
    ego = _ego_log_odds(path, content)
    return KitFile(content.get("cameras"), content.get("sizes"), belief, ego=ego)


def remembered(
    path: Path, kept: KitFile | None, cameras: tuple[str, str], sizes: Int
) -> tuple[KitBelief | None, str]:
    """Return the stored belief for these cameras with drift added, or None and the reason.

    cameras, sizes: as in `save`. A missing file, other cameras, another image size or the layout
    of another version are no errors: the kit is then learned from scratch.
    """
    if kept is None:
        return None, f"{path}: no earlier drive of this kit"
    if kept.belief is None:
        return None, f"{path}: {kept.unknown}"
    if kept.cameras != list(cameras):
        return None, f"{path}: of other cameras ({kept.cameras}, not {list(cameras)})"
    wanted = np.asarray(sizes).tolist()
    if kept.sizes != wanted:
        return None, f"{path}: of images of {kept.sizes} px, not {wanted}"
    return faded(kept.belief), ""


def _damaged(path: Path, why: str) -> KitFileError:
    return KitFileError(
        f"{path}: damaged ({why}); delete it, and the next drive learns the kit again"
    )


def _numbers(path: Path, content: dict[str, Any], key: str, dimensions: int) -> Float:
    try:
        numbers = np.array(content.get(key), np.float64)
    except (ValueError, TypeError, OverflowError):
        raise _damaged(path, f"{key} is not an array of numbers") from None
    if numbers.ndim != dimensions or not np.isfinite(numbers).all():
        raise _damaged(path, f"{key} is not an array of numbers")
    return numbers


def _ego_log_odds(path: Path, content: dict[str, Any]) -> EgoLogOdds:
    """Log odds of both eyes' masks; none of an eye that has none, as in files without masks."""
    entries = content.get("ego_log_odds", [None, None])
    if not isinstance(entries, list) or len(entries) != 2:
        raise _damaged(path, "ego_log_odds does not name two cameras")
    found = []
    for each in entries:
        name = {"ego_log_odds": each}
        found.append(None if each is None else _numbers(path, name, "ego_log_odds", 3))
    if any(each is not None and (len(each) != 2 or each.size == 0) for each in found):
        raise _damaged(path, "ego_log_odds has another shape than a mask")
    return found[0], found[1]


def _is_information(information: Float) -> bool:
    """Whether a matrix is symmetric and positive semidefinite, independent of its rows' units."""
    diagonal = np.diag(information)
    if (diagonal < 0).any():
        return False
    unit = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = information * unit[:, None] * unit
    if np.abs(scaled - scaled.T).max() > _ROUNDING:
        return False
    return bool(np.linalg.eigvalsh(scaled)[0] > -_ROUNDING)
