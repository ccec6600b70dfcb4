"""Sound tracks of two videos as a second witness of the offset between their clocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from calm_edge.interchange.clock_search import Coarse, search
from calm_edge.interchange.turn_rates import Rates
from calm_edge.interchange.video import require_av
from calm_edge.types import Float

RATE_HZ = 8000
STEP_S = 0.04
# sound travels 3 m in 10 ms, and recorders delay it against the picture by tens of milliseconds
SIGMA_S = 0.05


def loudness(file: Path, first_s: float) -> Rates | None:
    """Loudness of a video's sound in two bands over time; None without a sound track.

    first_s: stamp of the first picture in the file, which is time 0. Faults end the track.
    """
    av = require_av()
    pieces: list[Float] = []
    start: float | None = None
    try:
        with av.open(str(file)) as container:
            if not container.streams.audio:
                return None
            resampler = av.AudioResampler("flt", "mono", RATE_HZ)
            for frame in container.decode(container.streams.audio[0]):
                if start is None:
                    start = float(frame.time or 0.0)
                pieces += [f.to_ndarray()[0] for f in resampler.resample(frame)]
                if len(pieces) > 256:
                    pieces = [np.concatenate(pieces)]
    except av.error.FFmpegError:
        pass
    if start is None or not pieces:
        return None
    return levels(np.concatenate(pieces), start - first_s)


def levels(samples: Float, start_s: float) -> Rates | None:
    """Log energy of the low and the high half of the spectrum against the mean of seconds.

    samples: (N,) at RATE_HZ. None if they are silent or too few.
    """
    size = round(RATE_HZ * STEP_S)
    n = len(samples) // size
    if n < 100:
        return None
    x = samples[: n * size].astype(np.float64)
    change = np.diff(x, prepend=x[:1])
    energy = np.stack([(v.reshape(n, size) ** 2).mean(1) for v in (x, change)], axis=1)
    if not (energy > 1e-10).any():
        return None
    log = np.log(energy + 1e-9)
    log -= uniform_filter1d(log, min(n, round(4 / STEP_S)), axis=0, mode="nearest")
    rate = np.column_stack([log, np.zeros(n)])
    return Rates(start_s + STEP_S / 2, STEP_S, STEP_S, rate, np.ones(n, bool))


def heard(primary: Rates | None, assistant: Rates | None) -> Coarse | None:
    """Offset between the clocks by the sound; None if one is missing or it is not certain."""
    if primary is None or assistant is None:
        return None
    found = search(primary, assistant)
    return found if found is not None and found.certain else None
