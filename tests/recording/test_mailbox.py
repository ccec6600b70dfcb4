"""What the mailbox drops when it is full."""

from __future__ import annotations

import threading
import time

import pytest

from calm_edge.recording import RecordingError
from calm_edge.recording.mailbox import Mailbox


def drain(mailbox: Mailbox[str]) -> list[str]:
    items = []
    while (item := mailbox.take(0)) is not None:
        items.append(item)
    return items


def test_items_of_both_kinds_come_out_in_order_of_arrival() -> None:
    mailbox: Mailbox[str] = Mailbox(100)
    for i, is_image in enumerate([True, False, False, True, False]):
        mailbox.put(str(i), 1, is_image)
    assert drain(mailbox) == list("01234")


def test_the_oldest_item_that_is_not_an_image_is_dropped_first() -> None:
    mailbox: Mailbox[str] = Mailbox(4)
    for name, is_image in [("i0", True), ("p0", False), ("p1", False), ("i1", True)]:
        mailbox.put(name, 1, is_image)
    mailbox.put("i2", 1, True)
    assert mailbox.dropped == (1, 0)
    mailbox.put("i3", 1, True)
    assert mailbox.dropped == (2, 0)
    mailbox.put("i4", 1, True)
    assert mailbox.dropped == (2, 1)
    assert drain(mailbox) == ["i1", "i2", "i3", "i4"]


def test_an_image_is_not_dropped_for_another_item() -> None:
    mailbox: Mailbox[str] = Mailbox(2)
    mailbox.put("i0", 1, True)
    mailbox.put("i1", 1, True)
    mailbox.put("p", 1, False)
    assert drain(mailbox) == ["i0", "i1"]
    assert mailbox.dropped == (1, 0)


def test_a_single_item_larger_than_the_capacity_is_accepted() -> None:
    mailbox: Mailbox[str] = Mailbox(2)
    mailbox.put("huge", 10, True)
    assert drain(mailbox) == ["huge"]
    assert mailbox.fill == 0


def test_lossless_waits_for_room() -> None:
    mailbox: Mailbox[str] = Mailbox(1, lossless=True)
    mailbox.put("a", 1, True)
    thread = threading.Thread(target=mailbox.put, args=("b", 1, True))
    thread.start()
    time.sleep(0.05)
    assert thread.is_alive()
    assert mailbox.take(1) == "a"
    thread.join(2)
    assert not thread.is_alive()
    assert drain(mailbox) == ["b"]
    assert mailbox.dropped == (0, 0)


def test_lossless_put_raises_if_the_disk_fails() -> None:
    mailbox: Mailbox[str] = Mailbox(1, lossless=True)
    mailbox.put("a", 1, True)
    threading.Timer(0.05, mailbox.set_broken, ["disk full"]).start()
    with pytest.raises(RecordingError, match="disk full"):
        mailbox.put("b", 1, True)


def test_a_closed_mailbox_rejects_items_but_can_be_emptied() -> None:
    mailbox: Mailbox[str] = Mailbox(5)
    mailbox.put("a", 1, False)
    mailbox.close()
    with pytest.raises(RecordingError, match="closed"):
        mailbox.put("b", 1, False)
    assert drain(mailbox) == ["a"]


def test_clear_counts_the_dropped_items() -> None:
    mailbox: Mailbox[str] = Mailbox(5)
    mailbox.put("a", 1, False)
    mailbox.put("b", 1, True)
    assert mailbox.clear() == 2
    assert mailbox.dropped == (1, 1)
