"""A window, solved and rectified by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.scripted import ScriptedBackbone, ScriptedErrors
from calm_edge.backbones.base import BackboneError
from calm_edge.config import Config, merge
from calm_edge.estimator.atlas import Atlas
from calm_edge.estimator.direction_memory import DirectionMemory
from calm_edge.estimator.ego_masks import EgoMasks
from calm_edge.estimator.kit_memory import KitMemory
from calm_edge.estimator.kit_watch import KitWatch
from calm_edge.estimator.loop_closing import LoopClosing
from calm_edge.estimator.metre import DriveMetre
from calm_edge.estimator.rectifier import Rectifier
from calm_edge.estimator.scale import ScaleError
from calm_edge.estimator.stamp_correction import StampCorrection
from calm_edge.estimator.window_solver import ALIKE, WindowSolver
from calm_edge.kit.prior import KitPrior
from calm_edge.types import Hints, Keyframe, LoopClosure, Masks, Prediction, SubmapWindow
from tests.drives import T_P_A, curved, position_error, scene, windows

SPACING_M = float(np.linalg.norm(T_P_A[:3, 3]))
CONFIG = merge(Config(), {"scale": {"spacing_m": SPACING_M}, "correction": {"apply": "never"}})


class Closing(LoopClosing):
    """Appends a keyframe to the batch, and closes with it or not."""

    def __init__(self, keyframe: Keyframe, closed: LoopClosure | None) -> None:
        super().__init__(None, Atlas(CONFIG), SPACING_M)
        self._keyframe, self._closed = keyframe, closed

    def with_loop(self, window, images):  # type: ignore[no-untyped-def]
        joined = replace(window, loop_keyframe=self._keyframe)
        return joined, [*images, self._keyframe.frame.bgr()], None

    def closure(self, *_):  # type: ignore[no-untyped-def]
        return self._closed


class Counting(ScriptedBackbone):
    """Counts the views of each batch; fails if asked to."""

    fails = False

    def infer(self, images, hints: Hints) -> Prediction:  # type: ignore[no-untyped-def]
        self.views = len(images)
        if self.fails:
            raise BackboneError("scripted: too few points")
        return super().infer(images, hints)


def solver(loops: LoopClosing | None = None) -> tuple[WindowSolver, Counting, DriveMetre]:
    backbone = Counting(scene(curved(60)), ScriptedErrors(scale_log_sigma=0.5))
    metre = DriveMetre(SPACING_M)
    made = WindowSolver(
        CONFIG,
        backbone,
        memory=KitMemory(backbone, 10),
        kit_prior=KitPrior(CONFIG),
        rectifier=Rectifier(CONFIG, estimates_kit=False),
        loops=loops or LoopClosing(None, Atlas(CONFIG), SPACING_M),
        direction=DirectionMemory(),
        metre=metre,
        watch=KitWatch(),
        stamps=StampCorrection(),
        ego=EgoMasks(Masks()),
        lenses=None,
        retimed=lambda: None,
    )
    return made, backbone, metre


def textured(window: SubmapWindow, seeds: tuple[int, int]) -> SubmapWindow:
    """The window with one picture for each camera."""
    eyes = []
    for keyframes, seed in zip((window.primary, window.assistant), seeds, strict=True):
        image = np.random.default_rng(seed).integers(0, 255, (64, 96, 3)).astype(np.uint8)
        eyes.append(
            tuple(replace(k, frame=replace(k.frame, image=image)) for k in keyframes),
        )
    return replace(window, primary=eyes[0], assistant=eyes[1])


def test_a_window_is_solved_in_metres_whatever_its_own_unit() -> None:
    made, backbone, _ = solver()
    window = windows(60)[1]
    stage_ms: dict[str, float] = {}
    found, contradicts = made.solved(window, (), stage_ms)
    ids = [keyframe.id for keyframe in window.primary]
    T = found.submap.T_s_c[: len(ids)]
    assert position_error(T, curved(60)[ids]).max() < 1e-6
    assert found.closed is None and not contradicts
    assert backbone.views == len(window.keyframes())
    assert {"decode", "infer", "search", "rectify"} <= stage_ms.keys()


def test_the_same_pictures_from_both_cameras_are_refused_until_they_differ() -> None:
    made, _, metre = solver()
    window = windows(60)[0]
    with pytest.raises(ScaleError, match=ALIKE):
        made.reconstructed(textured(window, (1, 1)), (), {})
    assert metre.of(()).reason == ALIKE
    made.reconstructed(textured(window, (1, 2)), (), {})
    assert metre.of(()).reason != ALIKE


def test_a_loop_view_that_closes_nothing_is_dropped_and_a_recorded_one_has_to_close() -> None:
    first, window = windows(60)[0], windows(60)[2]
    made, backbone, _ = solver(Closing(first.primary[2], None))
    found = made.reconstructed(window, (), {})
    assert backbone.views == len(window.keyframes()) + 1
    assert found.window.loop_keyframe is None
    views = len(window.keyframes())
    assert len(found.submap.T_s_c) == len(found.prediction.T_s_c) == len(found.hints.t_ns) == views
    with pytest.raises(BackboneError, match="loop keyframe"):
        made.reconstructed(window, (), {}, known=True)
    closed = LoopClosure(20, 2, np.eye(4))
    made, _, _ = solver(Closing(first.primary[2], closed))
    found = made.reconstructed(window, (), {})
    assert found.closed is closed and len(found.submap.T_s_c) == views + 1


def test_a_backbone_without_a_kit_has_no_sigma_of_it_and_its_failure_is_raised() -> None:
    made, backbone, _ = solver()
    assert made.kit_sigma(0) is None
    backbone.fails = True
    with pytest.raises(BackboneError, match="too few points"):
        made.solved(windows(60)[0], (), {})
