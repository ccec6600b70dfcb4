"""Which camera is which: one is unplugged, and what vanished is the one that was meant."""

from __future__ import annotations

from collections.abc import Callable

from calm_edge.types import CalmEdgeError
from device.clock import NS_PER_S, Clock

POLL_NS = NS_PER_S // 2
# time enough to walk round a car; a forgotten command must end all the same
PATIENCE_NS = 300 * NS_PER_S


class IdentifyError(CalmEdgeError):
    """The cameras could not be told apart."""


def _settled(
    look: Callable[[], set[str]], clock: Clock, done: Callable[[set[str]], bool]
) -> set[str]:
    """What there is once `done` holds of two looks in a row: a plug bounces. IdentifyError."""
    limit_ns = clock.now_ns() + PATIENCE_NS
    previous: set[str] | None = None
    while clock.now_ns() < limit_ns:
        now = look()
        if done(now) and now == previous:
            return now
        previous = now
        clock.sleep_until_ns(clock.now_ns() + POLL_NS)
    raise IdentifyError(f"nothing happened in {PATIENCE_NS // NS_PER_S} s; start again")


def by_unplugging(
    look: Callable[[], set[str]], clock: Clock, say: Callable[[str], None]
) -> tuple[str, str]:
    """Addresses of the primary and the assistant; raises IdentifyError.

    look: the addresses that are there now. say: shows a line to whoever is at the cameras.
    """
    there = look()
    if len(there) < 2:
        raise IdentifyError(f"{len(there)} camera(s) found, two are needed; plug in both")
    chosen: list[str] = []
    for role in ("primary (its path is the trajectory)", "assistant (it gives the scale)"):
        left = there - set(chosen)
        if chosen and len(left) == 1:
            chosen += left
            break
        say(f"unplug the camera that is to be the {role} ...")
        now = _settled(look, clock, lambda now: now < there)
        gone = there - now
        if len(gone) > 1:
            raise IdentifyError(f"{', '.join(sorted(gone))} vanished together; unplug one alone")
        if gone <= set(chosen):
            raise IdentifyError(f"{gone.pop()} is the primary already; start again")
        say(f"  it was {next(iter(gone))}; plug it in again, at the same port ...")
        _settled(look, clock, lambda now: now >= there)
        chosen += gone
    return chosen[0], chosen[1]
