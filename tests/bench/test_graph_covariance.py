"""Covariances of the final poses, from sub-maps alone."""

import numpy as np

from bench.cost import circuit
from bench.graph_covariance import optimised
from bench.scripted import ScriptedBackbone, ScriptedErrors
from calm_edge.config import Config, merge
from calm_edge.estimator.localizer import Localizer


def _localizer(n_submaps):
    spacing_m = float(np.linalg.norm(circuit.T_P_A[:3, 3]))
    config = merge(Config(), {"scale": {"spacing_m": spacing_m}, "loops": {"enabled": False}})
    config = merge(config, {"correction": {"apply": "never"}})
    scene = circuit.scene(circuit.n_keyframes(n_submaps, config.frontend))
    errors = ScriptedErrors(rotation_sigma_rad=0.001, translation_sigma=0.01, seed=1)
    localizer = Localizer(config, ScriptedBackbone(scene, errors))
    for window in circuit.windows(n_submaps, config.frontend):
        localizer.process(window)
    return localizer, config


def test_the_optimum_of_a_drive_is_found_again_from_its_sub_maps():
    localizer, config = _localizer(3)
    final = localizer.finish()
    trajectory, marginals = optimised(localizer.submaps, config)
    np.testing.assert_array_equal(trajectory.keyframe_ids, final.keyframe_ids)
    np.testing.assert_allclose(trajectory.T_w_c, final.T_w_c, atol=1e-6)
    near, far = marginals.covariances(np.array([3, len(final.t_ns) - 1]), 0)
    assert 0 < np.trace(near[:3, :3]) < np.trace(far[:3, :3])


def test_without_sub_maps_there_is_nothing_to_optimise():
    assert optimised([], Config()) is None
