"""A server that starts again goes on with what it can."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from planner_service import PlannerService
from planner_service.parallel.pool import Event
from planner_service.serve.server import PlanningServer
from planner_service.serve.state.store import State, Store


class NoWorkers:
    """A backend that starts none."""

    max_workers = 0

    def start(self) -> Any:
        raise AssertionError

    def send(self, worker: Any, item: Any) -> None:
        raise AssertionError

    def tell(self, worker: Any, note: Any) -> None:
        raise AssertionError

    def receive(self, workers: Sequence[Any], timeout: float | None) -> list[tuple[Any, Event]]:
        time.sleep(0.01)
        return []

    def kill(self, workers: Sequence[Any]) -> None:
        assert not workers

    def close(self) -> None:
        pass


BODY = b'{"scene": "cell", "planner": {"name": "prm"}}'


def accepted(store: Store, content: str) -> str:
    """The id of a job that grows a roadmap in a scene."""
    work = json.dumps({"body": BODY.decode(), "sources": {"scene": content}, "deadline": None}).encode()
    return store.accept("roadmaps", work, request=BODY, uses=[content])[0].id


def states_after_start(service: PlannerService, store: Store) -> list[State]:
    """What has become of all jobs, the first one first, once a server has started."""

    async def started() -> list[State]:
        server = PlanningServer(service.world, store, NoWorkers(), capacity=1, poll=0.01)
        await server.start()
        found = [job.state for job in reversed(store.jobs())]
        await server.stop()
        return found

    return asyncio.run(started())


def test_a_damaged_content_ends_the_request_that_reads_it_and_not_the_server(
    discs: PlannerService, tmp_path: Path
) -> None:
    store = Store(tmp_path)
    scene = store.put_scene("cell", "0" * 64, b'{"name": "cell"}')
    accepted(store, scene.content)
    (damaged,) = (file for file in (tmp_path / "contents").rglob("*") if file.name.endswith(scene.content[-8:]))
    damaged.write_bytes(b"other")
    assert states_after_start(discs, store) == [State.REFUSED]


def test_a_request_that_was_under_way_when_two_servers_were_killed_is_lost(
    discs: PlannerService, tmp_path: Path
) -> None:
    store = Store(tmp_path)
    scene = store.put_scene("cell", "0" * 64, b'{"name": "cell"}')
    first, second, _ = (accepted(store, scene.content) for _ in range(3))
    for job in (first, second, first):
        store.start(job)
    assert states_after_start(discs, store) == [State.LOST, State.RUNNING, State.QUEUED]
    store = Store(tmp_path)
    answer = json.loads(store.answer(first)[1] or b"")
    assert (answer["status"], answer["reason"]) == (503, "WORKER_LOST")
    store.close()
