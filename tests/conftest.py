"""Order of the tests over the workers of `make test`."""

from __future__ import annotations

from pathlib import Path

import pytest

HERE = Path(__file__).parent
# Drives through the real daemon and commands of the documentation: minutes in few files.
LONGEST = (HERE / "replay", HERE / "daemon", HERE / "test_docs.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start the longest files first, so that no worker is left alone with one at the end."""

    def is_short(item: pytest.Item) -> bool:
        return not any(item.path.is_relative_to(path) for path in LONGEST)

    items.sort(key=is_short)
