"""How wrong the model of the kilometre runs is: sized by what the paper reports of VGGT."""

from __future__ import annotations

from bench.scripted import ScriptedErrors


def sized(seed: int) -> ScriptedErrors:
    """Table 6: 34.67 px raw focal error at KITTI's 718 px, 25.5 px of the mean over a drive.

    Those are mean absolute values: sigmas of 4.3 % for the drive and 3.9 % for the sub-map. Depth
    against poses is sized by the drift of Sim(3) chaining in tables 2 and 5, pose noise by what
    the paper's own system has left.
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
