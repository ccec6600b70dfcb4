"""The state of a recording in one sentence, with its reason."""

from __future__ import annotations

from collections.abc import Sequence

GOOD, WARNING, BAD = "good", "warning", "bad"

# state -> how serious it is, and the sentence up to its reason
_SENTENCES = {
    "STARTING": (WARNING, "Recording, without a pose so far"),
    "RUNNING": (GOOD, "Recording, and the pose is live"),
    "LAGGING": (WARNING, "Recording, but results are late"),
    "LOST": (BAD, "Recording, but the pose is lost"),
    "DEGRADED": (BAD, "Recording, with a fault"),
    "STOPPING": (WARNING, "No more frames are taken; the last windows are being solved"),
}


def sentence(state: str, reasons: Sequence[str], disk_error: str = "") -> tuple[str, str]:
    """How serious a state is (GOOD, WARNING, BAD), and one sentence for it.

    disk_error: why nothing is written to the disk at present, empty if all is.
    """
    if disk_error:
        return BAD, f"NOT recording: {_plain(disk_error)}."
    level, text = _SENTENCES.get(state, (WARNING, state))
    reason = _plain("; ".join(reasons))
    return level, f"{text} – {reason}." if reason else f"{text}."


def _plain(reason: str) -> str:
    return " ".join(reason.split()).rstrip(".")
