"""A real kit in the town: its pictures against the truth that is written beside them."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from calm_edge.evaluation.truth import read_truth
from calm_edge.geometry import se3
from calm_edge.geometry.fisheye import Fisheye
from tests.synthetic.drive import exposed, main, write_sequence
from tests.synthetic.settings import PLAIN, REAL
from tests.synthetic.shots import Shots
from tests.synthetic.world import World, make_world

Float = NDArray[np.float64]
SMALL = replace(REAL, width=272, height=104, density=14.0)
# the car ahead and an oncoming one are near
MEETING_S = 4.6


@pytest.fixture(scope="module")
def world() -> World:
    return make_world(0, density=14.0)


@pytest.fixture(scope="module")
def shots(world: World) -> Shots:
    return Shots(world, SMALL)


def row_poses(shots: Shots, eye: int, t: float) -> Float:
    return shots.poses(eye, shots.row_times(eye, t))


def test_the_kit_is_as_declared(shots: Shots) -> None:
    webcam, wide = shots.cameras
    assert not webcam.is_pinhole and isinstance(wide, Fisheye)
    middle = np.array([[-0.5, wide.cy], [wide.width - 0.5, wide.cy]])
    a, b = wide.rays(middle)
    assert np.degrees(np.arccos(a @ b)) == pytest.approx(110, abs=0.5)
    times = [shots.row_times(eye, 1.0) for eye in (0, 1)]
    assert [float(np.ptp(t)) for t in times] == pytest.approx([0.020, 0.025])
    assert np.mean(times[0]) == pytest.approx(1.0)


def test_depth_and_poses_of_rows_predict_the_other_eye(shots: Shots) -> None:
    t = MEETING_S, MEETING_S + SMALL.assistant_delay_s
    a, b = (shots.view(eye, t[eye]) for eye in (0, 1))
    row, column = np.nonzero((a.part == 0) & (a.depth < 30))
    p_a = shots.cameras[0].back_project(
        np.stack([column, row], -1).astype(float), a.depth[row, column].astype(float)
    )
    T_a, T_b = (row_poses(shots, eye, t[eye]) for eye in (0, 1))
    p_w = (T_a[row, :3, :3] @ p_a[..., None])[..., 0] + T_a[row, :3, 3]
    at = np.full(len(p_w), SMALL.height // 2)
    for _ in range(4):
        T_c_w = se3.inverse(T_b[at])
        p_b = (T_c_w[:, :3, :3] @ p_w[..., None])[..., 0] + T_c_w[:, :3, 3]
        uv = shots.cameras[1].project(p_b)
        at = np.clip(np.round(uv[:, 1]), 0, SMALL.height - 1).astype(int)
    inside = (p_b[:, 2] > 0.5) & ((uv > 2) & (uv < [SMALL.width - 3, SMALL.height - 3])).all(1)
    x, y = np.round(uv[inside]).astype(int).T
    clear = b.part[y, x] == 0
    agree = np.abs(b.depth[y, x] / p_b[inside, 2] - 1)[clear] < 0.03
    # the rest are occlusions and leaves
    assert clear.sum() > 5000 and agree.mean() > 0.85


def test_other_cars_are_seen_where_they_are(shots: Shots) -> None:
    view = shots.view(0, MEETING_S)
    T_w_rows, times = row_poses(shots, 0, MEETING_S), shots.row_times(0, MEETING_S)
    found = []
    for k, car in enumerate(shots.cars, 1):
        row, column = np.nonzero(view.part == k)
        if not len(row):
            continue
        found.append(k)
        p_c = shots.cameras[0].back_project(
            np.stack([column, row], -1).astype(float), view.depth[row, column].astype(float)
        )
        T = se3.inverse(car.drive.on_ground(times[row])) @ T_w_rows[row]
        p = (T[:, :3, :3] @ p_c[..., None])[..., 0] + T[:, :3, 3]
        assert (np.abs(p[:, 0]) < 1.0).all() and (p[:, 1] < 0.05).all() and (p[:, 1] > -2).all()
        assert (p[:, 2] > -1.2).all() and (p[:, 2] < 3.8).all()
    assert len(found) == 2
    # they drive at their own speeds, and one comes towards us
    t = np.array([MEETING_S, MEETING_S + 0.1])
    ours, *theirs = (d.poses(t)[:, :3, 3] for d in (shots.drive, *(c.drive for c in shots.cars)))
    move = np.diff(ours, axis=0)[0]
    along = [float(np.diff(p, axis=0)[0] @ move / (move @ move)) for p in theirs]
    assert min(along) < -0.5 and max(along) > 1.05


def test_the_bonnet_stands_still_and_mirrors_the_road(shots: Shots) -> None:
    views = [shots.view(0, t).image.astype(float) for t in (4.0, MEETING_S, 5.0)]
    bonnet = shots.bonnets[0]
    assert bonnet is not None
    hidden = bonnet.cover == 1
    assert hidden[:, SMALL.width // 2].mean() == pytest.approx(SMALL.bonnet[0], abs=0.02)
    change = np.std(views, axis=0).mean(-1)
    assert 0.3 < change[hidden].mean() < 0.4 * change[bonnet.cover == 0].mean()
    assert (shots.view(0, MEETING_S).part[hidden] == -1).all()


def test_exposure_drifts_apart_between_the_eyes() -> None:
    grey = np.full((40, 60, 3), 110, np.uint8)
    rng = np.random.default_rng(0)
    levels = np.array(
        [[exposed(grey, t, rng, REAL, eye).mean() for t in range(0, 40, 2)] for eye in (0, 1)]
    )
    assert (np.ptp(levels, axis=1) > 15).all()
    assert np.ptp(levels[1] - levels[0]) > 10
    assert exposed(grey, 3.0, rng, PLAIN).mean() == pytest.approx(
        exposed(grey, 3.0, rng, PLAIN, 1).mean(), abs=0.3
    )


def test_the_plain_kit_can_still_be_rendered(tmp_path: Path) -> None:
    size = ["--width", "136", "--height", "52", "--density", "4", "--frames", "2"]
    main(["--kit", "plain", "--out", str(tmp_path), *size])
    truth = read_truth(tmp_path)
    assert truth.cameras is not None and all(c.is_pinhole for c in truth.cameras)
    made = json.loads((tmp_path / "rig.json").read_text())["settings"]
    drawn = {"width": 136, "height": 52, "density": 4.0, "frames": 2}
    assert made == json.loads(json.dumps(asdict(PLAIN) | drawn))
    # what the first demo drive was rendered with
    assert made["hfov_deg"] == [78.0, 70.0] and made["readout_s"] == [0.0, 0.0]
    assert not made["oncoming"] and not made["ahead"] and made["bonnet"] == [0.0, 0.0]


def test_the_truth_of_a_written_drive(world: World, shots: Shots, tmp_path: Path) -> None:
    settings = replace(SMALL, frames=2, start_s=MEETING_S, cloud_every=1)
    rig = write_sequence(tmp_path, world, settings)
    truth = read_truth(tmp_path)
    assert truth.cameras is not None and truth.cloud is not None
    for read, true in zip(truth.cameras, rig.cameras, strict=True):
        assert type(read) is type(true)
        middle = np.array([[0.0, 0.0], [100.0, 50.0]])
        np.testing.assert_allclose(read.rays(middle), true.rays(middle), atol=1e-7)
    np.testing.assert_allclose(rig.T_w_c[0][0], np.eye(4), atol=1e-12)
    # the same drive with no other car: nothing of the cars is in the cloud
    alone = tmp_path / "alone"
    write_sequence(alone, world, replace(settings, oncoming=(), ahead=()))
    still = np.load(alone / "cloud.npy")
    apart = cKDTree(still).query(truth.cloud)[0]
    assert len(truth.cloud) > 500 and apart.max() < 1.0 and np.percentile(apart, 99) < 0.3
    # and they would be there: a car hides what is behind it
    assert (shots.view(0, MEETING_S).part > 0).mean() > 0.01
