"""Threads of the tests, and their order over the workers of `make test`."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from calm_edge.processes import CHILD_ENVIRONMENT

# As in the processes of the product, and set before NumPy is imported. With the small matrices
# here, a second thread of OpenBLAS uses as much CPU as the first, most of it waiting.
os.environ.update(CHILD_ENVIRONMENT)

HERE = Path(__file__).parent
# Drives through the real daemon and commands of the documentation: minutes in few files.
LONGEST = (HERE / "replay", HERE / "daemon", HERE / "test_docs.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start the longest files first, so that no worker is left alone with one at the end."""

    def is_short(item: pytest.Item) -> bool:
        return not any(item.path.is_relative_to(path) for path in LONGEST)

    items.sort(key=is_short)
