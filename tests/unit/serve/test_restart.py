"""A server that starts again goes on with what it can."""

from __future__ import annotations

import asyncio
import json
import sqlite3
from contextlib import closing
from pathlib import Path
from shutil import copytree

import pytest

from planner_service import PlannerService
from planner_service.serve.problems import Refused
from planner_service.serve.server import PlanningServer
from planner_service.serve.state.store import State, Store
from tests.support.workers import ScriptedWorkers

BODY = b'{"scene": "cell", "planner": {"name": "prm"}}'


def accepted(store: Store, content: str) -> str:
    """The id of a job that grows a roadmap in a scene."""
    work = json.dumps({"body": BODY.decode(), "sources": {"scene": content}, "deadline": None}).encode()
    return store.accept("roadmaps", work, request=BODY, uses=[content])[0].id


def states_after_start(service: PlannerService, store: Store) -> list[State]:
    """What has become of all jobs, the first one first, once a server has started."""

    async def started() -> list[State]:
        server = PlanningServer(service.world, store, ScriptedWorkers(0), capacity=1, poll=0.01)
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
    with closing(sqlite3.connect(tmp_path / "index.db", isolation_level=None)) as index:
        index.execute("UPDATE contents SET data = ?", (b"other",))
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


def test_what_was_cancelled_stays_cancelled_though_the_server_is_killed(discs: PlannerService, tmp_path: Path) -> None:
    store = Store(tmp_path / "state")
    store.put_scene("cell", "0" * 64, b'{"name": "cell"}')

    async def asked() -> None:
        workers = ScriptedWorkers(1)
        workers.allowed.set()
        server = PlanningServer(discs.world, store, workers, capacity=1, poll=0.01)
        await server.start()
        job = await server.accept("roadmaps", BODY, None)
        while not workers.sent:
            await asyncio.sleep(0.01)
        assert server.cancel(job)
        assert store.job(job).state is State.RUNNING  # and now it is killed
        copytree(tmp_path / "state", tmp_path / "killed")
        await server.stop()

    asyncio.run(asked())
    assert states_after_start(discs, Store(tmp_path / "killed")) == [State.CANCELLED]
    assert states_after_start(discs, Store(tmp_path / "state")) == [State.CANCELLED]


def test_a_server_that_stops_accepts_nothing_more(discs: PlannerService, tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.put_scene("cell", "0" * 64, b'{"name": "cell"}')

    async def asked() -> None:
        server = PlanningServer(discs.world, store, ScriptedWorkers(0), capacity=1, poll=0.01)
        await server.start()
        server.leave()
        with pytest.raises(Refused, match="stopping"):  # whose body came only now
            await server.accept("roadmaps", BODY, None)
        assert store.jobs() == []
        await server.stop()

    asyncio.run(asked())
