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


def test_a_damaged_content_ends_the_request_that_reads_it_and_not_the_server(
    discs: PlannerService, tmp_path: Path
) -> None:
    store = Store(tmp_path)
    scene = store.put_scene("cell", "0" * 64, b'{"name": "cell"}')
    work = json.dumps({"body": "{}", "sources": {"scene": scene.content}, "deadline": None}).encode()
    job, _ = store.accept("plans", work, request=work, uses=[scene.content])
    (damaged,) = (file for file in (tmp_path / "contents").rglob("*") if file.name.endswith(scene.content[-8:]))
    damaged.write_bytes(b"other")
    server = PlanningServer(discs.world, store, NoWorkers(), capacity=1, poll=0.01)

    async def started() -> State:
        await server.start()
        found = store.job(job.id).state
        await server.stop()
        return found

    assert asyncio.run(started()) is State.REFUSED
