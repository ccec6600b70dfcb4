from dataclasses import replace

import numpy as np

from calm_edge.estimator.window_submap import raw_submap, solved_again
from calm_edge.types import Hints, Keyframe, Prediction, SubmapWindow
from device.frame import Eye, Frame

T_NS = np.array([0, 100, 200, 10, 110], np.int64) * 1_000_000


def keyframe(eye, k, t_ns):
    return Keyframe(k, Frame(eye, k, int(t_ns), b""))


def test_a_submap_keeps_when_its_pictures_were_exposed():
    window = SubmapWindow(
        4,
        tuple(keyframe(Eye.PRIMARY, k, t) for k, t in enumerate(T_NS[:3])),
        tuple(keyframe(Eye.ASSISTANT, k, t) for k, t in enumerate(T_NS[3:])),
        0,
    )
    said = Prediction(
        np.tile(np.eye(3), (5, 1, 1)),
        np.tile(np.eye(4), (5, 1, 1)),
        assistant_late_s=0.02,
        stamps_off_s=np.array([0.003, -0.001]),
    )
    submap = raw_submap(window, Hints(np.array([0, 0, 0, 1, 1]), T_NS), said)
    assert np.array_equal(submap.exposed_ns - T_NS, [0, 0, 0, 23_000_000, 19_000_000])
    later = solved_again(submap, replace(said, assistant_late_s=0.01, stamps_off_s=None))
    assert np.array_equal(later.exposed_ns - T_NS, [0, 0, 0, 10_000_000, 10_000_000])
    assert solved_again(submap, None) is submap
