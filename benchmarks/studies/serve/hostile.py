"""Requests that no client would send, by schemathesis and over bare sockets, to every address of a server alone.

Whatever comes: no 5xx, no crash, no hang, bounded memory, and afterwards the same plan as before. The server runs
as an unprivileged user, with a cap on its memory. ``--queries 100000`` takes an hour.
"""

from __future__ import annotations

import base64
import json
import os
import random
import re
import socket
import subprocess
import tempfile
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

import msgpack
import numpy as np

from benchmarks.attack.jail import MEMORY, become_nobody, give_to_nobody
from benchmarks.attack.mutations import changed
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.serve import asked
from benchmarks.studies.serve.processes import Reply, Server, connected, server
from benchmarks.studies.serve.tools import tool
from planner_service.memory import Memory
from planner_service.memory.memory_file import MemoryRecord
from planner_service.records.exports.formats import FORMATS

__all__ = ["run"]

REQUESTS, THREADS, CHUNK = 2_000, 8, 50

PER_EXAMPLE, THOROUGH, TOOL_SECONDS = 500, 20, 1800.0
"""Requests over bare sockets for each example that schemathesis makes of an operation and phase; examples from which
on it also tries each bound of each field, which takes ten minutes; and seconds for all of that.
"""

SHOWN, LENGTH = 20, 400
"""Requests that went wrong and are kept, and their bytes."""

ANEW = 20
"""Chunks after which plans are made anew whose motions are asked for: a server keeps the last ones."""

SCENE = "kept-4f1d"
"""The scene that plans are made in, under a name that no hostile request has: they change and delete all others."""

FAR = {"position": [3.0, 0.0, 0.3], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
"""A pose that no robot of this size reaches."""

PATIENCE = 20.0
"""Seconds within which a server has answered whatever it was sent, or closed the connection."""

GROWTH_MB = 400.0

STATUS = re.compile(rb"HTTP/1\.[01] (\d{3})")


def run(queries: int | None = None, seed: int = 0) -> Report:
    """All of it.

    Args:
        queries: Requests over bare sockets; 2,000 if None.
    """
    count = REQUESTS if queries is None else queries
    with server("--workers", "1", "--queue", "16", memory=MEMORY) as running:
        _keep_scene(running)
        first, before = _plan(running), running.megabytes
        examined = _examined(running, seed, max(2, count // PER_EXAMPLE))
        statuses, worst = _bombarded(running, count, seed)
        end, alive = running.megabytes, running.process.poll() is None
        same = alive and _plan(running) == first
    faults = {status: number for status, number in statuses.items() if status.startswith("5")}
    rows: list[Row] = [
        {"part": "hostile", "what": "schemathesis", **examined},
        {"part": "hostile", "what": "sockets", "statuses": dict(statuses), "requests": sum(statuses.values())},
        {"part": "hostile", "what": "worst", "requests": worst},
        {"part": "hostile", "what": "memory", "before_mb": before, "after_mb": end},
    ]
    lines = [{"status": status, "requests": f"{number:,}"} for status, number in sorted(statuses.items())]
    caption = '"closed": the connection was closed without an answer, as a broken request deserves.'
    promises = (
        Promise("schemathesis finds no 5xx", f"{examined['tested']:,} requests: {examined['found']}", examined["ok"]),
        Promise(
            f"{count:,} hostile requests over bare sockets: no 5xx, no crash, none without an end",
            f"{faults or 'no'} 5xx, {statuses['hung']} hung",
            not faults and not statuses["hung"] and alive,
        ),
        Promise(
            f"memory is bounded: at most {GROWTH_MB:g} MB more, and the same plan as before",
            f"{before:.0f} -> {end:.0f} MB",
            end - before <= GROWTH_MB and same,
        ),
    )
    return Report("serve", tuple(rows), (table_of("Bare sockets", lines, caption=caption),), promises)


def _keep_scene(running: Server) -> None:
    """Store the scene that plans are made in under a name of its own."""
    with connected(running.port) as link:
        document = link.ask("GET", f"/scenes/{asked.SCENE}").document
        kept = {name: document[name] for name in ("description", "obstacles", "attached")}
        reply = link.ask("PUT", f"/scenes/{SCENE}", kept)
        assert reply.status == 201, reply.data


def _plan(running: Server) -> str:
    """The digest of a plan."""
    (body,) = asked.plan_bodies(asked.plan_requests(1))
    return asked.digest(_made(running.port, "plans", {**body, "scene": SCENE}).document)


def _made(port: int, kind: str, body: Any) -> Reply:
    """The reply to a request that is sent until there is room for it."""
    with connected(port) as link:
        end = time.monotonic() + 60.0
        while True:
            reply = link.ask("POST", f"/{kind}", body, Prefer="wait=60", Idempotency_Key=uuid.uuid4().hex)
            if reply.status == 200:
                return reply
            if reply.status not in (429, 503) or time.monotonic() > end:
                raise RuntimeError(f"none made: {reply.status} {reply.data[:500]!r}")
            time.sleep(0.2)


def _jobs(port: int) -> list[str]:
    """The ids of a plan, of a request without one, of a task and of a check."""
    (asked_plan,) = asked.plan_bodies(asked.plan_requests(1))
    plan = {**asked_plan, "scene": SCENE}
    nowhere = {**plan, "request": {**plan["request"], "goals": [{"pose": FAR}]}}
    (task,) = asked.task_bodies([0])
    bodies = [
        ("plans", plan),
        ("plans", nowhere),
        ("pick_place", {**task, "scene": SCENE}),
        ("check", {"scene": SCENE}),
    ]
    return [_made(port, kind, body).headers["content-location"].rpartition("/")[2] for kind, body in bodies]


# schemathesis


def _examined(running: Server, seed: int, examples: int) -> Row:
    """What schemathesis says of the server's description and its answers."""
    with tempfile.TemporaryDirectory() as name:
        give_to_nobody(name)
        address = f"http://127.0.0.1:{running.port}"
        command = [str(tool("schemathesis")), "run", f"{address}/openapi.json", "--url", address]
        command += ["--checks", "not_a_server_error", "--max-examples", str(examples), "--seed", str(seed)]
        phases = "examples,coverage,fuzzing" if examples >= THOROUGH else "examples,fuzzing"
        command += ["--workers", "2", "--phases", phases, "--request-timeout", str(PATIENCE)]
        command += ["--exclude-path-regex", "/events$|/view$", "--no-color", "--generation-database", "none"]
        environment = {**os.environ, "HOME": name}
        try:
            done = subprocess.run(
                command,
                preexec_fn=become_nobody,
                cwd=name,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
                timeout=TOOL_SECONDS,
            )
        except subprocess.TimeoutExpired as late:
            return {"ok": False, "tested": 0, "found": f"no end within {TOOL_SECONDS:g} s", "output": str(late.stdout)}
    tested = [int(number) for number in re.findall(r"(\d+) generated", done.stdout)]
    errors = re.findall(r"^.*(?:Server error|\d+ failure|\d+ unique failures?).*$", done.stdout, re.MULTILINE)
    found = "; ".join(errors[:3]) or ("nothing" if done.returncode == 0 else f"exit code {done.returncode}")
    return {"ok": done.returncode == 0, "tested": sum(tested), "found": found, "output": done.stdout[-5000:]}


# bare sockets


def _bombarded(running: Server, count: int, seed: int) -> tuple[Counter[str], list[str]]:
    """How many requests had which status, and how some of those began that had one of 5xx or none."""
    statuses, worst, lock = Counter[str](), list[str](), threading.Lock()

    def send(first: int) -> None:
        jobs = list[str]()
        for turn, k in enumerate(range(first, count, CHUNK * THREADS)):
            rng, own = random.Random(seed * 1_000_003 + k), Counter[str]()
            jobs = _jobs(running.port) if turn % ANEW == 0 else jobs
            for _ in range(min(CHUNK, count - k)):
                data = _hostile(rng, jobs)
                status = _answer(running.port, data)
                own[status] += 1
                if (status == "hung" or status.startswith("5")) and len(worst) < SHOWN:
                    worst.append(f"{status}: {data[:LENGTH]!r}")
            with lock:
                statuses.update(own)

    with ThreadPoolExecutor(THREADS) as threads:
        for thread in [threads.submit(send, CHUNK * first) for first in range(THREADS)]:
            thread.result()
    return statuses, worst


def _answer(port: int, data: bytes) -> str:
    """The status that some bytes have, ``closed`` or ``hung``."""
    try:
        with socket.create_connection(("127.0.0.1", port), PATIENCE) as link:
            if data.startswith(UPGRADE):
                return _channel_status(link, data.replace(b"Host: localhost", b"Host: 127.0.0.1:%d" % port))
            with suppress(OSError):  # refused before it was sent whole
                link.sendall(data.replace(b"Host: localhost", b"Host: 127.0.0.1:%d" % port))
                if not data.endswith(WHOLE):  # it may be without an end, and for a whole one this withdraws it
                    link.shutdown(socket.SHUT_WR)
            answer = b""
            while len(answer) < 12 or answer.startswith(b"HTTP/1.1 100"):
                part = link.recv(4096)
                if not part:
                    break
                answer = (answer + part).removeprefix(b"HTTP/1.1 100 Continue\r\n\r\n")
    except TimeoutError:
        return "hung"
    except OSError:
        return "closed"
    found = STATUS.match(answer)
    return "closed" if found is None else found[1].decode()


UPGRADE = b"GET /channel HTTP/1.1"


def _channel_status(link: socket.socket, data: bytes) -> str:
    """The status of a handshake, ``closed`` or ``hung``; 101 if the frames after it have ended, too."""
    head, _, frames = data.partition(b"\r\n\r\n")
    link.sendall(head + b"\r\n\r\n")
    found = STATUS.match(link.recv(4096))
    if found is None or found[1] != b"101":
        return "closed" if found is None else found[1].decode()
    with suppress(ConnectionError):  # it may end before all is sent
        link.sendall(frames)
        link.shutdown(socket.SHUT_WR)
        while link.recv(65_536):
            pass
    return "101"


ROUTES = (
    *("plans", "certify", "check", "pick", "place", "pick_place", "solve", "order", "move_linear", "replan", "explain"),
    *("plan_cell", "roadmaps"),
)

NAMES = (
    *("bin", "..", "../../etc/passwd", "%2e%2e%2fetc%2fpasswd", "a" * 5000, "\x00", "'; drop table scenes; --"),
    *("%00", ""),
)

BODIES: tuple[dict[str, Any], ...] = (
    {
        "scene": SCENE,
        "request": {"start": "home", "goals": [{"joints": "home"}], "max_checks": 100, "time_limit": 0.05},
    },
    {"scene": SCENE, "states": [[0.0] * 6], "edges": []},
    {"scene": SCENE, "waypoints": [[0.0] * 6, [0.1] * 6], "padding": 0.0},
    {"scene": SCENE, "q": "home", "target": "blue_block", "deadline": 0.05},
    {"scene": SCENE, "target": "blue_block", "onto": "tray", "deadline": 0.05},
    {"scene": SCENE, "start": "home", "goal": [0.0, 0.0, 0.01], "deadline": 0.5},
    {
        "scene": SCENE,
        "q": "home",
        "deadline": 0.5,
        "steps": [
            {"kind": "MoveTo", "goal": [{"joints": "home"}, {"pose": {"position": [0.2, 0.0, 0.2]}}]},
            {"kind": "Alternatives", "branches": [[{"kind": "Wait", "seconds": 0.1}], []]},
            {"kind": "Repeat", "times": 2, "steps": [{"kind": "MoveLinear", "goal": [[0.0, 0.0, 0.01]]}]},
        ],
    },
    {
        "scene": SCENE,
        "q": "home",
        "deadline": 0.5,
        "steps": [{"kind": "MoveTo", "goal": [{"joints": "home"}]}],
        "memory": MemoryRecord.of(Memory(("a",), (np.zeros((2, 1)),), (np.zeros(3),))).document(),
    },
    {
        "scene": SCENE,
        "q": "home",
        "deadline": 0.5,
        "visits": [
            {"name": "a", "branches": [{"joints": [0.1] * 6}, {"pose": {"position": [0.2, 0.0, 0.2]}}]},
            {"name": "b", "branches": [{"joints": [0.2] * 6}], "then": [{"name": "c", "branches": []}], "after": ["a"]},
        ],
    },
    {
        "scene": SCENE,
        "deadline": 0.5,
        "delay": 0.05,
        "arms": [
            {"name": "a", "request": {"start": "home", "goals": [{"joints": "home"}], "time_limit": 0.05}},
            {"name": "b", "base": {"position": [0.7, 0.0, 0.0]}, "stands": [0.1] * 6, "anywhere": False},
            {"name": "c", "joints": ["joint_0"], "tool": "tip", "at_tool": {"arm": "a"}, "carried": []},
        ],
    },
    {"plan": "0" * 32, "at_time": 0.1},
    {"scene": SCENE, "planner": {"name": "prm", "settings": {"milestones": 5}}, "deadline": 0.1},
    {"obstacles": [{"name": "a", "shape": {"kind": "box", "size": [1.0, 1.0, 1.0]}, "pose": {"position": [0, 0, 0]}}]},
    {"edits": [{"op": "remove", "name": "tray"}]},
)


WHOLE = b" \n"
"""How requests end that have a head, and as much of a body as they say: JSON does not mind."""


def _hostile(rng: random.Random, jobs: Sequence[str]) -> bytes:
    """A request as no client sends it; ``jobs`` are ids that there are."""
    return _of_job(rng, jobs) if rng.random() < OF_JOBS else rng.choice(KINDS)(rng)


def _of_job(rng: random.Random, jobs: Sequence[str]) -> bytes:
    """A request for an answer, or for its motions, in ways that make no sense."""
    queries = [(name, rng.choice(QUERIES[name])) for name in QUERIES if rng.random() < 0.3]
    query = "&".join(f"{name}={text}" for name, text in queries)
    path = f"/plans/{rng.choice((*jobs, *NAMES[:3]))}" + rng.choice(("", "/events", *["/trajectory"] * 6))
    headers = {"Host": "localhost", "Content-Length": str(len(WHOLE))}
    if rng.random() < 0.3:
        headers["Accept"] = rng.choice((*(each.media for each in FORMATS.values()), "*/*;q=0", "a" * 1000, "text/*"))
    if rng.random() < 0.3:
        headers["Accept-Encoding"] = rng.choice(("gzip", "gzip;q=0", "br", ""))
    method = "GET" if rng.random() < 0.95 else rng.choice(("HEAD", "DELETE", "PATCH"))
    if method == "DELETE":
        path = "/plans/" + "0" * 32
    head = "".join(f"{key}: {value}\r\n" for key, value in headers.items())
    return f"{method} {path}?{query} HTTP/1.1\r\n{head}\r\n".encode("utf-8", "replace") + WHOLE


NUMBERS = ("0.01", "1e-9", "1e-300", "0", "-1", "nan", "inf", "1e308", "9" * 400, "", "0x1", "1_0", "%00", "1e-2", "5")

QUERIES: dict[str, tuple[str, ...]] = {
    "format": (*FORMATS, *FORMATS, "", "exe", "../json", "%00", "json,csv"),
    "dt": NUMBERS,
    "tolerance": NUMBERS,
    "segment": ("0", "1", "-1", "99999999999999999999", "lift", "%00", "a" * 3000, ""),
    "robot": ("hash", "whole", "", "none"),
    "more": ("1",),
}

OF_JOBS = 0.15
"""Part of all requests that are for answers that there are."""


def _noise(rng: random.Random) -> bytes:
    """Bytes that are no HTTP."""
    return rng.randbytes(rng.choice((0, 1, 7, 100, 5000)))


def _broken_head(rng: random.Random) -> bytes:
    """A head that is wrong in some way, or without an end."""
    line = rng.choice(
        (b"GET / HTTP/1.1", b"GET /", b"POST /plans HTTP/9.9", b"FOO /plans HTTP/1.1", b"GET " + b"/a" * 40_000)
    )
    head = rng.choice(
        (
            b"Host: localhost",
            b"Host: localhost\r\nContent-Length: -1",
            b"Host: localhost\r\nContent-Length: 99999999999999999999",
            b"Host: localhost\r\nContent-Length: 5\r\nContent-Length: 6",
            b"Host: localhost\r\nTransfer-Encoding: chunked\r\nContent-Length: 5",
            b"Host: localhost\r\nTransfer-Encoding: chunked",
            b"Host: localhost\r\n" + b"X-A: b\r\n" * rng.choice((10, 5000)),
            b"Host: localhost\r\nX-A: " + b"b" * 200_000,
            b"Host: localhost\r\n: nameless",
            b"Host: localhost\r\nX-A: \x00\xff",
        )
    )
    return line + b"\r\n" + head + rng.choice((b"\r\n\r\n", b"\r\n", b"", b"\r\n\r\nzz\r\nhello\r\n0\r\n\r\n"))


def _mutated(rng: random.Random) -> bytes:
    """A body of a known kind with something changed in it, to an address of some kind."""
    body = rng.choice(BODIES)
    data = json.dumps(body).encode()
    if rng.random() < 0.9:
        data = changed(data, np.random.default_rng(rng.randrange(2**32)), body)
    data += WHOLE
    name = rng.choice(NAMES)
    path = rng.choice((*(f"/{route}" for route in ROUTES), f"/scenes/{name}", f"/plans/{name}", f"/roadmaps/{name}"))
    method = "POST" if path.removeprefix("/") in ROUTES else rng.choice(("PUT", "PATCH", "DELETE", "GET"))
    if rng.random() < 0.1:
        method = rng.choice(("POST", "PUT", "OPTIONS", "HEAD", "TRACE", "post"))
    headers = {"Host": "localhost", "Content-Type": "application/json", "Content-Length": str(len(data))}
    for header, values in HEADERS.items():
        if rng.random() < 0.15:
            headers[header] = rng.choice(values)
    head = "".join(f"{key}: {value}\r\n" for key, value in headers.items())
    return f"{method} {path} HTTP/1.1\r\n{head}\r\n".encode("utf-8", "replace") + data


HEADERS = {
    "Prefer": ("wait", "wait=0", "wait=-1", "wait=999999999999", "wait=1", "respond-async, wait=1", "wait=\x7f"),
    "Idempotency-Key": ("a", "", "b" * 10_000, "with blanks", "\u00e9"),
    "If-Match": ('"1"', "*", '"-1"', '"99999999999999999999999"', "1"),
    "If-None-Match": ("*", '"1"'),
    "Content-Type": ("text/plain", "application/xml", "application/json; charset=utf-16", "multipart/form-data"),
    "Content-Encoding": ("gzip", "br"),
    "Expect": ("100-continue",),
    "Range": ("bytes=0-1",),
    "Accept": ("text/html", "a" * 1000),
    "Connection": ("close", "upgrade"),
    "Upgrade": ("websocket", "h2c"),
}


def _frames(rng: random.Random) -> bytes:
    """A handshake of a channel and frames after it, most of them broken in some way."""
    head = {"Host": "localhost", "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    head["Sec-WebSocket-Key"] = base64.b64encode(rng.randbytes(16)).decode()
    if rng.random() < 0.1:
        head |= rng.choice(({"Origin": "http://elsewhere"}, {"Sec-WebSocket-Version": "1"}, {"Sec-WebSocket-Key": "a"}))
    text = "".join(f"{name}: {value}\r\n" for name, value in head.items())
    return UPGRADE + f"\r\n{text}\r\n".encode("ascii") + b"".join(_frame(rng) for _ in range(rng.choice((1, 3, 40))))


def _frame(rng: random.Random) -> bytes:
    """One frame: a request with something changed in it, lists that claim to be vast, or no message at all."""
    asked = {
        "id": rng.choice((1, "a", -1, None)),
        "verb": rng.choice((*ROUTES, "cancel", "")),
        "body": rng.choice(BODIES),
    }
    payload = bytearray(msgpack.packb(asked))
    if rng.random() < 0.5:
        payload[rng.randrange(len(payload))] = rng.randrange(256)
    if rng.random() < 0.2:
        payload = bytearray(rng.choice((b"\xdd\xff\xff\xff\xff" * 500, b"\x91" * 5000, b"", rng.randbytes(2000))))
    first = rng.choice((0x82, 0x82, 0x82, 0x81, 0x02, 0x00, 0x80, 0x88, 0x89, 0x8A, 0xF2, 0x83))
    size = len(payload) if rng.random() < 0.9 else rng.choice((0, 1, 2**31, 2**63 - 1, 2**64 - 1))
    mask = rng.randbytes(4)
    masked = bytes(byte ^ mask[k % 4] for k, byte in enumerate(payload))
    return bytes([first, 0xFF]) + size.to_bytes(8, "big") + mask + masked


KINDS: tuple[Callable[[random.Random], bytes], ...] = (_noise, _broken_head, *[_mutated] * 4, _frames)
