"""Put models/ on the import path, from which the export scripts import each other."""

from __future__ import annotations

import pytest

from calm_edge.backbones.onnx.model_folder import EXPORTED


@pytest.fixture(autouse=True)
def scripts_are_found(monkeypatch):
    monkeypatch.syspath_prepend(str(EXPORTED))
