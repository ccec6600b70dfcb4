"""Relation of two clocks by the turns of both cameras: errors against claimed sigmas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.clock_search import Coarse
from calm_edge.interchange.clocks import check_steady, relate
from calm_edge.interchange.turns import Turns
from device.frame import Eye
from tests.interchange.turning import drive


def test_errors_are_within_their_sigmas() -> None:
    """Over independent drives of a minute the normalised error has an rms near 1."""
    errors, normalised = [], []
    for seed in range(8):
        primary, assistant, true_s = drive(60, seed)
        fit = relate(primary, assistant, None).fit
        k = int(np.argmin(np.abs(assistant.t_s - fit.at_s)))
        errors.append(float(fit.primary_time(assistant.t_s)[k] - true_s[k]))
        normalised.append(errors[-1] / fit.sigma_s)
    assert np.sqrt(np.mean(np.square(errors))) < 0.004
    assert 0.3 < np.sqrt(np.mean(np.square(normalised))) < 1.6


def test_the_drift_of_a_long_drive() -> None:
    primary, assistant, true_s = drive(600, 3, ppm=300.0)
    relation = relate(primary, assistant, None)
    assert abs(relation.fit.drift - 300e-6) < 4 * relation.fit.drift_sigma < 100e-6
    assert abs(relation.fit.primary_time(assistant.t_s) - true_s).max() < 0.01
    assert any("clock drift +" in line and "sigma" in line for line in relation.lines())
    check_steady(relation, primary, assistant)


def test_a_zoomed_camera_is_refused() -> None:
    """From half of the time on the assistant sees 1.6 times as much of every turn."""
    primary, assistant, _ = drive(120, 4)
    half = len(assistant.step) // 2
    factor = np.where(np.arange(len(assistant.step)) < half, 1.0, 1.6)[:, None] ** [1, 1, 0]
    changed = Turns(assistant.t_s, assistant.step * factor, assistant.zoom, assistant.sigma)
    relation = relate(primary, changed, None)
    with pytest.raises(InterchangeError, match=r"turns 1\.[56]\d times.*zoomed"):
        check_steady(relation, primary, changed)


@pytest.mark.parametrize("eye", list(Eye))
def test_a_stabilised_camera_is_named(eye: Eye) -> None:
    """A stabiliser follows the slow part of every turn."""
    turns = list(drive(60, 4)[:2])
    t = turns[eye]
    calm = gaussian_filter1d(t.step, 15, axis=0)
    turns[eye] = Turns(t.t_s, calm, t.zoom, t.sigma)
    relation = relate(turns[0], turns[1], None)
    with pytest.raises(InterchangeError, match=rf"{eye.name.lower()}: shakes with .* stabilised"):
        check_steady(relation, turns[0], turns[1])


def test_sound_is_a_second_witness() -> None:
    """It is reported, and decides where the motion alone is not certain."""
    primary, assistant, _ = drive(60, 1)
    for apart_s, verdict in ((0.02, "agrees"), (0.5, "disagrees; the motion is used")):
        sound = Coarse(3.7 + apart_s, 0.0, 20.0, 60.0, 30.0, 10.0)
        relation = relate(primary, assistant, sound)
        assert relation.lines()[2].startswith(f"sound: {verdict} (")
        assert relation.sound_s == pytest.approx(apart_s, abs=0.01)
    # four seconds in common are few for the motion alone
    short = drive(8, 2)
    with pytest.raises(InterchangeError, match="--offset-s"):
        relate(*short[:2], None)
    found = relate(*short[:2], Coarse(3.72, 0.0, 4.0, 60.0, 30.0, 10.0))
    assert abs(found.fit.offset_s - 3.7) < 0.02


@pytest.mark.parametrize("seconds", [6.2, 7.0])
def test_short_videos_are_refused(seconds: float) -> None:
    with pytest.raises(InterchangeError, match="cannot be related"):
        relate(*drive(seconds, 1)[:2], None)


def test_different_drives_are_not_related() -> None:
    with pytest.raises(InterchangeError, match="cannot be related"):
        relate(drive(60, 1)[0], drive(60, 2)[1], None)
