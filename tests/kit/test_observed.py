import numpy as np
import pytest

from calm_edge.kit import layout
from calm_edge.kit.observed import observed_part
from calm_edge.types import KitBelief

PRIMARY, ASSISTANT = layout.LOG_FOCAL.tolist()
TERMS = np.arange(layout.SIZE)


def belief(**sigmas):
    """A good drive's belief, with other sigmas of some parts."""
    mean = layout.prior((70.0, 60.0)).mean
    mean[layout.RIG] = [0.02, 0.05, 0.0, 0.6, 0.0, 0.8]
    sigma = np.full(layout.SIZE, 0.01)
    for name, value in sigmas.items():
        sigma[getattr(layout, name)] = value
    return KitBelief(mean, np.diag(sigma**-2.0))


def test_an_observed_kit_is_kept_as_it_is():
    kept = observed_part(belief())
    assert np.array_equal(kept.mean, belief().mean)
    assert np.allclose(kept.information, belief().information)


@pytest.mark.parametrize(
    ("part", "sigma"),
    [("LOG_FOCAL", 0.08), ("RIG_ROTATION", 0.2), ("RIG_CENTRE", 0.3), ("RIG_CENTRE", np.inf)],
)
def test_an_unobserved_part_is_left_out(part, sigma):
    kept = observed_part(belief(**{part: sigma}))
    gone = TERMS[getattr(layout, part)]
    others = np.setdiff1d(TERMS, gone)
    assert not kept.information[gone].any() and not kept.information[:, gone].any()
    assert np.array_equal(kept.mean[gone], layout.prior((None, None)).mean[gone])
    assert np.allclose(np.diag(kept.information)[others], 1e4)


def test_one_eye_may_be_unobserved_and_its_error_stays_in_what_depends_on_it():
    # the rig's rotation is known only together with the assistant's focal, which is unknown
    information = belief(LOG_FOCAL=(0.01, np.inf)).information.copy()
    row = np.zeros(layout.SIZE)
    row[[layout.RIG_ROTATION.start, ASSISTANT]] = 100.0, 100.0
    information[layout.RIG_ROTATION, layout.RIG_ROTATION] = np.diag([0.0, 1e4, 1e4])
    kept = observed_part(KitBelief(belief().mean, information + np.outer(row, row)))
    assert kept.information[PRIMARY, PRIMARY] == pytest.approx(1e4)
    assert not kept.information[ASSISTANT].any()
    assert not kept.information[layout.RIG_ROTATION].any()


def test_without_any_observed_part_there_is_nothing_to_keep():
    assert observed_part(belief(LOG_FOCAL=0.1, RIG=0.5)) is None
