"""The bytes between the processes, counted on a small drive."""

from __future__ import annotations

from pathlib import Path

from bench.__main__ import main
from bench.tables import kept
from tests.replay.small_drive import write_drive


def test_a_picture_crosses_to_the_estimator_once_and_never_back(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drive", 24)
    arguments = ["cost.pipes", "--sequence", str(drive), "--out", str(tmp_path)]
    for setting in (f"backbone.name=scripted:{drive}", "frontend.n_max=6", "frontend.n_overlap=2"):
        arguments += ["--set", setting]
    assert main(arguments) == 0
    (table,) = kept(tmp_path)
    mb = {tuple(row[:3]): row[4] for row in table.rows}
    jpeg_mb = sum(path.stat().st_size for path in drive.glob("cam*/*")) / 1e6
    assert mb["capture", "tracker", "shared memory"] > 0.99 * jpeg_mb
    assert 0 < mb["capture", "estimator", "Process"] < jpeg_mb
    # stamps and names alone, though all windows come this way
    assert mb["tracker", "capture", "Tracked"] < 0.05 * jpeg_mb
    times = float(table.notes[0].split("; ")[1].split()[0])
    assert 1.0 <= times < 1.1
