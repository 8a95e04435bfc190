"""What a server has told a client is still there after whatever happens to the server."""

from __future__ import annotations

import hashlib
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.serve.state import store as stores
from planner_service.serve.state.store import StaleVersion, State, Store
from tests.support.optional import present

HASH, OTHER = "a" * 64, "b" * 64

WRITER = """
import hashlib, os, sys
from pathlib import Path
from planner_service.serve.state.store import State, Store

def write(folder, turn):
    store = Store(Path(folder))
    say = lambda *words: os.write(1, (" ".join(words) + "\\n").encode())
    version = store.scenes()[0].version if store.scenes() else None
    for number in range(1_000_000):
        content = b"%d, %d" % (turn, number)
        version = store.put_scene("cell", hashlib.sha256(content).hexdigest(), content, expected=version).version
        job, _ = store.accept("plan", content, request=content, key=content.decode())
        store.sync()
        say("accepted", job.id, content.hex())
        store.start(job.id)
        if number % 3:
            store.end(job.id, State.DONE, content * 1_000, ok=True)
            say("answered", job.id, hashlib.sha256(content * 1_000).hexdigest())

for line in sys.stdin:
    child = os.fork()
    if child == 0:
        write(sys.argv[1], int(line))
    print(child, flush=True)
    os.waitpid(child, 0)
    print("ended", flush=True)
"""


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    store = Store(tmp_path / "state")
    yield store
    store.close()


def accepted(store: Store, name: str = "one", *, key: str | None = None, uses: tuple[str, ...] = ()) -> str:
    job, new = store.accept("plan", name.encode(), request=name.encode(), key=key, uses=uses)
    assert new
    return job.id


def contents(folder: Path) -> set[bytes]:
    return {data for (data,) in in_index(folder, "SELECT data FROM contents")}


def in_index(folder: Path, statement: str, *values: object) -> list[tuple[Any, ...]]:
    """What a statement returns of the index in a folder, beside the store."""
    with closing(sqlite3.connect(folder / "index.db", isolation_level=None)) as index:
        return index.execute(statement, values).fetchall()


# Scenes and roadmaps.


def test_a_scene_changes_only_from_the_version_that_was_expected(store: Store) -> None:
    store.put_scene("cell", HASH, b"first", expected=None)
    store.put_scene("cell", OTHER, b"second", expected=1)
    for expected in (None, 1, 3):
        with pytest.raises(StaleVersion, match="its latest version is 2"):
            store.put_scene("cell", HASH, b"third", expected=expected)
        with pytest.raises(StaleVersion):
            store.delete_scene("cell", expected=expected)
    assert store.scene("cell").version == 2
    store.delete_scene("cell", expected=2)
    with pytest.raises(UnknownName):
        store.scene("cell")
    assert store.put_scene("cell", HASH, b"first", expected=None).version > 2  # no number is used for two documents


def test_of_a_scene_the_latest_versions_are_kept_and_what_a_job_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stores, "MAX_VERSIONS", 2)
    store = Store(tmp_path / "state")
    used = store.put_scene("cell", HASH, b"1")
    job = accepted(store, uses=(used.content,))
    for number in range(2, 6):
        store.put_scene("cell", HASH, b"%d" % number)
    with pytest.raises(UnknownName, match="version of scene cell"):
        store.scene("cell", 3)
    store.close()
    assert contents(tmp_path / "state") == {b"1", b"4", b"5"}
    store = Store(tmp_path / "state")
    store.end(job, State.CANCELLED)
    assert store.delete(job)
    store.close()
    assert contents(tmp_path / "state") == {b"4", b"5"}


def test_there_can_be_no_more_scenes_and_roadmaps_than_stated(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stores, "MAX_SCENES", 2)
    monkeypatch.setattr(stores, "MAX_ROADMAPS", 1)
    store.put_scene("one", HASH, b"1")
    store.put_scene("two", HASH, b"2")
    with pytest.raises(InvalidRequest, match="at most 2 scenes; delete one"):
        store.put_scene("three", HASH, b"3")
    store.delete_scene("one")
    store.put_scene("three", HASH, b"3")
    store.put_roadmap(HASH, b"1")
    store.put_roadmap(HASH, b"1")
    with pytest.raises(InvalidRequest, match="at most 1 roadmaps; delete one"):
        store.put_roadmap(OTHER, b"2")


# Jobs.


def test_the_same_key_and_request_are_the_same_job_and_another_request_is_refused(store: Store) -> None:
    job = accepted(store, key="key")
    again, new = store.accept("plan", b"looked up anew", request=b"one", key="key")
    assert (again.id, new) == (job, False)
    for kind, request in (("plan", b"other"), ("pick", b"one")):
        with pytest.raises(InvalidRequest, match="it came with another request before"):
            store.accept(kind, b"", request=request, key="key")


def test_a_job_ends_once(store: Store) -> None:
    job = accepted(store)
    assert store.start(job) == 1
    assert store.start(job) == 2
    assert store.end(job, State.DONE, b"answer", ok=False, reason="TIMED_OUT")
    for state in (State.DONE, State.CANCELLED, State.LOST):
        assert not store.end(job, state, b"another", ok=True)
    assert store.start(job) is None
    ended, answer = store.answer(job)
    assert answer == b"answer"
    assert (ended.state, ended.attempts, ended.ok, ended.reason) == (State.DONE, 2, False, "TIMED_OUT")


def test_jobs_that_have_not_ended_are_there_again_in_their_order_with_their_work(tmp_path: Path) -> None:
    store = Store(tmp_path / "state")
    jobs = [accepted(store, name) for name in ("one", "two", "three", "four")]
    store.start(jobs[2])
    store.end(jobs[1], State.CANCELLED)
    store.close()
    store = Store(tmp_path / "state")
    assert [job.id for job in store.unfinished()] == [jobs[0], jobs[2], jobs[3]]
    assert [store.work(job.id) for job in store.unfinished()] == [b"one", b"three", b"four"]
    assert store.job(jobs[2]).attempts == 0
    assert [job.id for job in store.jobs(2)] == [jobs[3], jobs[2]]
    assert [job.id for job in store.jobs(2, before=jobs[2])] == [jobs[1], jobs[0]]
    store.close()


@pytest.mark.parametrize("limits", [{"max_jobs": 2}, {"max_bytes": 25}])
def test_the_jobs_that_ended_first_make_room(tmp_path: Path, limits: dict[str, int]) -> None:
    store = Store(tmp_path / "state", **limits)
    jobs = [accepted(store, name) for name in ("one", "two", "three", "four")]
    for job in (jobs[2], jobs[0], jobs[1]):
        store.end(job, State.DONE, job.encode()[:10], ok=True)
    assert [job.id for job in store.jobs()] == [jobs[3], jobs[1], jobs[0]]
    with pytest.raises(UnknownName):
        store.job(jobs[2])
    store.close()
    assert contents(tmp_path / "state") == {job.encode()[:10] for job in jobs[:2]}


def test_a_folder_shrinks_to_a_smaller_limit_but_for_what_has_no_answer(tmp_path: Path) -> None:
    store = Store(tmp_path / "state")
    jobs = [accepted(store, str(k)) for k in range(9)]
    for k, job in enumerate(jobs[:8]):
        store.end(job, State.DONE, bytes([k]) * 100_000, ok=True)
    store.close()
    assert (tmp_path / "state" / "index.db").stat().st_size > 800_000
    store = Store(tmp_path / "state", max_bytes=250_000)
    assert [job.id for job in store.jobs()] == [jobs[8], jobs[7], jobs[6]]
    assert store.work(jobs[8])
    store.close()
    assert (tmp_path / "state" / "index.db").stat().st_size < 400_000


# What a folder goes through.


@pytest.mark.slow
def test_nothing_that_was_told_is_lost_when_the_process_is_killed_at_any_moment(tmp_path: Path) -> None:
    draws = random.Random(7)
    folder = tmp_path / "state"
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
    ) as writer:
        told: list[list[bytes]] = []
        said = present(writer.stdout)
        for turn in range(4):
            present(writer.stdin).write(b"%d\n" % turn)
            child = int(said.readline())
            told += [said.readline().split() for _ in range(draws.randrange(2, 12))]
            os.kill(child, signal.SIGKILL)
            while (words := said.readline().split()) != [b"ended"]:
                told.append(words)
            store = Store(folder)
            _require_all(store, told)
            store.close()
        present(writer.stdin).close()


def _require_all(store: Store, told: list[list[bytes]]) -> None:
    for word, name, what in told:
        job, answer = store.answer(name.decode())
        if word == b"answered":
            assert hashlib.sha256(answer or b"").hexdigest() == what.decode()
        elif job.ended is None:
            assert store.work(job.id).hex() == what.decode()
    latest = store.scene("cell").version
    for version in range(max(1, latest - stores.MAX_VERSIONS + 1), latest + 1):
        scene = store.scene("cell", version)
        assert hashlib.sha256(store.content(scene.content)).hexdigest() == scene.hash


def test_an_answer_that_a_power_cut_took_is_a_job_to_be_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stores, "SYNC_SECONDS", 1_000)
    store = Store(tmp_path / "state")
    jobs = [accepted(store, name) for name in ("one", "two")]
    store.end(jobs[0], State.DONE, b"first", ok=True)
    store.sync()
    there = (tmp_path / "state" / "index.db-wal").stat().st_size
    store.end(jobs[1], State.DONE, b"second", ok=True)
    shutil.copytree(tmp_path / "state", tmp_path / "after")
    store.close()
    os.truncate(tmp_path / "after" / "index.db-wal", there)
    store = Store(tmp_path / "after")
    assert store.answer(jobs[0])[1] == b"first"
    assert [job.id for job in store.unfinished()] == [jobs[1]]
    assert store.work(jobs[1]) == b"two"
    store.close()


def test_after_the_disk_failed_nothing_more_is_accepted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: Path) -> None:
        raise OSError(5, "Input/output error")

    store = Store(tmp_path / "state")
    with monkeypatch.context() as patch:
        patch.setattr(stores, "sync_file", fail)
        accepted(store)
        with pytest.raises(InvalidFile, match="the disk failed: Input/output error"):
            store.sync()
    with pytest.raises(InvalidFile, match="the disk failed"):
        store.accept("plan", b"", request=b"")
    with pytest.raises(InvalidFile, match="the disk failed"):
        store.close()


def test_a_second_server_is_refused_the_folder_until_the_first_has_closed_it(tmp_path: Path) -> None:
    first = Store(tmp_path / "state")
    with pytest.raises(InvalidFile, match=f"in use by process {os.getpid()}; each server needs a folder of its own"):
        Store(tmp_path / "state")
    first.close()
    Store(tmp_path / "state").close()


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("the work of a year")
    with pytest.raises(InvalidFile, match="not the folder of a server: it holds other files"):
        Store(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_the_folder_is_for_its_owner_alone(store: Store, tmp_path: Path) -> None:
    accepted(store)
    for path in (tmp_path / "state", *(tmp_path / "state").iterdir()):
        assert path.stat().st_mode & 0o077 == 0, path


# Nothing read from a file is believed.


def test_an_answer_that_was_changed_on_the_disk_is_refused(store: Store, tmp_path: Path) -> None:
    job = accepted(store)
    store.end(job, State.DONE, b"answer", ok=True)
    in_index(tmp_path / "state", "UPDATE contents SET data = ?", b"other")
    with pytest.raises(InvalidFile, match="damaged: the SHA-256 of a content is not its name"):
        store.answer(job)


@pytest.mark.parametrize(
    "damage",
    [
        "CREATE TRIGGER more AFTER INSERT ON jobs BEGIN DELETE FROM scenes; END",
        "DROP INDEX jobs_ended",
        "PRAGMA ignore_check_constraints = ON; UPDATE jobs SET answer = '../../etc/passwd'",
        "PRAGMA ignore_check_constraints = ON; UPDATE jobs SET state = 'eaten'",
        "INSERT INTO uses SELECT 99, answer FROM jobs",
    ],
)
def test_an_index_with_anything_else_in_it_is_refused(tmp_path: Path, damage: str) -> None:
    _one_answer(tmp_path / "state")
    with closing(sqlite3.connect(tmp_path / "state" / "index.db", isolation_level=None)) as index:
        index.executescript(damage)
    with pytest.raises(InvalidFile, match="damaged, or not the index of a server"):
        Store(tmp_path / "state")


@pytest.mark.parametrize("kept", [0, 4096])
def test_an_index_that_was_cut_short_is_refused(tmp_path: Path, kept: int) -> None:
    _one_answer(tmp_path / "state")
    os.truncate(tmp_path / "state" / "index.db", kept)
    with pytest.raises(InvalidFile, match="damaged, or not the index of a server"):
        Store(tmp_path / "state")


def _one_answer(folder: Path) -> None:
    store = Store(folder)
    store.end(accepted(store), State.DONE, b"answer", ok=True)
    store.close()
