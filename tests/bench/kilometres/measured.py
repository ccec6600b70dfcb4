"""Hand-made outcomes of runs."""

import dataclasses

from bench.kilometres.outcomes import Focals, Measured


def measured(drive="04", seed=1, setting="open", variant="ours", error=1.0, **changes):
    """A run over 1 km; error [m], None where it failed."""
    made = Measured(
        drive=drive,
        seed=seed,
        setting=setting,
        variant=variant,
        path_m=1000.0,
        n_keyframes=800,
        n_submaps=60,
        missing=0 if error is not None else 800,
        ms=100.0,
        ate_sim3_m=error,
        ate_se3_m=None if error is None else 2 * error,
        scale_error=None if error is None else error / 10,
        scale_std=None if error is None else error / 100,
        focals=None,
        failed="" if error is not None else "SL(4) lost it",
    )
    return dataclasses.replace(made, **changes)


def focals(off_px, sigma=0.01):
    """Focals with an error of the primary's estimate; raw error 30 px, of the mean 20 px."""
    return Focals(
        true=(700.0, 500.0),
        raw=(30.0, 20.0),
        mean=(720.0, 510.0),
        held=(700.0 + off_px, 505.0),
        log_sigma=(sigma, sigma),
        damping=(0.9, 0.9),
    )
