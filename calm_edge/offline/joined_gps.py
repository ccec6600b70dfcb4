"""Align the drives of one map to the GPS fixes of all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from calm_edge.evaluation.estimate import Estimate
from calm_edge.offline.georeference import Placement, place
from calm_edge.offline.gps_fixes import GpsFileError, GpsFixes, fixes_of, read_fixes
from calm_edge.recording.reader import Recording
from device.frame import Eye

# Time between drives that are put one after the other: much longer than any gap of a path that is
# interpolated, and a fix that is late by a second is still at the end of its drive.
APART_NS = 1_000_000 * 10**9
# before and after a drive: fixes of one file are taken for it, because they may be late
BESIDE_NS = 5 * 10**9


@dataclass(frozen=True, slots=True)
class GpsDrive:
    """A drive in the common frame, and its fixes, if it has any, with the same stamps."""

    name: str
    estimate: Estimate
    fixes: GpsFixes | None


def fixes_of_drives(
    recordings: Mapping[str, Recording], files: Sequence[Path]
) -> list[GpsFixes | None]:
    """Fixes of each recording: the recorded ones, of a file for each, or of one file for all.

    Raises GpsFileError if the times of one file do not tell which drive a fix is of.
    """
    if not files:
        return [fixes_of(recording, None) for recording in recordings.values()]
    if len(files) == len(recordings):
        named = zip(recordings.values(), files, strict=True)
        return [fixes_of(recording, file) for recording, file in named]
    (file,) = files
    spans: list[tuple[int, int, str]] = []
    for name, recording in recordings.items():
        t_ns = recording.frame_times(Eye.PRIMARY) - recording.origin_ns
        if len(t_ns):
            spans.append((int(t_ns.min()), int(t_ns.max()), name))
    for (_, end, before), (start, _, after) in pairwise(sorted(spans)):
        if start <= end:
            raise GpsFileError(
                f"{file}: the times of {before} and {after} overlap, so which drive a fix is of is "
                "not known; give --gps once for each drive"
            )
    fixes = read_fixes(file)
    within = {
        name: fixes.within(first - BESIDE_NS, last + BESIDE_NS) for first, last, name in spans
    }
    if not any(within.values()):
        raise GpsFileError(f"{file}: holds no fix of the times of these drives")
    return [within.get(name) for name in recordings]


def place_joined(drives: Mapping[int, GpsDrive], say: Callable[[str], None]) -> Placement | None:
    """Where the common frame of drives lies on the Earth.

    The fixes of all drives have one delay. Stamps of drives may overlap, as those of replays
    that begin at 0 do. None without fixes, or, with a line for the user, if these do not determine
    it.
    """
    kept = list(drives.values())
    own = [each for each in kept if each.fixes is not None]
    if not own:
        return None
    if len(kept) == 1:
        assert own[0].fixes is not None
        return place(own[0].estimate, own[0].fixes, say)
    # seconds since the first keyframe of each drive, one drive after the other
    path_ns, fix_ns = [], []
    start = 0
    for each in kept:
        first, last = (int(each.estimate.t_ns[i]) for i in (0, -1))
        path_ns.append(each.estimate.t_ns - first + start)
        if each.fixes is not None:
            # fixes long before or after the drive must not fall into another one
            beyond = APART_NS // 3
            since = np.clip(each.fixes.t_ns - first, -beyond, last - first + beyond)
            fix_ns.append(since + start)
        start += last - first + APART_NS
    every = [each.fixes for each in own if each.fixes is not None]
    estimate = replace(
        kept[0].estimate,
        t_ns=np.concatenate(path_ns),
        T_w_c=np.concatenate([each.estimate.T_w_c for each in kept]),
        # joined lengths are at least as well known as those of the best drive
        metre=min(
            (e.estimate.metre for e in kept if e.estimate.metre is not None),
            key=lambda metre: metre.log_sigma,
            default=None,
        ),
    )
    spacings = {each.estimate.spacing_m for each in kept}
    found = GpsFixes(
        Path(", ".join(each.name for each in own)),
        np.concatenate(fix_ns),
        np.concatenate([each.lla for each in every]),
        np.concatenate([each.sigma_m for each in every]),
        sum(each.dropped for each in every),
    )
    placement = place(estimate, found, say, one_kit=len(spacings) == 1)
    if placement is None:
        return None
    return replace(placement, content=placement.content | {"drives": _by_drive(own, placement)})


def _by_drive(own: list[GpsDrive], placement: Placement) -> list[dict[str, object]]:
    """Numbers of fixes and residuals of each drive; one of the wrong delay or place stands out."""
    rows: list[dict[str, object]] = []
    at, found = 0, placement.alignment
    for each in own:
        assert each.fixes is not None
        mine = slice(at, at + len(each.fixes.t_ns))
        at = mine.stop
        used = found.used[mine]
        away = found.residual_m[mine][used]
        rows.append(
            {
                "name": each.name,
                "source": str(each.fixes.path),
                "fixes": len(used),
                "used": int(used.sum()),
                "refused": int((found.inside[mine] & ~used).sum()),
                "residual_rms_m": float(np.sqrt(np.mean(away**2))) if len(away) else None,
            }
        )
    return rows
