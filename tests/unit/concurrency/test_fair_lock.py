"""The fair lock: first come, first served."""

from __future__ import annotations

import threading

import pytest

from planner_service.collision.budget import Cancelled
from planner_service.concurrency.fair_lock import FairLock


def test_threads_get_their_turns_in_the_order_in_which_they_asked() -> None:
    turns, served, threads = FairLock(), list[int](), list[threading.Thread]()

    def take(k: int, queued: threading.Event) -> None:
        queued.set()
        turns.hold(lambda: served.append(k))

    def queue() -> None:
        for k in range(8):
            queued = threading.Event()
            threads.append(threading.Thread(target=take, args=(k, queued)))
            threads[-1].start()
            queued.wait()
            while turns.waiting <= k:  # the thread has said it will ask; wait until it has asked
                pass

    turns.hold(queue)
    for thread in threads:
        thread.join()
    assert served == list(range(8))


def test_a_caller_who_waits_no_more_leaves_the_queue() -> None:
    turns = FairLock()

    def impatient() -> None:
        raise Cancelled

    def served() -> None:
        raise AssertionError("a cancelled caller got a turn")

    def first() -> None:
        with pytest.raises(Cancelled):
            turns.hold(served, impatient)

    turns.hold(first)
    assert turns.hold(lambda: turns.waiting) == 0
