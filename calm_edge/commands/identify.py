"""Identify the primary and the assistant camera by unplugging them one at a time."""

from __future__ import annotations

from collections.abc import Callable

from calm_edge.types import CalmEdgeError
from device.clock import NS_PER_S, Clock

POLL_NS = NS_PER_S // 2
# enough to walk around a car; limited, so that a forgotten command ends
TIMEOUT_NS = 300 * NS_PER_S


class IdentifyError(CalmEdgeError):
    """The cameras could not be identified."""


def _wait_until(
    addresses: Callable[[], set[str]], clock: Clock, done: Callable[[set[str]], bool]
) -> set[str]:
    """Return the addresses once `done` is true for two equal polls in a row.

    Two polls, as contacts bounce while a plug is pulled. Raises IdentifyError after TIMEOUT_NS.
    """
    limit_ns = clock.now_ns() + TIMEOUT_NS
    previous: set[str] | None = None
    while clock.now_ns() < limit_ns:
        now = addresses()
        if done(now) and now == previous:
            return now
        previous = now
        clock.sleep_until_ns(clock.now_ns() + POLL_NS)
    raise IdentifyError(f"no change within {TIMEOUT_NS // NS_PER_S} s; start again")


def by_unplugging(
    addresses: Callable[[], set[str]], clock: Clock, say: Callable[[str], None]
) -> tuple[str, str]:
    """Prompt to unplug cameras and return the addresses (primary, assistant).

    addresses: returns the addresses plugged in now. say: shows a prompt. Raises IdentifyError.
    """
    present = addresses()
    if len(present) < 2:
        raise IdentifyError(f"{len(present)} camera(s) found, two are needed; plug in both")
    chosen: list[str] = []
    for role in ("primary (its path is the trajectory)", "assistant (it gives the scale)"):
        left = present - set(chosen)
        if chosen and len(left) == 1:
            chosen += left
            break
        say(f"unplug the camera that is to be the {role} ...")
        now = _wait_until(addresses, clock, lambda now: now < present)
        gone = present - now
        if len(gone) > 1:
            raise IdentifyError(
                f"{', '.join(sorted(gone))} vanished together; start again and unplug only one"
            )
        if gone <= set(chosen):
            raise IdentifyError(f"{gone.pop()} is the primary already; start again")
        say(f"  it is {next(iter(gone))}; plug it in again, at the same port ...")
        _wait_until(addresses, clock, lambda now: now >= present)
        chosen += gone
    return chosen[0], chosen[1]
