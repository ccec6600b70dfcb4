"""Results as tables and as JSON."""

import json

import pytest

from calm_edge.evaluation.estimate import Estimate
from calm_edge.evaluation.results import compare
from calm_edge.evaluation.table import (
    aligned,
    json_text,
    label,
    measured,
    pretty,
    print_result,
    unit,
)
from calm_edge.evaluation.truth import Truth
from tests.evaluation.worlds import curve, stamps


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (True, "yes"),
        (0.123456, "0.1235"),
        (123456.7, "123,457"),
        ([1.0, None], "1, –"),
        ({"p50": 3.14159}, "p50 3.142"),
        ({"sigma": 0.5, "reason": ""}, "sigma 0.5"),
        ({}, "–"),
        ("word", "word"),
    ],
)
def test_pretty(value: object, text: str) -> None:
    assert pretty(value) == text


def test_json_is_one_valid_line() -> None:
    text = json_text({"a": None, "b": [1.5, None]})
    assert "\n" not in text and json.loads(text) == {"a": None, "b": [1.5, None]}
    with pytest.raises(ValueError, match=r"JSON compliant"):
        json_text({"a": float("nan")})


def test_columns_are_aligned_under_their_names() -> None:
    assert aligned([("one", 1.5), ("three", None)], ("name", "value")) == [
        "name   value",
        "-----  -----",
        "one    1.5",
        "three  –",
    ]
    assert aligned([], ("name",)) == ["name", "----"] and aligned([("a", {})]) == ["a  –"]


def test_long_values_wrap_below_themselves(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    print_result({"stage_ms": {f"stage{k}": k / 7 for k in range(9)}, "frames": 3})
    first, *others, last = capsys.readouterr().out.splitlines()
    assert first.startswith("stage_ms  stage0 0, stage1") and last == "frames    3 frames"
    assert others and all(len(line) <= 60 and line.startswith(10 * " ") for line in others)


def test_every_figure_has_its_unit() -> None:
    truth, T = Truth(stamps(40), curve(40)), curve(40)
    for name in compare(Estimate("here", stamps(40), T), truth):
        assert unit(name) or name in {"align", "truth_moves", "metre", "live"}
    assert measured("rpe_rot_deg_per_m", 0.25) == "0.25 deg/m" and measured("align", "se3") == "se3"
    assert label("rpe_rot_deg_per_m") == "rpe rot" and measured("path_m", None) == "–"
    assert measured("focal_px", [1.0, None]) == "1, – px"


def test_the_table_goes_to_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    print_result({"ate_se3_m": 0.51234}, "drive")
    out = capsys.readouterr().out
    for word in ("ate_se3_m", "0.5123 m"):
        assert word in out
