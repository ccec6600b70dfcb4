"""`map` solves with one thread of linear algebra for each process; a preview has fewer pictures."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from calm_edge.commands.map_pages import Options


def test_linear_algebra_has_one_thread(tmp_path: Path) -> None:
    # the library starts its threads when it is loaded; the command ends when it finds no recording
    code = (
        "import os, sys\nfrom calm_edge.cli import main\n"
        "before = 'numpy' in sys.modules\n"
        f"code = main(['map', {str(tmp_path / 'none')!r}, '--out', {str(tmp_path / 'map')!r}])\n"
        "import numpy, scipy.linalg\n"
        "print(before, code, len(os.listdir('/proc/self/task')))"
    )
    environment = {"OPENBLAS_NUM_THREADS": "8", "OMP_NUM_THREADS": "8", "PATH": "/usr/bin"}
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True
    )
    assert run.stdout.split() == ["False", "1", "1"]


def test_a_preview_has_pictures_of_fewer_keyframes() -> None:
    assert Options("preview").pairs < Options().pairs == Options("fine").pairs
