import numpy as np

from calm_edge.geometry.camera import Perspective
from calm_edge.types import Hints, KitBelief, Landmarks, Overlap, PathLength, Prediction, Submap

N = 5  # three primary views, an assistant's, a loop keyframe
CAMERAS = tuple(Perspective.from_hfov(60.0 + n, 64, 48) for n in range(N))
POSES = np.arange(16.0 * N).reshape(N, 4, 4)
T_NS = np.arange(N) * 100
# the loop keyframe sees landmarks 1 and 3
MARKS = Landmarks(
    points_s=np.arange(15.0).reshape(5, 3),
    index=np.array([0, 1, 2, 4, 0, 1, 3, 3, 1]),
    view=np.array([0, 0, 1, 1, 2, 3, 3, 4, 4]),
    uv=np.arange(18, dtype=np.float32).reshape(9, 2),
    sigma_px=np.arange(9, dtype=np.float32),
)


def test_landmarks_that_a_view_saw_and_the_others():
    assert MARKS.seen_by(4).tolist() == [1, 3]
    others = MARKS.unseen_by(4)
    assert np.array_equal(others.points_s, MARKS.points_s[[0, 2, 4]])
    assert others.index.tolist() == [0, 1, 2, 0] and others.view.tolist() == [0, 1, 1, 2]
    assert others.sigma_px.tolist() == [0, 2, 3, 4]
    assert np.array_equal(others.uv, MARKS.uv[[0, 2, 3, 4]])


def test_a_batch_without_its_loop_keyframe():
    hints = Hints(np.array([0, 0, 0, 1, 0]), T_NS, loop=True).without_loop()
    assert not hints.loop and hints.eyes.tolist() == [0, 0, 0, 1] and len(hints.t_ns) == 4
    depth = np.arange(N * 6, dtype=np.float32).reshape(N, 2, 3)
    whole = Prediction(
        CAMERAS, POSES, depth, depth / 30, np.arange(N) / 10, MARKS, loop_found=False
    )
    window = whole.without_loop()
    assert window.cameras == CAMERAS[:-1] and window.loop_found
    for name in ("T_s_c", "depth", "confidence", "focal_log_sigma"):
        assert np.array_equal(getattr(window, name), getattr(whole, name)[:-1])
    assert np.array_equal(window.landmarks.uv, MARKS.unseen_by(4).uv)
    bare = Prediction(CAMERAS, POSES).without_loop()
    assert (bare.depth, bare.confidence, bare.focal_log_sigma, bare.landmarks) == (None,) * 4


def test_a_submap_without_its_loop_keyframe():
    submap = Submap(
        7, (0, 1, 2), (0,), 0, T_NS, POSES, CAMERAS, 2 * POSES, CAMERAS[::-1], 2.0, np.eye(4),
        np.zeros(2),
    ).without_loop()  # fmt: skip
    assert submap.cameras_raw == CAMERAS[:-1] and submap.cameras == CAMERAS[:0:-1]
    assert np.array_equal(submap.T_s_c_raw, POSES[:-1])
    assert np.array_equal(submap.T_s_c, 2 * POSES[:-1])
    assert submap.t_ns.tolist() == submap.exposed_ns.tolist() == [0, 100, 200, 300]


def test_hints_without_neighbours_keep_the_kit_and_drop_what_other_windows_say():
    one, none = np.zeros(1), np.zeros((0, 0))
    kit = KitBelief(one, np.eye(1))
    overlap = Overlap(np.arange(2), np.tile(np.eye(4), (2, 1, 1)), one, one, none, none)
    lengths = (PathLength(np.arange(2), 3.0, 0.02),)
    hints = Hints(np.zeros(2, int), np.arange(2), kit=kit, overlap=overlap, lengths=lengths)
    alone = hints.without_neighbours()
    assert alone.kit is kit and alone.overlap is None and alone.lengths == ()
