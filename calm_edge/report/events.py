"""Moments that somebody marked while driving, and where the car was then."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from urllib.parse import quote

import numpy as np

from calm_edge.report.chart import minutes
from calm_edge.types import Float, Int

# an event further than this from any keyframe has no place: before the first sub-map, or after the
# last frame
NEAR_S = 5.0
# whose times are in the sentence
NAMED = 6


@dataclass(frozen=True, slots=True)
class MarkedEvent:
    """t_s: since the first keyframe. keyframe: row of the nearest one. p_w: (3,) its position.

    Both are None for an event that is not on the path.
    """

    t_s: float
    text: str
    keyframe: int | None
    p_w: Float | None


def marked_events(
    events: Iterable[tuple[int, str]], t_ns: Int, T_w_c: Float
) -> tuple[MarkedEvent, ...]:
    """Place events, (stamp, text) each, on the path; in order of time, none without a path.

    t_ns: (K,) stamps of the keyframes, ascending, on the clock of the events. T_w_c: (K, 4, 4).
    """
    if not len(t_ns):
        return ()
    found = []
    for stamp, text in sorted(events):
        apart = np.abs(t_ns - stamp)
        row = int(apart.argmin())
        t_s = (stamp - int(t_ns[0])) / 1e9
        if apart[row] > NEAR_S * 1e9:
            found.append(MarkedEvent(t_s, text, None, None))
        else:
            found.append(MarkedEvent(t_s, text, row, T_w_c[row, :3, 3]))
    return tuple(found)


def sentence(events: Sequence[MarkedEvent]) -> str:
    """How many events were marked, and when; empty without one."""
    if not events:
        return ""
    count = "1 event was" if len(events) == 1 else f"{len(events)} events were"
    more = f" and {len(events) - NAMED} more times" if len(events) > NAMED else ""
    return f"{count} marked: at {', '.join(time(event) for event in events[:NAMED])}{more}."


def time(event: MarkedEvent) -> str:
    """Minutes and seconds since the first keyframe."""
    return f"{'-' if event.t_s < 0 else ''}{minutes(abs(event.t_s))}"


def table(events: Sequence[MarkedEvent], driven: Float, unit: str, map_page: str) -> str:
    """HTML table of events: number, time, distance driven until then, text, place in the map.

    driven: (K,) distance at each keyframe. map_page: address of map.html, empty without one.
    """
    head = "<tr><th>no.</th><th>at</th><th>driven</th><th>text</th>"
    rows = []
    for number, event in enumerate(events, 1):
        k = event.keyframe
        place = "not on the path" if k is None else f"{driven[k]:,.0f} {unit}"
        cells = [str(number), time(event), place, event.text]
        row = "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
        if map_page and k is not None:
            address = f"{quote(map_page)}#k={k + 1}"
            row += f'<td><a href="{html.escape(address)}">see it in the map</a></td>'
        elif map_page:
            row += "<td></td>"
        rows.append(f"<tr>{row}</tr>")
    return f"<table>{head}{'<th></th>' if map_page else ''}</tr>{''.join(rows)}</table>"
