import numpy as np
import pytest

from bench.__main__ import main
from bench.consistency import consistent_band, pose_nees, rows
from bench.tables import kept
from calm_edge.geometry import se3
from calm_edge.posegraph.marginals import Marginals
from calm_edge.posegraph.noise import measured_noise
from tests.drives import circle, curved
from tests.posegraph.graphs import graph_of, optimised


def test_errors_drawn_from_the_covariance_average_to_their_degrees_of_freedom():
    rng, n = np.random.default_rng(3), 4000
    L = rng.normal(size=(6, 6)) * 0.01
    covariance = np.tile(L @ L.T, (n, 1, 1))
    truth = se3.exp(rng.normal(size=(n, 6)))
    T = truth @ se3.exp(rng.normal(size=(n, 6)) @ L.T)
    low, high = consistent_band(n, 0.999)
    assert low < pose_nees(T, truth, covariance).mean() / 6 < high
    assert pose_nees(T, truth, covariance / 4).mean() / 6 > 3.5


def test_band_narrows_around_one_as_runs_add_up():
    few, many = consistent_band(20), consistent_band(2000)
    assert few[0] < many[0] < 1.0 < many[1] < few[1]
    assert few == pytest.approx((0.763, 1.268), abs=1e-3)  # chi-square tables at 120


@pytest.mark.parametrize(
    ("T", "noise", "turn"),
    [(curved(75), 0.01, 0.1), (curved(75), 0.003, 1.0), (circle(75, 12.0), 0.01, 0.05)],
)
def test_a_drives_covariances_are_honest_over_twenty_draws(T, noise, turn):
    rows, values = np.array([14, 40, 74]), []
    truth = (se3.inverse(T[0]) @ T)[rows]
    for seed in range(20):
        graph = graph_of(T, noise=noise, turn=turn, rectified=True, seed=seed)
        optimised(graph)
        X = (se3.inverse(graph.poses()[0]) @ graph.poses())[rows]
        problem = graph.problem()
        marginals = Marginals(problem, graph.state(), measured_noise(problem))
        values.append(pose_nees(X, truth, marginals.covariances(rows)) / 6)
    low, high = consistent_band(20)
    # the noise is itself estimated from a few dozen pairs: widen the band by half
    assert (np.mean(values, 0) > low / 1.5).all()
    assert (np.mean(values, 0) < high * 1.5).all()


def test_claims_of_a_scripted_drive_are_as_large_as_its_errors():
    second, hectometre = rows(seeds=3, n_submaps=9)
    assert (second[:2], hectometre[:2]) == ((10, 33), (100, 3))
    for _, _, error, claimed, ratio, _ in (second, hectometre):
        assert 0 < error < 3 * claimed
        assert 0.6 < ratio < 1.6


def test_the_command_keeps_its_table(tmp_path):
    assert main(["consistency", "--seeds", "1", "--submaps", "4", "--out", str(tmp_path)]) == 0
    (table,) = kept(tmp_path)
    assert table.name == "consistency" and [row[0] for row in table.rows] == [10]
