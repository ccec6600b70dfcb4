import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calm_edge.geometry import se3
from calm_edge.kit import change, layout
from calm_edge.kit.belief import product
from calm_edge.kit.swap import swapped
from calm_edge.types import KitBelief

D = layout.SIZE
# how sure one drive is of optics and rig, and what happens until the next; then the clocks' offset
SIGMA = np.full(D, 0.002)
SIGMA[layout.OPTICS] = 0.01, 0.004, 0.004, 2e-3, 2e-3
SIGMA[layout.RIG] = 0.004, 0.004, 0.004, 0.01, 0.02, 0.02
FADES = np.full(D, 1.0)
FADES[layout.OPTICS] = 0.015, 0.003, 0.003, 2e-3, 2e-3
FADES[layout.READOUT] = 1e-4
FADES[layout.FAMILY] = 1e-4
FADES[layout.RIG] = 0.005, 0.005, 0.005, 0.01, 0.01, 0.01
DRIFT = FADES.copy()
DRIFT[layout.TIME_OFFSET] = 0.005
FOCALS, ROTATION, PLACE = slice(0, 2), 2, 3
PRIMARY, ASSISTANT = layout.LOG_FOCAL.tolist()
TURN = np.arange(D)[layout.RIG_ROTATION].tolist()


def true_kit():
    theta = layout.prior((76.0, 66.0)).mean
    theta[layout.RIG_ROTATION] = np.radians([1.0, -3.7, 1.2])
    theta[layout.RIG_CENTRE] = np.array([0.99, 0.03, 0.1]) / np.linalg.norm([0.99, 0.03, 0.1])
    return theta


def learned(rng, theta, unknown=()):
    """A belief with errors drawn from its covariance. `unknown`: entries without information.

    All entries are correlated, as focals and rig are.
    """
    mixing = np.linalg.qr(rng.normal(size=(D, D)))[0]
    J = (mixing * rng.uniform(0.7, 1.5, D)) @ np.diag(1 / SIGMA)
    J[:, list(unknown)] = 0
    information = J.T @ J
    error = np.linalg.pinv(J, rcond=1e-10) @ rng.normal(size=D)
    error[list(unknown)] = rng.normal(size=len(unknown)) * 0.2
    return KitBelief(mean=theta + error, information=information)


def drives(seed, bump=None, unknown=()):
    """The faded belief of one drive, and the evidence of the next after a change by `bump`."""
    rng = np.random.default_rng(2000 + seed)
    theta = true_kit()
    remembered = change.faded(learned(rng, theta))
    later = theta + DRIFT * rng.normal(size=D) + (0 if bump is None else bump)
    return remembered, learned(rng, later, unknown)


@pytest.mark.parametrize("unknown", [(), (PRIMARY, ASSISTANT), (TURN[0], layout.RIG_CENTRE.start)])
def test_an_unchanged_kit_has_the_stated_false_alarm_rate(unknown):
    parts = [change.changes(*drives(seed, unknown=unknown)) for seed in range(200)]
    p_values = np.array([[part.p_value for part in four] for four in parts])
    assert sum(part.noticed for four in parts for part in four) <= 3
    # the p-values of a correct test are uniformly distributed
    seen = np.array([[part.observed > 0 for part in four] for four in parts]).all(0)
    for part in np.nonzero(seen)[0]:
        low = (p_values[:, part] < 0.1).mean()
        assert 0.04 < low < 0.17
        assert 0.42 < p_values[:, part].mean() < 0.58


def test_a_turned_mount_is_noticed_and_described():
    bump = np.zeros(D)
    bump[TURN[1]] = np.radians(3.0)
    caught = [change.changes(*drives(seed, bump)) for seed in range(50)]
    assert all(four[ROTATION].noticed for four in caught)
    assert not any(part.noticed for four in caught for part in four[FOCALS])
    degrees = [float(four[ROTATION].text.split()[-2]) for four in caught]
    assert caught[0][ROTATION].text.startswith("the assistant has moved, turned by ")
    assert np.mean(degrees) == pytest.approx(3.0, abs=0.3)


def test_another_lens_is_noticed_for_its_eye_only():
    bump = np.zeros(D)
    bump[ASSISTANT] = np.log(1.12)
    caught = [change.changes(*drives(seed, bump)) for seed in range(50)]
    assert sum(four[1].noticed for four in caught) >= 46
    assert not any(four[0].noticed or four[ROTATION].noticed for four in caught)
    percent = [float(four[1].text.split()[-2]) for four in caught]
    assert caught[0][1].text.startswith("another lens on the assistant camera, focal +")
    assert np.mean(percent) == pytest.approx(12, abs=1.5)


def test_a_moved_assistant_is_noticed_but_not_a_change_of_distance():
    theta = true_kit()
    across = np.cross(theta[layout.RIG_CENTRE], [0, 0, 1.0])
    for bump, expected in ((0.2 * across, True), (0.2 * theta[layout.RIG_CENTRE], False)):
        moved = np.zeros(D)
        moved[layout.RIG_CENTRE] = bump
        caught = [change.changes(*drives(seed, moved))[PLACE].noticed for seed in range(30)]
        assert np.mean(caught) > 0.9 if expected else not any(caught)


def swung(axis, degrees):
    """The change of the rig when the assistant swings around the primary."""
    bump = np.zeros(D)
    centre = true_kit()[layout.RIG_CENTRE]
    axis = np.cross(centre, axis)
    turn = se3.so3_exp(np.radians(degrees) * axis / np.linalg.norm(axis))
    bump[layout.RIG_CENTRE] = turn @ centre - centre
    return bump


@pytest.mark.parametrize("degrees", [12, 90, 178, 180])
@pytest.mark.parametrize("axis", [(0, 0, 1.0), (0, 1.0, 0), (0, 1.0, 1.0)])
def test_a_direction_is_compared_on_the_sphere(axis, degrees):
    caught = [change.changes(*drives(seed, swung(axis, degrees)))[PLACE] for seed in range(20)]
    assert all(part.noticed for part in caught)
    angles = [float(part.text.split()[-5]) for part in caught]
    assert np.median(angles) == pytest.approx(degrees, abs=2.5)


def test_a_lens_of_another_family_is_noticed():
    remembered, evidence = drives(0)
    evidence.mean[layout.FAMILY[1]] = 1.0
    lines = change.described(remembered, evidence)
    assert lines[0] == "another lens on the assistant camera"


def test_swapped_cameras_are_named_and_nothing_else():
    pairs = [drives(seed) for seed in range(50)]
    texts = [change.described(remembered, swapped(evidence)) for remembered, evidence in pairs]
    # by the rate of false alarms one may seem to have changed besides
    assert sum(text == ("the cameras are swapped",) for text in texts) >= 49


def test_an_assistant_on_the_other_side_is_not_called_swapped():
    # its rotation to the primary is the remembered one, not the inverse
    bump = swung((0, 0, 1.0), 180)
    for seed in range(20):
        lines = change.described(*drives(seed, bump))
        assert len(lines) == 1 and lines[0].startswith("the assistant has moved by 1")
    bump = np.zeros(D)
    bump[ASSISTANT] = 0.2
    remembered, evidence = drives(1, bump)
    assert "the cameras are swapped" not in change.described(remembered, swapped(evidence))


def test_an_untouched_kit_is_rarely_called_changed():
    changed = [change.described(*drives(seed)) for seed in range(300)]
    assert sum(bool(lines) for lines in changed) <= 4


def test_directions_unobserved_in_either_drive_are_not_tested():
    bump = np.zeros(D)
    bump[[PRIMARY, TURN[1]]] = 1.0, 0.5
    remembered, evidence = drives(3, bump, unknown=(PRIMARY, *TURN))
    for pair in ((remembered, evidence), (evidence, remembered)):
        primary, assistant, rotation, place = change.changes(*pair)
        for part in (primary, rotation):
            assert (part.observed, part.distance2, part.p_value) == (0, 0.0, 1.0)
        assert assistant.observed == 1 and place.observed == 2
    nothing = KitBelief(evidence.mean, np.zeros((D, D)))
    assert not any(part.observed for part in change.changes(remembered, nothing))


def test_a_partly_observed_rotation_is_tested_in_its_observed_part():
    bump = np.zeros(D)
    bump[TURN[:2]] = 0.05, 0.5
    rotation = change.changes(*drives(5, bump, unknown=(TURN[1],)))[ROTATION]
    assert rotation.observed == 2 and rotation.noticed
    assert float(rotation.text.split()[-2]) == pytest.approx(np.degrees(0.05), abs=1.0)


def test_the_distance_is_the_mahalanobis_distance_of_the_marginals():
    remembered, evidence = drives(11)
    prior = layout.prior((None, None))
    bounds = np.diag(prior.information).copy()
    bounds[layout.LOG_FOCAL] = bounds[layout.RIG] = 0
    bounded = [product([b, KitBelief(prior.mean, np.diag(bounds))]) for b in (remembered, evidence)]
    S = sum(np.linalg.inv(b.information) for b in bounded)
    d = bounded[1].mean - bounded[0].mean
    primary, assistant, rotation, _ = change.changes(remembered, evidence)
    assert primary.distance2 == pytest.approx(d[PRIMARY] ** 2 / S[PRIMARY, PRIMARY], rel=1e-6)
    assert assistant.distance2 == pytest.approx(
        d[ASSISTANT] ** 2 / S[ASSISTANT, ASSISTANT], rel=1e-6
    )
    turn = layout.RIG_ROTATION
    expected = d[turn] @ np.linalg.solve(S[turn, turn], d[turn])
    assert rotation.distance2 == pytest.approx(expected, rel=1e-6)
    assert (primary.observed, rotation.observed) == (1, 3)


@given(st.integers(0, 10**6))
def test_fading_adds_its_variances_to_the_covariance(seed):
    belief = learned(np.random.default_rng(seed), true_kit())
    faded = change.faded(belief)
    expected = np.linalg.inv(belief.information) + np.diag(FADES**2)
    assert np.allclose(np.linalg.inv(faded.information) / np.outer(FADES, FADES),
                       expected / np.outer(FADES, FADES), rtol=1e-6, atol=1e-8)  # fmt: skip
    assert np.array_equal(faded.mean, belief.mean)


def test_fading_bounds_information_by_the_drift():
    belief = learned(np.random.default_rng(2), true_kit(), unknown=(PRIMARY, TURN[1]))
    faded = change.faded(belief).information
    assert np.abs(faded[[PRIMARY, TURN[1]]]).max() < 1e-6
    certain = KitBelief(true_kit(), np.eye(D) * 1e16)
    assert np.allclose(np.diag(change.faded(certain).information) ** -0.5, FADES)


def test_ten_drives_give_no_more_information_than_the_drift_allows():
    rng, belief = np.random.default_rng(8), None
    for _ in range(10):
        earlier = None if belief is None else change.faded(belief)
        belief = product([earlier, learned(rng, true_kit())])
    sigma = np.sqrt(np.diag(np.linalg.inv(change.faded(belief).information)))
    assert (sigma > FADES).all()


def test_the_time_offset_is_forgotten_between_drives():
    certain = change.faded(KitBelief(true_kit(), np.eye(D) * 1e16))
    assert certain.information[layout.TIME_OFFSET, layout.TIME_OFFSET] < 1.01


def test_a_focal_correlated_with_its_centre_is_tested_with_the_prior_of_the_centre():
    # 1 % of the width in the centre has the effect of 2 % in the focal
    information = np.zeros((D, D))
    row = np.zeros(D)
    row[layout.OPTICS[0, :2]] = 1.0, 2.0
    information += np.outer(row, row) / 0.01**2
    apart = true_kit()
    apart[PRIMARY] += 0.5
    primary = change.changes(KitBelief(true_kit(), information), KitBelief(apart, information))[0]
    assert primary.observed == 1 and primary.noticed
    sigma = np.hypot(0.01, 2 * layout.PRINCIPAL_POINT_SIGMA)
    assert primary.distance2 == pytest.approx(0.5**2 / (2 * sigma**2), rel=1e-6)


def test_beliefs_of_another_size_raise():
    belief, other = KitBelief(true_kit(), np.eye(D)), KitBelief(np.zeros(3), np.eye(3))
    for pair in ((belief, other), (other, belief)):
        with pytest.raises(ValueError, match="not 3"):
            change.changes(*pair)
    with pytest.raises(ValueError, match="not 3"):
        change.faded(other)
