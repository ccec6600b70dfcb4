import numpy as np
import pytest

from calm_edge.geometry.distortion import distorted, distorted_jacobian, term_jacobian

K = (-0.12, 0.05, 2e-3, -1e-3, 0.01, 0.04, -0.02, 0.003)
Q = np.random.default_rng(0).uniform(-0.8, 0.8, (2, 50))
F = np.linspace(200.0, 400.0, 50)
H = 1e-6
every_number_of_terms = pytest.mark.parametrize("n", range(len(K) + 1))


@every_number_of_terms
def test_missing_terms_are_zero(n):
    padded = K[:n] + (0.0,) * (len(K) - n)
    assert np.allclose(distorted(Q, K[:n], F), distorted(Q, padded, F), rtol=1e-14)
    assert np.allclose(distorted_jacobian(Q, K[:n], F), distorted_jacobian(Q, padded, F))


@every_number_of_terms
def test_derivatives_are_the_numeric_ones(n):
    by_q = np.stack(
        [
            (distorted(Q + step, K[:n], F) - distorted(Q - step, K[:n], F)) / (2 * H)
            for step in H * np.eye(2)[..., None]
        ]
    )
    assert np.allclose(distorted_jacobian(Q, K[:n], F), by_q, atol=1e-5)
    analytic = term_jacobian(Q, K[:n], F)
    assert analytic.shape == (n, *Q.shape)
    for term, found in enumerate(analytic):
        high, low = (np.array(K[:n]) + sign * H * (np.arange(n) == term) for sign in (1, -1))
        numeric = (distorted(Q, list(high), F) - distorted(Q, list(low), F)) / (2 * H)
        assert np.allclose(found, numeric, atol=1e-5)


def test_every_point_may_have_its_own_lens():
    k = np.random.default_rng(1).uniform(-0.05, 0.05, (8, Q.shape[1]))
    together = [distorted(Q, k, F), distorted_jacobian(Q, k, F), term_jacobian(Q, k, F)]
    for i in range(Q.shape[1]):
        alone = Q[:, i : i + 1], k[:, i].tolist(), float(F[i])
        for all_of, of_one in zip(
            together, (distorted, distorted_jacobian, term_jacobian), strict=True
        ):
            assert np.allclose(all_of[..., i : i + 1], of_one(*alone), rtol=1e-12)
