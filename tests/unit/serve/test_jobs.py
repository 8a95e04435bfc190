"""Requests are handed to workers in their order, and each ends once."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest

from planner_service.parallel.pool import Answered, Died, Noted, Raised
from planner_service.serve import jobs
from planner_service.serve.jobs import Dispatcher, Task
from planner_service.serve.work import Answer, Assignment, Cancellation, Ending
from tests.support.workers import ScriptedWorkers


@dataclass
class Heard:
    """What a dispatcher tells.

    Attributes:
        failing: Whether each call raises once it is noted.
    """

    failing: bool = False
    ends: dict[str, Any] = field(default_factory=dict)
    retries: list[str] = field(default_factory=list)

    def started(self, task: Task) -> None:
        self._fail()

    def noted(self, task: Task, note: Any) -> None:
        self._fail()

    def retried(self, task: Task) -> None:
        self.retries.append(task.id)
        self._fail()

    def ended(self, task: Task, outcome: Answer | Ending | Raised) -> None:
        assert task.id not in self.ends
        self.ends[task.id] = outcome
        self._fail()

    def _fail(self) -> None:
        if self.failing:
            raise OSError("no room on the disk")


@contextmanager
def dispatching(workers: int, *, failing: bool = False) -> Iterator[tuple[ScriptedWorkers, Heard, Dispatcher[int]]]:
    backend, heard = ScriptedWorkers(workers), Heard(failing)
    backend.allowed.set()
    dispatcher = Dispatcher(backend, heard, 0.001)
    dispatcher.start()
    try:
        yield backend, heard, dispatcher
    finally:
        dispatcher.stop()


def until(holds: Callable[[], bool]) -> None:
    """Wait for the dispatcher's thread."""
    end, pause = time.monotonic() + 10.0, threading.Event()
    while not holds():
        assert time.monotonic() < end
        pause.wait(0.001)


def task(name: str, **settings: Any) -> Task:
    return Task(Assignment(name, "plans"), **settings)


def answer(name: str) -> Answer:
    return Answer(name.encode(), True)


def test_each_worker_has_one_request_and_gets_the_next_when_it_has_answered() -> None:
    with dispatching(2) as (workers, heard, dispatcher):
        for name in "abc":
            dispatcher.submit(task(name))
        until(lambda: len(workers.sent) == 2)
        assert sorted(workers.sent) in ([(1, "a"), (2, "b")], [(1, "b"), (2, "a")])
        assert (dispatcher.position("c"), dispatcher.position("a"), dispatcher.running) == (0, None, 2)
        (worker,) = (worker for worker, name in workers.sent if name == "b")
        workers.events.put((worker, Answered(answer("b"))))
        until(lambda: "b" in heard.ends)
        assert workers.sent[-1] == (worker, "c")
        assert list(heard.ends) == ["b"]


def test_a_request_is_tried_again_once_and_lost_with_its_second_worker() -> None:
    with dispatching(1) as (workers, heard, dispatcher):
        dispatcher.submit(task("a"))
        dispatcher.submit(task("b"))
        for worker in (1, 2):
            until(lambda worker=worker: (worker, "a") in workers.sent)  # type: ignore[misc]
            workers.events.put((worker, Died("it was ended")))
        until(lambda: (3, "b") in workers.sent)
        assert heard.retries == ["a"]
        assert heard.ends == {"a": Ending.LOST}


def test_a_worker_that_does_not_end_what_was_cancelled_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "GRACE", 0.0)
    with dispatching(1) as (workers, heard, dispatcher):
        dispatcher.submit(task("a"))
        until(lambda: (1, "a") in workers.sent)
        assert dispatcher.cancel("a")
        until(lambda: "a" in heard.ends)
        assert workers.told == [(1, Cancellation("a", Ending.CANCELLED))]
        assert workers.killed == [1]
        assert heard.ends == {"a": Ending.CANCELLED}
        assert not dispatcher.cancel("a")


def test_a_deadline_ends_what_waits_and_tells_the_worker_of_what_runs() -> None:
    with dispatching(1) as (workers, heard, dispatcher):
        dispatcher.submit(task("a"))
        until(lambda: (1, "a") in workers.sent)
        dispatcher.submit(task("b", deadline=time.monotonic()))
        until(lambda: "b" in heard.ends)
        assert heard.ends == {"b": Ending.DEADLINE}
        assert workers.told == []


def test_whatever_the_listener_raises_every_request_ends_and_no_worker_is_lost() -> None:
    with dispatching(2, failing=True) as (workers, heard, dispatcher):
        for name in "abcd":
            dispatcher.submit(task(name))
        dispatcher.submit(task("e", deadline=time.monotonic()))
        until(lambda: "e" in heard.ends and len(workers.sent) == 2)
        workers.events.put((1, Noted("half")))
        workers.events.put((1, Died("it was ended")))
        for _ in "abcd":
            until(lambda: len(workers.sent) > len(heard.ends) - 1 + len(heard.retries))
            worker, name = next((w, n) for w, n in reversed(workers.sent) if n not in heard.ends and w != 1)
            workers.events.put((worker, Answered(answer(name))))
            until(lambda name=name: name in heard.ends)  # type: ignore[misc]
        assert len(heard.retries) == 1
        assert (dispatcher.running, dispatcher.waiting, workers.killed) == (0, 0, [])
