"""Numbers of /kit and /health once more, each as a topic, for viewers that plot no JSON (rerun)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from calm_edge.recording import float_array, schema
from calm_edge.recording.schema import LogMessage


def messages(topic: str, t_ns: int, value: Mapping[str, Any]) -> list[LogMessage]:
    """Plots of a JSON message; none of other topics.

    An array is left out while a number of it is unknown, because rerun plots as many curves as the
    first array of a topic has numbers: so a focal length appears with its sigma.
    """
    found = []
    for plot, places in schema.PLOTS.get(topic, {}).items():
        numbers = [number for place in places if (number := _at(value, place)) is not None]
        if len(numbers) == len(places):
            found.append(LogMessage(plot, t_ns, float_array.encode(numbers)))
    return found


def _at(value: Any, place: str) -> float | None:
    """Number at a place of a JSON object; None if it is unknown."""
    for name in place.split("."):
        value = value.get(name) if isinstance(value, Mapping) else None
    return None if value is None or not math.isfinite(value) else float(value)
