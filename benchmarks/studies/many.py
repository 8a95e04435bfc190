"""Many plans at once: the same as one by one, how much faster, at what cost, and what becomes of them in mishaps."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from itertools import islice
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.harness.report import Promise, Report, Row, merged, table, table_of
from benchmarks.worlds import queries
from planner_service import PlannerService, PlanRequest, PlanResult
from planner_service.parallel import Engine, Processes, Ray, Sequential
from planner_service.records.result import result_record

__all__ = ["PARTS", "run"]

SCENE = "bin"
"""About 11 ms a plan."""

EASY_SCENE = "table"
"""The same queries with nothing but a table in the way: about 2.4 ms a plan, the least that a plan takes."""

SAME, SPEED, TURNS = 500, 1000, 3
"""Plans that are compared; that are timed, and how often."""

WARM, MARKS = 200, (100, 1_000, 10_000)
"""Plans before anything is measured, and numbers of them after which it is looked."""

CPU_TICK = 0.01
"""Seconds of CPU below which the kernel may tell of none."""

KILL_AFTER = 100

GAIN, OVERHEAD_MS, DRIFT, GROWTH_MB, STOP_SECONDS = 1.8, 1.0, 0.1, 20.0, 1.0


def _requests() -> Iterator[PlanRequest]:
    """The stored queries, again and again with other seeds."""
    stored, seed = queries.load(SCENE), 0
    while True:
        yield from (PlanRequest(query.start, query.goal, seed=seed, time_limit=None) for query in stored)
        seed += 1


def _service(scene: str = SCENE) -> PlannerService:
    """A service that has planned once."""
    service = PlannerService(queries.ROBOT, scene)
    service.plan(next(_requests()))
    return service


def _digest(result: PlanResult) -> str:
    """All of a result but the clock's part."""
    record = result_record(result)
    for stage in record["stages"]:
        del stage["seconds"]
    return hashlib.sha256(json.dumps(record).encode()).hexdigest()


# --- the same


def same() -> Report:
    """One by one, in this process by the engine, in processes, and on Ray."""
    service, asked = _service(), list(islice(_requests(), SAME))
    alone = [_digest(service.plan(request)) for request in asked]
    rows: list[Row] = []
    for engine in (Sequential(), Processes(2), Ray(workers=2)):
        began = time.perf_counter()
        found = service.plan_many(asked, engine=engine, progress=False)
        seconds = time.perf_counter() - began
        differ = sum(_digest(result) != other for result, other in zip(found, alone, strict=True))
        rows.append({"part": "same", "engine": repr(engine), "plans": len(found), "differ": differ, "seconds": seconds})
    cells = [(row["engine"], row["plans"], row["differ"], f"{row['seconds']:.1f}") for row in rows]
    caption = "Next to service.plan one by one: all of a result but wall times. Seconds with starting the workers."
    shown = table(f"The same plans, {SCENE}", ("engine", "plans", "that differ", "s"), cells, caption=caption)
    text = f"{SAME} requests: Sequential, Processes and Ray give the paths and counts of one by one"
    told = "; ".join(f"{row['differ']} differ" for row in rows)
    return Report("many", tuple(rows), (shown,), (Promise(text, told, not any(row["differ"] for row in rows)),))


# --- how fast


def _streamed(service: PlannerService, engine: Engine, count: int) -> Row:
    """Milliseconds per plan from the first result on, by the clock and of CPU, and seconds to the first."""
    began = time.perf_counter()
    results = service.plan_stream(_requests(), engine=engine)
    next(results)
    start, workers = time.perf_counter() - began, _children()
    with closing(results):
        return _told(lambda: sum(1 for _ in islice(results, count)), count, workers) | {"start": start}


def _looped(service: PlannerService, count: int) -> Row:
    """The same of a plain loop."""
    asked = islice(_requests(), count)
    return _told(lambda: [service.plan(request).ok for request in asked], count, ()) | {"start": 0.0}


def _told(work: Callable[[], Any], count: int, workers: Sequence[int]) -> Row:
    clock, here, there = time.perf_counter(), time.process_time(), _cpu_seconds(workers)
    work()
    spent = {"ms": time.perf_counter() - clock, "here": time.process_time() - here}
    return {key: value / count * 1e3 for key, value in (spent | {"there": _cpu_seconds(workers) - there}).items()}


LOOP = f"""
import sys
from benchmarks.studies.many import _looped, _service
service = _service()
print("ready", flush=True)
sys.stdin.readline()
print(_looped(service, {SPEED})["ms"], flush=True)
"""


def _side_by_side() -> float:
    """Milliseconds per plan of two plain loops in two processes at once: the most that two cores here give."""
    command = [sys.executable, "-c", LOOP]
    running = [subprocess.Popen(command, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE) for _ in range(2)]
    for process in running:
        _line(process)
    for process in running:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    return 1.0 / sum(1.0 / float(process.communicate()[0]) for process in running)


def _line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


def speed() -> Report:
    """One core and two, and what an engine adds to the cheapest plans; by turns, medians."""
    rows: list[Row] = []
    for scene in (SCENE, EASY_SCENE):
        service = _service(scene)
        ways: dict[str, Callable[[], Row]] = {
            "a loop": lambda service=service: _looped(service, SPEED),  # type: ignore[misc]
            "Processes(1)": lambda service=service: _streamed(service, Processes(1), SPEED),  # type: ignore[misc]
            "Processes(2)": lambda service=service: _streamed(service, Processes(2), SPEED),  # type: ignore[misc]
        }
        if scene == SCENE:
            ways["two loops side by side"] = lambda: {"ms": _side_by_side(), "here": 0.0, "there": 0.0, "start": 0.0}
        turns = [{name: way() for name, way in ways.items()} for _ in range(TURNS)]
        for name in ways:
            told = {key: median(turn[name][key] for turn in turns) for key in ("ms", "here", "there", "start")}
            rows.append({"part": "speed", "scene": scene, "way": name, **told})
    return Report("many", tuple(rows), (_speed_table(rows),), _speed_promises(rows))


def _speed_promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    at = {(row["scene"], row["way"]): row for row in rows}
    one, two, most = (at[SCENE, way]["ms"] for way in ("a loop", "Processes(2)", "two loops side by side"))
    alone, engine = (at[EASY_SCENE, way] for way in ("a loop", "Processes(1)"))
    added = engine["here"] + engine["there"] - alone["here"]
    cores = f"two cores make {SPEED:,} plans in {SCENE} at least {GAIN} times as fast as one"
    times = f"{one / two:.2f} times; two loops side by side, nothing shared: {one / most:.2f} times"
    adds = f"an engine adds less than {OVERHEAD_MS:g} ms of CPU to a plan, on both sides together ({EASY_SCENE})"
    told = f"{added:.2f} ms, of which {engine['there'] - alone['here']:.2f} ms in the worker"
    return Promise(cores, times, one / two >= GAIN), Promise(adds, told, added < OVERHEAD_MS)


def _speed_table(rows: Sequence[Row]) -> Any:
    times = {"CPU ms here": "here", "CPU ms there": "there", "start s": "start"}
    lines = (
        {"scene": row["scene"], "": row["way"], "ms a plan": f"{row['ms']:.2f}", "plans/s": f"{1e3 / row['ms']:.0f}"}
        | {name: f"{row[key]:.2f}" if row[key] else "" for name, key in times.items()}
        for row in rows
    )
    caption = (
        f"{SPEED:,} plans, medians of {TURNS} turns, from the first result on: wall time, CPU of the process that asks "
        "and of its workers; start: seconds to the first result."
    )
    return table_of("How fast", lines, caption=caption)


# --- how it grows


def _children() -> list[int]:
    told = Path(f"/proc/self/task/{os.getpid()}/children").read_text("utf-8")
    return [int(word) for word in told.split()]


def _cpu_seconds(processes: Sequence[int]) -> float:
    """What these have computed so far."""
    return sum(int((Path("/proc") / str(p) / "schedstat").read_text("utf-8").split()[0]) for p in processes) / 1e9


def _megabytes(process: int) -> float:
    pages = (Path("/proc") / str(process) / "statm").read_text("utf-8").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / 1e6


def growth() -> Report:
    """One stream of many plans, looked at after more and more of them."""
    stream = _service().plan_stream(_requests(), engine=Processes(2))
    for _ in islice(stream, WARM):
        pass
    workers = _children()
    rows: list[Row] = []
    for mark in MARKS:
        began, spent = time.perf_counter(), _cpu_seconds(workers)
        for _ in islice(stream, mark):
            pass
        wall, cpu = time.perf_counter() - began, max(_cpu_seconds(workers) - spent, CPU_TICK)
        memory = {"here_mb": _megabytes(os.getpid()), "worker_mb": max(map(_megabytes, workers))}
        rate = {"per_second": mark / wall, "per_core_second": mark / cpu}
        rows.append({"part": "growth", "plans": mark, **rate, **memory})
    stream.close()
    first, last = rows[0], rows[-1]
    ratio = last["per_core_second"] / first["per_core_second"]
    grown = max(last[key] - first[key] for key in ("here_mb", "worker_mb"))
    lines = (
        {
            "the next ... plans": f"{row['plans']:,}",
            "plans/s": f"{row['per_second']:.1f}",
            "plans per CPU second of a worker": f"{row['per_core_second']:.1f}",
            "MB here": f"{row['here_mb']:.0f}",
            "MB of a worker": f"{row['worker_mb']:.0f}",
        }
        for row in rows
    )
    shown = table_of(f"One stream, Processes(2), {SCENE}", lines)
    steady = f"plans per second of a core stay the same from {MARKS[0]:,} plans to {MARKS[-1]:,}, within {DRIFT:.0%}"
    promises = (
        Promise(steady, f"{ratio:.2f} times", ratio >= 1.0 - DRIFT),
        Promise(f"memory stays flat: less than {GROWTH_MB:g} MB more", f"{grown:+.1f} MB", grown < GROWTH_MB),
    )
    return Report("many", tuple(rows), (shown,), promises)


# --- mishaps


def faults() -> Report:
    """A worker that is killed, a machine that is lost, and Ctrl-C."""
    service, asked = _service(), list(islice(_requests(), SAME))
    alone = [_digest(service.plan(request)) for request in asked]

    def judged(what: str, engine: Engine, mishap: Callable[[], None]) -> Row:
        found, began = list[str](), time.perf_counter()
        for result in service.plan_stream(asked, engine=engine):
            found.append(_digest(result))
            if len(found) == KILL_AFTER:
                mishap()
        told = {"answered": len(found), "as_before": sum(map(str.__eq__, found, alone))}
        return {"part": "faults", "what": what, **told, "seconds": time.perf_counter() - began}

    rows = [judged("kill -9 of a worker", Processes(2), lambda: os.kill(_children()[-1], signal.SIGKILL))]
    with _two_machines() as lose_one:
        rows.append(judged("loss of one of two machines", Ray(), lose_one))
    stopped = _interrupted()
    kept = all(row["answered"] == row["as_before"] == SAME for row in rows)
    cells = [(row["what"], row["answered"], row["as_before"], f"{row['seconds']:.1f}") for row in rows]
    cells.append((f"Ctrl-C: {stopped['kept']} results kept", "", "", f"{stopped['seconds']:.2f}"))
    caption = f"After {KILL_AFTER} of {SAME} results, in order. Seconds of the whole, and until Ctrl-C is handled."
    shown = table("Mishaps", ("", "answered", "as without it", "s"), cells, caption=caption)
    lost = "a worker killed, a machine lost: every request answered, none twice, all as without it"
    ctrl_c = f"Ctrl-C stops within {STOP_SECONDS:g} s, keeps what is finished, and leaves no worker behind"
    told = f"{stopped['seconds']:.2f} s; {stopped['kept']} kept; {stopped['left']} left behind"
    well = stopped["seconds"] < STOP_SECONDS and stopped["kept"] > 0 and stopped["left"] == 0
    promises = (
        Promise(lost, "; ".join(f"{row['as_before']} of {SAME}" for row in rows), kept),
        Promise(ctrl_c, told, well),
    )
    return Report("many", (*rows, {"part": "faults", "what": "Ctrl-C", **stopped}), (shown,), promises)


@contextmanager
def _two_machines() -> Iterator[Callable[[], None]]:
    """A Ray cluster of two machines with a core each, as far as Ray knows, and how to lose one of them."""
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        second = cluster.add_node(num_cpus=1)
        ray.init(address=cluster.address, logging_level="ERROR", log_to_driver=False)
        yield lambda: cluster.remove_node(second, allow_graceful=False)
    finally:
        ray.shutdown()
        cluster.shutdown()


INTERRUPTED = """
import time
from itertools import islice
from benchmarks.studies.many import _children, _requests, _service
from planner_service.parallel import Processes
from planner_service.planning import Interrupted

asked = list(islice(_requests(), 5000))
service = _service()
print("go", flush=True)
try:
    service.plan_many(asked, engine=Processes(2), progress=False)
except Interrupted as interrupted:
    print(time.monotonic(), len(interrupted.results), len(_children()))
"""


def _interrupted() -> Mapping[str, Any]:
    """Seconds from Ctrl-C until a program with many plans goes on, what it kept, and how many workers it left."""
    with subprocess.Popen([sys.executable, "-c", INTERRUPTED], text=True, stdout=subprocess.PIPE) as running:
        _line(running)
        time.sleep(4.0)  # in the midst of it
        began = time.monotonic()
        running.send_signal(signal.SIGINT)
        end, kept, left = running.communicate()[0].split()
        return {"seconds": float(end) - began, "kept": int(kept), "left": int(left)}


PARTS: Mapping[str, Callable[[], Report]] = {"same": same, "speed": speed, "growth": growth, "faults": faults}
"""What is measured, by the names that ``--part`` takes."""


def run(part: str | None = None) -> Report:
    """Measure a part, or all; that takes about five minutes."""
    return merged("many", [measured() for name, measured in PARTS.items() if part in (None, name)])
