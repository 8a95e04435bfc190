"""32 clients for a minute by locust: errors, bits, throughput next to the library's engine, and the cost of a call."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import msgpack
from websockets.sync.client import connect
from websockets.sync.connection import Connection

import planner_service as ps
from benchmarks.attack.jail import become_nobody, give_to_nobody
from benchmarks.harness.report import Promise, Report, Row, p50, p95, table_of
from benchmarks.studies.serve import asked
from benchmarks.studies.serve.processes import Server, connected, server
from benchmarks.studies.serve.tools import tool
from planner_service import PlannerService
from planner_service.client import Remote
from planner_service.parallel import Lost, Processes

__all__ = ["run"]

CLIENTS, SECONDS, WORKERS = 32, 60, 2

PLANS, TASKS = 240, 40
"""Requests of each kind, sent again and again."""

CALLS = 200
"""Single calls, by turns with the library's."""

WAYS = ("library", "http", "http, robot=hash", "Remote", "channel")

SHARE, OVERHEAD_MS = 0.9, 3.0

TOOL_SECONDS = SECONDS + 120.0


def run(queries: int | None = None, seed: int = 0) -> Report:
    """Load by locust, then single calls."""
    del queries, seed
    service = PlannerService("wxai", asked.SCENE)
    with server("--workers", str(WORKERS), "--queue", str(4 * CLIENTS)) as running:
        rates = [_engine_rate(service)]
        rows = [_loaded(running, "pick_place", *_tasks(service))]
        rates.append(_engine_rate(service))  # before and after, as how fast a machine is changes within minutes
        rows.append(_loaded(running, "plans", *_plans(service)))
    engine = {"part": "load", "way": f"Processes({WORKERS})", "per_second": sum(rates) / 2.0, "rates": rates}
    with server("--workers", "1") as running:
        single = _single(running, service)
    return Report("serve", (*rows, engine, single), _tables(rows, engine, single), _promises(rows, engine, single))


def _plans(service: PlannerService) -> tuple[list[dict[str, Any]], list[str]]:
    requests = asked.plan_requests(PLANS)
    return asked.plan_bodies(requests), [asked.planned(service, request) for request in requests]


def _tasks(service: PlannerService) -> tuple[list[dict[str, Any]], list[str]]:
    work, seeds = asked.Tasks(service), asked.task_requests(TASKS)
    return asked.task_bodies(seeds), [work(seed) for seed in seeds]


def _engine_rate(service: PlannerService) -> float:
    """Pick-and-places per second of the library's engine with as many workers, from the first answer on."""
    work, seeds = asked.Tasks(service), asked.task_requests(TASKS) * 8
    with closing(Processes(WORKERS).run(work, seeds)) as answers:
        next(answers)
        began, done = time.perf_counter(), 0
        for _, answer in answers:
            assert not isinstance(answer, Lost)
            done += 1
    return done / (time.perf_counter() - began)


def _loaded(running: Server, kind: str, bodies: Sequence[dict[str, Any]], digests: Sequence[str]) -> Row:
    """What locust says of a minute, and what the server took for it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        give_to_nobody(folder)
        requests = [
            {"path": f"/{kind}", "body": body, "digest": digest} for body, digest in zip(bodies, digests, strict=True)
        ]
        (folder / "requests.json").write_text(json.dumps(requests), encoding="utf-8")
        before, tool_before = running.cpu_seconds, _seconds_of_tools()
        command = [tool("locust"), "-f", Path(__file__).with_name("locustfile.py"), "--headless", "--only-summary"]
        command += ["-u", CLIENTS, "-r", CLIENTS, "-t", f"{SECONDS}s", "-s", "60", "--json"]
        done = subprocess.run(
            [*map(str, command), "--host", f"http://127.0.0.1:{running.port}"],
            preexec_fn=become_nobody,
            env={**os.environ, "SERVE_REQUESTS": str(folder / "requests.json"), "HOME": name},
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            timeout=TOOL_SECONDS,
        )
        spent = {name: seconds - before[name] for name, seconds in running.cpu_seconds.items()}
        spent["tool"] = _seconds_of_tools() - tool_before
    try:
        (told,) = json.loads(done.stdout)
    except ValueError:
        raise RuntimeError(f"locust: {done.stderr[-2000:]}") from None
    count = told["num_requests"]
    seconds = told["last_request_timestamp"] - told["start_time"]
    times = [float(ms) for ms, number in told["response_times"].items() for _ in range(number)]
    return {
        "part": "load",
        "way": f"{CLIENTS} clients, {kind}",
        "requests": count,
        "errors": told["num_failures"],
        "per_second": count / seconds,
        "p50_ms": p50(times),
        "p95_ms": p95(times),
        "server_cpu_ms": spent["server"] / count * 1e3,
        "workers_cpu_ms": spent["workers"] / count * 1e3,
        "tool_cpu_ms": spent["tool"] / count * 1e3,
    }


def _seconds_of_tools() -> float:
    """CPU of the processes that this one has waited for."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def _single(running: Server, service: PlannerService) -> Row:
    """One call at a time: by the library, over HTTP with and without the robot, by ``Remote``, and over a channel."""
    requests = asked.plan_requests(CALLS)
    bodies = asked.plan_bodies(requests)
    spent: dict[str, list[_Cost]] = {name: [] for name in WAYS}
    url = f"127.0.0.1:{running.port}"
    with (
        connected(running.port) as link,
        Remote(f"http://{url}", asked.SCENE) as remote,
        connect(f"ws://{url}/channel", compression=None, max_size=None) as channel,
    ):
        ways: dict[str, Callable[[ps.PlanRequest, Any], Any]] = {
            "library": lambda request, _: service.plan(request),
            "http": lambda _, body: link.ask("POST", "/plans", body, Prefer="wait=60").document,
            "http, robot=hash": lambda _, body: link.ask("POST", "/plans?robot=hash", body, Prefer="wait=60").document,
            "Remote": lambda request, _: remote.plan(request),
            "channel": lambda _, body: _over(channel, body),
        }
        for k, (request, body) in enumerate(zip(requests, bodies, strict=True)):
            for name in WAYS:
                cost = _cost(running, ways[name], request, body)
                if k >= CALLS // 10:  # the first ones build what later ones use
                    spent[name].append(cost)
    library = spent.pop("library")
    row: Row = {"part": "load", "way": "single calls", "library": p50([each.seconds for each in library]) * 1e3}
    for name, costs in spent.items():
        pairs = list(zip(costs, library, strict=True))
        row[name] = p50([each.seconds - own.seconds for each, own in pairs]) * 1e3
        row[f"{name}, server CPU"] = (_mean(costs, "server") - _mean(library, "client")) * 1e3
        row[f"{name}, client CPU"] = _mean(costs, "client") * 1e3
    return row


@dataclass(frozen=True)
class _Cost:
    """Seconds of a call: on the clock, of this process, and of the server and its workers."""

    seconds: float
    client: float
    server: float


def _cost(running: Server, call: Callable[[Any, Any], Any], request: Any, body: Any) -> _Cost:
    server, client, began = sum(running.cpu_nanoseconds), time.process_time(), time.perf_counter()
    call(request, body)
    seconds, client = time.perf_counter() - began, time.process_time() - client
    return _Cost(seconds, client, (sum(running.cpu_nanoseconds) - server) / 1e9)


def _mean(costs: Sequence[_Cost], name: str) -> float:
    return fmean(getattr(each, name) for each in costs)


def _over(channel: Connection, body: Any) -> Any:
    channel.send(msgpack.packb({"id": 1, "verb": "plans", "body": body, "robot": "hash"}))
    reply = msgpack.unpackb(channel.recv())
    assert reply["status"] == 200, reply
    return reply["answer"]


def _tables(rows: Sequence[Row], engine: Row, single: Row) -> tuple[Any, ...]:
    lines = [
        {
            "": row["way"],
            "requests": f"{row['requests']:,}",
            "errors": row["errors"],
            "a second": f"{row['per_second']:.1f}",
            "p50 / p95 ms": f"{row['p50_ms']:.0f} / {row['p95_ms']:.0f}",
            "server CPU ms": f"{row['server_cpu_ms']:.2f}",
            "workers CPU ms": f"{row['workers_cpu_ms']:.2f}",
            "locust CPU ms": f"{row['tool_cpu_ms']:.2f}",
        }
        for row in rows
    ]
    before, after = engine["rates"]
    caption = (
        f"{WORKERS} workers, {SECONDS} s of locust, which uses the same cores; errors: another status than 200, or "
        "other bits than the library's. Pick-and-places a second by "
        f"{engine['way']}: {before:.1f} before, {after:.1f} after."
    )
    calls = [
        {
            "": name,
            "p50 above, ms": f"{single[name]:.2f}",
            "server CPU above, ms": f"{single[f'{name}, server CPU']:.2f}",
            "client CPU, ms": f"{single[f'{name}, client CPU']:.2f}",
        }
        for name in WAYS[1:]
    ]
    above = f"By turns; above the library's call, which takes {single['library']:.2f} ms (p50)."
    return table_of("Load", lines, caption=caption), table_of("Single calls", calls, caption=above)


def _promises(rows: Sequence[Row], engine: Row, single: Row) -> tuple[Promise, ...]:
    errors = sum(row["errors"] for row in rows)
    requests = sum(row["requests"] for row in rows)
    share = rows[0]["per_second"] / engine["per_second"]
    return (
        Promise(
            f"{CLIENTS} clients for {SECONDS} s: no error, and no answer that differs from the library's bits",
            f"{errors} of {requests:,}",
            errors == 0 and requests > 0,
        ),
        Promise(
            f"pick-and-places: at least {SHARE:g} times as many as by the library's engine",
            f"{share:.2f}",
            share >= SHARE,
        ),
        Promise(
            f"a single call takes at most {OVERHEAD_MS:g} ms longer than the library's (p50)",
            f"{single['http']:.2f} ms; by Remote {single['Remote']:.2f} ms",
            single["http"] <= OVERHEAD_MS,
        ),
    )
