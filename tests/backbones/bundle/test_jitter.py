import numpy as np
import pytest

from calm_edge.backbones.bundle.jitter import jitter


def stamps(n=15, period_s=0.1, frames=(1, 3, 2, 3), jitter_s=0.0, drift_ppm=0.0, seed=0):
    """Keyframes of a fixed-rate camera as its host stamped them: t (n,) s, its errors (n,) s."""
    count = np.r_[0, np.cumsum(np.resize(frames, n - 1))]
    noise = np.random.default_rng(seed).normal(0, jitter_s, n)
    return 7.3 + period_s * (1 + 1e-6 * drift_ppm) * count + noise, noise


@pytest.mark.parametrize("period_s", [1 / 10, 1 / 29.97, 1 / 60])
@pytest.mark.parametrize("frames", [(1,), (3,), (2, 3), (1, 3, 2, 3), (3, 3, 7)])
def test_a_fixed_rate_has_no_jitter_whichever_frames_are_missing(period_s, frames):
    t, _ = stamps(period_s=period_s, frames=frames, drift_ppm=80)
    assert np.abs(jitter(t)).max() < 1e-9


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("frames", [(1,), (2, 3), (1, 3, 2, 3)])
def test_jitter_is_found_up_to_a_fitted_line(frames, seed):
    t, noise = stamps(frames=frames, jitter_s=0.004, seed=seed)
    found = jitter(t)
    assert np.sqrt(np.mean((found - noise) ** 2)) < 0.6 * np.sqrt(np.mean(noise**2))
    assert found.sum() == pytest.approx(0, abs=1e-9)


def test_without_a_frame_rate_there_is_no_jitter():
    rng = np.random.default_rng(3)
    found = [jitter(np.cumsum(rng.uniform(0.05, 0.3, 15))) for _ in range(40)]
    # fifteen random gaps look regular now and then
    assert sum(each is not None for each in found) <= 2
    faster = np.cumsum(np.r_[np.full(7, 0.1), np.full(8, 0.137)])
    assert jitter(faster) is None
    assert jitter(0.1 * np.arange(5)) is None
    assert jitter(np.array([0, 0.1, 0.2, 0.2, 0.4, 0.5, 0.6])) is None
