"""Spoilt copies that are made here, and the true length of a path."""

import cv2
import numpy as np
import pytest

from bench.spoilt import cases
from bench.spoilt.cases import Base, Case
from calm_edge.recording.sequence_folder import SequenceFolder
from calm_edge.trajectories import write_kitti
from device.frame import Eye
from tests.evaluation.worlds import curve

N = 12


@pytest.fixture
def base(tmp_path):
    folder = tmp_path / "base"
    rng = np.random.default_rng(0)
    for eye in (0, 1):
        (folder / f"cam{eye}").mkdir(parents=True)
        for k in range(N):
            picture = rng.integers(100, 200, (40, 60, 3), np.uint8)
            cv2.imwrite(str(folder / f"cam{eye}" / f"{k:06d}.jpg"), picture)
        (folder / f"times{eye}.txt").write_text("".join(f"{0.1 * k:.6f}\n" for k in range(N)))
    write_kitti(folder / "poses0.txt", curve(N))
    return Base("base", folder, 0.5)


def test_one_camera_is_split_with_its_true_stamps(base, tmp_path):
    cases.one_camera(base, tmp_path / "out")
    sequence = SequenceFolder(tmp_path / "out")
    steps = [np.diff(sequence.t_ns(eye)) for eye in Eye]
    assert all((step == 200_000_000).all() for step in steps)
    late = sequence.t_ns(Eye.ASSISTANT) - sequence.t_ns(Eye.PRIMARY)
    assert (late == 100_000_000).all()
    second = (tmp_path / "out" / "cam1" / "000000.jpg").read_bytes()
    assert second == (base.folder / "cam0" / "000001.jpg").read_bytes()


def test_a_parked_bonnet_is_dark_below(base, tmp_path, monkeypatch):
    def tool(source, out, case):
        assert case == "parked"
        source.rename(out)
        source.mkdir()

    monkeypatch.setattr(cases, "spoil", tool)
    cases.parked_bonnet(base, tmp_path / "out")
    picture = cv2.imread(str(tmp_path / "out" / "cam0" / "000000.jpg"))
    assert picture[33:].mean() < 20 < 100 < picture[:28].mean()
    # the base is as it was
    assert cv2.imread(str(base.folder / "cam0" / "000000.jpg"))[33:].mean() > 100


def test_a_parked_night_is_the_dark_copy_of_a_parked_car(base, tmp_path, monkeypatch):
    made = []

    def tool(source, out, case):
        made.append((source, case))
        out.mkdir()

    monkeypatch.setattr(cases, "spoil", tool)
    cases.parked_night(base, tmp_path / "out")
    assert made == [(base.folder, "parked"), (tmp_path / "out.parked", "dark")]
    assert (tmp_path / "out").is_dir() and not (tmp_path / "out.parked").exists()


def test_the_true_path_is_that_between_the_keyframes(base):
    moves, stands = Case("a", cases.one_camera), Case("b", cases.one_camera, moves=False)
    t_ns = SequenceFolder(base.folder).t_ns(Eye.PRIMARY)
    steps = np.linalg.norm(np.diff(curve(N)[:, :3, 3], axis=0), axis=1)
    found = cases.true_path_m(base, moves, t_ns[2:9])
    assert found == pytest.approx(steps[2:8].sum(), rel=1e-6)
    assert cases.true_path_m(base, stands, t_ns) == 0
    assert cases.true_path_m(base, moves, t_ns[:0]) == 0
