"""The command line: errors are one line with the right exit code; --help imports little."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calm_edge
from calm_edge.cli import COMMANDS, main
from calm_edge.config import Config
from calm_edge.mapping import cloud_file
from calm_edge.mapping.mapper import Mapper
from calm_edge.offline import map_drive
from calm_edge.offline.densify import densified
from calm_edge.recording.reader import Recording
from calm_edge.recording.writer import RecordingWriter
from calm_edge.types import Submap
from device.frame import Eye
from tests.replay.small_drive import write_drive

HEAVY = ("cv2", "numpy", "scipy", "gtsam", "mcap", "depthai", "serial")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("cli") / "sequence", 20)


@pytest.fixture(scope="module")
def recorded(drive: Path) -> Path:
    out = drive.parent / "rec"
    arguments = ["record", "--sequence", str(drive), "--out", str(out), "--pace", "lockstep"]
    arguments += ["--no-report"]
    arguments += ["--set", f"backbone.name=scripted:{drive}", "--set", "frontend.n_max=4"]
    assert main([*arguments, "--set", "frontend.n_overlap=2", "--spacing-m", "0.5"]) == 0
    assert not (out / "report.html").exists()
    return out


def only_line(capsys: pytest.CaptureFixture[str]) -> str:
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("calm-edge: ")
    return line


def test_help_names_every_command_and_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom calm_edge.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit as e:\n    code = e.code\n"
        f"print('LOADED', code, [m for m in {HEAVY!r} if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "LOADED 0 []"
    assert all(name in run.stdout for name in COMMANDS)


def test_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out == f"calm-edge {calm_edge.__version__}\n"


@pytest.mark.parametrize("arguments", [[], ["nonsense"], ["record"], ["map", "x"], ["eval", "x"]])
def test_wrong_usage_is_exit_2(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2


def _gone(folder: Path) -> None:
    shutil.rmtree(folder)


def _one_camera(folder: Path) -> None:
    shutil.rmtree(folder / "cam1")


def _no_pictures(folder: Path) -> None:
    for image in (folder / "cam0").iterdir():
        image.write_text("not a picture")


def _backwards(folder: Path) -> None:
    times = (folder / "times0.txt").read_text().splitlines()
    (folder / "times0.txt").write_text("\n".join(times[::-1]))


def _apart(folder: Path) -> None:
    times = (folder / "times1.txt").read_text().splitlines()
    (folder / "times1.txt").write_text("\n".join(f"{float(t) + 64:.6f}" for t in times))


@pytest.mark.parametrize(
    ("harm", "names"),
    [
        (_gone, "sequence"),
        (_one_camera, "cam1"),
        (_no_pictures, "000000.jpg"),
        (_backwards, "times0.txt"),
        (_apart, "no time in common"),
    ],
)
def test_an_invalid_sequence_gives_one_line(
    harm: Callable[[Path], None],
    names: str,
    drive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "sequence"
    shutil.copytree(drive, folder)
    harm(folder)
    out = tmp_path / "rec"
    assert main(["record", "--sequence", str(folder), "--out", str(out)]) == 1
    assert names in only_line(capsys)
    assert not out.exists()


@pytest.mark.parametrize("pace", ["lockstep", "realtime"])
def test_unreadable_images_are_a_loss_and_not_the_end(
    pace: str, drive: Path, tmp_path: Path
) -> None:
    # no name is too odd for a folder: this one is not UTF-8
    folder = tmp_path / os.fsdecode(b"s\xe9quence")
    shutil.copytree(drive, folder)
    for eye, name in [(0, "000003.jpg"), (0, "000005.jpg"), (1, "000004.jpg")]:
        image = folder / f"cam{eye}" / name
        image.write_bytes(image.read_bytes()[:700])
    (folder / "cam0" / "000007.jpg").write_text("not a picture")
    command = [sys.executable, "-m", "calm_edge.cli", "record", "--sequence", str(folder)]
    command += ["--out", str(folder / "rec"), "--pace", pace]
    command += ["--set", f"backbone.name=scripted:{drive}"]
    run = subprocess.run(
        command, capture_output=True, text=True, errors="surrogateescape", timeout=100
    )
    assert run.returncode == 3, run.stderr
    assert f"recording   {folder}/rec" in run.stdout
    assert "Traceback" not in run.stderr and "libjpeg" not in run.stderr
    lines = run.stderr.splitlines()
    named = sorted(line[line.index("00000") :] for line in lines if ".jpg" in line)
    assert len(named) == 2 and named[0].startswith("000003.jpg: primary frame 3: incomplete")
    assert named[1] == "000007.jpg: not a JPEG"
    assert "calm-edge: loss: 4 frames were not readable" in lines


@pytest.mark.parametrize(
    ("extra", "names"),
    [
        (["--set", "frontend.n_maxx=3"], "frontend.n_maxx"),
        (["--set", "frontend.n_max=many"], "frontend.n_max"),
        (["--set", "nonsense"], "section.key=value"),
        (["--config", "/nonexistent.toml"], "/nonexistent.toml"),
        (["--set", "backbone.name=nothing"], "backbone.name"),
        (
            ["--set", "correction.apply=allways"],
            "correction.apply = 'allways': expected one of auto, always, never",
        ),
        (
            ["--set", "correction.matches=SIFT"],
            "correction.matches = 'SIFT': expected one of auto, sift",
        ),
        (["--hfov-deg", "80", "80", "80"], "--hfov-deg"),
        (["--hfov-deg", "190"], "hfov_deg"),
        (["--set", "capture.readout_ms=[-1.0]"], "capture.readout_ms"),
        (["--set", "capture.readout_ms=[8.0, 9.0, 10.0]"], "capture.readout_ms"),
        (["--set", 'capture.mask=["/nonexistent.png"]'], "/nonexistent.png: cannot be read"),
        (["--set", 'capture.mask=["/dev/null"]'], "/dev/null: not an image"),
        (["--set", 'capture.mask=["a", "b", "c"]'], "capture.mask"),
        (["--set", 'capture.mask_cells=["2x2:00"]'], "capture.mask"),
        (["--spacing-m", "-1"], "spacing_m"),
    ],
)
def test_an_invalid_setting_gives_one_line(
    extra: list[str],
    names: str,
    drive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "rec"
    assert main(["record", "--sequence", str(drive), "--out", str(out), *extra]) == 1
    assert names in only_line(capsys)
    assert not out.exists()


def test_a_file_that_is_not_a_kit_file_gives_one_line_and_is_unchanged(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept, out = tmp_path / "kit.json", tmp_path / "rec"
    kept.write_text('{"precious": 1}')
    arguments = ["record", "--sequence", str(drive), "--out", str(out), "--pace", "lockstep"]
    arguments += ["--set", f"backbone.name=scripted:{drive}"]
    assert main([*arguments, "--set", f"backbone.kit_file={kept}"]) == 1
    assert "kit.json: not a kit file" in only_line(capsys)
    assert kept.read_text() == '{"precious": 1}' and not out.exists()


def test_a_folder_with_a_recording_is_not_overwritten(
    recorded: Path, drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {p.name: p.stat().st_mtime_ns for p in recorded.iterdir()}
    assert main(["record", "--sequence", str(drive), "--out", str(recorded)]) == 1
    assert "already holds a recording" in only_line(capsys)
    assert before == {p.name: p.stat().st_mtime_ns for p in recorded.iterdir()}


def test_an_output_that_cannot_be_made_is_named(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    command = ["record", "--sequence", str(drive), "--pace", "lockstep"]
    for out, reason in ((file, "file: is a file"), (file / "r", "r: cannot be written")):
        assert main([*command, "--set", f"backbone.name=scripted:{drive}", "--out", str(out)]) == 1
        line = only_line(capsys)
        assert reason in line and "choose another output folder" in line
    assert file.read_text() == "mine"


def test_lockstep_with_live_cameras_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["record", "--out", str(tmp_path / "r"), "--pace", "lockstep"]) == 1
    assert "lockstep" in only_line(capsys)


def stamps(file: Path) -> list[str]:
    return [line.split()[0] for line in file.read_text().splitlines()]


def test_a_replay_has_the_configuration_and_the_stamps_of_the_first_run(
    recorded: Path, drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    again = tmp_path / "again"
    assert main(["record", "--replay", str(recorded), "--out", str(again), "--pace=lockstep"]) == 0
    assert "cameras 0.5 m apart" in capsys.readouterr().err
    assert Recording(again).config == Recording(recorded).config
    (first, second) = (folder / "record_trajectory.tum" for folder in (recorded, again))
    assert first.read_bytes() == second.read_bytes()
    given = [f"{float(line):.9f}" for line in (drive / "times0.txt").read_text().splitlines()]
    assert len(stamps(first)) > 5 and {*stamps(first)} <= {*given}


def test_map_uses_what_record_logged_and_eval_reads_all_three(
    recorded: Path,
    drive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # neither drawings nor tables need a library
    for name in ("matplotlib", "PIL", "rich"):
        monkeypatch.setitem(sys.modules, name, None)
    out = tmp_path / "map"
    reads: list[Path] = []
    read_cloud = cloud_file.read_cloud
    monkeypatch.setattr(cloud_file, "read_cloud", lambda p: (reads.append(p), read_cloud(p))[1])
    marked = [(int(Recording(recorded).frame_times(Eye.PRIMARY)[9]), "tram crosses")]
    monkeypatch.setattr(Recording, "events", lambda self: iter(marked))
    assert main(["map", str(recorded), "--out", str(out), "--truth", str(drive)]) == 0
    captured = capsys.readouterr()
    # a long drive's cloud is large
    assert reads == [out / "map.ply"]
    assert "computed again" not in captured.err
    for name in ("map.ply", "trajectory.tum", "trajectory.kitti", "summary.json", "report.html"):
        assert str(out / name) in captured.out or (out / name).stat().st_size > 0
    # both have the user's own stamps
    logged = (recorded / "record_trajectory.tum").read_text()
    assert (out / "trajectory.tum").read_text() == logged
    for target in (recorded, out, out / "trajectory.tum"):
        assert main(["eval", str(target), "--truth", str(drive), "--json"]) == 0
        figures = json.loads(capsys.readouterr().out)
        assert figures["ate_sim3_m"] < 0.01
    assert main(["eval", str(out), "--truth", str(drive)]) == 0
    assert "ate_sim3_m" in capsys.readouterr().out
    report = (out / "report.html").read_text()
    assert "The trajectory from above" in report
    # what was marked while driving is listed, and leads to its place in the map
    keyframe = re.search(r'tram crosses</td><td><a href="map.html#k=(\d+)"', report)
    walk = (out / "map.html").read_text()
    assert "calmEdgeMap.points(" in walk and "calmEdgeMap.pictures([[0," in walk
    assert keyframe and f'"events":[[{int(keyframe[1]) - 1},"0:0' in walk
    assert main(["map", str(recorded), "--out", str(out)]) == 1
    assert "already holds" in only_line(capsys)


def test_map_solves_again_with_another_model_and_draws_a_preview(
    recorded: Path, drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, arguments = tmp_path / "map", ["map", str(recorded), "--quality", "preview"]
    assert main([*arguments, "--rerun-model", "no-such-model", "--out", str(out)]) == 1
    assert "no-such-model" in only_line(capsys) and not out.exists()
    other = shutil.copytree(drive, tmp_path / "other")
    model = f"scripted:{other}"
    assert main([*arguments, "--rerun-model", model, "--out", str(out)]) == 0
    captured = capsys.readouterr()
    assert "solving windows" in captured.err and "map.ply" in captured.out
    summary = json.loads((out / "summary.json").read_text())
    assert summary["backbone"] == model and summary["quality"] == "preview"


def test_an_interrupted_map_is_continued_and_gives_the_same_bytes(
    recorded: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    whole, out = tmp_path / "whole", tmp_path / "map"
    assert main(["map", str(recorded), "--out", str(whole)]) == 0
    add, computed = Mapper.add, list[int]()

    def interrupted(mapper: Mapper, submap: Submap, *arguments: Any) -> None:
        add(mapper, submap, *arguments)
        if submap.id == 1:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Mapper, "add", interrupted)
        assert main(["map", str(recorded), "--out", str(out)]) == 1
    assert "continue with --resume" in capsys.readouterr().err and not (out / "map.ply").exists()
    assert main(["map", str(recorded), "--out", str(out)]) == 1
    assert "--resume" in only_line(capsys)
    assert main(["map", str(recorded), "--out", str(out), "--set", "mapping.grid=5"]) == 1
    capsys.readouterr()

    def counted(*arguments: Any) -> Any:
        computed.append(len(arguments[2]))
        return densified(*arguments)

    monkeypatch.setattr(map_drive, "densified", counted)
    assert main(["map", str(recorded), "--out", str(out), "--resume"]) == 0
    submaps = json.loads((whole / "summary.json").read_text())["submaps"]
    assert computed == [submaps - 2]
    for name in ("map.ply", "trajectory.tum"):
        assert (out / name).read_bytes() == (whole / name).read_bytes()
    assert {path.name for path in out.iterdir()} == {path.name for path in whole.iterdir()}


def test_a_finished_map_is_replaced_only_if_asked(
    recorded: Path, drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, truth = tmp_path / "map", tmp_path / "truth"
    out.mkdir()
    truth.mkdir()
    (truth / "poses0.txt").write_text((drive / "poses0.txt").read_text())
    np.savetxt(truth / "times0.txt", np.arange(20) * 7.3 + 1000)
    for name in ("map.ply", "trajectory.kitti"):
        for extra in ([], ["--resume"]):
            (out / name).write_text("mine")
            assert main(["map", str(recorded), "--out", str(out), *extra]) == 1
            assert f"already holds {name}; replace it with --force" in only_line(capsys)
        assert (out / name).read_text() == "mine"
        (out / name).unlink()
    (out / "map.ply").write_text("mine")
    # what fails before the new map is complete leaves the old one
    assert main(["map", str(tmp_path / "none"), "--out", str(out), "--force"]) == 1
    assert (out / "map.ply").read_text() == "mine"
    # a truth of another drive costs only the comparison
    arguments = ["map", str(recorded), "--out", str(out), "--force", "--truth", str(truth)]
    assert main([*arguments, "--no-pictures"]) == 3
    walk = (out / "map.html").read_text()
    assert "calmEdgeMap.points(" in walk and "calmEdgeMap.pictures(" not in walk
    assert "loss: not compared with the truth: " in capsys.readouterr().err
    assert (out / "map.ply").stat().st_size > 1000 and (out / "report.html").exists()
    assert not (out / "unfinished").exists()


def test_a_truncated_recording_is_mapped_with_loss(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    data = (recorded / "0000.mcap").read_bytes()
    cut.write_bytes(data[: len(data) * 9 // 10])
    assert main(["map", str(cut), "--out", str(tmp_path / "map")]) == 3
    captured = capsys.readouterr()
    assert any("loss" in line and "cut.mcap" in line for line in captured.err.splitlines())
    assert (tmp_path / "map" / "map.ply").stat().st_size > 1000
    assert main(["validate", str(cut)]) == 3
    assert main(["recover", str(cut), "--out", str(tmp_path / "whole.mcap")]) == 3
    assert main(["validate", str(tmp_path / "whole.mcap")]) == 0


def test_a_path_that_is_not_a_recording_gives_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (tmp_path / "missing", tmp_path):
        assert main(["map", str(path), "--out", str(tmp_path / "map")]) == 1
        only_line(capsys)
    empty = tmp_path / "empty"
    RecordingWriter(empty, Config()).close()
    assert main(["map", str(empty), "--out", str(tmp_path / "map")]) == 3
    only_line(capsys)
    assert not (tmp_path / "map").exists()
