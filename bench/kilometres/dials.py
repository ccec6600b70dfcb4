"""Error model of the scripted backbone in the kilometre runs, from the paper's figures for VGGT."""

from __future__ import annotations

from bench.scripted import ScriptedErrors


def sized(seed: int) -> ScriptedErrors:
    """Errors with the sizes that the paper's tables report.

    Focal: table 6 gives mean absolute errors of 34.67 px for single sub-maps and of 25.5 px for the
    mean over a drive, at KITTI's 718 px: sigmas of 4.3 % for the bias of a drive and of 3.9 % for
    the deviation of a sub-map from it. Growth of the ratio of depth to poses within a sub-map:
    such that Sim(3) chaining has about its errors of tables 2 and 5. Pose noise: such that our
    method has about the error of the paper's full system.
    """
    return ScriptedErrors(
        coupled=True,
        scale_log_sigma=0.2,
        scale_walk=0.1,
        focal_bias_log_sigma=0.043,
        focal_log_sigma=0.039,
        rotation_sigma_rad=0.0005,
        translation_sigma=0.005,
        bend_sigma_rad=0.0025,
        depth_warp=0.1,
        depth_drift=0.05,
        match_sigma_px=0.4,
        outlier_share=0.05,
        seed=seed,
    )
