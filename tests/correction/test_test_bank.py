from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from bench.scripted.motions import CAMERA, N_VIEWS, group, motion, seen
from calm_edge.config import CorrectionConfig
from calm_edge.correction import test_bank
from calm_edge.correction.matches import from_landmarks
from calm_edge.correction.test_bank import GroupBuilder
from calm_edge.geometry import epipolar, se3
from calm_edge.types import Landmarks

CONFIG = CorrectionConfig()
AT = float(np.log(700))


def builder(landmarks, config=CONFIG, n=N_VIEWS):
    ids = range(40, 40 + n)
    return GroupBuilder(from_landmarks(landmarks), range(n), ids, config)


def test_fifteen_views_give_all_pairs():
    T = motion("general")
    made = builder(seen(T, 0)).finish(CAMERA)
    for F, (a, b) in zip(made.F, combinations(range(15), 2), strict=True):
        if b - a >= 4:
            truth = epipolar.from_motion(CAMERA, CAMERA, se3.inverse(T[b]) @ T[a])
            uv = seen(T, 0, noise_px=0)
            matches = from_landmarks(uv).pair(a, b)
            assert np.median(np.abs(epipolar.sampson(F, *matches))) < 0.2
            assert np.median(np.abs(epipolar.sampson(truth, *matches))) < 1e-3


def test_building_in_steps_gives_the_same_group():
    landmarks = seen(motion("general"), 1)
    spread = builder(landmarks)
    for call in range(CONFIG.group_every):
        assert not spread.done, call
        spread.advance()
    assert spread.done
    at_once = builder(landmarks).finish(CAMERA)
    assert (spread.finish(CAMERA).F == at_once.F).all()


def test_a_group_needs_n_pair_pairs_and_a_pair_n_feature_matches():
    landmarks = seen(motion("general", 6), 2)
    assert builder(landmarks, n=5).finish(CAMERA) is not None
    assert builder(landmarks, n=4).finish(CAMERA) is None
    assert builder(landmarks, replace(CONFIG, n_pair=16), n=6).finish(CAMERA) is None
    assert builder(landmarks, replace(CONFIG, n_feature=10_000), n=6).finish(CAMERA) is None


def test_without_landmarks_there_is_no_group():
    empty = np.zeros(0, np.int64)
    nothing = Landmarks(np.zeros((0, 3)), empty, empty, np.zeros((0, 2), np.float32))
    assert builder(nothing).finish(CAMERA) is None


def test_a_full_bank_without_weights_accepts_no_group():
    bank = test_bank.TestBank(replace(CONFIG, n_group=2, weighted=False))
    straight, turn = group("straight", 0), group("general", 0)
    assert bank.add(straight, AT) and bank.add(straight, AT) and bank.is_closed
    assert not bank.add(turn, AT)
    assert bank.groups == (straight, straight)


def test_a_full_weighted_bank_drops_the_group_of_least_information():
    bank = test_bank.TestBank(replace(CONFIG, n_group=2))
    straight, turn, other = group("straight", 0), group("general", 0), group("ahead", 0)
    assert bank.add(straight, AT) and bank.add(turn, AT) and not bank.is_closed
    assert bank.add(other, AT)
    assert bank.groups == (turn, other)
    assert not bank.add(straight, AT)
    assert len(bank.F) == len(bank.information(AT)) == len(bank.noise(AT)) == 210
    assert bank.group_of().tolist() == [0] * 105 + [1] * 105


def test_an_empty_bank_has_empty_columns():
    bank = test_bank.TestBank(CONFIG)
    assert bank.F.shape == (0, 3, 3) and bank.centre_shift(AT).shape == (0, 2)
    assert len(bank.information(AT)) == len(bank.group_of()) == 0


def test_the_focal_range_is_in_image_widths():
    low, high = test_bank.focal_range(CAMERA)
    assert (low, high) == pytest.approx((0.3 * 1226, 3 * 1226))


def test_a_group_is_built_again_for_another_lens_from_its_matches():
    lens = replace(CAMERA, distortion=(-0.25, 0.06))
    landmarks = seen(motion("general"), 0, camera=lens)
    bent = builder(landmarks).finish(CAMERA)
    again = bent.source.builder(CONFIG, lens).finish(CAMERA)
    T = motion("general")
    exact = from_landmarks(seen(T, 0, noise_px=0))
    pairs = list(bent.source.matches.pixels)
    off = [
        np.mean([np.median(np.abs(epipolar.sampson(F, *exact.pair(*p)))) for F, p in made])
        for made in (zip(bent.F, pairs, strict=True), zip(again.F, pairs, strict=True))
    ]
    assert off[1] < 0.05 and off[0] > 5 * off[1]
