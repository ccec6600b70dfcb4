"""Sound tracks as a second witness of the clock offset."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calm_edge.interchange.sound import RATE_HZ, heard, levels, loudness
from calm_edge.types import Float
from tests.interchange.moving import pictures, write_video


def street(seconds: float, seed: int = 5) -> Float:
    """Noise whose loudness changes, as of passing cars."""
    rng = np.random.default_rng(seed)
    n = round(seconds * RATE_HZ)
    loud = np.interp(np.arange(n), np.arange(0, n, 1500), rng.uniform(-3, 0, -(-n // 1500)))
    return np.asarray(rng.standard_normal(n) * np.exp(loud) * 0.1, np.float64)


def test_the_offset_of_two_recorders_is_heard() -> None:
    """The second began 3.7 s later, is quieter and has noise of its own."""
    sound = street(60)
    own = np.random.default_rng(1).standard_normal(len(sound)) * 0.004
    a, b = levels(sound, 0.0), levels((0.3 * sound + own)[round(3.7 * RATE_HZ) :], 0.0)
    found = heard(a, b)
    assert found is not None and abs(found.offset_s - 3.7) < 0.04


def test_different_sounds_give_no_offset() -> None:
    assert heard(levels(street(60), 0.0), levels(street(50, seed=6), 0.0)) is None
    assert levels(np.zeros(10 * RATE_HZ), 0.0) is None


@pytest.mark.parametrize("sounding", [True, False])
def test_the_sound_track_of_a_video(tmp_path: Path, sounding: bool) -> None:
    t = np.arange(0, 6, 0.5)
    sound = street(6)
    file = write_video(tmp_path / "a.mp4", t, pictures(t), sound=sound if sounding else None)
    found, wanted = loudness(file, 0.0), levels(sound, 0.0)
    assert (found is not None) == sounding
    if found is not None and wanted is not None:
        n = min(len(found.rate), len(wanted.rate))
        assert np.corrcoef(found.rate[:n, 0], wanted.rate[:n, 0])[0, 1] > 0.7
