"""The engine of many machines: Ray actors, wherever a cluster has cores. The only import of ray."""

from __future__ import annotations

import socket
import traceback
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.parallel.engine import Answers, Limit, Work
from planner_service.parallel.events import Event, Gone, Raised, Ready, outcome
from planner_service.parallel.processes import available_cores, require_workers
from planner_service.parallel.scheduler import Schedule

__all__ = ["Ray"]

PATIENCE = 5.0
"""Seconds for a cluster's head to take a connection."""

Item = TypeVar("Item")
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Ray:
    """Answers on a Ray cluster, whose machines have this package installed in the same version.

    A cluster that this process is connected to is used, and left as it is. Else one is connected to, or started, and
    left again when all is answered.

    Attributes:
        address: Of a running cluster, such as ``"auto"`` or ``"ray://head:10001"``; None to start one on this machine.
        workers: How many at most; None for one on each core of the cluster.

    Raises:
        InvalidRequest: no number of workers, or no address.
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
            InvalidRequest: there is no cluster at the address.
        """
        return Schedule(_Crew(self, work), items, limit)


def _ray() -> Any:
    try:
        import ray  # 0.6 s
    except ImportError as error:
        raise MissingDependency("ray", "ray") from error
    return ray


class _Actor:
    """A worker, in a process of its own."""

    def prepare(self, work: Work[Any, Any]) -> tuple[Event, str]:
        """Take the work; tells on which node."""
        self._work = work
        try:
            work.prepare()
        except Exception as error:
            return Raised(error, traceback.format_exc()), ""
        return Ready(), _ray().get_runtime_context().get_node_id()

    def answer(self, item: Any) -> Event:
        """What an item comes to."""
        return outcome(self._work, item)


@dataclass(eq=False)
class _Hand:
    """An actor, what it has been asked and not yet told, in order, and on which node it is, once that is known."""

    actor: Any
    asked: deque[Any] = field(default_factory=deque)
    node: str = ""


class _Crew:
    def __init__(self, engine: Ray, work: Work[Any, Any]) -> None:
        self._ray = _ray()
        self._ours = not self._ray.is_initialized()
        if self._ours:
            _connect(self._ray, engine)
        self.size = engine.workers or max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        self._kind = self._ray.remote(num_cpus=1, max_restarts=0)(_Actor)
        self._work = self._ray.put(work)

    def hire(self) -> _Hand:
        actor = self._kind.remote()
        return _Hand(actor, deque([actor.prepare.remote(self._work)]))

    def give(self, hand: _Hand, item: Any) -> None:
        hand.asked.append(hand.actor.answer.remote(item))

    def look(self, hands: Sequence[_Hand], timeout: float | None) -> list[tuple[_Hand, Event]]:
        asked = {hand.asked[0]: hand for hand in hands if hand.asked}
        if not asked:
            return []
        ready, others = self._ray.wait(list(asked), timeout=timeout)
        if ready and others:
            ready += self._ray.wait(others, num_returns=len(others), timeout=0)[0]
        return [(asked[ref], self._heard(asked[ref])) for ref in ready]

    def _heard(self, hand: _Hand) -> Event:
        try:
            told: Event | tuple[Event, str] = self._ray.get(hand.asked.popleft())
        except self._ray.exceptions.RayTaskError as error:  # what was sent, or was to be, cannot be read there
            return Raised(error.cause if isinstance(error.cause, Exception) else error, str(error))
        except self._ray.exceptions.RayError as error:
            return Gone(_in_short(error), blameless=self._is_lost(hand.node))
        if isinstance(told, tuple):
            event, hand.node = told
            return event
        return told

    def _is_lost(self, node: str) -> bool:
        """Whether a whole machine is no more, for which its workers' items are not to blame."""
        return bool(node) and all(one["NodeID"] != node or not one["Alive"] for one in self._ray.nodes())

    def end(self, hands: Sequence[_Hand]) -> None:
        for hand in hands:
            self._ray.kill(hand.actor)

    def close(self) -> None:
        if self._ours:
            self._ray.shutdown()


def _in_short(error: Exception) -> str:
    """What Ray says of a worker's end, without what it says at length of every end."""
    told = " ".join(str(error).split()).partition(" Some common causes")[0]
    return told[told.find("The actor is dead because") :] if "The actor is dead because" in told else told


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
    """Within the block a cluster that is begun listens on the loopback address only: others could run code in it.

    Ray does so on systems where it supports no clusters, which nothing but this says; an address that is given to it
    as 127.0.0.1 it replaces by one that others reach.
    """
    from ray._private import ray_constants

    before = ray_constants.ENABLE_RAY_CLUSTER
    ray_constants.ENABLE_RAY_CLUSTER = False
    try:
        yield
    finally:
        ray_constants.ENABLE_RAY_CLUSTER = before


def _require_listener(address: str) -> None:
    """Raise an OSError if nothing listens at an address with a port: Ray would look for it for minutes.

    Others, such as ``auto``, are names that Ray knows.
    """
    host, _, port = address.removeprefix("ray://").partition("/")[0].rpartition(":")
    if host and port.isdecimal() and int(port) <= 65_535:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=PATIENCE):
            pass
