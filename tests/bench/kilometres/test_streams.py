import numpy as np
import pytest

from bench.kilometres.streams import Streams

T_NS = 5_000_000_000 + 100_000_000 * np.arange(200)


def test_plain_streams_are_the_paths_own_frames():
    for eye in Streams().exposures(T_NS, 0):
        assert np.array_equal(eye.t_ns, T_NS) and np.array_equal(eye.stamp_ns, T_NS)


def test_alternate_frames_go_to_one_eye_each():
    primary, assistant = Streams(alternate=True).exposures(T_NS, 0)
    assert np.array_equal(primary.t_ns, T_NS[::2]) and np.array_equal(assistant.t_ns, T_NS[1::2])


def test_halved_streams_are_alternate_ones_in_step():
    alternate, _ = Streams(alternate=True).exposures(T_NS, 0)
    for eye in Streams(halved=True).exposures(T_NS, 0):
        assert np.array_equal(eye.t_ns, alternate.t_ns)


def test_stamps_have_the_given_errors():
    streams = Streams(late_s=(0.02, 0.05), jitter_s=0.005, drift_ppm=50)
    primary, assistant = streams.exposures(T_NS, 0)
    late = (primary.stamp_ns - primary.t_ns) * 1e-9
    assert late.mean() == pytest.approx(0.02, abs=0.002) and late.std() == pytest.approx(
        0.005, rel=0.2
    )
    late = (assistant.stamp_ns - assistant.t_ns) * 1e-9
    drift = np.polyfit((T_NS - T_NS[0]) * 1e-9, late, 1)[0]
    assert drift == pytest.approx(50e-6, abs=150e-6) and late.mean() == pytest.approx(
        0.05, abs=0.003
    )
    assert np.all(np.diff(primary.stamp_ns) > 0)


def test_an_offset_is_true_and_a_drop_is_gone():
    primary, assistant = Streams(offset_s=0.03, drop_share=0.2).exposures(T_NS, 0)
    assert 130 < len(primary.t_ns) < 185
    assert np.all((assistant.t_ns - T_NS[0]) % 100_000_000 == 30_000_000)
    assert np.array_equal(assistant.stamp_ns, assistant.t_ns)


def test_truth_is_found_by_stamp():
    primary, _ = Streams(jitter_s=0.005).exposures(T_NS, 3)
    assert np.array_equal(primary.at(primary.stamp_ns[[5, 2]]), T_NS[[5, 2]])
