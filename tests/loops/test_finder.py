from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from calm_edge.backbones.bundle.learned import place
from calm_edge.config import LoopConfig
from calm_edge.geometry import se3, sift
from calm_edge.geometry.camera import Perspective
from calm_edge.loops.finder import EVERY, PlaceLoops, PlaceMemory
from calm_edge.loops.same_place import KnownKit
from calm_edge.types import Float, Keyframe, SubmapWindow
from device.frame import Eye, Frame
from tests.synthetic.drive import exposed, make_rig
from tests.synthetic.render import render_views
from tests.synthetic.settings import Settings
from tests.synthetic.shots import T_primary_assistant
from tests.synthetic.world import make_world

SETTINGS = Settings(width=320, height=128, density=14.0, frames=40, start_s=6.0)
STEP = 3  # frames per keyframe
N = 5
FIRST_RETURN = 100
# the return is 0.3 m to the side, with keyframes at other positions
ASIDE = se3.exp(np.array([0.3, 0.0, 0.4, 0.0, 0.02, 0.0]))
CONFIG = LoopConfig()


@dataclass(frozen=True)
class Street:
    """Images of a first visit and of a return (primary, then assistant), T_w_c (N, 4, 4)."""

    first: list
    T_first: Float
    again: list
    T_again: Float
    elsewhere: list
    kit: KnownKit


@pytest.fixture(scope="module")
def street() -> Street:
    world = make_world(SETTINGS.seed, SETTINGS.density)
    rig, rng = make_rig(world, SETTINGS), np.random.default_rng(0)
    T_p_a = T_primary_assistant(SETTINGS)

    def pictures(T_w_c, eye):
        views, _ = render_views(world.scene, T_w_c, rig.cameras[eye], oversample=1)
        return [exposed(view, 0.0, rng, SETTINGS) for view in views]

    T_first = rig.T_w_c[0][: N * STEP : STEP]
    T_again = T_first @ ASIDE
    late = rig.T_w_c[1][: N * STEP : STEP] @ se3.inverse(T_p_a) @ ASIDE @ T_p_a
    return Street(
        pictures(T_first, 0),
        T_first,
        pictures(T_again, 0) + pictures(late, 1),
        T_again,
        pictures(rig.T_w_c[0][20 : 20 + N * STEP : STEP], 0),
        KnownKit(rig.cameras, T_p_a),
    )


def keyframe(i, image, eye=Eye.PRIMARY):
    return Keyframe(i, Frame(eye, i, 10**9 + 300_000_000 * i, image))


def window(first_id, images, submap_id=0, n_overlap=0):
    """A window of images: the first half of the primary, the second of the assistant."""
    half = len(images) // 2
    primary = [keyframe(first_id + k, image) for k, image in enumerate(images[:half])]
    assistant = [
        keyframe(first_id + k, image, Eye.ASSISTANT) for k, image in enumerate(images[half:])
    ]
    return SubmapWindow(submap_id, tuple(primary), tuple(assistant), n_overlap)


def visited(pictures, kit, config=CONFIG, descriptor=None, first_id=0):
    """A finder with the places of these images."""
    finder = PlaceLoops(config, descriptor)
    past = window(first_id, pictures + pictures)
    assert finder.find(past, pictures + pictures, kit) is None
    finder.remember(past)
    return finder


def found(finder, street, first_id=FIRST_RETURN):
    return finder.find(window(first_id, street.again), street.again, street.kit)


def test_a_return_is_found_with_an_approximate_pose(street):
    candidate = found(visited(street.elsewhere[::-1] + street.first, street.kit), street)
    here, there = candidate.query_view, candidate.keyframe.id - N
    assert 0 <= there < N
    true = se3.inverse(street.T_again[here]) @ street.T_first[there]
    assert np.linalg.norm(true[:3, 3]) < 4.0
    rough = candidate.T_query_match[:3, 3] * SETTINGS.spacing_m
    assert np.linalg.norm(rough - true[:3, 3]) < 0.4
    assert candidate.agrees(true, SETTINGS.spacing_m)


def test_a_return_is_found_by_the_learned_descriptor(street):
    descriptor = place()
    known = visited(street.elsewhere[::-1] + street.first, street.kit, descriptor=descriptor)
    candidate = found(known, street)
    there = candidate.keyframe.id - N
    assert 0 <= there < N
    true = se3.inverse(street.T_again[candidate.query_view]) @ street.T_first[there]
    assert candidate.agrees(true, SETTINGS.spacing_m)


def test_a_measurement_far_off_does_not_agree(street):
    candidate = found(visited(street.first, street.kit), street)
    own = np.array(candidate.T_query_match)
    assert candidate.agrees(own, 1.0)
    assert not candidate.agrees(own @ se3.exp(np.array([0, 0, 12.0, 0, 0, 0])), 1.0)
    assert not candidate.agrees(own @ se3.exp(np.array([0, 0, 0, 0, 0.3, 0])), 1.0)


def test_the_same_windows_give_the_same_candidate(street):
    a, b = (found(visited(street.first, street.kit), street) for _ in range(2))
    assert (a.query_view, a.keyframe.id) == (b.query_view, b.keyframe.id)
    assert a.T_query_match.tobytes() == b.T_query_match.tobytes()


class AllAlike:
    """A descriptor for which all places are equal."""

    min_similarity = 0.5

    def describe(self, image):
        return np.ones(1, np.float32)

    def similarity(self, queries, places):
        return np.ones((len(queries), len(places)), np.float32)


def test_a_composed_look_alike_is_rejected(street):
    """Another street with this one's road and kerbs at the same pixels."""
    planted = [image.copy() for image in street.elsewhere]
    for image, here in zip(planted, street.first, strict=True):
        image[70:] = here[70:]
    query, past = (
        sift.detect(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), 800)
        for image in (street.again[2], planted[2])
    )
    # there are enough matches on one epipolar geometry
    assert len(sift.consistent(query, past, 1.0)) >= CONFIG.min_matches
    assert found(visited(planted, street.kit, descriptor=AllAlike()), street) is None
    assert found(visited(street.first, street.kit, descriptor=AllAlike()), street) is not None


def test_another_street_is_rejected_at_any_similarity(street):
    assert found(visited(street.elsewhere, street.kit, descriptor=AllAlike()), street) is None


def test_one_look_alike_between_other_places_is_rejected(street):
    lonely = [street.elsewhere[0], street.elsewhere[1], street.first[2], *street.elsewhere[3:]]
    assert found(visited(lonely, street.kit, descriptor=AllAlike()), street) is None


def test_nothing_is_found_before_the_first_sub_map(street):
    finder = visited(street.first, street.kit)
    assert finder.find(window(FIRST_RETURN, street.again), street.again, None) is None


def test_recent_keyframes_are_no_loop(street):
    assert found(visited(street.first, street.kit), street, first_id=CONFIG.min_gap - 1) is None
    wide = replace(CONFIG, min_gap=FIRST_RETURN + N)
    assert found(visited(street.first, street.kit, wide), street) is None


def test_closures_keep_a_minimum_distance(street):
    finder = visited(street.first, street.kit)
    assert found(finder, street) is not None
    assert found(finder, street, FIRST_RETURN + N) is None
    assert found(finder, street, FIRST_RETURN + 10 * N) is not None


def test_a_window_without_a_pose_is_no_place(street):
    finder = PlaceLoops(CONFIG)
    finder.find(window(0, street.first * 2), street.first * 2, street.kit)
    # `remember` was not called
    assert found(finder, street) is None


def picture_of(i, size=(40, 60, 3)):
    return np.full(size, i % 251, np.uint8)


def test_places_are_limited_and_thinned_evenly_in_pairs():
    memory = PlaceMemory(max_places=16)
    for i in range(1000):
        memory.add(keyframe(i, picture_of(i)), np.full(4, i, np.float32))
        assert len(memory) <= 16
    places, vectors = memory.before(999)
    ids = np.array([place.id for place in places])
    first, second = ids[::2], ids[1::2]
    assert len(ids) > 8 and ids[0] == 0
    assert (np.diff(first) == memory.every).all() and ids[-1] > 999 - memory.every
    assert np.array_equal(second, first[: len(second)] + EVERY)
    assert np.array_equal(vectors[:, 0], ids)
    assert [place.id for place in memory.before(int(ids[3]))[0]] == ids[:4].tolist()
    # only the other one of the pair is left as a neighbour
    assert [place.id for place in memory.neighbours(places[2])] == [ids[3]]


def test_a_return_is_found_after_a_drive_of_any_length(street):
    """Thinned to one pair per sixteen keyframes, a place still has a neighbour to confirm it."""
    memory_of_few = replace(CONFIG, max_places=4)
    finder = visited(street.first, street.kit, memory_of_few)
    blank = [np.full((128, 320, 3), k, np.uint8) for k in (0, 80, 160)]
    for first_id in range(N, 60, 3):
        later = window(first_id, blank + blank)
        assert finder.find(later, blank + blank, street.kit) is None
        finder.remember(later)
    assert found(finder, street, FIRST_RETURN + 60) is not None


def test_the_bytes_of_images_are_limited():
    noise = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)
    memory = PlaceMemory(max_places=1000, max_bytes=20_000)
    for i in range(0, 200, EVERY):
        memory.add(keyframe(i, noise), np.zeros(4, np.float32))
        assert memory.n_bytes <= 20_000
    assert 1 < len(memory) < 20


def test_one_place_every_few_keyframes():
    memory = PlaceMemory(max_places=100)
    for i in range(20):
        memory.add(keyframe(i, picture_of(i)), np.zeros(4, np.float32))
    assert [place.id for place in memory.before(100)[0]] == list(range(0, 20, EVERY))
    near = memory.neighbours(memory.before(100)[0][3])
    assert [place.id for place in near] == [2 * EVERY, 4 * EVERY]
    assert [p.id for p in memory.neighbours(memory.before(0)[0][0])] == [EVERY]


def test_a_place_is_the_frame_itself():
    """Eye, sequence and stamp find it in a recording; JPEG bytes of a camera are unchanged."""
    memory = PlaceMemory(max_places=10)
    jpeg = cv2.imencode(".jpg", picture_of(7))[1].tobytes()
    given = keyframe(0, jpeg), keyframe(EVERY, picture_of(9))
    for one in given:
        memory.add(one, np.zeros(4, np.float32))
    kept, decoded = memory.before(100)[0]
    assert kept.frame is given[0].frame
    assert isinstance(decoded.frame.image, bytes)
    assert np.abs(decoded.frame.bgr().astype(int) - 9).max() <= 1
    assert replace(decoded.frame, image=b"") == replace(given[1].frame, image=b"")


def test_blank_images_are_never_a_return():
    tiny = [np.zeros((4, 4, 3), np.uint8)] * 4
    kit = KnownKit((Perspective.from_hfov(70.0, 4, 4),) * 2, np.eye(4))
    finder = visited(tiny[:2], kit)
    assert finder.find(window(200, tiny), tiny, kit) is None
