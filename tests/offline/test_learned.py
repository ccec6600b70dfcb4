import dataclasses

import numpy as np
import pytest

from calm_edge.config import merge
from calm_edge.geometry.camera import Perspective
from calm_edge.interchange.calibration.calibration import CalibrationError
from calm_edge.kit import layout
from calm_edge.offline.learned import learned
from calm_edge.recording.reader import Recording
from calm_edge.recording.writer import RecordingWriter
from calm_edge.types import KitBelief
from tests.recording import samples

SIZES = ((640, 480), (800, 600))


def kit(focal_sigma=0.004, rotation_sigma=0.002):
    mean, sigma = layout.prior((70.0, 65.0)).mean, np.full(layout.SIZE, 0.003)
    mean[layout.DISTORTION[:, 0]] = -0.01
    mean[layout.RIG] = [0.02, 0.05, -0.01, 0.99, 0.01, 0.1]
    sigma[layout.LOG_FOCAL], sigma[layout.RIG_ROTATION] = focal_sigma, rotation_sigma
    return KitBelief(mean, np.diag(sigma**-2.0))


def recorded(folder, belief, spacing_m=0.0, focal_log_sigma=(0.02, 0.03)):
    update = samples.update()
    cameras = tuple(Perspective.from_hfov(70, *SIZES[view >= 3]) for view in range(5))
    submap = dataclasses.replace(
        update.submap, cameras=cameras, focal_log_sigma=np.array(focal_log_sigma)
    )
    config = merge(samples.config(), {"scale": {"spacing_m": spacing_m}})
    with RecordingWriter(folder, config, {}) as writer:
        # an earlier window knew less
        writer.write_update(dataclasses.replace(update, submap=submap, kit=kit(0.3)))
        writer.write_update(dataclasses.replace(update, submap=submap, kit=belief))
    return Recording(folder)


@pytest.mark.parametrize("spacing_m", [0.0, 0.52])
def test_the_last_belief_is_the_calibration(tmp_path, spacing_m):
    belief = kit()
    calibration, notes = learned(recorded(tmp_path / "rec", belief, spacing_m))
    for eye, each in enumerate(calibration.cameras):
        assert (each.camera.width, each.camera.height) == SIZES[eye]
        expected = np.exp(belief.mean[layout.LOG_FOCAL[eye]]) * SIZES[eye][0]
        assert each.camera.fx == pytest.approx(expected, rel=1e-3)
        assert each.camera.distortion[0] == pytest.approx(-0.01, abs=1e-3)
    assert calibration.spacing_m == (pytest.approx(spacing_m) if spacing_m else None)
    assert np.linalg.norm(calibration.T_p_a[:3, 3]) == pytest.approx(spacing_m or 1.0)
    assert sum("sigma 0.40 %" in note for note in notes) == 2
    assert any("spacings" in note for note in notes) == (not spacing_m)


def test_an_unobserved_focal_is_refused(tmp_path):
    with pytest.raises(CalibrationError, match=r"primary is not observed.*record a drive"):
        learned(recorded(tmp_path / "rec", kit(0.2)))


def test_an_unobserved_rig_is_left_out_and_said(tmp_path):
    calibration, notes = learned(recorded(tmp_path / "rec", kit(rotation_sigma=0.3)))
    assert calibration.T_p_a is None and "rig         not observed" in notes[-1]


def test_a_backbone_without_a_kit_gives_its_focal_lengths(tmp_path):
    recording = recorded(tmp_path / "rec", None)
    calibration, notes = learned(recording)
    assert calibration.T_p_a is None and len(calibration.cameras) == 2
    assert "sigma 2.00 %" in notes[1] and "sigma 3.00 %" in notes[2]
    with pytest.raises(CalibrationError, match="assistant is not observed"):
        learned(recorded(tmp_path / "other", None, focal_log_sigma=(0.02, np.inf)))


def test_a_recording_without_windows_is_refused(tmp_path):
    with RecordingWriter(tmp_path / "rec", samples.config(), {}) as writer:
        writer.write_frame(samples.frame(samples.Eye.PRIMARY, 0))
    with pytest.raises(CalibrationError, match="no window was solved"):
        learned(Recording(tmp_path / "rec"))
