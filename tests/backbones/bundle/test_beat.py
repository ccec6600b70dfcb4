import numpy as np
import pytest

from calm_edge.backbones.bundle.beat import off_beat


def stamps(n=15, period_s=0.1, frames=(1, 3, 2, 3), jitter_s=0.0, drift_ppm=0.0, seed=0):
    """Keyframes of a fixed-rate camera as its host stamped them: t (n,) s, its errors (n,) s."""
    count = np.r_[0, np.cumsum(np.resize(frames, n - 1))]
    noise = np.random.default_rng(seed).normal(0, jitter_s, n)
    return 7.3 + period_s * (1 + 1e-6 * drift_ppm) * count + noise, noise


@pytest.mark.parametrize("period_s", [1 / 10, 1 / 29.97, 1 / 60])
@pytest.mark.parametrize("frames", [(1,), (3,), (2, 3), (1, 3, 2, 3), (3, 3, 7)])
def test_an_even_camera_is_on_its_beat_whatever_frames_are_missing(period_s, frames):
    t, _ = stamps(period_s=period_s, frames=frames, drift_ppm=80)
    assert np.abs(off_beat(t)).max() < 1e-9


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("frames", [(1,), (2, 3), (1, 3, 2, 3)])
def test_jitter_is_found_but_for_the_line_it_shares_with_the_beat(frames, seed):
    t, noise = stamps(frames=frames, jitter_s=0.004, seed=seed)
    found = off_beat(t)
    assert np.sqrt(np.mean((found - noise) ** 2)) < 0.6 * np.sqrt(np.mean(noise**2))
    assert found.sum() == pytest.approx(0, abs=1e-9)


def test_without_a_beat_there_is_nothing_to_be_off():
    rng = np.random.default_rng(3)
    told = [off_beat(np.cumsum(rng.uniform(0.05, 0.3, 15))) for _ in range(40)]
    # fifteen gaps look even now and then
    assert sum(found is not None for found in told) <= 2
    faster = np.cumsum(np.r_[np.full(7, 0.1), np.full(8, 0.137)])
    assert off_beat(faster) is None
    assert off_beat(0.1 * np.arange(5)) is None  # too few to tell
    assert off_beat(np.array([0, 0.1, 0.2, 0.2, 0.4, 0.5, 0.6])) is None
