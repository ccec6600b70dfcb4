"""Drives are rendered completely or not at all, with a synchronised variant."""

from pathlib import Path

import pytest

from bench import drives

RENDERER = """
import sys, pathlib
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
for eye in (0, 1):
    (out / f"cam{eye}").mkdir(parents=True, exist_ok=True)
(out / "options").write_text(" ".join(sys.argv[1:]))
if "--fail" in sys.argv:
    sys.exit("no texture")
(out / "cloud.npy").write_bytes(b"x")
"""


@pytest.fixture
def renderer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    script = tmp_path / "renderer.py"
    script.write_text(RENDERER)
    monkeypatch.setattr(drives, "SIMULATOR", script)
    monkeypatch.setattr(drives, "SIMULATED", tmp_path / "sim")
    return tmp_path / "sim"


def test_a_drive_is_rendered_once(renderer: Path, tmp_path: Path) -> None:
    prepare = drives.simulated("d", "--track", "t")
    assert prepare(tmp_path) == renderer / "d"
    assert "--track t" in (renderer / "d" / "options").read_text()
    (renderer / "d" / "options").write_text("kept")
    assert prepare(tmp_path) == renderer / "d"
    assert (renderer / "d" / "options").read_text() == "kept"


def test_a_failed_rendering_is_no_drive(renderer: Path, tmp_path: Path) -> None:
    said = drives.simulated("d", "--fail")(tmp_path)
    assert isinstance(said, str) and said.endswith("no texture")
    assert not (renderer / "d").exists()


def test_without_the_simulator_it_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drives, "SIMULATOR", tmp_path / "gone.py")
    monkeypatch.setattr(drives, "SIMULATED", tmp_path / "sim")
    assert drives.simulated("d")(tmp_path) == f"{tmp_path / 'gone.py'} is not here"


def test_the_plain_demo_is_rendered_by_its_recipe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    python = tmp_path / "python"
    python.write_text('#!/bin/sh\nmkdir -p "$4"\necho "$@" >"$4/options"\ntouch "$4/cloud.npy"\n')
    python.chmod(0o755)
    monkeypatch.setattr(drives.sys, "executable", str(python))
    monkeypatch.setattr(drives, "SIMULATED", tmp_path / "sim")
    folder = drives.plain_demo(tmp_path)
    assert folder == tmp_path / "sim" / "demo_plain"
    options = (tmp_path / "sim" / "demo_plain" / "options").read_text().split()
    assert options[:2] == ["-m", "tests.synthetic.drive"] and options[-2:] == ["--kit", "plain"]
    python.unlink()
    assert drives.plain_demo(tmp_path) == folder


def test_the_twin_in_step_differs_in_its_clocks_alone(renderer: Path, tmp_path: Path) -> None:
    drive = drives.Kilometre("k", 0.4, ("--track", "t"), ("--async", "0.03"))
    loose, in_step = drive.loose(tmp_path), drive.in_step(tmp_path)
    assert isinstance(loose, Path) and isinstance(in_step, Path) and loose != in_step
    options = [(p / "options").read_text().split()[2:] for p in (loose, in_step)]
    assert options[0] == [*options[1], "--async", "0.03"]
    assert "--baseline 0.4" in " ".join(options[1])
    plain = drives.Kilometre("p", 0.4, ("--track", "t"))
    assert plain.loose(tmp_path) == plain.in_step(tmp_path)


def test_the_kilometres_are_what_was_asked_for() -> None:
    """Tracks held out are never developed on, and no two rigs are alike."""

    def value(drive: drives.Kilometre, key: str) -> list[str]:
        words = (*drive.scene, *drive.timing)
        start = words.index(key) + 1 if key in words else len(words)
        return list(words[start : start + (2 if key == "--hfov" else 1)])

    every = (*drives.DEVELOPMENT, *drives.HELD_OUT)
    assert len({d.name for d in every}) == len(every)
    seen = {value(d, "--track")[0] for d in drives.DEVELOPMENT}
    assert not seen & {value(d, "--track")[0] for d in drives.HELD_OUT}
    assert all(0.2 <= d.spacing_m <= 1.2 for d in every)
    assert all(60 <= float(a) <= 100 for d in every for a in value(d, "--hfov"))
    assert all(float(v) <= 0.05 for d in every for v in value(d, "--async"))
    rigs = {(d.spacing_m, *value(d, "--hfov")) for d in every}
    assert len(rigs) == len(every)
    assert any(value(d, "--laps") == ["1.3"] for d in drives.DEVELOPMENT)


def test_pictures_are_those_a_sequence_plays(tmp_path: Path) -> None:
    (tmp_path / "cam0").mkdir()
    for name in ("b.PNG", "a.jpg", "notes.txt", "c.jpeg"):
        (tmp_path / "cam0" / name).touch()
    assert [p.name for p in drives.pictures(tmp_path, 0)] == ["a.jpg", "b.PNG", "c.jpeg"]


def test_an_excerpt_keeps_stamps_and_poses(tmp_path: Path) -> None:
    source = tmp_path / "drive"
    for eye in (0, 1):
        (source / f"cam{eye}").mkdir(parents=True)
        for k in range(5):
            (source / f"cam{eye}" / f"{k:06d}.jpg").write_bytes(b"%d %d" % (eye, k))
        (source / f"times{eye}.txt").write_text("".join(f"{k / 10}\n" for k in range(5)))
    (source / "poses0.txt").write_text("".join(f"pose {k}\n" for k in range(5)))
    folder = drives.excerpt(source, 1, 3)(tmp_path / "out")
    assert isinstance(folder, Path)
    assert (folder / "cam1" / "000000.jpg").read_bytes() == b"1 1"
    assert (folder / "times0.txt").read_text().split() == ["0.1", "0.2", "0.3"]
    assert (folder / "poses0.txt").read_text().splitlines() == ["pose 1", "pose 2", "pose 3"]
    assert "is not here" in str(drives.excerpt(tmp_path / "gone", 1, 3)(tmp_path / "out"))
