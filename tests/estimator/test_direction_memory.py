import numpy as np
import pytest

from calm_edge.estimator.direction_memory import MAX_WINDOWS, MIN_PATH, DirectionMemory
from calm_edge.geometry import se3

TURNED = np.array([np.sin(0.3), -0.1, np.cos(0.3)]) / np.linalg.norm([1.0, 0.1])


def path(direction, turn=0.05, steps=10, length=2.0):
    T = [np.eye(4)]
    for _ in range(steps):
        w = np.array([0.0, turn, 0.0])
        T.append(T[-1] @ se3.compose(se3.so3_exp(w), length * (se3.so3_exp(w / 2) @ direction)))
    return np.stack(T)


def angle(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1, 1)))


@pytest.mark.parametrize("length", [2.0, -2.0], ids=["forward", "reverse"])
def test_the_axis_of_an_arc_is_the_mount(length):
    memory = DirectionMemory()
    assert memory.direction is None
    memory.add(path(TURNED, length=length), 1.0)
    assert angle(memory.direction, TURNED) < 1e-3


def test_a_car_that_stands_says_nothing():
    memory = DirectionMemory()
    memory.add(path(TURNED, length=0.9 * MIN_PATH / 10), 1.0)
    assert memory.direction is None
    # the limit is in spacings
    memory.add(path(TURNED, length=0.9 * MIN_PATH / 10), 0.5)
    assert memory.direction is not None


def test_one_wrong_window_among_three_is_outvoted_and_a_new_mount_is_learned():
    memory = DirectionMemory()
    sideways = np.array([1.0, 0.0, 0.0])
    for direction in (TURNED, sideways, TURNED):
        memory.add(path(direction), 1.0)
    assert angle(memory.direction, TURNED) < 1
    for _ in range(MAX_WINDOWS):
        memory.add(path(sideways), 1.0)
    assert angle(memory.direction, sideways) < 1e-3
