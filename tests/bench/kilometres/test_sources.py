from __future__ import annotations

from pathlib import Path

import pytest

from bench.kilometres.sources import digest, imported


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """root imports pkg.near at the top, which imports pkg.deep.far inside a function."""
    files = {
        "root.py": "import json\nfrom pkg import near\n",
        "pkg/__init__.py": "",
        "pkg/near.py": "def f():\n    from pkg.deep.far import X\n    return X\n",
        "pkg/deep/__init__.py": "",
        "pkg/deep/far.py": "import root\nX = 1\n",
        "pkg/unrelated.py": "X = 1\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_everything_imported_is_found_and_nothing_else(tree: Path) -> None:
    names = ["pkg", "pkg.deep", "pkg.deep.far", "pkg.near", "root"]
    assert list(imported(["root"], tree)) == names


@pytest.mark.parametrize("changed", ["root", "pkg/near", "pkg/deep/far", "pkg/deep/__init__"])
def test_a_change_of_any_imported_module_is_another_digest(tree: Path, changed: str) -> None:
    before = digest(["root"], tree)
    with (tree / f"{changed}.py").open("a") as file:
        file.write("# changed\n")
    assert digest(["root"], tree) != before


def test_a_change_elsewhere_is_not(tree: Path) -> None:
    before = digest(["root"], tree)
    (tree / "pkg" / "unrelated.py").write_text("X = 2\n")
    (tree / "pkg" / "new.py").write_text("X = 2\n")
    assert digest(["root"], tree) == before


def test_an_outcome_depends_on_the_estimator_and_the_baselines_and_not_on_the_daemon() -> None:
    found = imported(["bench.kilometres.outcomes", "bench.kilometres.rivals"])
    assert {
        "bench.baselines.sl4",
        "bench.scripted.epipolar",
        "calm_edge.correction.rectify",
        "calm_edge.estimator.localizer",
        "calm_edge.geometry.se3",
        "calm_edge.posegraph.levenberg_marquardt",
    } <= found.keys()
    others = ("calm_edge.daemon", "calm_edge.commands", "calm_edge.mapping", "bench.tables")
    assert not [name for name in found if name.startswith(others)]
