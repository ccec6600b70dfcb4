import numpy as np

from calm_edge.backbones.bundle.scanline import aggregate

D, H, W = 8, 12, 16


def volume(plane):
    """Costs (D, H, W) that are 0 at `plane` (H, W) and 1 elsewhere."""
    return (np.arange(D)[:, None, None] != plane).astype(np.float32)


def test_a_hole_is_filled_from_both_sides():
    cost = volume(np.full((H, W), 3))
    cost[:, 4:7, 5:9] = 1  # nothing to tell there
    chosen = aggregate(cost, np.full((H, W), 128, np.uint8)).argmin(0)
    assert (chosen == 3).all()


def test_a_single_outlier_is_smoothed_and_a_step_is_kept():
    plane = np.where(np.arange(W) < 8, 2, 6) * np.ones((H, 1), int)
    cost = volume(plane)
    cost[7, 6, 3], cost[2, 6, 3] = 0, 0.3  # a little better elsewhere
    gray = np.where(plane == 2, 40, 200).astype(np.uint8)
    assert np.array_equal(aggregate(cost, gray).argmin(0), plane)


def test_a_uniform_volume_stays_uniform():
    flat = np.full((D, H, W), 0.4, np.float32)
    out = aggregate(flat, np.zeros((H, W), np.uint8))
    assert np.allclose(out, out[0, 0, 0])
