"""Points as the viewer's records: places, colours and sub-maps are kept, any prefix is a sample."""

import numpy as np

from calm_edge.report.point_records import (
    RECORD,
    STEPS,
    bounding_box,
    packed,
    random_order,
    unpacked,
)


def test_points_return_within_half_a_step() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-900, 3, -2], [800, 400, 11], (5000, 3))
    color = rng.integers(0, 256, (5000, 3)).astype(np.uint8)
    submap = rng.integers(0, 65536, 5000)
    box = bounding_box(points)
    records = packed(points, color, submap, box)
    assert records.itemsize == RECORD.itemsize == 12
    # the longest side, 1,700 units, in 2^18 - 1 steps
    assert 0.0064 < box.step < 0.0066 and np.isclose(box.step * STEPS, np.ptp(points[:, 0]))
    assert np.abs(unpacked(records, box) - points).max() <= box.step / 2 + 1e-9
    assert np.array_equal(records["color"], color) and np.array_equal(records["submap"], submap)


def test_the_bytes_are_those_that_the_shader_reads() -> None:
    box = bounding_box(np.array([[0, 0, 0], [STEPS, STEPS, STEPS]], np.float64))
    assert np.isclose(box.step, 1.0)
    record = packed(
        np.array([[5.0, 2**17, 2.0]]), np.array([[1, 2, 3]], np.uint8), np.array([258]), box
    )
    # 5 = 1 * 4 + 1, 2^17 = 2^15 * 4, 2 = 0 * 4 + 2
    assert record.tobytes() == bytes([1, 0, 0, 128, 0, 0, 2, 1, 1, 2, 3, 1 | 2 << 4])


def test_one_point_and_none_have_a_box() -> None:
    for points in (np.zeros((0, 3)), np.full((1, 3), 7.0)):
        box = bounding_box(points)
        records = packed(points, np.zeros((len(points), 3), np.uint8), np.zeros(len(points)), box)
        assert np.allclose(unpacked(records, box), points)


def test_any_prefix_is_a_fair_sample() -> None:
    order = random_order(100_000)
    assert np.array_equal(np.sort(order), np.arange(100_000))
    for size in (2_000, 20_000):
        share = np.histogram(order[:size], 10, (0, 100_000))[0] / size
        # binomial: a sigma of 0.0067 for 2,000
        assert np.abs(share - 0.1).max() < 0.03
    assert np.array_equal(order, random_order(100_000))
