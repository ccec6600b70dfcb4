"""What the exit code of every command means."""

from __future__ import annotations

OK, ERROR, USAGE, LOSS = range(4)
