import numpy as np
import pytest

from calm_edge.geometry import epipolar, se3
from calm_edge.geometry.camera import Perspective

CAMERA = Perspective(500, 520, 320, 200, 640, 400)
T_B_A = se3.exp(np.array([0.3, -0.1, -1.0, 0.02, 0.06, -0.01]))


def matches(seed=0, n=150, noise_px=0.0, outliers=0.0):
    rng = np.random.default_rng(seed)
    p_a = rng.uniform([-8, -4, 6], [8, 4, 40], (n, 3))
    uv_a = CAMERA.project(p_a) + rng.normal(size=(n, 2)) * noise_px
    uv_b = CAMERA.project(se3.transform(T_B_A, p_a)) + rng.normal(size=(n, 2)) * noise_px
    wrong = rng.random(n) < outliers
    uv_b[wrong] = rng.uniform(0, [640, 400], (wrong.sum(), 2))
    return uv_a, uv_b, ~wrong


def test_the_matrix_of_a_motion_satisfies_the_epipolar_constraint():
    uv_a, uv_b, _ = matches()
    F = epipolar.from_motion(CAMERA, CAMERA, T_B_A)
    assert np.linalg.norm(F) == pytest.approx(1)
    assert np.abs(epipolar.sampson(F, uv_a, uv_b)).max() < 1e-9
    assert np.abs(epipolar.sampson(F.T, uv_a, uv_b)).mean() > 0.3


def test_sampson_distances_have_the_sigma_of_the_noise():
    uv_a, uv_b, _ = matches(n=4000, noise_px=0.4)
    F = epipolar.from_motion(CAMERA, CAMERA, T_B_A)
    assert epipolar.sampson(F, uv_a, uv_b).std() == pytest.approx(0.4, rel=0.05)


def test_exact_matches_give_the_exact_rank_two_matrix():
    uv_a, uv_b, _ = matches()
    fit = epipolar.fundamental(uv_a, uv_b)
    truth = epipolar.from_motion(CAMERA, CAMERA, T_B_A)
    assert fit.inliers.all()
    assert np.abs(fit.F * np.sign((fit.F * truth).sum()) - truth).max() < 1e-6
    singular = np.linalg.svd(fit.F, compute_uv=False)
    assert singular[2] < 1e-12 * singular[0]


def test_twenty_percent_outliers_are_rejected_and_the_noise_estimated():
    uv_a, uv_b, right = matches(noise_px=0.3, outliers=0.2)
    fit = epipolar.fundamental(uv_a, uv_b)
    assert fit.inliers[right].mean() > 0.97
    assert fit.inliers[~right].mean() < 0.15
    louder = epipolar.fundamental(*matches(noise_px=0.6, outliers=0.2)[:2])
    grown = np.linalg.norm(louder.steps) / np.linalg.norm(fit.steps)
    assert grown == pytest.approx(2, rel=0.25)


def test_the_estimated_uncertainty_is_correct():
    """Errors in units of the one-sigma steps have squares of mean 1."""
    truth, squares = epipolar.from_motion(CAMERA, CAMERA, T_B_A), []
    to = np.array([[300, 0, 320], [0, 200, 200], [0, 0, 1.0]])
    for seed in range(40):
        uv_a, uv_b, _ = matches(seed, noise_px=0.3)
        fit = epipolar.refine(truth, uv_a, uv_b, threshold_px=2)
        away = truth * np.sign((fit.F * truth).sum()) - fit.F
        # in normalised pixels, with the free scale of F as an eighth direction
        basis = (to.T @ np.concatenate([fit.steps, fit.F[None]]) @ to).reshape(8, 9)
        size = np.linalg.norm(basis, axis=1)
        found = np.linalg.lstsq((basis / size[:, None]).T, (to.T @ away @ to).ravel(), rcond=None)
        squares.append(((found[0] / size)[:7] ** 2).mean())
    assert 0.6 < np.median(squares) < 1.6


def test_the_seed_fixes_the_result():
    uv_a, uv_b, _ = matches(noise_px=0.3, outliers=0.3)
    one, two = (epipolar.fundamental(uv_a, uv_b, seed=7) for _ in range(2))
    assert (one.F == two.F).all() and (one.inliers == two.inliers).all()


@pytest.mark.parametrize("n", [0, 7])
def test_too_few_matches_give_nothing(n):
    uv_a, uv_b, _ = matches(n=20)
    assert epipolar.fundamental(uv_a[:n], uv_b[:n]) is None


def test_random_matches_give_none_or_large_noise():
    same = np.full((30, 2), 50.0)
    assert epipolar.fundamental(same, same) is None
    rng = np.random.default_rng(0)
    noise = [rng.uniform(0, 400, (40, 2)) for _ in range(2)]
    fit = epipolar.fundamental(*noise)
    assert fit is None or fit.inliers.sum() < 20
