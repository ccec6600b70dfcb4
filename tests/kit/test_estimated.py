import dataclasses

import numpy as np
import pytest

from calm_edge.geometry.camera import Perspective
from calm_edge.kit import layout
from calm_edge.kit.estimated import cameras
from calm_edge.types import KitBelief
from device.frame import Eye
from tests.recording import samples

LENS = Perspective.from_hfov(70.0, 640, 480)


def update(kit=None, sigma=(0.02, 0.03)):
    made = samples.update()
    submap = dataclasses.replace(made.submap, cameras=(LENS,) * 5, focal_log_sigma=np.array(sigma))
    return dataclasses.replace(made, submap=submap, kit=kit)


def kit():
    mean = layout.prior((65.0, 80.0)).mean
    mean[layout.DISTORTION[:, 0]] = -0.2, -0.05
    return KitBelief(mean, np.eye(layout.SIZE) * 1e6)


def test_the_lenses_are_those_that_the_kit_has_learned():
    found = cameras(update(kit()))
    assert [found[eye].distortion[0] for eye in Eye] == pytest.approx([-0.2, -0.05], abs=1e-3)
    hfov = [2 * np.degrees(np.arctan(320 / found[eye].fx)) for eye in Eye]
    assert hfov == pytest.approx([65.0, 80.0], abs=0.1)


def test_without_a_kit_they_are_those_of_the_sub_map():
    assert cameras(update()) == {Eye.PRIMARY: LENS, Eye.ASSISTANT: LENS}
    alone = update()
    alone = dataclasses.replace(alone, submap=dataclasses.replace(alone.submap, assistant_ids=()))
    assert cameras(alone) == {Eye.PRIMARY: LENS}


@pytest.mark.parametrize("belief", [None, kit()])
def test_an_unobserved_focal_is_left_out(belief):
    assert list(cameras(update(belief, (0.2, 0.03)))) == [Eye.ASSISTANT]
    assert cameras(update(belief, (np.inf, np.inf))) == {}
