"""The feed-forward backbone: single runs, stitched runs, and errors."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.onnx import model_folder, verdict
from calm_edge.backbones.onnx.model_folder import read_manifest
from calm_edge.backbones.onnx.precision import pinned
from calm_edge.backbones.onnx.verdict import Verdict
from calm_edge.backbones.registry import open_backbone
from calm_edge.config import Config, merge
from calm_edge.geometry.camera import Perspective
from calm_edge.types import Hints
from tests.backbones.painted_model import FOV, SIZE, centres, paint, write_model


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """Use an empty cache instead of this machine's verdicts."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_model(tmp_path_factory.mktemp("painted"), drift_int8=0.01)


def config_of(name, **backbone) -> Config:
    return merge(Config(), {"backbone": {"name": str(name), **backbone}})


def opened(folder, **backbone):
    return open_backbone(config_of(f"feedforward:{folder}", **backbone))


def hints_of(n: int, loop: bool = False) -> Hints:
    """Hints of n primary views 0.2 s apart, n assistant ones 17 ms later, and a loop keyframe."""
    t_ns = 200_000_000 * np.arange(1, n + 1)
    stamps = [t_ns, t_ns + 17_000_000, [5]] if loop else [t_ns, t_ns + 17_000_000]
    eyes = np.repeat([0, 1, 0], [n, n, int(loop)])
    return Hints(eyes=eyes, t_ns=np.concatenate(stamps), loop=loop)


def unit_of(centre):
    """Length by which the network divides its output: its unit."""
    return (centre[:, 2] + 4).mean()


def test_a_window_that_fits_is_one_run(folder):
    centre = centres(4)
    p = opened(folder).infer(paint(centre), hints_of(4))
    found = p.T_s_c[:, :3, 3] * unit_of(centre)
    assert found == pytest.approx(centre - centre[0], abs=0.05)
    width, height = SIZE
    fx, fy = width / 2 / np.tan(FOV[1] / 2), height / 2 / np.tan(FOV[0] / 2)
    expected = Perspective(fx, fy, (width - 1) / 2, (height - 1) / 2, width, height)
    assert p.cameras[3].matrix == pytest.approx(expected.matrix, rel=1e-5)
    assert (p.cameras[3].width, p.cameras[3].height) == SIZE
    assert p.depth.shape == (8, 32, 64) and p.landmarks is None


@pytest.mark.parametrize("cap", [2, 3, 5, 8, 11])
def test_a_longer_window_is_split_and_stitched(folder, tmp_path, cap):
    """Each run has its own unit; the stitched result has that of the first part."""
    capped = write_model(tmp_path / "capped", max_views=cap)
    centre = centres(6)
    images, hints = paint(centre), hints_of(6)
    p = opened(capped).infer(images, hints)
    whole = opened(folder).infer(images, hints)
    units = np.linalg.norm(p.T_s_c[5, :3, 3]) / np.linalg.norm(whole.T_s_c[5, :3, 3])
    assert abs(units - 1) > 0.02
    assert p.T_s_c[:, :3, 3] == pytest.approx(whole.T_s_c[:, :3, 3] * units, abs=0.02)
    ratio = np.median((p.depth / whole.depth).reshape(12, -1), axis=1)
    assert ratio == pytest.approx(np.full(12, units), rel=0.01)
    assert np.array_equal(p.T_s_c[0], np.eye(4)) and p.confidence.max() == 1
    assert any(f"takes {cap} views" in notice for notice in p.notices)
    assert not any("takes" in notice for notice in whole.notices)


@pytest.mark.parametrize("cap", [2, 4, 30])
def test_a_loop_keyframe_is_solved_with_the_most_similar_views(tmp_path, cap):
    capped = write_model(tmp_path / "capped", max_views=cap)
    centre = np.concatenate([centres(5), [[0.2, 0, 2.5]]])
    p = opened(capped).infer(paint(centre), hints_of(5, loop=True))
    T = p.T_s_c[:, :3, 3]
    unit = (centre[4, 2] - centre[0, 2]) / T[4, 2]
    assert T[10] * unit == pytest.approx([0.2, 0, 2.5], abs=0.1)
    assert len(p.depth) == 11 and p.loop_found


def test_missing_views_of_a_fixed_number_are_filled_up(folder, tmp_path):
    """Repeating the last image changes only the unit of this network."""
    fixed = write_model(tmp_path / "fixed", max_views=6)
    text = (fixed / "manifest.toml").read_text()
    text = text.replace("min = 1\n", "min = 6\n").replace("dynamic = true", "dynamic = false")
    (fixed / "manifest.toml").write_text(text)
    centre = centres(2)
    p = opened(fixed).infer(paint(centre), hints_of(2))
    assert len(p.cameras) == len(p.T_s_c) == len(p.depth) == len(p.confidence) == 4
    unit = unit_of(centre[[0, 1, 2, 3, 3, 3]])
    assert p.T_s_c[:, :3, 3] * unit == pytest.approx(centre - centre[0], abs=0.05)


def test_pictures_of_two_sizes(folder):
    centre = centres(2)
    images = paint(centre[:2]) + paint(centre[2:], (96, 64))
    p = opened(folder).infer(images, hints_of(2))
    assert p.cameras[0].cx == pytest.approx(63.5) and p.cameras[2].cx == pytest.approx(47.5)
    assert p.depth.shape[0] == 4 and (p.depth > 0).mean() > 0.99


def test_depth_that_was_dropped_is_computed_again(folder):
    backbone = opened(folder)
    images, hints = paint(centres(3)), hints_of(3)
    p = backbone.infer(images, hints)
    again = backbone.densify(images, hints, replace(p, depth=None, confidence=None))
    assert np.array_equal(again.depth, p.depth) and np.array_equal(again.confidence, p.confidence)


def test_models_are_backbones_by_name(folder, monkeypatch):
    monkeypatch.setattr(model_folder, "search_path", lambda: [folder.parent])
    for name in (folder.name, f"feedforward:{folder.name}"):
        assert open_backbone(config_of(name)).infer(paint(centres(2)), hints_of(2)).cameras
    with pytest.raises(BackboneError, match=rf"'none': unknown; known: .*{folder.name}"):
        open_backbone(config_of("none"))


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("feedforward", "add a model, feedforward:NAME"),
        ("feedforward:/nowhere", "model '/nowhere': neither a known name"),
        ("bundle:painted", "model 'painted': neither a known name"),
    ],
)
def test_an_unknown_name_is_an_error_of_one_line(name, line):
    with pytest.raises(BackboneError, match=line):
        open_backbone(config_of(name))


def test_a_damaged_folder_is_refused(tmp_path):
    folder = write_model(tmp_path / "damaged")
    with (folder / "fp32.onnx").open("ab") as file:
        file.write(b"!")
    with pytest.raises(BackboneError, match=r"fp32\.onnx: sha256 is"):
        opened(folder)


def test_one_view_per_run_is_an_error(tmp_path):
    with pytest.raises(BackboneError, match="runs one view at a time"):
        opened(write_model(tmp_path / "single", max_views=1))


def test_a_model_that_was_not_checked_gives_a_notice(folder):
    notices = opened(folder).infer(paint(centres(2)), hints_of(2)).notices
    assert [n for n in notices if "not checked on" in n and "runs in fp32" in n]


def test_unmeasured_in_the_manifest_sets_the_default_precision(folder, tmp_path):
    folder = Path(shutil.copytree(folder, tmp_path / "sure"))
    path = folder / "manifest.toml"
    path.write_text('unmeasured = "int8"\n' + path.read_text())
    assert pinned(config_of(f"feedforward:{folder}"), deterministic=False).backbone.precision == (
        "int8"
    )
    notices = opened(folder).infer(paint(centres(2)), hints_of(2)).notices
    assert not [n for n in notices if "not checked on" in n]


def test_a_verdict_sets_views_and_refusal(folder):
    manifest = read_manifest(folder)
    verdict.save(manifest, Verdict("", "int8", {"int8": 3, "fp32": 2}, "faster"))
    p = opened(folder).infer(paint(centres(2)), hints_of(2))
    assert [n for n in p.notices if "takes 3 views" in n] and len(p.notices) == 1
    fp32 = opened(folder, precision="fp32").infer(paint(centres(2)), hints_of(2))
    assert not np.array_equal(p.depth, fp32.depth)
    verdict.save(manifest, Verdict("golden values differ", "fp32", {}, ""))
    with pytest.raises(BackboneError, match="refused by model check: golden values differ"):
        opened(folder)


def test_precision_and_views_are_pinned_in_the_config(folder):
    config = config_of(f"feedforward:{folder}")
    assert pinned(config, deterministic=False).backbone.precision == "fp32"
    verdict.save(read_manifest(folder), Verdict("", "int8", {"int8": 3, "fp32": 2}, "faster"))
    live, lockstep = (pinned(config, deterministic=d).backbone for d in (False, True))
    assert (live.precision, live.max_views) == ("int8", 3)
    assert (lockstep.precision, lockstep.max_views) == ("fp32", 2)
    asked = config_of(f"feedforward:{folder}", precision="int8")
    assert pinned(asked, deterministic=True).backbone.precision == "int8"
    with pytest.raises(BackboneError, match="has no fp16 graphs; it has fp32, int8"):
        pinned(config_of(f"feedforward:{folder}", precision="fp16"), deterministic=True)
    without = config_of("bundle")
    assert pinned(without, deterministic=True) == without


def test_a_malformed_verdict_file_is_ignored(folder):
    manifest = read_manifest(folder)
    path = verdict.save(manifest, Verdict("", "int8", {"int8": 3}, ""))
    assert verdict.load(manifest) == Verdict("", "int8", {"int8": 3}, "")
    for text in ("", "{}", '{"refusal": 1}', "[]"):
        path.write_text(text)
        assert verdict.load(manifest) is None
