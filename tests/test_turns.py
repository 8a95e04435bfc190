"""Turns: first come, first served."""

from __future__ import annotations

import threading

import pytest

from planner_service.collision.ledger import Cancelled, CancelToken
from planner_service.turns import Turns


def test_threads_get_their_turns_in_the_order_in_which_they_asked() -> None:
    turns, served, threads = Turns(), list[int](), list[threading.Thread]()

    def take(k: int, queued: threading.Event) -> None:
        queued.set()
        with turns.taken():
            served.append(k)

    with turns.taken():
        for k in range(8):
            queued = threading.Event()
            threads.append(threading.Thread(target=take, args=(k, queued)))
            threads[-1].start()
            queued.wait()
            while turns.waiting <= k:  # the thread has said it will ask; wait until it has asked
                pass
    for thread in threads:
        thread.join()
    assert served == list(range(8))


def test_a_turn_is_given_back_when_its_holder_fails() -> None:
    turns = Turns()
    with pytest.raises(ZeroDivisionError), turns.taken():
        1 / 0  # noqa: B018
    with turns.taken():
        assert turns.waiting == 0


def test_a_cancelled_caller_leaves_the_queue() -> None:
    turns, token = Turns(), CancelToken()
    token.cancel()
    with turns.taken(), pytest.raises(Cancelled), turns.taken(token):
        raise AssertionError("a cancelled caller got a turn")
    with turns.taken():
        assert turns.waiting == 0
