"""Requests on their way to workers: a queue, workers that are kept alive, deadlines, and cancellation.

Unlike ``parallel.pool``, which answers in the order of the items, this hands out each answer when it is there.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, ParamSpec, Protocol, TypeVar

from planner_service.parallel.pool import Answered, Backend, Died, Event, Noted, Raised
from planner_service.serve.work import Answer, Assignment, Cancellation, Ending, Following

__all__ = ["Dispatcher", "Listener", "Task"]

logger = logging.getLogger(__name__)

Worker = TypeVar("Worker")
Told = ParamSpec("Told")

GRACE = 5.0
"""Seconds that a cancelled request may take to end; then its worker is ended."""

MAX_DEATHS = 2
"""Workers that a request may take with it."""

START_PAUSE = 1.0
"""Seconds before another worker is started after one that died before it was ready."""


@dataclass(eq=False)
class Task:
    """A request that waits or is carried out.

    Attributes:
        deadline: On the clock ``time.monotonic``.
        deaths: Workers that died of it.
        ending: Why it is being ended.
        kill_at: When its worker is ended if it has not obeyed.
        followed: Whether its stages are noted as they end.
    """

    assignment: Assignment
    deadline: float | None = None
    deaths: int = 0
    ending: Ending | None = None
    kill_at: float | None = None
    followed: bool = False

    @property
    def id(self) -> str:
        """The id of its job."""
        return self.assignment.id


class Listener(Protocol):
    """Hears how tasks go on and end; called from several threads. What it raises is logged, and changes nothing."""

    def started(self, task: Task) -> None:
        """A worker is about to get it; do not call the dispatcher from here."""

    def noted(self, task: Task, note: Any) -> None:
        """Its worker has sent a note."""

    def retried(self, task: Task) -> None:
        """Its worker was lost; another one will have it. Do not call the dispatcher from here."""

    def ended(self, task: Task, outcome: Answer | Ending | Raised) -> None:
        """It has an answer, or never will; ``Raised`` is a bug of ours."""


@dataclass(eq=False)
class _State:
    ready: bool = False
    task: Task | None = None


@dataclass(eq=False)
class Dispatcher(Generic[Worker]):
    """Hands tasks to the workers of a backend, in the order in which they come.

    Attributes:
        poll: Seconds after which it looks at tasks that were handed out meanwhile; a backend whose ``receive`` sees
            their answers anyway needs none.
    """

    backend: Backend[Worker]
    listener: Listener
    poll: float
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _queue: deque[Task] = field(default_factory=deque)
    _workers: dict[Worker, _State] = field(default_factory=dict)
    _stopping: threading.Event = field(default_factory=threading.Event)
    _start_at: float = 0.0

    def start(self) -> None:
        """Start the workers."""
        self._start_missing()
        self._thread = threading.Thread(target=self._run, name="dispatcher", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the workers; tasks that have no answer get none, but those that were to end do."""
        self._stopping.set()
        self._thread.join()
        self.backend.kill(list(self._workers))
        self.backend.close()
        for state in self._workers.values():
            if state.task is not None and state.task.ending is not None:
                self._announce(self.listener.ended, state.task, state.task.ending)

    @property
    def ready(self) -> bool:
        """Whether there is a worker that can plan."""
        return any(state.ready for state in list(self._workers.values()))

    @property
    def waiting(self) -> int:
        """How many tasks no worker has begun."""
        return len(self._queue)

    @property
    def running(self) -> int:
        """How many tasks workers are at."""
        return sum(state.task is not None for state in list(self._workers.values()))

    def position(self, job: str) -> int | None:
        """How many tasks come before one that waits; None if it does not."""
        with self._lock:
            return next((k for k, task in enumerate(self._queue) if task.id == job), None)

    def submit(self, task: Task) -> None:
        """Have a task carried out."""
        with self._lock:
            self._queue.append(task)
            self._hand_out()

    def cancel(self, job: str, ending: Ending = Ending.CANCELLED) -> bool:
        """End a task soon; False if there is none with that id."""
        with self._lock:
            waiting = next((task for task in self._queue if task.id == job), None)
            if waiting is not None:
                self._queue.remove(waiting)
            else:
                worker = next((w for w, s in self._workers.items() if s.task is not None and s.task.id == job), None)
                if worker is None:
                    return False
                self._tell_to_end(worker, ending)
        if waiting is not None:
            self._announce(self.listener.ended, waiting, ending)
        return True

    def follow(self, job: str) -> None:
        """Have the stages of a task noted as they end, from the first on; else they come with its answer."""
        with self._lock:
            for task in self._queue:
                task.followed |= task.id == job
            for worker, state in self._workers.items():
                if state.task is not None and state.task.id == job and not state.task.followed:
                    state.task.followed = True
                    self.backend.tell(worker, Following(job))

    def _announce(self, told: Callable[Told, None], *what: Told.args, **named: Told.kwargs) -> None:
        """Tell the listener something."""
        try:
            told(*what, **named)
        except Exception:  # whatever it is, tasks and workers go on
            logger.exception("the outcome of a task could not be recorded")

    def _tell_to_end(self, worker: Worker, ending: Ending) -> None:
        task = self._workers[worker].task
        if task is not None and task.ending is None:
            task.ending, task.kill_at = ending, time.monotonic() + GRACE
            self.backend.tell(worker, Cancellation(task.id, ending))

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                for worker, event in self.backend.receive(list(self._workers), self.poll):
                    self._handle(worker, event)
                self._end_overdue()
                self._start_missing()
            except Exception:  # whatever it is, the other tasks go on
                logger.exception("the dispatcher goes on after an error")
                self._stopping.wait(START_PAUSE)

    def _start_missing(self) -> None:
        if time.monotonic() >= self._start_at:
            while len(self._workers) < self.backend.max_workers:
                worker = self.backend.start()
                with self._lock:
                    self._workers[worker] = _State()

    def _handle(self, worker: Worker, event: Event) -> None:
        state = self._workers[worker]
        task = state.task
        if isinstance(event, Noted):
            if task is not None:
                self._announce(self.listener.noted, task, event.value)
            return
        if isinstance(event, Died) or not state.ready:
            if isinstance(event, Answered):
                state.ready = True
                self._go_on(state)
            else:
                self._lose(worker, event)
            return
        self._go_on(state)
        if task is not None:
            outcome = event if isinstance(event, Raised) else event.value
            if task.deadline is not None and task.deadline <= time.monotonic():
                outcome = Ending.DEADLINE
            self._announce(self.listener.ended, task, outcome)

    def _go_on(self, state: _State) -> None:
        """Give a worker that has answered its next task."""
        with self._lock:
            state.task = None
            self._hand_out()

    def _hand_out(self) -> None:
        """Give tasks to workers that wait for one, as far as there are any."""
        for worker, state in self._workers.items():
            if not self._queue:
                return
            if state.ready and state.task is None:
                state.task = self._queue.popleft()
                self._announce(self.listener.started, state.task)
                self.backend.send(worker, state.task.assignment)
                if state.task.followed:
                    self.backend.tell(worker, Following(state.task.id))

    def _lose(self, worker: Worker, event: Event) -> None:
        """Go on without a worker that has died, or cannot plan."""
        with self._lock:
            state = self._workers.pop(worker)
            task = state.task
            again = False
            if task is not None:
                task.deaths += not (isinstance(event, Died) and event.blameless)
                again = task.ending is None and task.deaths < MAX_DEATHS
                if again:
                    self._announce(self.listener.retried, task)
                    self._queue.appendleft(task)
                    self._hand_out()
        if not isinstance(event, Died):
            self.backend.kill([worker])
        detail = event.detail if isinstance(event, Died) else getattr(event, "traceback", event)
        logger.warning("a worker was lost: %s", detail)
        if not state.ready:
            self._start_at = time.monotonic() + START_PAUSE
        if task is not None and not again:
            self._announce(self.listener.ended, task, task.ending or Ending.LOST)

    def _end_overdue(self) -> None:
        """End tasks whose deadline has passed, and workers that do not end what was cancelled."""
        now = time.monotonic()
        with self._lock:
            overdue = [task for task in self._queue if task.deadline is not None and task.deadline <= now]
            for task in overdue:
                self._queue.remove(task)
            for worker, state in self._workers.items():
                if state.task is not None and state.task.deadline is not None and state.task.deadline <= now:
                    self._tell_to_end(worker, Ending.DEADLINE)
            stuck = [w for w, s in self._workers.items() if s.task and s.task.kill_at and s.task.kill_at <= now]
        for task in overdue:
            self._announce(self.listener.ended, task, Ending.DEADLINE)
        for worker in stuck:
            self.backend.kill([worker])
            self._lose(worker, Died("it did not end what was cancelled"))
