"""A server as its clients see it: the library's answers, each once, whatever happens to workers and to the server."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from planner_service.records.exports.formats import How, exported
from planner_service.records.plan_file import load_plan
from planner_service.robot_setup.loading import load_robot
from tests.support.optional import present

pytestmark = pytest.mark.slow

GOAL = [0.9, 1.0, 1.0, 0.0, 0.0, 0.0]
PLAN = {"scene": "bin", "request": {"start": "home", "goals": [{"joints": GOAL}], "seed": 3}}
LONG = {"scene": "bin", "planner": {"name": "prm", "settings": {"milestones": 100_000, "max_checks": 10**9}}}
"""Takes minutes."""

WORKERS, QUEUE = 1, 3


@dataclass
class Server:
    """A server in a process of its own, and a client of it."""

    process: subprocess.Popen[str]
    client: httpx.Client

    def post(self, kind: str, body: Any, *, wait: bool = True, **headers: str) -> httpx.Response:
        prefer = {"Prefer": "wait"} if wait else {}
        return self.client.post(
            f"/{kind}", json=body, headers=prefer | {k.replace("_", "-"): v for k, v in headers.items()}
        )

    def begun(self, kind: str, body: Any, **headers: str) -> str:
        """The id of a request that is not waited for."""
        response = self.post(kind, body, wait=False, **headers)
        assert response.status_code == 202, response.text
        assert response.headers["location"] == f"/plans/{response.json()['id']}"
        return str(response.json()["id"])

    def answer(self, job: str) -> httpx.Response:
        """The answer of a request, once it is there."""
        response = self.client.get(f"/plans/{job}", headers={"Prefer": "wait"})
        assert response.status_code != 202
        return response

    def events(self, job: str, until: Callable[[str, dict[str, Any]], bool]) -> list[tuple[str, dict[str, Any]]]:
        """The events of a request up to one that is waited for."""
        events = []
        with self.client.stream("GET", f"/plans/{job}/events") as response:
            name = ""
            for line in response.iter_lines():
                if line.startswith("event: "):
                    name = line.removeprefix("event: ")
                if line.startswith("data: "):
                    events.append((name, json.loads(line.removeprefix("data: "))))
                    if until(*events[-1]):
                        break
        return events

    def workers(self) -> list[int]:
        """The processes of its workers."""
        threads = Path(f"/proc/{self.process.pid}/task").iterdir()
        return [int(child) for thread in threads for child in (thread / "children").read_text("ascii").split()]

    def end(self, *jobs: str) -> None:
        """Cancel requests, and wait until they have ended."""
        for job in jobs:
            self.client.delete(f"/plans/{job}")
        for job in jobs:
            self.answer(job)


@contextmanager
def serving(folder: Path, *options: str) -> Iterator[Server]:
    command = [sys.executable, "-m", "planner_service", "serve", "--scene", "bin", "--port", "0"]
    command += ["--workers", str(WORKERS), "--queue", str(QUEUE), "--state", str(folder / "state"), *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder)
    try:
        url = present(process.stdout).readline().removeprefix("serving at ").strip()
        with httpx.Client(base_url=url, timeout=60.0) as client:
            while client.get("/ready").status_code != 200:
                time.sleep(0.05)
            yield Server(process, client)
    finally:
        process.terminate()
        process.wait()
        present(process.stdout).close()


@dataclass
class Before:
    """What a server was asked, and has told, before it was killed."""

    answered: httpx.Response
    running: list[str]
    waiting: str


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Before]:
    """The folder of a server that was killed."""
    folder = tmp_path_factory.mktemp("server")
    with serving(folder) as server:
        answered = server.post("plans", PLAN)
        server.client.put("/scenes/cell", json={"obstacles": []})
        running = [server.begun("roadmaps", LONG) for _ in range(WORKERS)]
        before = Before(answered, running, server.begun("plans", PLAN, Idempotency_Key="mine"))
        server.process.kill()
        server.process.wait()
    return folder, before


@pytest.fixture(scope="module")
def server(killed: tuple[Path, Before]) -> Iterator[Server]:
    """A server that was started in the folder of the killed one."""
    folder, before = killed
    with serving(folder) as server:
        for job in before.running:
            server.events(job, is_running)
        server.end(*before.running)
        yield server


def timeless(value: Any) -> Any:
    """A document without the seconds that something took."""
    if isinstance(value, dict):
        return {key: timeless(entry) for key, entry in value.items() if key != "seconds"}
    return [timeless(entry) for entry in value] if isinstance(value, list) else value


def is_running(name: str, data: dict[str, Any]) -> bool:
    return data.get("state") == "running"


# Answers.


def test_an_answer_has_the_robots_hash_in_its_place_if_the_client_says_so(server: Server) -> None:
    whole, robot = server.post("plans", PLAN), server.client.get("/robot").json()
    named = server.post("plans?robot=hash", PLAN)
    assert whole.json()["robot"] == robot["robot"]
    assert timeless(named.json()) == timeless({**whole.json(), "robot": {"hash": robot["hash"]}})
    assert len(named.content) < 0.7 * len(whole.content)
    again = server.client.get(f"{named.headers['content-location']}?robot=hash")
    assert again.content == named.content
    assert server.client.get(named.headers["content-location"]).json()["robot"] == robot["robot"]
    assert server.post("plans?robot=none", PLAN).json()["type"].endswith(":malformed")


@pytest.mark.parametrize(
    ("accepted", "encoding"),
    [("gzip, deflate", "gzip"), ("br;q=1.0, *;q=0.1", "gzip"), ("gzip;q=0, *", None), ("identity", None)],
)
def test_answers_are_gzipped_for_who_takes_that(server: Server, accepted: str, encoding: str | None) -> None:
    plain = server.client.get("/robot", headers={"Accept-Encoding": "identity"})
    response = server.client.get("/robot", headers={"Accept-Encoding": accepted})
    assert response.headers.get("content-encoding") == encoding
    assert response.content == plain.content
    assert "accept-encoding" in response.headers["vary"].lower()
    short = server.client.get("/health", headers={"Accept-Encoding": accepted})
    assert "content-encoding" not in short.headers


@pytest.mark.parametrize(
    ("kind", "body", "status", "problem"),
    [
        ("plans", "{", 400, "malformed"),
        ("plans", json.dumps({**PLAN, "more": 1}), 422, "invalid-request"),
        ("plans", json.dumps(PLAN).replace("0.9", "NaN"), 400, "malformed"),
        ("plans", json.dumps({**PLAN, "scene": "../../etc/passwd"}), 422, "unknown-name"),
        ("replan", json.dumps({"plan": "0" * 32, "at_time": 0.0}), 422, "unknown-name"),
    ],
)
def test_what_cannot_be_carried_out_is_a_problem(
    server: Server, kind: str, body: str, status: int, problem: str
) -> None:
    headers = {"Content-Type": "application/json", "Prefer": "wait"}
    response = server.client.post(f"/{kind}", content=body, headers=headers)
    assert response.headers["content-type"] == "application/problem+json"
    assert (response.status_code, response.json()["status"]) == (status, status)
    assert response.json()["type"].endswith(f":{problem}")


def test_the_same_key_gets_the_same_answer_and_another_request_a_problem(server: Server) -> None:
    first = server.post("plans", PLAN, Idempotency_Key="one")
    again = server.post("plans", PLAN, Idempotency_Key="one")
    assert (again.content, again.headers["content-location"]) == (first.content, first.headers["content-location"])
    other = server.post("plans", {**PLAN, "deadline": 5.0}, Idempotency_Key="one")
    assert other.status_code == 422
    assert other.json()["type"].endswith(":key-reused")


def test_stages_are_told_in_their_order_also_to_those_who_come_late(server: Server) -> None:
    job = server.begun("plans", PLAN)
    events = server.events(job, lambda *_: False)
    server.answer(job)
    assert events[-1] == ("state", {"state": "done"})
    if len(events) > 1:
        assert events[:2] == [("state", {"state": "queued"}), ("state", {"state": "running"})]
        assert next(data["stage"] for name, data in events if name == "stage") == "endpoints"
    text = server.client.get("/metrics").text
    assert 'planner_service_ended_total{kind="plans",reason="OK"}' in text
    assert 'planner_service_checks_total{what="states"}' in text


def test_an_answer_after_its_deadline_is_none(server: Server) -> None:
    late = server.post("plans", {**PLAN, "deadline": 0.001})
    assert late.json()["result"]["failure"]["reason"] == "TIMED_OUT"


@pytest.mark.parametrize("goal", [{"joint": GOAL}, {}, 5, "home", {"joints": GOAL, "pose": {}}])
def test_a_goal_that_is_of_neither_kind_says_what_a_goal_is(server: Server, goal: Any) -> None:
    refused = server.post("plans", {"scene": "bin", "request": {"start": "home", "goals": [goal]}})
    assert "with joints, the values or the name of a pose, or with pose" in refused.json()["detail"]


def test_an_object_is_set_down_at_a_pose(server: Server) -> None:
    there = {"position": [0.22, 0.3, 0.0325], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
    done = server.post("pick_place", {"scene": "bin", "target": "blue_block", "onto": "tray", "poses": [there]}).json()
    assert done["failure"] is None
    motions = {each["name"]: each for each in done["segments"]}
    tool = load_robot("wxai").tool_pose(motions["retreat"]["result"]["path"]["waypoints"][0])
    assert tool[:2, 3].tolist() == pytest.approx(there["position"][:2], abs=1e-3)


# Motions ready to run.


def test_a_motion_comes_in_the_format_that_is_asked_for_or_accepted(server: Server, tmp_path: Path) -> None:
    planned = server.post("plans", PLAN)
    address = planned.headers["content-location"] + "/trajectory"
    (tmp_path / "plan.json").write_bytes(planned.content)
    saved = load_plan(tmp_path / "plan.json")
    samples = saved.result.unwrap()[1].sample(0.05)
    motion = server.client.get(address, params={"dt": 0.05}).json()["motions"][0]
    assert motion["positions"] == samples.q.tolist()
    array = server.client.get(address, params={"dt": 0.05}, headers={"Accept": "application/x-npy"})
    np.testing.assert_array_equal(np.load(io.BytesIO(array.content))[:, 1:7], samples.q)
    assert "within" in array.headers["deviation"]
    table = server.client.get(address, headers={"Accept": "text/csv, application/json;q=0"})
    assert table.text == exported(saved, "csv", How())
    for form in ("joint-trajectory", "follow-joint-trajectory", "urscript-servoj", "lerobot"):
        answer = server.client.get(address, params={"format": form, "dt": 0.05, "segment": 0})
        assert answer.text == exported(saved, form, How(dt=0.05)), form


@pytest.mark.parametrize(
    ("query", "accept", "status", "says"),
    [
        ("?format=krl&dtt=1", "*/*", 400, "dtt"),
        ("?dt=fast", "*/*", 400, "dt: got 'fast'"),
        ("?dt=", "*/*", 400, "dt: got ''"),
        ("?tolerance=.", "*/*", 400, "tolerance: got '.'"),
        ("?dt=e5", "*/*", 400, "dt: got 'e5'"),
        ("?dt=1e999", "*/*", 422, "dt"),
        ("?dt=1e-9", "*/*", 422, "at least"),
        ("?dt=0.00001", "*/*", 422, "at most 50,000 points"),
        ("?format=mujoco", "*/*", 422, "MJCF"),
        ("?format=gcode", "*/*", 404, "gcode"),
        ("?segment=descend", "*/*", 404, "segment"),
        ("?format=csv", "application/json", 406, "text/csv"),
        ("", "image/png", 406, "image/png"),
        ("", "application/json;q=0", 406, "Accept"),
    ],
)
def test_a_motion_that_cannot_be_had_so_is_a_problem(
    server: Server, query: str, accept: str, status: int, says: str
) -> None:
    address = server.post("plans", PLAN).headers["content-location"] + "/trajectory"
    answer = server.client.get(address + query, headers={"Accept": accept})
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    assert says in answer.json()["detail"]


def test_what_an_address_does_not_take_is_refused(server: Server) -> None:
    for address in ("/robot?version=2", "/scenes?limit=1", "/plans?limit=1&page=2"):
        assert server.client.get(address).status_code == 400, address
    assert server.client.get("/robot", headers={"Accept": "text/html"}).status_code == 406
    assert server.client.post("/plans?wait=1", json=PLAN).status_code == 400


# Queue, deadlines, cancellation.


def test_beyond_the_queue_requests_are_refused_but_not_those_that_were_accepted_before(server: Server) -> None:
    known = server.begun("plans", PLAN, Idempotency_Key="known")
    server.answer(known)
    running = [server.begun("roadmaps", LONG) for _ in range(WORKERS)]
    for job in running:
        server.events(job, is_running)
    waiting = [server.begun("plans", PLAN) for _ in range(QUEUE)]
    assert [server.client.get(f"/plans/{job}").json()["position"] for job in waiting] == [0, 1, 2]
    refused = server.post("plans", PLAN)
    assert refused.status_code == 429
    assert int(refused.headers["retry-after"]) >= 1
    assert server.post("plans", PLAN, Idempotency_Key="known").status_code == 200
    server.end(*running)
    assert [server.answer(job).json()["result"]["failure"] for job in waiting] == [None] * QUEUE


def test_what_is_cancelled_ends_and_says_so(server: Server) -> None:
    running = [server.begun("roadmaps", LONG) for _ in range(WORKERS)]
    for job in running:
        server.events(job, is_running)
    waiting = server.begun("plans", PLAN)
    assert server.client.delete(f"/plans/{waiting}").status_code == 202
    answer = server.answer(waiting)
    assert answer.status_code == 200
    assert answer.json()["result"]["failure"]["reason"] == "PREEMPTED"
    server.end(*running)
    assert {server.answer(job).status_code for job in running} == {410}
    for finished, kept in (("keep", 200), ("remove", 404)):
        deleted = server.client.delete(f"/plans/{waiting}", params={"finished": finished})
        assert (deleted.status_code, server.client.get(f"/plans/{waiting}").status_code) == (204, kept)
    assert server.client.delete(f"/plans/{running[0]}").status_code == 204
    assert server.client.get(f"/plans/{running[0]}").status_code == 404


def test_a_deadline_ends_a_request_that_waits_and_one_that_runs(server: Server) -> None:
    running = [server.begun("roadmaps", {**LONG, "deadline": 0.5}) for _ in range(WORKERS)]
    waiting = server.post("plans", {**PLAN, "deadline": 0.1})
    assert waiting.json()["result"]["failure"]["reason"] == "TIMED_OUT"
    assert waiting.json()["result"]["stages"] == []
    assert {server.answer(job).status_code for job in running} == {408}


def test_a_closed_connection_cancels_what_has_no_key(server: Server) -> None:
    jobs = {}
    for name, headers in (("without", {}), ("with", {"Idempotency-Key": "closed"})):
        with pytest.raises(httpx.ReadTimeout):
            server.client.post("/roadmaps", json=LONG, headers={"Prefer": "wait", **headers}, timeout=0.5)
        jobs[name] = server.client.get("/plans", params={"limit": 1}).json()["plans"][0]["id"]
    assert server.answer(jobs["without"]).json()["type"].endswith(":cancelled")
    assert server.client.get(f"/plans/{jobs['with']}").status_code == 202
    server.end(jobs["with"])


# What is lost, or comes later.


def test_a_server_that_stops_lets_waiting_clients_go_and_answers_after_its_next_start(tmp_path: Path) -> None:
    with serving(tmp_path) as server, ThreadPoolExecutor(1) as thread:
        running = server.begun("roadmaps", LONG)
        waiting = thread.submit(server.post, "plans", PLAN)
        while len(server.client.get("/plans").json()["plans"]) < 2:
            time.sleep(0.01)
        server.process.terminate()
        response = waiting.result(30.0)
        assert server.process.wait(30.0) in (0, -signal.SIGTERM)
    assert response.status_code == 202
    with serving(tmp_path) as server:
        server.end(running)
        assert server.answer(response.json()["id"]).json()["result"]["failure"] is None


def test_a_killed_worker_costs_its_request_one_retry(server: Server) -> None:
    job = server.begun("roadmaps", LONG)
    server.events(job, is_running)
    for worker in server.workers():
        os.kill(worker, signal.SIGKILL)
    events = server.events(job, lambda _, data: data.get("state") == "retried")
    assert [data["state"] for _, data in events] == ["queued", "running", "retried"]
    server.end(job)
    assert server.post("plans", PLAN).json()["result"]["failure"] is None


def test_after_the_server_was_killed_answers_are_there_and_what_was_accepted_is_answered(
    killed: tuple[Path, Before], server: Server
) -> None:
    before = killed[1]
    found = server.client.get(before.answered.headers["content-location"])
    assert found.content == before.answered.content
    assert server.client.get("/scenes/cell").headers["etag"] == '"1"'
    again = server.post("plans", PLAN, Idempotency_Key="mine")
    assert again.headers["content-location"] == f"/plans/{before.waiting}"
    assert timeless(again.json()) == timeless(before.answered.json())


# Scenes.


def test_a_scene_is_changed_only_from_the_version_that_the_client_knows(server: Server) -> None:
    box = {"name": "box", "shape": {"kind": "box", "size": [0.1, 0.1, 0.1]}, "pose": POSE}
    first = server.client.put("/scenes/room", json={"obstacles": []}, headers={"If-None-Match": "*"})
    assert (first.status_code, first.headers["etag"]) == (201, '"1"')
    edits = {"edits": [{"op": "add", "obstacle": box}, {"op": "move", "name": "box", "pose": POSE}]}
    second = server.client.patch("/scenes/room", json=edits, headers={"If-Match": '"1"'})
    assert (second.status_code, second.headers["etag"]) == (200, '"2"')
    for change in (
        server.client.patch("/scenes/room", json=edits, headers={"If-Match": '"1"'}),
        server.client.put("/scenes/room", json={"obstacles": []}, headers={"If-None-Match": "*"}),
        server.client.delete("/scenes/room", headers={"If-Match": '"1"'}),
    ):
        assert change.status_code == 412
    for version in ('"0"', "2", "*"):
        assert server.client.delete("/scenes/room", headers={"If-Match": version}).status_code == 400
    assert [o["name"] for o in server.client.get("/scenes/room").json()["obstacles"]] == ["box"]
    assert server.client.get("/scenes/room?version=1").json()["obstacles"] == []
    assert server.client.delete("/scenes/room").status_code == 204
    assert server.client.get("/scenes/room").status_code == 404


POSE = {"position": [1.0, 1.0, 1.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
