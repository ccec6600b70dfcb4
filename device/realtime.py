"""Real-time scheduling of the calling thread, so that capture keeps its rate under CPU load."""

from __future__ import annotations

import os

# RESET_ON_FORK: threads and processes started later run at normal priority
_POLICY = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK


def request(priority: int) -> str | None:
    """Request SCHED_FIFO at `priority` (1 to 99) for the calling thread; 0 requests nothing.

    Returns None on success, else one line with the reason and the remedy. See sched(7).
    """
    if priority == 0:
        return None
    try:
        os.sched_setscheduler(0, _POLICY, os.sched_param(priority))
    except PermissionError:
        return (
            f"real-time priority {priority} was not granted: capture runs at normal priority; "
            "raise LimitRTPRIO= of the unit, or set capture.realtime_priority = 0"
        )
    except OSError as error:
        return f"real-time priority {priority}: {error.strerror}; it must be from 1 to 99"
    return None
