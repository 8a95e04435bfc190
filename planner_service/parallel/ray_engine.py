"""The engine of many machines: Ray actors, wherever a cluster has cores. The only module that imports ray."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, TypeVar

from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.parallel.engine import Answers, Limit, TalkingWork, Work
from planner_service.parallel.pool import Backend, Died, Event, Noted, Raised, WorkerPool, outcome, prepare_and_freeze
from planner_service.parallel.processes import available_cores, require_workers

__all__ = ["Ray"]

CONNECT_SECONDS = 5.0
"""How long a cluster's head may take to accept a connection."""

NOTES = "notes"
"""The thread of an actor in which notes arrive while it is at an item."""

Item = TypeVar("Item")
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Ray:
    """Answers on a Ray cluster, whose machines have the same version of this package.

    A cluster that this process is connected to already is used and stays connected. Else one is connected to, or
    started, and left when all items are answered.

    Attributes:
        address: Of a running cluster, such as ``"auto"`` or ``"ray://head:10001"``; None to start one on this machine.
        workers: The most there may be; None for one on each core of the cluster.

    Raises:
        InvalidRequest: ``workers`` is not a whole number from 1 to 10,000, or ``address`` is empty or not a string.
        MissingDependency: ray is not installed.
    """

    address: str | None = None
    workers: int | None = None

    def __post_init__(self) -> None:
        require_workers(self.workers)
        if self.address is not None and not (isinstance(self.address, str) and self.address):
            raise InvalidRequest("address", self.address, "the address of a Ray cluster, or None")
        _ray()

    def run(
        self, work: Work[Item, Answer], items: Iterable[Item], *, limit: Limit[Any] | None = None
    ) -> Answers[Answer]:
        """See ``Engine``.

        Raises:
            InvalidRequest: There is no cluster at the address.
        """
        return WorkerPool(self.backend(work), items, limit)

    def backend(self, work: Work[Any, Any]) -> Backend[_Worker]:
        """What starts workers for a work, and talks to them.

        Raises:
            InvalidRequest: There is no cluster at the address.
        """
        return _Backend(self, work)


def _ray() -> Any:
    try:
        import ray  # 0.6 s
    except ImportError as error:
        raise MissingDependency("ray", "ray") from error
    return ray


class _Actor:
    """A worker in a process of its own."""

    def prepare(self, work: Work[Any, Any]) -> tuple[Event, str]:
        """Take the work; returns the event and the id of the actor's machine."""
        self._work: Any = work
        self._events: SimpleQueue[Event] = SimpleQueue()
        if isinstance(work, TalkingWork):
            work.connect(lambda note: self._events.put(Noted(note)))
        return outcome(prepare_and_freeze, work), _ray().get_runtime_context().get_node_id()

    def answer(self, item: Any) -> Event:
        """What an item comes to."""
        return outcome(self._work, item)

    def events(self, item: Any) -> Iterator[Event]:
        """The notes that the work sends at an item, as they come, and what the item comes to."""
        threading.Thread(target=lambda: self._events.put(outcome(self._work, item)), daemon=True).start()
        while True:
            event = self._events.get()
            yield event
            if not isinstance(event, Noted):
                return

    def tell(self, note: Any) -> None:
        """Hand a note to the work."""
        self._work.told(note)


@dataclass(eq=False)
class _Worker:
    """An actor, the answer or the stream of events that it owes, and the id of its machine once that is known."""

    actor: Any
    pending: Any
    node: str = ""


class _Backend:
    def __init__(self, engine: Ray, work: Work[Any, Any]) -> None:
        self._ray = _ray()
        self._ours = not self._ray.is_initialized()
        if self._ours:
            _connect(self._ray, engine)
        self.max_workers = engine.workers or max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        self._talks = isinstance(work, TalkingWork)
        groups = {"concurrency_groups": {NOTES: 1}} if self._talks else {}  # threads beside the one of the items
        self._kind = self._ray.remote(num_cpus=1, max_restarts=0, **groups)(_Actor)
        self._work = self._ray.put(work)

    def start(self) -> _Worker:
        actor = self._kind.remote()
        return _Worker(actor, actor.prepare.remote(self._work))

    def send(self, worker: _Worker, item: Any) -> None:
        if self._talks:
            worker.pending = worker.actor.events.options(num_returns="streaming").remote(item)
        else:
            worker.pending = worker.actor.answer.remote(item)

    def tell(self, worker: _Worker, note: Any) -> None:
        worker.actor.tell.options(concurrency_group=NOTES).remote(note)

    def receive(self, workers: Sequence[_Worker], timeout: float | None) -> list[tuple[_Worker, Event]]:
        pending = {worker.pending: worker for worker in workers if worker.pending is not None}
        if not pending:
            return []
        ready, others = self._ray.wait(list(pending), timeout=timeout)
        if ready and others:
            ready += self._ray.wait(others, num_returns=len(others), timeout=0)[0]
        return [(pending[ref], self._received(pending[ref])) for ref in ready]

    def _received(self, worker: _Worker) -> Event:
        pending, worker.pending = worker.pending, None
        try:
            streams = isinstance(pending, self._ray.ObjectRefGenerator)
            answer: Event | tuple[Event, str] = self._ray.get(next(pending) if streams else pending)
        except self._ray.exceptions.RayTaskError as error:  # the item cannot be read there, or its answer not be sent
            return Raised(error.cause if isinstance(error.cause, Exception) else error, str(error))
        except self._ray.exceptions.RayError as error:
            return Died(_in_short(error), blameless=self._has_lost(worker.node))
        if isinstance(answer, tuple):
            event, worker.node = answer
            return event
        if isinstance(answer, Noted):
            worker.pending = pending
        return answer

    def _has_lost(self, node: str) -> bool:
        """Whether a whole machine has left the cluster, which is not the fault of its workers' items."""
        return bool(node) and all(one["NodeID"] != node or not one["Alive"] for one in self._ray.nodes())

    def kill(self, workers: Sequence[_Worker]) -> None:
        for worker in workers:
            self._ray.kill(worker.actor)

    def close(self) -> None:
        if self._ours:
            self._ray.shutdown()


def _in_short(error: Exception) -> str:
    """Ray's message about a worker's death, without the general advice that follows it."""
    message = " ".join(str(error).split()).partition(" Some common causes")[0]
    return message[max(0, message.find("The actor is dead because")) :]


def _connect(ray: Any, engine: Ray) -> None:
    quiet: dict[str, Any] = {"logging_level": "ERROR", "log_to_driver": False}
    if engine.address is None:
        with _on_this_machine_alone():
            ray.init(address="local", num_cpus=engine.workers or available_cores(), include_dashboard=False, **quiet)
        return
    try:
        _require_listener(engine.address)
        ray.init(address=engine.address, **quiet)
    except (OSError, ValueError) as error:
        raise InvalidRequest("address", engine.address, f"that of a running Ray cluster ({error})") from error


@contextmanager
def _on_this_machine_alone() -> Iterator[None]:
    """Have a cluster that is started in the block listen on the loopback address only: others could run code in it.

    Ray does so on systems where it supports no clusters, and nothing but this setting says so; the address 127.0.0.1
    it would replace by one that others reach.
    """
    from ray._private import ray_constants

    before = ray_constants.ENABLE_RAY_CLUSTER
    ray_constants.ENABLE_RAY_CLUSTER = False
    try:
        yield
    finally:
        ray_constants.ENABLE_RAY_CLUSTER = before


def _require_listener(address: str) -> None:
    """Raise an OSError if nothing listens at an address with a port: Ray would try to connect for minutes.

    Addresses without a port, such as ``auto``, are left to Ray.
    """
    host, _, port = address.removeprefix("ray://").partition("/")[0].rpartition(":")
    if host and port.isdecimal() and int(port) <= 65_535:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_SECONDS):
            pass
