import numpy as np
import pytest

from calm_edge.cli import main
from calm_edge.commands.calibration import FORMATS
from calm_edge.interchange.calibration import formats
from calm_edge.interchange.calibration.formats import read
from tests.offline.test_learned import kit, recorded


def test_the_formats_offered_are_those_that_exist():
    assert set(FORMATS) == set(formats.FORMATS)


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_written_is_printed_and_can_be_read(tmp_path, capsys, name):
    recorded(tmp_path / "rec", kit(), 0.52)
    out = tmp_path / "out"
    assert main(["calibration", str(tmp_path / "rec"), "--format", name, "--out", str(out)]) == 0
    printed = capsys.readouterr()
    files = tuple(sorted(out.iterdir(), reverse=name == "ros"))
    assert printed.err == "" and all(f"written     {path}" in printed.out for path in files)
    assert "sigma 0.40 %" in files[0].read_text()
    found = read(files[:1] if name == "colmap" else files)
    assert len(found.cameras) == 2 and np.linalg.norm(found.T_p_a[:3, 3]) == pytest.approx(0.52)


def test_nothing_is_written_of_an_unobserved_focal(tmp_path, capsys):
    recorded(tmp_path / "rec", kit(0.2))
    arguments = ["calibration", str(tmp_path / "rec"), "--format", "ros"]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "is not observed" in line and not (tmp_path / "out").exists()
