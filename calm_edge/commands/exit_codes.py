"""Exit codes of all commands."""

from __future__ import annotations

OK, ERROR, USAGE, LOSS = range(4)
