"""`model check` passes a correct model with its best precision, and gives reasons for others."""

from __future__ import annotations

import dataclasses
import json
import shutil

import numpy as np
import pytest
from onnx import parser, save_model

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.model_check import probe
from calm_edge.backbones.model_check.check import Report, _choose, check
from calm_edge.backbones.model_check.probe import Limits, Measured, ladder, steps
from calm_edge.backbones.onnx import verdict
from calm_edge.backbones.onnx.manifest import FrameRange
from calm_edge.backbones.onnx.model_folder import read_manifest
from calm_edge.backbones.registry import open_backbone
from calm_edge.cli import main
from calm_edge.config import Config, merge
from tests.backbones.painted_model import sha256, write_model

LIMITS = Limits(20.0, 4000.0, (128, 64))


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """Use an empty cache instead of this machine's verdicts."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def unmeasured(monkeypatch):
    """Replace the measurement by one where N views take N milliseconds; no process is started."""

    def cheap(manifest, precision, limits):
        rows = [Measured(precision, n, "", n / 1000, 100.0) for n in steps(manifest.frames)]
        return rows, "maximum of the manifest"

    monkeypatch.setattr(probe, "ladder", cheap)


def checked(folder) -> Report:
    return check(read_manifest(folder), LIMITS, lambda text: None)


def replaced(folder, old: str, new: str):
    path = folder / "manifest.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return folder


def test_a_good_folder_passes_and_is_measured(tmp_path, capsys):
    """Run the whole command, with a real measuring process."""
    folder = write_model(tmp_path / "painted", max_views=3)
    arguments = ["model", "check", str(folder), "--json", "--size", "128x64"]
    assert main(arguments) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["passed"] and report["files"] == 2 and report["refusal"] == ""
    assert [row["views"] for row in report["measured"]] == [2, 3]
    assert all(row["seconds"] > 0 and row["peak_mb"] > 10 for row in report["measured"])
    assert max(row["deviation"] for row in report["compared"]) < 1e-4
    assert {row["case"] for row in report["compared"]} == {"model/n2", "model/n4"}
    assert all(0 < seen["disagreement"] < 0.02 for seen in report["reprojection"].values())
    assert report["max_views"] == {"fp32": 3} and report["precision"] == "fp32"
    found = verdict.load(read_manifest(folder))
    assert found is not None and found.max_views == {"fp32": 3} and not found.refusal


def test_a_graph_traced_at_two_views_is_refused_everywhere(tmp_path, capsys):
    """It runs at any number of views, but is right for two only."""
    folder = write_model(tmp_path / "frozen", frozen=True)
    assert main(["model", "check", str(folder)]) == 1
    out = capsys.readouterr().out
    assert "golden       fp32 model/n2: off by" in out
    assert "refused      golden values: fp32 model/n4: pose is off by 0." in out
    config = merge(Config(), {"backbone": {"name": f"feedforward:{folder}"}})
    with pytest.raises(BackboneError, match="refused by model check: golden values: fp32"):
        open_backbone(config)


def test_record_refuses_what_the_check_refused(tmp_path, capsys):
    folder = write_model(tmp_path / "frozen", frozen=True)
    main(["model", "check", str(folder)])
    capsys.readouterr()
    arguments = ["record", "--sequence", "demo/drive", "--out", str(tmp_path / "rec")]
    assert main([*arguments, "--set", f"backbone.name=feedforward:{folder}"]) == 1
    assert "refused by model check: golden values: fp32 model/n4" in capsys.readouterr().err
    assert not (tmp_path / "rec").exists()


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize(
    ("change", "line"),
    [
        (
            lambda f: replaced(f, "world_to_camera", "camera_to_world"),
            "output.pose.direction is wrong",
        ),
        (lambda f: replaced(f, '"rgb"', '"bgr"'), "golden values: fp32"),
        (lambda f: replaced(f, '"expp1"', '"logit"'), ""),
        (lambda f: replaced(f, 'inputs = ["image"]', 'inputs = ["other"]'), "no input 'other'"),
        (lambda f: (f / "LICENSE").unlink(), "LICENSE: missing"),
        (lambda f: (f / "fp32.onnx").write_bytes(b""), "fp32.onnx: sha256 is"),
    ],
)
def test_a_single_fault_is_the_reason_of_refusal(tmp_path, change, line):
    folder = write_model(tmp_path / "painted")
    change(folder)
    refusal = checked(folder).refusal
    assert (line in refusal) if line else not refusal


@pytest.mark.usefixtures("unmeasured")
def test_a_precision_with_too_large_a_deviation_is_refused(tmp_path):
    assert not checked(write_model(tmp_path / "little", drift_int8=0.01)).refusal
    report = checked(write_model(tmp_path / "much", drift_int8=0.4))
    assert "golden values: int8 model/n2" in report.refusal


@pytest.mark.usefixtures("unmeasured")
def test_images_without_a_common_scene_are_not_compared(tmp_path):
    folder = write_model(tmp_path / "painted")
    replaced(folder, "[golden]", "[golden]\nscene = false")
    assert checked(folder).reprojection == {}


def measured(precision, *rows):
    return [Measured(precision, views, "", seconds, 1.0) for views, seconds in rows]


@pytest.mark.parametrize(
    ("fp32", "int8", "precision"),
    [
        ([(2, 1.0), (4, 2.0)], [(2, 0.5), (4, 1.5)], "int8"),
        ([(2, 1.0), (4, 2.0)], [(2, 0.5), (4, 1.9)], "fp32"),
        ([(2, 1.0), (4, 2.0)], [(2, 2.0), (4, 3.0)], "fp32"),
        ([(2, 1.0)], [(2, 0.5), (4, 9.0)], "int8"),
    ],
)
def test_the_faster_precision_is_chosen_if_ten_percent_faster(tmp_path, fp32, int8, precision):
    manifest = read_manifest(write_model(tmp_path / "painted", drift_int8=0.01))
    report = Report("painted", measured=measured("fp32", *fp32) + measured("int8", *int8))
    _choose(manifest, report)
    assert report.precision == precision and report.why.startswith(f"{precision}: ")


def test_steps_end_at_the_maximum_of_the_manifest():
    assert steps(FrameRange(1, 10, True)) == [2, 3, 4, 6, 8, 10]
    assert steps(FrameRange(5, 8, True)) == [5, 6, 8]
    assert steps(FrameRange(6, 6, False)) == [6]


class Answers:
    """Stand-in for the measuring process with given answers."""

    def __init__(self, answers):
        self._answers = iter(answers)

    def __call__(self, manifest, precision, limits):
        return self

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return None

    def ask(self, request, limit_s):
        return next(self._answers)


def answer(seconds, peak_mb):
    return {"seconds": seconds, "peak_mb": peak_mb}


@pytest.mark.parametrize(
    ("answers", "views", "line"),
    [
        (
            [answer(1, 200), answer(2, 300), answer(25, 400)],
            [2, 3],
            "4 views: 25.0 s, more than 20.0 s",
        ),
        ([answer(1, 200), answer(2, 1900)], [2, 3], "4 views would take up to 3300 MB"),
        ([answer(1, 200), {"over": "ended"}], [2], "3 views: ended"),
        ([answer(1, 200), answer(1, 2100)], [2], "3 views: 2100 MB, more than 2000 MB"),
    ],
)
def test_the_ladder_stops_before_a_limit_is_exceeded(tmp_path, monkeypatch, answers, views, line):
    monkeypatch.setattr(probe, "_child", Answers([{"peak_mb": 100.0}, *answers]))
    manifest = read_manifest(write_model(tmp_path / "painted", max_views=8))
    rows, ended = ladder(manifest, "fp32", Limits(20.0, 2000.0, (128, 64)))
    assert [row.views for row in rows] == views and line in ended


def test_a_model_that_cannot_run_two_views_is_refused(tmp_path):
    folder = write_model(tmp_path / "painted", max_views=4)
    report = check(read_manifest(folder), Limits(20.0, 1.0, (128, 64)), lambda text: None)
    assert (
        "fp32: 2 views do not run here: " in report.refusal and "more than 1 MB" in report.refusal
    )


def bundle_folder(folder, weight: float = 2.0):
    """A bundle model with an encoder y = 2 x, and golden values for two numbers of views."""
    painted = write_model(folder)
    text = (
        '<ir_version: 9, opset_import: ["" : 17]>'
        "encoder (float[N,1,H,W] image) => (float[N,1,H,W] code) "
        f"<float[1] two = {{{weight}}}> {{ code = Mul(image, two) }}"
    )
    save_model(parser.parse_model(text), painted / "encoder.onnx")
    arrays = {}
    for n in (1, 3):
        pictures = np.random.default_rng(n).integers(0, 256, (n, 16, 24, 3), np.uint8)
        gray = pictures @ np.array([0.114, 0.587, 0.299])
        arrays[f"encoder/n{n}/pictures"] = pictures
        arrays[f"encoder/n{n}/out/code"] = 2 * gray[:, None] / 255
    np.savez(painted / "golden.npz", **arrays)
    (painted / "manifest.toml").write_text(
        'format = 1\nname = "coder"\nkind = "bundle"\nlicense = "none"\n'
        f'[graphs.encoder]\nfp32 = {{ file = "encoder.onnx", sha256 = "'
        f'{sha256(painted / "encoder.onnx")}" }}\noutputs = ["code"]\n'
        '[input]\nname = "image"\nlayout = "NCHW"\nchannels = "gray"\nresize = "keep"\n'
        "[frames]\nmin = 1\nmax = 64\ndynamic = true\n"
        f'[golden]\nsha256 = "{sha256(painted / "golden.npz")}"\nfp32 = 0.01\n'
    )
    return painted


def test_a_bundle_is_checked_graph_by_graph(tmp_path, capsys):
    folder = bundle_folder(tmp_path / "coder")
    assert main(["model", "check", str(folder)]) == 0
    out = capsys.readouterr().out
    assert "run          fp32 encoder/n1" in out and "run          fp32 encoder/n3" in out
    shutil.rmtree(folder)
    report = checked(bundle_folder(tmp_path / "coder", weight=2.1))
    assert "fp32 encoder/n1: code is off by 0.05" in report.refusal


def test_models_are_listed_with_their_verdicts(tmp_path, capsys, monkeypatch):
    from calm_edge.backbones.onnx import model_folder

    monkeypatch.setattr(model_folder, "search_path", lambda: [tmp_path / "models"])
    folder = write_model(tmp_path / "models" / "painted")
    broken = write_model(tmp_path / "models" / "broken")
    replaced(broken, "format = 1", "format = 9")
    assert main(["model", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "format = 9" in lines[0] and "not checked here" in lines[1]
    report = dataclasses.replace(Report("painted"), refusal="too slow")
    verdict.save(read_manifest(folder), report.verdict())
    main(["model", "list"])
    assert "refused: too slow" in capsys.readouterr().out
    assert main(["model", "list", "--json"]) == 0
    first, second = json.loads(capsys.readouterr().out)["models"]
    assert first["name"] == "broken" and "format = 9" in first["error"]
    assert second["name"] == "painted" and second["precisions"] == ["fp32"]
    assert second["passed"] is False and second["result"] == "too slow"


@pytest.mark.parametrize("size", ["big", "10x10", "640"])
def test_a_malformed_size_is_a_usage_error(size, capsys):
    with pytest.raises(SystemExit):
        main(["model", "check", "x", "--size", size])
    assert "expected WIDTHxHEIGHT" in capsys.readouterr().err
