import logging

import numpy as np
import pytest

from calm_edge.config import Config, merge
from calm_edge.kit import layout
from calm_edge.kit.file import KitFileError
from calm_edge.kit.prior import TRUSTED_AFTER, KitPrior
from calm_edge.types import KitBelief

SIZES = np.array([[640, 360], [640, 360]])


def config(path):
    return merge(Config(), {"backbone": {"kit_file": str(path)}})


def evidence(turned_rad=0.0):
    """The evidence of a good drive: focals to 0.5 %, the rig to half a milliradian."""
    mean = layout.prior((70.0, 70.0)).mean
    mean[layout.RIG] = [0.02, 0.05 + turned_rad, 0.0, 1.0, 0.0, 0.0]
    sigma = np.full(layout.SIZE, 0.005)
    sigma[layout.RIG] = 0.0005
    return KitBelief(mean, np.diag(sigma**-2.0))


def test_the_belief_of_one_drive_is_used_in_the_next(tmp_path):
    first = KitPrior(config(tmp_path / "kit.json"))
    first.open(SIZES)
    assert first.belief is None
    first.save(evidence())
    second = KitPrior(config(tmp_path / "kit.json"))
    second.open(SIZES)
    for _ in range(TRUSTED_AFTER):
        # not used before it has been compared with this drive's evidence
        assert second.belief is None
        assert second.contradicted(evidence()) == ()
    assert np.allclose(second.belief.mean, evidence().mean)


def test_a_turned_mount_is_reported_and_the_belief_dropped(tmp_path):
    first = KitPrior(config(tmp_path / "kit.json"))
    first.open(SIZES)
    first.save(evidence())
    second = KitPrior(config(tmp_path / "kit.json"))
    second.open(SIZES)
    notices = second.contradicted(evidence(np.radians(4.0)))
    assert any("the assistant has moved, turned by 4.0 deg" in line for line in notices)
    assert second.belief is None and second.contradicted(evidence()) == ()


def test_a_drive_that_observed_nothing_leaves_the_file_alone(tmp_path):
    for known, kept in (
        (evidence(), True),
        (KitBelief(evidence().mean, np.eye(layout.SIZE)), False),
    ):
        path = tmp_path / f"{kept}.json"
        prior = KitPrior(config(path))
        prior.open(SIZES)
        prior.save(known)
        assert path.exists() == kept


def test_without_a_file_nothing_is_stored(tmp_path):
    prior = KitPrior(Config())
    prior.open(SIZES)
    prior.save(evidence())
    assert prior.belief is None and not list(tmp_path.iterdir())


FOREIGN = ("[]", "not JSON", '{"format": "calm-edge kit", "version": 1, "mean": [1]}')


@pytest.mark.parametrize("text", FOREIGN)
def test_an_invalid_file_raises_at_the_start(tmp_path, text):
    (tmp_path / "kit.json").write_text(text)
    with pytest.raises(KitFileError, match=r"kit\.json"):
        KitPrior(config(tmp_path / "kit.json"))


@pytest.mark.parametrize("text", FOREIGN)
def test_an_invalid_file_is_not_overwritten(tmp_path, caplog, text):
    prior = KitPrior(config(tmp_path / "kit.json"))
    prior.open(SIZES)
    (tmp_path / "kit.json").write_text(text)
    with caplog.at_level(logging.ERROR):
        prior.save(evidence())
    assert "kit.json" in caplog.text
    assert (tmp_path / "kit.json").read_text() == text


def test_a_file_that_cannot_be_written_is_logged(tmp_path, caplog):
    prior = KitPrior(config(tmp_path / "folder" / "kit.json"))
    prior.open(SIZES)
    (tmp_path / "folder").write_text("")
    with caplog.at_level(logging.ERROR):
        prior.save(evidence())
    assert "Not a directory" in caplog.text


def test_a_calibration_is_used_beside_the_kit_file_and_kept_out_of_it(tmp_path):
    camera = {"model": "perspective", "fx": 457.0, "fy": 457.0, "cx": 319.5, "cy": 179.5}
    camera |= {"width": 640, "height": 360}
    given = merge(config(tmp_path / "kit.json"), {"calibration": {"cameras": [camera, camera]}})
    prior = KitPrior(given)
    prior.open(SIZES)
    calibrated = prior.belief
    assert np.diag(calibrated.information)[layout.LOG_FOCAL].min() > 1e4
    prior.save(evidence())
    alone = KitPrior(config(tmp_path / "kit.json"))
    alone.open(SIZES)
    for _ in range(TRUSTED_AFTER):
        alone.contradicted(evidence())
    # what is stored is what this drive has shown
    assert np.allclose(alone.belief.mean, evidence().mean)
    again = KitPrior(given)
    again.open(SIZES)
    for _ in range(TRUSTED_AFTER):
        again.contradicted(evidence())
    more = np.diag(again.belief.information)[layout.LOG_FOCAL]
    assert (more > np.diag(calibrated.information)[layout.LOG_FOCAL]).all()


def test_a_change_during_the_drive_leaves_the_calibrated_optics():
    camera = {"model": "perspective", "fx": 457.0, "fy": 457.0, "cx": 319.5, "cy": 179.5}
    camera |= {"width": 640, "height": 360}
    prior = KitPrior(merge(Config(), {"calibration": {"cameras": [camera]}}))
    prior.open(SIZES)
    held = prior.forget(lens=False)
    assert held is not None and held.information[0, 0] > 0
    assert prior.forget(lens=True) is None
