import numpy as np

from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.kit.swap import swapped
from calm_edge.types import KitBelief


def kit(seed=0):
    rng = np.random.default_rng(seed)
    mean = 0.3 * rng.normal(size=layout.SIZE)
    mean[layout.RIG_CENTRE] /= np.linalg.norm(mean[layout.RIG_CENTRE])
    J = rng.normal(size=(layout.SIZE, layout.SIZE))
    return KitBelief(mean, J.T @ J)


def test_the_rig_is_inverted_and_the_optics_are_exchanged():
    before, after = kit(), swapped(kit())
    assert np.allclose(layout.rig(after.mean), se3.inverse(layout.rig(before.mean)))
    assert np.array_equal(after.mean[layout.OPTICS], before.mean[layout.OPTICS[::-1]])
    assert np.array_equal(after.mean[layout.FAMILY], before.mean[layout.FAMILY[::-1]])
    assert after.mean[layout.TIME_OFFSET] == -before.mean[layout.TIME_OFFSET]


def test_twice_swapped_is_the_same_belief():
    for seed in range(5):
        back = swapped(swapped(kit(seed)))
        assert np.allclose(back.mean, kit(seed).mean)
        assert np.allclose(back.information, kit(seed).information)


def test_the_information_follows_the_mean():
    # a kit off by a small step is as improbable after the exchange as before
    belief = kit(3)
    step = 1e-5 * np.random.default_rng(4).normal(size=layout.SIZE)
    moved = swapped(KitBelief(belief.mean + step, belief.information)).mean
    after = swapped(belief)
    before2 = step @ belief.information @ step
    off = moved - after.mean
    assert np.isclose(off @ after.information @ off, before2, rtol=1e-3)
