"""Describe the losses of a damaged recording file, one line each."""

from __future__ import annotations

from calm_edge.recording.scan import SegmentIndex
from calm_edge.recording.schema import IMAGE_TOPICS


def newest_ns(index: SegmentIndex) -> int | None:
    """Log time of the newest intact image, else of the newest message; None if nothing is intact.

    Images are preferred: in a replay the other messages are stamped by another clock.
    """
    images = [rows for topic in IMAGE_TOPICS.values() for _, rows in index.topic_rows(topic)]
    return max((max(rows.log_time) for rows in images or index.rows.values()), default=None)


def describe(index: SegmentIndex) -> list[str]:
    """Return one line for each loss: file, cause, time of the loss, messages recovered."""
    lines = []
    if index.cut and not index.data_ended:
        end = newest_ns(index)
        since = "all of it" if end is None else f"everything after t = {end / 1e9:.3f} s"
        lines.append(
            f"{index.path}: {index.cut}; lost: {since} ({index.cut_bytes} bytes unreadable); "
            f"recovered: {index.n_messages} messages"
        )
    elif index.cut:
        lines.append(
            f"{index.path}: {index.cut}, after the last message; "
            f"recovered: all {index.n_messages} messages"
        )
    if index.damaged:
        lines.append(
            f"{index.path}: {len(index.damaged)} damaged chunks left out "
            f"({sum(c.size for c in index.damaged)} bytes); "
            f"recovered: {index.n_messages} messages"
        )
    if index.loose_messages:
        lines.append(f"{index.path}: {index.loose_messages} messages outside of chunks left out")
    return lines
