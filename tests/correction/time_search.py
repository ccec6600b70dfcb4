"""Prints what the intrinsic search costs here and how honest its sigma is. Not a test.

python -m tests.correction.time_search [SEEDS] [FOLDER_OF_IMAGES]
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import process_time

import cv2
import numpy as np

from calm_edge.config import CorrectionConfig
from calm_edge.correction import bank_focal
from calm_edge.correction.matches import SiftMatcher
from calm_edge.correction.spectral import PRINCIPAL_POINT_SHARE
from calm_edge.correction.test_bank import GroupBuilder, TestBank
from calm_edge.geometry import pinhole
from device.frame import Eye
from tests.correction.motions import N_VIEWS, SIZE, K, group

CONFIG = CorrectionConfig()
GUESS = pinhole.matrix(770, 770, K[0, 2], K[1, 2])
BANKS = (
    ("general",),
    ("ahead", "-ahead"),
    ("general", "-ahead", "straight", "ahead", "-general"),
    ("tangent", "-tangent", "straight", "tangent", "tangent"),
)


def calibration(kinds: tuple[str, ...], seeds: int) -> None:
    """Errors of log focal over the claimed sigma; the guess is 10 % long, 0.3 px of noise."""
    errors, sigmas, cost_ms = [], [], []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, len(kinds)])
        off = rng.normal(size=2) * PRINCIPAL_POINT_SHARE * SIZE[0]
        bank, aside = TestBank(CONFIG), (float(off[0]), float(off[1]))
        for n, kind in enumerate(kinds):
            made = group(kind, seed * 10 + n, guess=GUESS[0, 0], off_px=aside)
            bank.add(made, np.log(GUESS[0, 0]))
        start = process_time()
        found = bank_focal.minimise(bank, GUESS, GUESS[0, 0], weighted=True)
        cost_ms.append((process_time() - start) * 1e3)
        errors.append(found.log_focal - np.log(K[0, 0]))
        sigmas.append(found.log_sigma)
    error, sigma = np.array(errors), np.array(sigmas)
    told = np.isfinite(sigma)
    print(f"{' '.join(kinds)}: informative {told.sum()}/{seeds}", end="")
    if told.any():
        rms, z = (np.sqrt(np.mean(v[told] ** 2)) for v in (error, error / sigma))
        print(f", error rms {rms:.4f}, sigma median {np.median(sigma[told]):.4f}", end="")
        print(f", error / sigma rms {z:.2f}", end="")
    print(f"; search {np.median(cost_ms):.1f} CPU-ms", flush=True)


def bank_cost(folder: Path) -> None:
    """CPU seconds of one group by SIFT, from the first images of a folder."""
    names = sorted(folder.iterdir())[:N_VIEWS]
    images = [np.asarray(cv2.imread(str(name)), np.uint8) for name in names]
    views = range(len(images))
    start = process_time()
    matches = SiftMatcher(CONFIG.max_features).describe(images, views)
    described = process_time()
    builder = GroupBuilder(Eye.PRIMARY, matches, views, views, CONFIG)
    shape = pinhole.from_hfov(73, images[0].shape[1], images[0].shape[0])
    made = builder.finish(shape)
    pairs = 0 if made is None else len(made.test.F)
    print(
        f"group of {pairs} pairs: features {described - start:.2f}, matching and matrices "
        f"{process_time() - described:.2f} CPU-s"
    )


if __name__ == "__main__":
    for kinds in BANKS:
        calibration(kinds, int(sys.argv[1]) if len(sys.argv) > 1 else 200)
    if len(sys.argv) > 2:
        bank_cost(Path(sys.argv[2]))
