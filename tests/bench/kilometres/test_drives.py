import dataclasses

import numpy as np
import pytest

from bench.kilometres import drives
from bench.kilometres.streams import Streams
from calm_edge.config import Config
from calm_edge.geometry import se3
from device.frame import Eye
from tests.bench.scripted.street_drive import street
from tests.drives import START_NS


@pytest.fixture(scope="module")
def drive():
    return drives.cut("street", street(120, turn=0.005), Config(), Streams(), 0)


def test_windows_are_the_front_ends(drive):
    sizes = [(len(w.primary), len(w.assistant), w.n_overlap) for w in drive.windows]
    assert sizes[:3] == [(6, 6, 0), (15, 15, 6), (15, 15, 3)]
    covered = {keyframe.id for w in drive.windows for keyframe in w.primary}
    assert covered == set(range(len(drive.keyframes)))
    for w in drive.windows:
        assert [p.frame.t_ns for p in w.primary] == [a.frame.t_ns for a in w.assistant]
        assert {p.frame.eye for p in w.primary} == {Eye.PRIMARY}


def test_keyframes_come_by_motion_or_by_the_clock(drive):
    steps = np.linalg.norm(np.diff(drive.T_w_p[:, :3, 3], axis=0), axis=1)
    assert len(drive.keyframes) < 120
    assert np.all(steps > 0.2 * drives.STEP_M) and np.median(steps) < 2.5
    gaps = np.diff([k.frame.t_ns for k in drive.keyframes])
    assert gaps.max() <= 0.4e9
    assert drive.path_m == pytest.approx(steps.sum())


def test_a_car_that_waits_makes_no_keyframes():
    scene = street(60)
    T = np.concatenate(
        [scene.T_w_p[:30], np.repeat(scene.T_w_p[29:30], 50, axis=0), scene.T_w_p[30:]]
    )
    t_ns = START_NS + 100_000_000 * np.arange(len(T))
    waiting = drives.cut(
        "waits", dataclasses.replace(scene, T_w_p=T, t_ns=t_ns), Config(), Streams(), 0
    )
    going = drives.cut("goes", scene, Config(), Streams(), 0)
    assert abs(len(waiting.keyframes) - len(going.keyframes)) <= 1


def test_pictures_have_the_cameras_sizes(drive):
    assert drive.windows[0].primary[0].frame.bgr().shape == (200, 640, 3)
    assert drive.windows[0].assistant[0].frame.bgr().shape == (240, 640, 3)


def test_a_rig_has_the_given_length_and_differs_by_seed():
    T = [drives.rig(np.random.default_rng(seed), 0.54) for seed in (0, 1)]
    for T_p_a in T:
        assert np.linalg.norm(T_p_a[:3, 3]) == pytest.approx(0.54)
        assert T_p_a[0, 3] > 0.5
    assert not np.allclose(T[0], T[1])


@pytest.mark.skipif(not drives.TRAJECTORIES.is_dir(), reason="no trajectories here")
def test_kitti_is_read_in_metres():
    drive = drives.kitti("04", Config(), seed=1)
    assert drive.path_m == pytest.approx(394, abs=2)
    assert np.allclose(np.linalg.det(drive.scene.T_w_p[:, :3, :3]), 1)
    assert len(drive.windows) == 24


def test_a_drive_that_is_not_here_is_said(monkeypatch, tmp_path):
    monkeypatch.setattr(drives, "TRAJECTORIES", tmp_path)
    with pytest.raises(drives.DriveError, match=r"kitti_odom_00\.txt: missing"):
        drives.kitti("00", Config())
    with pytest.raises(drives.DriveError, match=r"drive_sim\.py"):
        drives.rendered(tmp_path, Config())


def test_a_rendered_drives_folder_is_a_drive(tmp_path):
    scene = street(40)
    upright = se3.exp(np.array([40.0, -3.0, 2.0, np.pi / 2, 0.0, 0.0]))
    T_w_p = upright @ scene.T_w_p
    for eye, T in enumerate((T_w_p, T_w_p @ scene.T_p_a)):
        np.savetxt(tmp_path / f"poses{eye}.txt", T[:, :3].reshape(-1, 12))
        np.savetxt(tmp_path / f"times{eye}.txt", np.arange(40) * 0.1)
    (tmp_path / "calib.txt").write_text("300 300 319.5 99.5 640 200\n310 310 319.5 119.5 640 240\n")
    drive = drives.rendered(tmp_path, Config())
    assert np.allclose(drive.scene.T_p_a, scene.T_p_a, atol=1e-6)
    assert np.allclose(drive.scene.T_w_p, se3.inverse(scene.T_w_p[0]) @ scene.T_w_p, atol=1e-6)
    assert drive.scene.cameras[1].fx == 310 and drive.scene.size.tolist() == [
        [640, 200],
        [640, 240],
    ]
