import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.geometry.car_motion import MAX_SPEED, contradiction


def path(steps, yaw=0.0):
    """Poses of a camera that moves by these steps [spacings] ahead, and turns with each."""
    T = [np.eye(4)]
    for step in steps:
        T.append(T[-1] @ se3.exp(np.array([0, 0, step, 0, yaw, 0])))
    return np.stack(T)


def said(T, dt=0.3):
    return contradiction(dt * np.arange(len(T)), T)


@pytest.mark.parametrize(
    "steps, drivable",
    [
        (np.full(8, 5.0), True),
        (np.r_[0, 0, 0, np.linspace(0.2, 4, 6)], True),
        (np.linspace(5, 0, 8), True),
        (np.r_[np.linspace(2, 0, 4), np.linspace(0, -2, 4)], True),
        (np.r_[np.full(4, 5.0), -0.2, np.full(4, -1.0)], False),
        (np.r_[np.full(4, 6.0), 0.6, np.full(4, 6.0)], False),
    ],
    ids=["even", "pulling away", "braking", "three-point turn", "thrown back", "one short step"],
)
def test_a_velocity_that_no_car_has_is_refused(steps, drivable):
    assert said(path(steps)) == (
        "" if drivable else "the velocity jumps between keyframes as no car's does"
    )


def test_a_parked_car_at_the_speed_of_a_rocket_is_refused():
    assert said(path(np.full(8, 1.1 * MAX_SPEED * 0.3))) == "no car is so fast"


def test_a_u_turn_is_driven_and_a_spin_is_not():
    assert said(path(np.full(8, 1.0), yaw=np.radians(18))) == ""
    assert said(path(np.full(8, 1.0), yaw=np.radians(35))) == "no car turns so fast"


def test_two_keyframes_have_no_change_of_velocity():
    assert said(path([5.0])) == ""
