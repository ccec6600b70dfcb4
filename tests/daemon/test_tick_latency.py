"""Percentiles of the tick latency."""

from __future__ import annotations

import numpy as np

from calm_edge.daemon.tick_latency import TickLatency, TickLatencyMeter


def test_percentiles_of_a_second_and_of_the_run() -> None:
    meter = TickLatencyMeter()
    assert meter.take() == meter.overall() == TickLatency()
    late_ms = np.random.default_rng(0).exponential(1.0, (50, 100))
    for second in late_ms:
        for value in second:
            meter.add(int(value * 1e6))
        taken = meter.take()
        assert taken.ticks == 100
        np.testing.assert_allclose(
            [taken.p50_ms, taken.p99_ms, taken.max_ms],
            np.percentile(second, [50, 99, 100]),
            atol=1e-5,
        )
    whole = meter.overall()
    assert whole.ticks == 5000
    np.testing.assert_allclose(
        [whole.p50_ms, whole.p99_ms, whole.max_ms], np.percentile(late_ms, [50, 99, 100]), atol=0.1
    )


def test_early_ticks_count_as_zero_and_long_stalls_keep_their_maximum() -> None:
    meter = TickLatencyMeter()
    meter.add(-5)
    meter.add(90 * 10**9)
    assert meter.take().max_ms == meter.overall().max_ms == 90_000
    assert meter.overall().p50_ms == 0.05
