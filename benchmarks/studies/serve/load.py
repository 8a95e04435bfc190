"""32 clients for a minute by locust: errors, bits, throughput next to the library's engine, and the cost of a call.

With ``--against PYTHON`` the server and ``Remote`` of another version are measured in the same run.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgpack
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from benchmarks.attack.jail import become_nobody, give_to_nobody
from benchmarks.harness.report import Promise, Report, Row, p50, p95, table_of
from benchmarks.studies.serve import asked
from benchmarks.studies.serve.processes import Server, connected, server
from benchmarks.studies.serve.tools import tool
from planner_service import PlannerService
from planner_service.parallel import Lost, Processes

__all__ = ["run"]

CLIENTS, SECONDS, WORKERS = 32, 60, 2

PLANS, TASKS = 240, 40
"""Requests of each kind, sent again and again."""

CALLS = 200
"""Single calls, by turns with the library's."""

CHILD = Path(__file__).with_name("remote_calls.py")

BEFORE = ", before"
"""What is said of another version."""

SHARE, SERVER_MS, REMOTE_MS, CHANNEL_MS = 0.9, 2.0, 1.0, 1.5
"""Promised: part of the engine's throughput; CPU of the server above the library's, and of ``Remote``; p50 above."""

TOOL_SECONDS = SECONDS + 120.0


def run(queries: int | None = None, seed: int = 0, *, against: Path | None = None) -> Report:
    """Load by locust, then single calls.

    Args:
        queries: Single calls of each way; 200 if None.
        against: The python of an environment with another version.
    """
    del seed
    service, calls = PlannerService("wxai", asked.SCENE), CALLS if queries is None else queries
    plans, options = _plans(service), ("--workers", str(WORKERS), "--queue", str(4 * CLIENTS))
    with server(*options) as running:
        rates = [_engine_rate(service)]
        rows = [_loaded(running, "pick_place", *_tasks(service))]
        rates.append(_engine_rate(service))  # before and after, as how fast a machine is changes within minutes
        rows.append(_loaded(running, "plans", *plans))
    if against is not None:
        with server(*options, python=against) as running:
            rows.append(_loaded(running, "plans", plans[0], [""] * len(plans[0]), named=BEFORE))  # it plans otherwise
    engine = {"part": "load", "way": f"Processes({WORKERS})", "per_second": sum(rates) / 2.0, "rates": rates}
    single = _single(service, calls, against)
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


def _loaded(
    running: Server, kind: str, bodies: Sequence[dict[str, Any]], digests: Sequence[str], *, named: str = ""
) -> Row:
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
        "way": f"{CLIENTS} clients, {kind}{named}",
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


def _single(service: PlannerService, calls: int, against: Path | None) -> Row:
    """One call at a time, by turns: by the library, over HTTP with and without the robot, a channel, and ``Remote``."""
    requests = asked.plan_requests(calls)
    bodies = asked.plan_bodies(requests)
    with ExitStack() as open_until_the_end, tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "requests.json"
        given = [{**body["request"], "goal": body["request"]["goals"][0]["joints"]} for body in bodies]
        for each in given:
            del each["goals"]
        file.write_text(json.dumps(given), encoding="utf-8")
        ways: dict[str, tuple[Server | None, _Call]] = {"library": (None, _timed(lambda k: service.plan(requests[k])))}
        for version, python in {"": Path(sys.executable), BEFORE: against}.items():
            if python is not None:
                running = open_until_the_end.enter_context(server("--workers", "1", python=python))
                for name, call in _calls(running, bodies, file, python, open_until_the_end, old=bool(version)).items():
                    ways[name + version] = running, call
        spent: dict[str, list[_Cost]] = {name: [] for name in ways}
        for k in range(calls):
            for name, (running_one, call) in ways.items():
                cost = _cost(running_one, call, k)
                if k >= calls // 10:  # the first ones build what later ones use
                    spent[name].append(cost)
    library = spent.pop("library")
    row: Row = {"part": "load", "way": "single calls", "ways": list(spent)}
    row["library"] = p50([each.seconds for each in library]) * 1e3
    for name, costs in spent.items():
        pairs = list(zip(costs, library, strict=True))
        row[name] = p50([each.seconds - own.seconds for each, own in pairs]) * 1e3
        row[f"{name}, server CPU"] = p50([each.server - own.client for each, own in pairs]) * 1e3
        row[f"{name}, client CPU"] = p50([each.client for each in costs]) * 1e3
    return row


_Call = Callable[[int], tuple[float, float]]
"""What a request took by its number: seconds on the clock, and of the client's processor."""


def _calls(
    running: Server, bodies: list[dict[str, Any]], file: Path, python: Path, until: ExitStack, *, old: bool
) -> dict[str, _Call]:
    """The ways to ask a server."""
    link, url = until.enter_context(connected(running.port)), f"127.0.0.1:{running.port}"

    def by_http(query: str) -> _Call:
        return _timed(lambda k: link.ask("POST", f"/plans{query}", bodies[k], Prefer="wait=60").document)

    ways = {"http": by_http(""), "Remote": _in_child(python, url, file, until)}
    if old:
        return ways
    channel = until.enter_context(connect(f"ws://{url}/channel", compression=None, max_size=None))
    ways |= {"http, robot=hash": by_http("?robot=hash"), "channel": _timed(lambda k: _over(channel, bodies[k]))}
    return ways | {"Remote, channel": _in_child(python, url, file, until, "channel")}


def _timed(call: Callable[[int], Any]) -> _Call:
    def timed(k: int) -> tuple[float, float]:
        client, began = time.process_time(), time.perf_counter()
        call(k)
        return time.perf_counter() - began, time.process_time() - client

    return timed


def _in_child(python: Path, url: str, file: Path, until: ExitStack, *named: str) -> _Call:
    """``Remote`` of a version."""
    command = [str(python), str(CHILD), f"http://{url}", asked.SCENE, str(file), *named]
    child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=file.parent)
    until.enter_context(child)
    until.callback(child.kill)

    def call(k: int) -> tuple[float, float]:
        assert child.stdin is not None
        assert child.stdout is not None
        print(k, file=child.stdin, flush=True)
        seconds, client = json.loads(child.stdout.readline())
        return seconds, client

    return call


@dataclass(frozen=True)
class _Cost:
    """Seconds of a call: on the clock, of the client, and of the server and its workers."""

    seconds: float
    client: float
    server: float


def _cost(running: Server | None, call: _Call, k: int) -> _Cost:
    before = 0 if running is None else sum(running.cpu_nanoseconds)
    seconds, client = call(k)
    after = 0 if running is None else sum(running.cpu_nanoseconds)
    return _Cost(seconds, client, (after - before) / 1e9)


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
        for name in single["ways"]
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
            f"a single plan over HTTP takes server and workers at most {SERVER_MS:g} ms of CPU above the library",
            f"{single['http, robot=hash, server CPU']:.2f} ms; on the clock {single['http, robot=hash']:.2f} ms",
            single["http, robot=hash, server CPU"] <= SERVER_MS,
        ),
        Promise(
            f"Remote takes at most {REMOTE_MS:g} ms of CPU for one",
            f"{single['Remote, client CPU']:.2f} ms; over a channel {single['Remote, channel, client CPU']:.2f} ms",
            single["Remote, client CPU"] <= REMOTE_MS,
        ),
        Promise(
            f"over a channel one takes at most {CHANNEL_MS:g} ms longer than the library's (p50)",
            f"{single['channel']:.2f} ms",
            single["channel"] <= CHANNEL_MS,
        ),
    )
