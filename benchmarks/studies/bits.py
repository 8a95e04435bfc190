"""Whether plans are the same to the last bit with every instruction set, without compiled code, and from many threads.

Each way has a process of its own, in which the instruction set is chosen, or compiled modules cannot be imported. No
clock has a say. Compared is all that a plan file holds of a result, but seconds: path, motion, certificate, counts by
stage, contacts.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import count, islice
from typing import NamedTuple

from rich.table import Table

from benchmarks.harness.environment import ROOT
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.problems import ROBOT, public_problems
from benchmarks.worlds import queries
from planner_service import PlannerService, PlanRequest, RRTConnect, Scene
from planner_service.certify import prover
from planner_service.collision import native_kernel
from planner_service.records.result import result_record

__all__ = ["NOTHING", "PLANS", "run"]

PLANS = 500
SCENES = ("bin", "shelf", "post", "clutter")

EVERY = 5
"""One plan in so many is OMPL's RRTConnect's, the others the default planner's."""

NOTHING = "without compiled code"
THREADS = (2, 4, 8)

SHOWN = 5
"""Differences that are printed in full."""

Digest = dict[str, str]
"""A hash of each part of a result."""


class Work(NamedTuple):
    """A plan, and the world that it is made in."""

    name: str
    robot: str
    world: str
    scene: Scene | str
    request: PlanRequest


def _works(plans: int) -> Iterator[Work]:
    """The stored queries of the WidowX AI and the public Panda problems, again and again with other seeds."""
    for k, (name, robot, world, scene, request) in enumerate(islice(_with_the_default(), plans)):
        yield Work(name, robot, world, scene, replace(request, planner=RRTConnect()) if k % EVERY == 0 else request)


def _with_the_default() -> Iterator[Work]:
    for seed in count():
        for scene in SCENES:
            for query in queries.load(scene):
                request = PlanRequest(query.start, query.goal, seed=seed, time_limit=None)
                yield Work(f"{query.name} seed {seed}", queries.ROBOT, scene, scene, request)
        for problem in public_problems().problems:
            request = PlanRequest(problem.start, problem.goals[0], seed=seed, time_limit=None)
            yield Work(f"{problem.id} seed {seed}", ROBOT, problem.id, problem.scene, request)


def use(way: str) -> None:
    """Have this process use one instruction set, or nothing that is compiled; before anything is planned."""
    if way == NOTHING:
        for module in ("planner_service.native._core", "planner_service.certify.native._proof"):
            sys.modules[module] = None  # type: ignore[assignment]  # what cannot be imported was not built
        if native_kernel.instruction_sets() or prover.instruction_sets():
            raise AssertionError("compiled code is there")
        return
    native_kernel.build_kernel.__defaults__ = (way,)
    proofs = prover.instruction_sets()
    prover.native_prover.__defaults__ = (way if way in proofs else proofs[-1],)


def _main(way: str, threads: str, plans: str) -> None:
    """Print what was used, then the digest of every plan, then CPU seconds."""
    use(way)
    works = list(_works(int(plans)))
    services = {work.world: PlannerService(work.robot, work.scene) for work in works}
    used = {service.checker.instruction_set for service in services.values()}
    if used != {None if way == NOTHING else way}:
        raise AssertionError(f"{way}: {used} was used")
    clock = time.process_time()
    with ThreadPoolExecutor(int(threads)) as pool:
        found = pool.map(lambda work: services[work.world].plan(work.request), works)
        told = [_digest(result_record(result)) for result in found]
    json.dump({"cpu": time.process_time() - clock, "told": told}, sys.stdout)


def _digest(record: Row) -> Digest:
    for stage in record["stages"]:
        del stage["seconds"]
    return {key: hashlib.sha256(json.dumps(part).encode()).hexdigest() for key, part in record.items()}


def _asked(way: str, threads: int, plans: int) -> Row:
    command = [sys.executable, "-m", "benchmarks.studies.bits", way, str(threads), str(plans)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise AssertionError(f"{way}, {threads} threads: {done.stderr[-2000:]}")
    return {"way": way, "threads": threads, **json.loads(done.stdout)}


def run(plans: int = PLANS, threads: Sequence[int] = THREADS) -> Report:
    """Plan them all in every way, two ways at a time; some minutes, most of them without compiled code."""
    sets = native_kernel.instruction_sets()
    fastest = sets[-1] if sets else NOTHING
    ways = [(NOTHING, 1), *((way, 1) for way in sets), *((fastest, number) for number in threads)]
    with ThreadPoolExecutor(2) as pool:
        rows = list(pool.map(lambda way: _asked(way[0], way[1], plans), ways))
    reference, *others = rows
    names = [work.name for work in _works(plans)]
    for row in rows:
        pairs = zip(names, row["told"], reference["told"], strict=True)
        row["words"] = [f"{name}: {_different(a, b)}" for name, a, b in pairs if a != b]
    return Report("bits", tuple(rows), (_table(rows),), tuple(_promise(row) for row in others))


def _different(a: Digest, b: Digest) -> str:
    return ", ".join(sorted(key for key in {*a, *b} if a.get(key) != b.get(key)))


def _name(row: Row) -> str:
    return row["way"] if row["threads"] == 1 else f"{row['way']}, {row['threads']} threads"


def _promise(row: Row) -> Promise:
    text = f"{_name(row)}: {len(row['told'])} plans are those made {NOTHING}, to the last bit"
    told = [f"{len(row['words'])} differ", *row["words"][:SHOWN]]
    return Promise(text, "; ".join(told), not row["words"])


def _table(rows: Sequence[Row]) -> Table:
    lines = (
        {
            "": _name(row),
            "plans": len(row["told"]),
            "that differ": len(row["words"]),
            "CPU ms each": f"{row['cpu'] / len(row['told']) * 1e3:.1f}",
        }
        for row in rows
    )
    caption = (
        f"The stored queries of {', '.join(SCENES)} and the public Panda problems, again and again with other seeds; "
        f"one in {EVERY} by OMPL's RRTConnect. Path, motion, certificate, counts by stage and contacts are "
        "compared with the first line's. No clock has a say. CPU time of all threads, with writing the results down."
    )
    return table_of("The same plans in every way", lines, caption=caption)


if __name__ == "__main__":
    _main(*sys.argv[1:])
