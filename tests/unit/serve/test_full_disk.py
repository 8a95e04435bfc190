"""A disk without room costs time, not answers: what was planned meanwhile is told once it can be kept."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from planner_service import PlannerService
from planner_service.planning.request import World
from planner_service.serve import server as servers
from planner_service.serve.server import PlanningServer, StoredAnswer
from planner_service.serve.state.store import State, StateUnusable, Store
from planner_service.serve.work import Answer
from tests.support.optional import present
from tests.support.workers import ScriptedWorkers

BODY = b'{"scene": "cell", "planner": {"name": "prm"}}'


class Disk(Store):
    """A store on a disk that may be full.

    Attributes:
        room: Bytes of the longest answer for which there is room; None if nothing can be written.
        refused: How often something could not be.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.room: int | None = 10**9
        self.refused = 0

    def start(self, job: str) -> int | None:
        self._require(0)
        return super().start(job)

    def end(self, job: str, state: State, answer: bytes | None = None, **about: Any) -> bool:
        self._require(len(answer or b""))
        return super().end(job, state, answer, **about)

    def _require(self, room: int) -> None:
        if self.room is None or room > self.room:
            self.refused += 1
            raise StateUnusable("index.db", ["cannot be written: database or disk is full"])


def _echo(job: str) -> bytes:
    return json.dumps({"id": job, "much": "." * 1000}).encode()


async def until(happened: Callable[[], bool]) -> None:
    """Wait until something is so."""
    for _ in range(1000):
        if happened():
            return
        await asyncio.sleep(0.01)
    raise AssertionError


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Disk:
    monkeypatch.setattr(servers, "KEEP_PAUSE", 0.01)
    store = Disk(tmp_path)
    store.put_scene("cell", "0" * 64, b'{"name": "cell"}')
    return store


@asynccontextmanager
async def served(world: World, disk: Disk) -> AsyncIterator[tuple[PlanningServer, ScriptedWorkers]]:
    workers = ScriptedWorkers(1, lambda job: Answer(_echo(job), True))
    server = PlanningServer(world, disk, workers, capacity=8, poll=0.01)
    await server.start()
    try:
        yield server, workers
    finally:
        await server.stop()


def test_answers_that_the_disk_has_no_room_for_are_told_once_they_are_kept(discs: PlannerService, disk: Disk) -> None:
    async def asked() -> None:
        async with served(discs.world, disk) as (server, workers):
            jobs = [await server.accept("roadmaps", BODY, None) for _ in range(4)]
            answers = [server.pending(job) for job in jobs]
            disk.room = None
            workers.allowed.set()
            await until(lambda: disk.refused > 20)
            assert not any(answer is not None and answer.done() for answer in answers)
            disk.room = 10**9
            for job, answer in zip(jobs, answers, strict=True):
                expected = StoredAnswer(_echo(job), refused=False)
                assert await asyncio.wait_for(present(answer), 10.0) == expected
                assert await server.answer(job) == expected
            assert await server.accept("roadmaps", BODY, None) not in jobs

    asyncio.run(asked())
