"""Fixture: the small drive, rendered once per session."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.replay.small_drive import write_drive


@pytest.fixture(scope="session")
def small_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("drive") / "sequence")
