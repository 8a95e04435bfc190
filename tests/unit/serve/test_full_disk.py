"""A disk without room costs time, not answers: what was planned meanwhile is told once it can be kept."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import pytest

from planner_service import PlannerService
from planner_service.parallel.pool import Answered, Event
from planner_service.serve import server as servers
from planner_service.serve.server import PlanningServer, StoredAnswer
from planner_service.serve.state.content_files import StateUnusable
from planner_service.serve.state.store import State, Store
from planner_service.serve.work import Answer

BODY = b'{"scene": "cell", "planner": {"name": "prm"}}'


class Disk(Store):
    """A store on a disk that may be full.

    Attributes:
        full: While it is, nothing can be written.
        refused: Set once something could not be.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.full = False
        self.refused = threading.Event()

    def start(self, job: str) -> int | None:
        self._require_room()
        return super().start(job)

    def end(self, job: str, state: State, answer: bytes | None = None, **about: Any) -> bool:
        self._require_room()
        return super().end(job, state, answer, **about)

    def _require_room(self) -> None:
        if self.full:
            self.refused.set()
            raise StateUnusable("index.db", ["cannot be written: database or disk is full"])


class Echo:
    """A backend with one worker, which answers with the request's id when it is allowed to."""

    max_workers = 1

    def __init__(self) -> None:
        self.allowed = threading.Event()
        self._events: SimpleQueue[tuple[int, Event]] = SimpleQueue()

    def start(self) -> int:
        self._events.put((1, Answered(None)))
        return 1

    def send(self, worker: int, item: Any) -> None:
        self._events.put((worker, Answered(Answer(json.dumps({"id": item.id}).encode(), True))))

    def tell(self, worker: int, note: Any) -> None:
        raise AssertionError

    def receive(self, workers: Sequence[int], timeout: float | None) -> list[tuple[int, Event]]:
        if not self.allowed.wait(timeout):
            return []
        try:
            return [self._events.get(timeout=timeout)]
        except Empty:
            return []

    def kill(self, workers: Sequence[int]) -> None:
        pass

    def close(self) -> None:
        pass


def test_answers_made_while_the_disk_is_full_are_told_once_they_are_kept(
    discs: PlannerService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(servers, "KEEP_PAUSE", 0.01)

    async def asked() -> None:
        store, workers = Disk(tmp_path), Echo()
        store.put_scene("cell", "0" * 64, b'{"name": "cell"}')
        server = PlanningServer(discs.world, store, workers, capacity=8, poll=0.01)
        await server.start()
        jobs = [await server.accept("roadmaps", BODY, None) for _ in range(4)]
        answers = [server.pending(job) for job in jobs]
        store.full = True
        workers.allowed.set()
        assert await asyncio.to_thread(store.refused.wait, 10.0)
        assert not any(answer is not None and answer.done() for answer in answers)
        store.full = False
        for job, answer in zip(jobs, answers, strict=True):
            assert answer is not None
            expected = StoredAnswer(json.dumps({"id": job}).encode(), refused=False)
            assert await asyncio.wait_for(answer, 10.0) == expected
            assert await server.answer(job) == expected
        assert await server.accept("roadmaps", BODY, None) not in jobs
        await server.stop()

    asyncio.run(asked())
