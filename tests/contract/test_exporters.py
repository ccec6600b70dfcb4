"""What every exporter must do, whichever format it writes: one suite over all of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calm_edge.cli import main
from calm_edge.commands.export import FORMATS
from calm_edge.interchange.export.registry import EXPORTERS
from calm_edge.mapping.cloud_file import CloudWriter
from calm_edge.types import MapTile
from tests.interchange.export.drives import (
    MARKERS,
    georeferenced,
    with_map,
    write_recording,
)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map on the Earth, with the recording that it names."""
    folder = tmp_path_factory.mktemp("drive")
    made = with_map(write_recording(folder / "rec"), folder / "map")
    with CloudWriter(made / "map.ply") as cloud:
        cloud.write(MapTile(MARKERS.astype(np.float32), np.zeros((4, 3), np.uint8)))
    return georeferenced(made)


def content(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


def test_the_command_offers_every_exporter() -> None:
    assert tuple(EXPORTERS) == FORMATS
    assert all(name == each.name and each.writes for name, each in EXPORTERS.items())


@pytest.mark.parametrize("name", FORMATS)
def test_an_export_says_what_it_did_and_never_replaces_unasked(
    name: str, source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, out = content(source.parent), tmp_path / "new" / "out"
    command = ["export", str(source), "--to", name, "--out", str(out)]
    assert main(command) == 0
    shown = capsys.readouterr()
    heads = {line.split("  ")[0] for line in shown.out.splitlines()}
    assert heads == {"wrote", "assumed", "left out"} and not shown.err
    first = content(out)
    assert first and all(first.values())
    for line in shown.out.splitlines():
        if line.startswith("wrote"):
            assert Path(line.split(maxsplit=1)[1].split(":")[0]).exists(), line
    # neither the source nor what is around the output has changed
    assert content(source.parent) == before and [f.name for f in out.parent.iterdir()] == ["out"]

    (out / "mine.txt").write_text("kept")
    assert main(command) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "is not empty" in error and "--force" in error
    assert main([*command, "--force"]) == 0
    assert content(out) == first | {"mine.txt": b"kept"}


@pytest.mark.parametrize("name", FORMATS)
def test_a_recording_without_a_solved_window_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["export", str(tmp_path / "no"), "--to", name, "--out", str(out)]) == 1
    assert "not found" in capsys.readouterr().err and not out.exists()
