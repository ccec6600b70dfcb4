import numpy as np

from calm_edge.geometry.polyline import path_length


def test_the_length_is_that_of_all_steps_and_not_of_the_way_between_the_ends():
    p = np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 12], [3, 4, 0]])
    assert path_length(p) == 29.0
    assert path_length(p[:1]) == 0.0
