import json
import os
import re
import stat

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calm_edge.kit import file, layout
from calm_edge.kit.change import faded
from calm_edge.types import KitBelief

CAMERAS = ("v4l2:usb-0000:00:14.0-1", "v4l2:usb-0000:00:14.0-2")
SIZES = np.array([[1280, 720], [640, 480]])


def belief(seed=0, rank=layout.SIZE):
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(rank, layout.SIZE)) * 10 ** rng.uniform(0, 4, layout.SIZE)
    return KitBelief(mean=rng.normal(size=layout.SIZE), information=J.T @ J)


def saved(folder, **changed):
    """A kit file with some keys replaced; None removes the key."""
    path = folder / "kit.json"
    file.save(path, CAMERAS, SIZES, belief())
    content = json.loads(path.read_text()) | changed
    path.write_text(json.dumps({k: v for k, v in content.items() if v is not None}))
    return path


def load(path, cameras, sizes):
    return file.remembered(path, file.read(path), cameras, sizes)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, layout.SIZE))
def test_a_saved_belief_is_read_back_faded(tmp_path_factory, seed, rank):
    path = tmp_path_factory.mktemp("kit") / "kit.json"
    kept = belief(seed, rank)
    file.save(path, CAMERAS, SIZES, kept)
    back, reason = load(path, CAMERAS, SIZES)
    assert reason == ""
    assert np.array_equal(back.mean, kept.mean)
    assert np.array_equal(back.information, faded(kept).information)


def test_the_masks_of_a_kit_are_kept(tmp_path):
    ego = np.random.default_rng(0).uniform(-9, 9, (2, 18, 32)).round(2)
    file.save(tmp_path / "kit.json", CAMERAS, SIZES, belief(), (None, ego))
    kept = file.read(tmp_path / "kit.json")
    assert kept.ego[0] is None and np.array_equal(kept.ego[1], ego)


@pytest.mark.parametrize("wrong", [7, [None], [None, 3], [None, [[1.0]]], [[[["x"]]], None]])
def test_damaged_masks_are_refused(tmp_path, wrong):
    path = saved(tmp_path, ego_log_odds=wrong)
    with pytest.raises(file.KitFileError, match="ego_log_odds"):
        file.read(path)


def test_a_kit_file_without_masks_is_read(tmp_path):
    assert file.read(saved(tmp_path, ego_log_odds=None)).ego == (None, None)


def test_the_same_belief_gives_the_same_bytes(tmp_path):
    for name in ("a.json", "b.json"):
        file.save(tmp_path / name, CAMERAS, SIZES, belief())
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_without_a_file_nothing_is_remembered(tmp_path):
    assert load(tmp_path / "kit.json", CAMERAS, SIZES) == (
        None,
        f"{tmp_path}/kit.json: no earlier drive of this kit",
    )


@pytest.mark.parametrize(
    ("cameras", "sizes", "message"),
    [
        (CAMERAS[::-1], SIZES, "other cameras"),
        (("v4l2:usb-9", CAMERAS[1]), SIZES, "other cameras .*usb-9"),
        (CAMERAS, SIZES[::-1], "images of .*not .*640, 480"),
    ],
)
def test_the_belief_of_another_kit_is_not_used(tmp_path, cameras, sizes, message):
    back, reason = load(saved(tmp_path), cameras, sizes)
    assert back is None
    assert re.search(message, reason)


def test_another_version_is_reported_and_not_used(tmp_path):
    back, reason = load(saved(tmp_path, version=2), CAMERAS, SIZES)
    assert back is None and "version 2" in reason
    shorter = saved(tmp_path, mean=[0.0] * 12, information=np.eye(12).tolist())
    back, reason = load(shorter, CAMERAS, SIZES)
    assert back is None and "holds 12 entries" in reason


def test_a_kit_of_one_radial_term_has_nothing_on_the_second(tmp_path):
    J = np.random.default_rng(0).normal(size=(15, 15))
    mean, information = np.arange(15.0), J.T @ J
    older = saved(tmp_path, mean=mean.tolist(), information=information.tolist())
    back = file.read(older).belief
    names = np.r_[layout.OPTICS[0, :4], layout.OPTICS[1, :4], np.r_[layout.RIG], layout.TIME_OFFSET]
    assert np.array_equal(back.mean[names], mean)
    assert np.array_equal(back.information[np.ix_(names, names)], information)
    assert not back.information[layout.DISTORTION[:, 1]].any()
    assert layout.families(back.mean) == layout.PERSPECTIVE


NOT_POSITIVE = np.diag([-1.0] + [1.0] * (layout.SIZE - 1)).tolist()
INDEFINITE = (np.eye(layout.SIZE) + 2 * np.eye(layout.SIZE)[::-1]).tolist()
LOPSIDED = (np.eye(layout.SIZE) + np.eye(layout.SIZE, k=1)).tolist()


@pytest.mark.parametrize(
    "changed",
    [
        {"mean": None},
        {"mean": "text"},
        {"mean": [[0.0]]},
        {"mean": [float("nan")] * layout.SIZE},
        {"mean": [10**400] * layout.SIZE},
        {"mean": [0.0] * (layout.SIZE - 1)},
        {"information": None},
        {"information": [[0.0], [0.0, 1.0]]},
        {"information": {"0": 1}},
        {"information": NOT_POSITIVE},
        {"information": INDEFINITE},
        {"information": LOPSIDED},
    ],
)
def test_a_damaged_file_raises_one_line_with_the_remedy(tmp_path, changed):
    path = saved(tmp_path, **changed)
    with pytest.raises(file.KitFileError) as caught:
        load(path, CAMERAS, SIZES)
    text = str(caught.value)
    assert text.startswith(f"{path}: damaged (") and "delete it" in text and "\n" not in text


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_truncated_file_is_damaged(tmp_path, share):
    path = saved(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(file.KitFileError, match=r"damaged \(not JSON\)"):
        load(path, CAMERAS, SIZES)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(file.KitFileError, match=r"damaged \(not text\)"):
        load(path, CAMERAS, SIZES)
    path.write_text("[" * 100_000)
    with pytest.raises(file.KitFileError, match=r"damaged \(not JSON\)"):
        load(path, CAMERAS, SIZES)


@pytest.mark.parametrize("text", ["[]", "3", '{"format": "other", "mean": [1]}', "{}"])
def test_a_file_of_another_kind_is_not_overwritten(tmp_path, text):
    path = tmp_path / "settings.json"
    path.write_text(text)
    with pytest.raises(file.KitFileError, match=r"not a kit file; set backbone\.kit_file"):
        load(path, CAMERAS, SIZES)


def test_a_folder_in_place_of_the_file_raises(tmp_path):
    with pytest.raises(file.KitFileError, match=f"{tmp_path}: cannot be read"):
        load(tmp_path, CAMERAS, SIZES)
    with pytest.raises(file.KitFileError, match=f"{tmp_path}: cannot be written"):
        file.save(tmp_path, CAMERAS, SIZES, belief())
    below = tmp_path / "file"
    below.write_text("")
    with pytest.raises(file.KitFileError, match="cannot be written"):
        file.save(below / "kit.json", CAMERAS, SIZES, belief())


def test_a_failed_write_keeps_the_previous_file(tmp_path, monkeypatch):
    path = tmp_path / "deep" / "kit.json"
    file.save(path, CAMERAS, SIZES, belief(1))
    before = path.read_bytes()

    def full(fd):
        # the folder is synced after the rename, when the new file is in place
        if stat.S_ISREG(os.fstat(fd).st_mode):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(file.KitFileError, match=r"cannot be written \(No space left"):
        file.save(path, CAMERAS, SIZES, belief(2))
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_a_belief_that_is_not_finite_is_not_written(tmp_path):
    path = tmp_path / "kit.json"
    broken = KitBelief(np.full(layout.SIZE, np.nan), np.eye(layout.SIZE))
    with pytest.raises(file.KitFileError, match="not finite"):
        file.save(path, CAMERAS, SIZES, broken)
    assert not path.exists()
