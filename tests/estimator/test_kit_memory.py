import dataclasses

import numpy as np
import pytest

from calm_edge.backbones.base import BackboneError
from calm_edge.estimator.kit_memory import KitMemory
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.kit import layout
from calm_edge.kit.lens import Family
from calm_edge.types import Hints, KitBelief, Overlap, Prediction

HINTS = Hints(eyes=np.array([0, 0, 1]), t_ns=np.arange(3))


def evidence(kit, families=layout.PERSPECTIVE):
    """Evidence on the first entry of the kit alone."""
    mean = np.zeros(layout.SIZE)
    mean[0], mean[layout.FAMILY] = kit, families
    information = layout.with_known_families(np.diag(np.eye(layout.SIZE)[0]))
    information[layout.LOG_FOCAL, layout.LOG_FOCAL] = 1.0
    return KitBelief(mean, information)


def seen(focals, *, sigma=0.002, kit=None):
    each = [focals[eye] for eye in HINTS.eyes]
    belief = None if kit is None else evidence(kit)
    depth = np.ones((3, 2, 2), np.float32)
    return Prediction(
        cameras=tuple(Perspective(f, f, 319.5, 119.5, 640, 240) for f in each),
        T_s_c=np.tile(np.eye(4), (3, 1, 1)),
        depth=depth,
        confidence=depth,
        focal_log_sigma=np.full(3, sigma),
        kit=belief,
    )


class Resolver:
    """Returns focals of 500 px and its own evidence, or raises if `fails`."""

    def __init__(self, *, fails=False):
        self.fails, self.asked = fails, []

    def kit_sigma(self, hints):
        return np.zeros(2)

    def resolve(self, prediction, hints):
        assert prediction.depth is None and prediction.confidence is None
        self.asked.append(None if hints.kit is None else float(hints.kit.mean[0]))
        if self.fails:
            raise BackboneError("no")
        return seen((500, 500), kit=5.0)


def test_the_prior_of_a_window_is_the_evidence_of_the_others():
    memory = KitMemory(Resolver(), 10)
    for submap_id, kit in enumerate((1.0, 2.0, 6.0)):
        memory.add(submap_id, seen((500, 500), kit=kit), HINTS)
    assert memory.belief().mean[0] == pytest.approx(3.0)
    assert memory.belief(without=2).mean[0] == pytest.approx(1.5)
    assert KitMemory(Resolver(), 10).belief() is None


def test_a_window_whose_scale_is_unknown_teaches_nothing_until_it_is_known():
    unknown = dataclasses.replace(seen((500, 500), kit=9.0), scale_log_sigma=np.inf)
    memory = KitMemory(Resolver(), 10)
    memory.add(0, unknown, HINTS)
    assert memory.evidence() is None
    memory.add(1, seen((500, 500), kit=1.0), HINTS)
    assert memory.evidence().mean[0] == pytest.approx(1.0)
    # the resolver gives evidence of 5 and no sigma
    memory.resolve([0])
    assert memory.evidence().mean[0] == pytest.approx(3.0)
    # and what became unknown is forgotten
    memory.add(0, unknown, HINTS)
    assert memory.evidence().mean[0] == pytest.approx(1.0)


def test_new_evidence_of_a_window_replaces_the_old():
    backbone = Resolver()
    memory = KitMemory(backbone, 10)
    for submap_id, kit in enumerate((1.0, 2.0)):
        memory.add(submap_id, seen((500, 500), kit=kit), HINTS)
    assert set(memory.resolve([0, 1])) == {0, 1}
    # each was solved with the newest evidence of the other
    assert backbone.asked == [2.0, 5.0]
    assert memory.belief().mean[0] == pytest.approx(5.0)
    assert memory.belief().information[0, 0] == pytest.approx(2.0)


@pytest.mark.parametrize("moved", [(520, 500), (500, 520)])
def test_a_focal_that_moved_in_either_eye_is_outdated(moved):
    memory = KitMemory(Resolver(), 10)
    memory.add(0, seen((500, 500), sigma=0.3), HINTS)
    memory.add(1, seen((503, 503), sigma=0.3), HINTS)
    assert memory.outdated() == []
    memory.add(2, seen(moved), HINTS)
    assert memory.outdated() == [0, 1]


def test_an_uncertain_focal_outdates_nothing():
    memory = KitMemory(Resolver(), 10)
    memory.add(0, seen((500, 500)), HINTS)
    memory.add(1, seen((700, 700), sigma=0.2), HINTS)
    assert memory.outdated() == []
    memory.add(2, dataclasses.replace(seen((700, 700)), focal_log_sigma=None), HINTS)
    assert memory.outdated() == []


def test_a_window_that_cannot_be_solved_again_is_not_tried_each_time():
    memory = KitMemory(Resolver(fails=True), 10)
    memory.add(0, seen((600, 600), sigma=0.3), HINTS)
    memory.add(1, seen((500, 500)), HINTS)
    assert memory.outdated() == [0]
    assert memory.resolve([0]) == {}
    assert memory.outdated() == []


def test_a_scale_that_is_known_is_not_given_up_for_one_that_is_not():
    class Loses(Resolver):
        def resolve(self, prediction, hints):
            return dataclasses.replace(prediction, scale_log_sigma=np.inf, kit=None)

    memory = KitMemory(Loses(), 10)
    for submap_id, sigma in enumerate((0.2, np.inf)):
        known = dataclasses.replace(seen((500, 500), kit=1.0), scale_log_sigma=sigma)
        memory.add(submap_id, known, HINTS)
    assert list(memory.resolve([0, 1])) == [1]
    assert memory.prediction(0).scale_log_sigma == 0.2
    assert memory.evidence().mean[0] == pytest.approx(1.0)


def test_the_oldest_windows_are_dropped_but_not_their_evidence():
    memory = KitMemory(Resolver(), 2)
    for submap_id in range(4):
        memory.add(submap_id, seen((500, 500), kit=float(submap_id)), HINTS)
    assert memory.retained() == [2, 3]
    assert memory.belief().mean[0] == pytest.approx(1.5)


def test_a_backbone_that_cannot_resolve_keeps_no_window():
    memory = KitMemory(object(), 10)
    memory.add(0, seen((500, 500), kit=1.0), HINTS)
    assert memory.retained() == [] and memory.resolve([0]) == {}
    assert memory.belief().mean[0] == pytest.approx(1.0)


def test_the_overlap_is_that_of_the_newest_solution_of_the_window_before():
    def overlap(value):
        one = np.full(1, value)
        return Overlap(np.arange(1), np.eye(4)[None], one, one, one[None], one[None])

    class Ties(Resolver):
        def resolve(self, prediction, hints):
            self.asked.append(hints.overlap)
            return dataclasses.replace(prediction, overlap=overlap(10.0 + len(self.asked)))

    backbone = Ties()
    memory = KitMemory(backbone, 10)
    for submap_id in (0, 1, 3):
        made = dataclasses.replace(seen((500, 500)), overlap=overlap(submap_id))
        memory.add(submap_id, made, HINTS)
    # window 2 was skipped, and nothing is handed on across it
    assert memory.overlap_before(0) is None and memory.overlap_before(3) is None
    assert memory.overlap_before(2).kit == [1.0]
    memory.resolve([0, 1])
    assert backbone.asked[0] is None and backbone.asked[1].kit == [11.0]
    assert memory.overlap_before(2).kit == [12.0]
    # nor across a change of the kit
    memory.begin_epoch(2, None)
    assert memory.overlap_before(2) is None and memory.overlap_before(1) is not None


def test_neighbours_give_the_lengths_of_shared_paths():
    def window(first, sigma, step):
        """Three primary views from stamp `first` on, `step` apart, and one of the assistant."""
        hints = Hints(eyes=np.array([0, 0, 0, 1]), t_ns=np.r_[first + np.arange(3), first])
        T = np.tile(np.eye(4), (4, 1, 1))
        T[:3, 2, 3] = step * np.arange(3)
        made = dataclasses.replace(seen((500, 500)), T_s_c=T, scale_log_sigma=sigma)
        cameras = made.cameras[:1] * 3 + made.cameras[-1:]
        sigmas = np.full(4, 0.002)
        return dataclasses.replace(made, cameras=cameras, focal_log_sigma=sigmas), hints

    memory = KitMemory(Resolver(), 10)
    own, hints = window(1, 0.3, 1.0)
    assert memory.lengths_beside(1, hints) == ()
    memory.add(0, *window(0, 0.01, 2.0))
    memory.add(1, own, hints)
    memory.add(2, *window(2, 0.02, 3.0))
    before, after = memory.lengths_beside(1, hints)
    assert before.t_ns.tolist() == [1, 2] and (before.spacings, before.log_sigma) == (2.0, 0.01)
    assert after.t_ns.tolist() == [2, 3] and (after.spacings, after.log_sigma) == (3.0, 0.02)
    # none of a window of unknown scale, nor of another epoch
    memory.add(0, *window(0, np.inf, 2.0))
    assert len(memory.lengths_beside(1, hints)) == 1
    memory.begin_epoch(2, None)
    assert memory.lengths_beside(1, hints) == ()


def test_pictures_of_another_size_begin_an_epoch_of_the_kit():
    memory = KitMemory(Resolver(), 9)
    wide, small = np.array([[640, 240], [640, 240]]), np.array([[640, 240], [320, 120]])
    assert not memory.resized(0, None) and not memory.resized(0, wide)
    memory.add(0, seen((400.0, 400.0), kit=1.0), HINTS)
    assert not memory.resized(1, wide)
    assert memory.resized(2, small) and not memory.resized(2, small)
    assert memory.evidence() is None and memory.belief() is None
    # an earlier window that is solved again keeps its epoch
    assert not memory.resized(1, wide) and np.array_equal(memory.sizes, small)
    assert memory.evidence(without=1).mean[0] == 1.0
    memory.add(2, seen((200.0, 200.0), kit=3.0), HINTS)
    assert memory.evidence().mean[0] == 3.0 and memory.overlap_before(2) is None


def test_windows_of_another_family_of_lenses_are_outdated_and_no_evidence():
    memory = KitMemory(Resolver(), 10)
    memory.add(0, seen((500, 500), kit=1.0), HINTS)
    wide = (Family.FISHEYE, Family.FISHEYE)
    of_fisheye = tuple(Fisheye(500.0, 500.0, 319.5, 119.5, 640, 240) for _ in range(3))
    found = dataclasses.replace(
        seen((500, 500)), cameras=of_fisheye, kit=evidence(7.0, wide), overlap=None
    )
    memory.add(1, found, HINTS)
    assert layout.families(memory.belief().mean) == wide
    assert memory.belief().mean[0] == pytest.approx(7.0)
    assert memory.belief().information[0, 0] == pytest.approx(1.0)
    assert memory.outdated() == [0]
    # not again and again where that fails
    failing = KitMemory(Resolver(fails=True), 10)
    failing.add(0, seen((500, 500), kit=1.0), HINTS)
    failing.add(1, found, HINTS)
    assert failing.outdated() == [0] and not failing.resolve([0])
    assert failing.outdated() == []
