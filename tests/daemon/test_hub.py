"""How the daemon starts, or why it does not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from calm_edge.daemon import hub
from calm_edge.daemon.hub import DaemonError, Hub


@pytest.mark.parametrize("is_replay", [False, True])
@pytest.mark.parametrize(
    ("given_up", "text"),
    [(True, "did not start; see the lines above"), (False, "within .* s: the")],
)
def test_a_failed_start_says_whether_the_processes_died_or_were_slow(
    monkeypatch: pytest.MonkeyPatch, is_replay: bool, given_up: bool, text: str
) -> None:
    limits = []

    def until(done: Any, end_s: float) -> None:
        limits.append(end_s)

    monkeypatch.setattr(hub.time, "monotonic", lambda: 0.0)
    link = SimpleNamespace(ready=False, given_up=given_up)
    it: Any = SimpleNamespace(
        source=SimpleNamespace(is_replay=is_replay),
        tracker=link, estimator=link, impatient=False, until=until,
    )  # fmt: skip
    with pytest.raises(DaemonError, match=text):
        Hub.start(it)
    assert limits == [hub.REPLAY_START_LIMIT_S if is_replay else hub.START_LIMIT_S]
