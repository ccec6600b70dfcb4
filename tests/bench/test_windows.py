from pathlib import Path

import pytest

from bench import windows
from calm_edge.evaluation import EvaluationError
from tests.recording import samples


def test_a_folder_needs_its_spacing():
    with pytest.raises(EvaluationError, match="FOLDER:SPACING_M"):
        windows._solved("some/drive", [])


def test_a_recording_needs_a_spacing(tmp_path: Path):
    samples.small_recording(tmp_path / "drive")
    with pytest.raises(EvaluationError, match="spacing_m"):
        windows._recorded(f"{tmp_path / 'drive'}={tmp_path}")
