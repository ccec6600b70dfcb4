"""Real-time scheduling of the calling thread: capture keeps its beat when the processor is full."""

from __future__ import annotations

import os

# RESET_ON_FORK: what a capturing thread starts later is ordinary again
_POLICY = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK


def request(priority: int) -> str | None:
    """SCHED_FIFO at `priority` (1 to 99) for this thread alone; 0 changes nothing.

    Returns None when it was granted or not asked for, else one line saying why not, with the mend.
    """
    if priority == 0:
        return None
    try:
        os.sched_setscheduler(0, _POLICY, os.sched_param(priority))
    except PermissionError:
        return (
            f"real-time priority {priority} was not granted: capture runs at ordinary priority; "
            "raise LimitRTPRIO= of the unit, or set capture.realtime_priority = 0"
        )
    except OSError as error:
        return f"real-time priority {priority}: {error.strerror}; it must be from 1 to 99"
    return None
