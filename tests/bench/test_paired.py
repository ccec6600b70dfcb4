"""Known ratios are found, with intervals of the right coverage."""

import numpy as np
import pytest

from bench import paired
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.table import json_text

DRIVES = ("a", "b", "c", "d", "e", "f")


def errors(
    seed: int, ratio: float = 1.0, between: float = 0.2, within: float = 0.1, seeds: int = 5
) -> tuple[dict, dict]:
    """(variant, reference): drives of very different size, whose log ratios scatter."""
    rng = np.random.default_rng(seed)
    variant, reference = {}, {}
    for k, drive in enumerate(DRIVES):
        mean = np.log(ratio) + between * rng.standard_normal()
        for s in range(seeds):
            reference[drive, s] = 10.0 ** (k - 2) * float(np.exp(rng.standard_normal()))
            variant[drive, s] = reference[drive, s] * float(
                np.exp(mean + within * rng.standard_normal())
            )
    return variant, reference


def test_an_exact_ratio_has_no_width() -> None:
    variant, reference = errors(0, ratio=0.25, between=0, within=0)
    found = paired.compare(variant, reference)
    assert (found.ratio, found.low, found.high) == pytest.approx((0.25, 0.25, 0.25))
    assert (found.drives, found.pairs, found.verdict) == (6, 30, "better")
    assert found.within(0.2501) and not found.within(0.2499)
    assert paired.compare(reference, variant).verdict == "worse"
    assert paired.compare(reference, variant).ratio == pytest.approx(4)


def test_the_interval_holds_the_truth_about_as_often_as_it_says() -> None:
    inside = 0
    for seed in range(200):
        found = paired.compare(*errors(seed, ratio=0.8), samples=400)
        inside += found.low <= 0.8 <= found.high
    # six clusters make a percentile bootstrap narrow: about 85 %, where single runs give 50 %
    assert 150 <= inside <= 196


def test_more_seeds_of_a_drive_are_no_more_drives() -> None:
    few, many = (paired.compare(*errors(3, seeds=n)) for n in (5, 200))
    assert many.high / many.low > 0.6 * few.high / few.low
    assert many.high / many.low > 1.1


def test_every_drive_weighs_alike() -> None:
    variant = {("a", 0): 1.0, **{("b", s): 4.0 for s in range(9)}}
    reference = dict.fromkeys(variant, 1.0)
    assert paired.compare(variant, reference).ratio == pytest.approx(2.0)


def test_noise_alone_is_a_tie_and_few_runs_are_no_verdict() -> None:
    variant, reference = errors(1, between=0.3)
    assert paired.compare(variant, reference).verdict == "tie"
    few = {key: 0.1 * reference[key] for key in list(reference)[:4]}
    assert paired.compare(few, reference).verdict == "too few runs"


def test_failures_are_counted_and_leave_no_ratio() -> None:
    variant, reference = errors(2)
    variant["a", 0] = None
    reference["b", 0] = None
    reference["b", 1] = float("nan")
    variant["c", 0] = reference["c", 0] = None
    found = paired.compare(variant, reference)
    assert (found.failed, found.reference_failed, found.pairs) == (1, 2, 26)
    lost = paired.compare(variant, dict.fromkeys(variant))
    assert lost.ratio is None and lost.verdict == "too few runs" and not lost.within(1)
    assert lost.reference_failed == 28
    assert json_text(lost.to_dict())


def test_the_same_runs_give_the_same_interval_in_any_order() -> None:
    variant, reference = errors(4)
    again = paired.compare(dict(reversed(variant.items())), reference)
    assert again == paired.compare(variant, reference)


def test_only_shared_runs_count_and_none_is_an_error() -> None:
    variant, reference = errors(5)
    some = {key: value for key, value in variant.items() if key[0] != "a"}
    assert paired.compare(some, reference).drives == 5
    with pytest.raises(EvaluationError, match="same drive and seed"):
        paired.compare({("x", 0): 1.0}, reference)


@pytest.mark.parametrize("value", [0.0, -1.0, float("inf")])
def test_an_error_that_has_no_ratio_is_said(value: float) -> None:
    variant, reference = errors(6)
    variant["c", 2] = value
    with pytest.raises(EvaluationError, match="c, seed 2"):
        paired.compare(variant, reference)


def test_a_row_fits_its_columns() -> None:
    row = paired.compare(*errors(7)).row("ours / Sim(3)")
    assert len(row) == len(paired.COLUMNS)
    assert row[0] == "ours / Sim(3)" and row[-1] in ("better", "worse", "tie")


def test_a_geometric_mean_weighs_drives_equally_and_counts_failures() -> None:
    several = {("a", 0): 1.0, ("a", 1): 1.0, ("b", 0): 0.01, ("c", 0): None}
    found = paired.geometric_mean(several)
    assert found.ratio == pytest.approx(0.1)
    assert (found.drives, found.pairs, found.failed) == (2, 3, 1)
