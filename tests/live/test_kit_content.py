"""What was learned of the cameras, as it is shown."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from calm_edge.kit import layout
from calm_edge.live import kit_content
from calm_edge.live.kit_content import KitContent, lenses, summary
from calm_edge.live.wire import Message
from calm_edge.types import KitBelief, LocalizerUpdate
from tests.recording import samples

K1 = int(layout.DISTORTION[0][0])


def update(i: int = 0, sigma: float = 0.01) -> LocalizerUpdate:
    """With a kit of which the primary's k1 is known to be -0.1 with `sigma`."""
    mean = layout.prior((None, None)).mean.copy()
    mean[K1] = -0.1
    information = np.zeros((layout.SIZE, layout.SIZE))
    information[K1, K1] = sigma**-2
    return dataclasses.replace(samples.update(i), kit=KitBelief(mean, information))


def test_a_lens_has_its_terms_and_their_sigmas() -> None:
    primary, assistant = lenses(update())
    assert primary is not None and assistant is not None
    assert primary["family"] == "perspective"
    assert primary["k"][0] == pytest.approx(-0.1, abs=0.01)
    assert primary["sigma"][0] == pytest.approx(0.01, rel=0.05)
    # nothing was learned of the other: its prior remains
    assert assistant["sigma"][0] == pytest.approx(layout.RADIAL_SIGMA[0], rel=0.05)


def test_a_backbone_without_a_kit_shows_no_lens() -> None:
    assert lenses(samples.update()) == [None, None]
    content = KitContent().update(samples.update())
    assert content["primary"]["lens"] is None and len(content["history"]) == 1


def test_the_lines_tell_what_is_observed_from_what_is_not() -> None:
    primary, assistant = summary(KitContent().update(update()))
    assert "± 3.0 %; k1 -0.1" in primary and primary.startswith("primary: focal ")
    assert "not observed" not in primary
    assert "sigma unknown, not observed" in assistant


def test_the_history_is_thinned_and_keeps_its_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kit_content, "HISTORY", 20)
    content, shown = KitContent(), {}
    for i in range(333):
        shown = content.update(update(i))
    seconds = [row[0] for row in shown["history"]]
    assert len(seconds) <= 20 and seconds[0] == 0 and seconds[-1] == 332
    assert seconds == sorted(set(seconds))
    # can be sent although the assistant's sigma is unknown
    assert math.isinf(shown["assistant"]["focal_sigma_percent"])
    assert (
        json.loads(Message("kit", shown).encoded()[8:])["assistant"]["focal_sigma_percent"] is None
    )
