"""A server does what the library does: the same plans, proofs and tasks, to the bit, and the same refusals."""

from __future__ import annotations

import json
import math
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

import planner_service as library
import planner_service as ps
from planner_service import tasks
from planner_service.client import Remote, ServerRefused
from planner_service.collision.budget import Cancelled
from planner_service.constraints import KeepUpright
from planner_service.grasping import GraspKind, GraspKinds
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.memory import Memory
from planner_service.memory.memory_file import MemoryRecord
from planner_service.planning.request import Pace
from planner_service.records.plan_file import load_plan
from planner_service.records.recertify import recertify
from planner_service.records.result import result_record
from planner_service.replanning.result import Outcome
from planner_service.tasks import places_on, plan_pick_place
from planner_service.tasks.ordering import Branch, OrderResult, Visit, order
from tests.support.optional import present
from tests.support.served import served

pytestmark = pytest.mark.slow

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "client.md"


@dataclass(frozen=True)
class Planner:
    """The library, or a server through its client, by the same names."""

    service: Any
    pick: Callable[..., ps.TaskResult]
    place: Callable[..., ps.TaskResult]
    plan_pick_place: Callable[..., ps.TaskResult]
    move_linear: Callable[..., ps.PlanResult]
    order: Callable[..., OrderResult]

    def with_scene(self, scene: Any) -> Planner:
        return replace(self, service=self.service.with_scene(scene))

    def of(self, world: Any) -> Planner:
        return replace(self, service=self.service.of(world))


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    options = ("--robot", "wxai", "--scene", "bin", "--scene", "post", "--workers", "1")
    with served(tmp_path_factory.mktemp("served"), *options) as address:
        yield address


CLIENTS = ps.client.plan_pick_place, ps.client.move_linear, ps.client.order


@pytest.fixture(scope="module", params=[False, True], ids=["http", "channel"])
def there(url: str, request: pytest.FixtureRequest) -> Iterator[Planner]:
    with Remote(url, "bin", channel=request.param) as remote:
        yield Planner(remote, ps.client.pick, ps.client.place, *CLIENTS)


@pytest.fixture(scope="module")
def here() -> Planner:
    service = ps.PlannerService("wxai", "bin")
    return Planner(service, library.pick, library.place, plan_pick_place, library.move_linear, order)


def bits(result: ps.PlanResult) -> dict[str, Any]:
    """All of a result but the clock's part."""
    record = result_record(result)
    for stage in record["stages"]:
        del stage["seconds"]
    return {**record, "fraction": result.fraction}


def task_bits(task: ps.TaskResult) -> list[Any]:
    """The same of a task, with the worlds before and after it."""
    motions = [
        (
            *(segment.name, bits(segment.result), segment.width, segment.timing),
            None if segment.gripper is None else replace(segment.gripper, seconds=0.0),
        )
        for segment in task.segments
    ]
    worlds = [(world.robot.hash, world.scene.hash, world.allowed) for world in (task.begin, task.world)]
    said = task.q.tolist(), str(task.failure), task.choosing, task.notes, task.task, task.memory.hash
    return [motions, worlds, *said]


HOME = ps.PlannerService("wxai", "empty").robot.home
ASIDE = HOME + np.array([0.8, 0.1, -0.1, 0.1, 0.0, 0.0])
ROUND = HOME + np.array([1.6, 0.0, 0.0, 0.0, 0.0, 0.0])
LOW = np.array([0.0, 2.3, 0.0, 0.0, 0.0, 0.0])
"""In the table."""

ABOVE = ps.Pose((0.25, -0.2, 0.2), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))


def asked(goal: Any = ASIDE, start: Any = HOME, **settings: Any) -> ps.PlanRequest:
    return ps.PlanRequest(**{"start": start, "goal": goal, "time_limit": None, **settings})


# -- plans ----------------------------------------------------------------------------------------


REQUESTS = {
    "rrt-connect": asked(ROUND, planner=ps.RRTConnect(), seed=2),
    "prm": asked(ROUND, planner=ps.PRM(milestones=60)),
    "pose with room": asked(PoseGoal(ABOVE, 0.01, 0.1)),
    "nowhere": asked(ps.Pose((3.0, 0.0, 0.3))),
    "slowly": asked(timing=ps.SCurve(), velocity_scale=0.3, acceleration_scale=0.5, max_tool_speed=0.1),
    "touching": asked(LOW),
    "in no time": asked(time_limit=0.0),
    "clamped": asked(start=[0.0, -0.005, 0.0, 0.0, 0.0, 0.0]),
    "polished": asked(ROUND, polish=library.Optimise(clearance=np.float64(0.02))),
}


@pytest.mark.parametrize("name", REQUESTS)
def test_a_server_plans_to_the_bit_what_the_library_plans(here: Planner, there: Planner, name: str) -> None:
    result, own = (planner.with_scene("post").service.plan(REQUESTS[name]) for planner in (there, here))
    assert bits(result) == bits(own)


def test_many_plans_are_the_same_in_their_order(here: Planner, there: Planner) -> None:
    requests = [asked(seed=seed, goal=ASIDE + 0.01 * seed) for seed in range(12)]
    own = [bits(here.service.plan(request)) for request in requests]
    assert [bits(result) for result in there.service.plan_many(requests, progress=False)] == own
    assert [bits(result) for result in there.service.plan_stream(iter(requests), at_once=3)] == own


def test_a_running_plan_is_cancelled_at_once(there: Planner) -> None:
    d, cancel = 0.5**0.5, ps.CancelToken()
    across = (math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8))  # between the start and the goal, to both sides
    walls = [
        ps.Obstacle(f"wall_{k}", ps.Box((1.15, 0.02, 1.8)), ps.Pose((d * r, d * r, 0.9), across))
        for k, r in ((0, 0.7), (1, -0.7))
    ]
    closed = there.with_scene(
        ps.Scene((*walls, ps.Obstacle("lintel", ps.Box((0.5, 0.02, 1.0)), ps.Pose((0.0, 0.0, 1.1), across))))
    )
    began = time.monotonic()
    threading.Timer(0.5, cancel.cancel).start()
    result = closed.service.plan(asked(ROUND, max_checks=10**9), cancel=cancel)
    assert present(result.failure).reason is ps.Reason.PREEMPTED
    assert time.monotonic() - began >= 0.5


# -- proofs and checks ----------------------------------------------------------------------------


def test_states_and_edges_are_judged_as_by_the_library(there: Planner) -> None:
    found = there.service.check([HOME, LOW], [(HOME, ASIDE), (HOME, LOW)])
    checker = ps.PlannerService("wxai", "bin").checker
    assert [state.free for state in found.states] == [True, False]
    assert found.edges == (True, False)
    verdicts = [checker.state_is_free(q) for q in (HOME, LOW)] + [checker.edge_is_free(HOME, q) for q in (ASIDE, LOW)]
    assert verdicts == [True, False, True, False]
    assert found.states[1].contacts == checker.contacts(LOW)
    assert found.counts == checker.counts
    assert there.service.check().states == ()


# -- tasks ----------------------------------------------------------------------------------------


def taken(planner: Planner, **handling: Any) -> ps.TaskResult:
    service = planner.service
    grasps = ps.top_grasps(service.robot, service.scene.obstacle("blue_block"))
    return planner.pick(service, HOME, "blue_block", grasps, ps.Handling(**{"support": "bin_floor", **handling}))


def test_picks_and_places_are_the_librarys_to_the_bit(here: Planner, there: Planner) -> None:
    request = asked(seed=4, velocity_scale=0.5)
    for handling in ({}, {"request": request, "line_timing": ps.SCurve(), "upright": 0.3, "open_width": 0.07}):
        assert task_bits(taken(there, **handling)) == task_bits(taken(here, **handling))
    pick = taken(here)
    scene = here.service.scene
    poses = list(places_on(scene.obstacle("blue_block"), scene.obstacle("tray")))
    results = [
        planner.place(planner.of(pick.world).service, pick.q, "blue_block", poses, ps.Handling(support="tray"))
        for planner in (here, there)
    ]
    assert task_bits(results[0]) == task_bits(results[1])
    for grasps in (None, GraspKinds([GraspKind.SIDE, GraspKind.TOP], friction=0.4)):
        how = ps.Handling("bin_floor", upright=0.3, request=request)
        results = [p.pick(p.service, HOME, "blue_block", grasps, how) for p in (here, there)]
        assert task_bits(results[0]) == task_bits(results[1])
        assert results[0].ok
    far = [ps.Pose((3.0, 0.0, 0.0))]
    results = [
        planner.pick(planner.service, HOME, "blue_block", far, ps.Handling(support="bin_floor"))
        for planner in (here, there)
    ]
    assert not results[0].ok
    assert task_bits(results[0]) == task_bits(results[1])


PICKED = tasks.pick_steps("blue_block", handling=library.Handling(support="table"))


@pytest.mark.parametrize(
    "steps",
    [
        (*PICKED, tasks.MoveTo("home")),
        tasks.pick_steps("blue_block", GraspKinds([GraspKind.SIDE])),
        (tasks.Alternatives([[tasks.MoveTo(LOW)], [tasks.MoveTo(ASIDE, name="aside")]]), tasks.Wait(0.5)),
        (tasks.Connect(), tasks.Approach(), tasks.Grasp("tray")),
    ],
    ids=["a pick", "from the side", "alternatives", "too wide"],
)
def test_tasks_of_steps_are_the_librarys_to_the_bit_with_how_each_step_fared(
    here: Planner, there: Planner, steps: Any
) -> None:
    task, request = tasks.Task(steps, "by steps"), asked(HOME)
    own, answer = (planner.service.solve(task, HOME, request=request, beam=2) for planner in (here, there))
    assert task_bits(answer) == task_bits(own)
    assert [str(step) for step in answer.steps] == [str(step) for step in own.steps]
    assert len(own.steps) >= 2


def test_a_memory_goes_there_and_comes_back_as_in_the_library(here: Planner, there: Planner) -> None:
    task, request = tasks.Task((*PICKED, tasks.MoveTo("home"))), asked(HOME)
    learned, states = {}, {}
    for planner in (here, there):
        first = planner.service.solve(task, HOME, request=request, memory=Memory())
        second = planner.service.solve(task, HOME, request=request, memory=first.memory)
        assert task_bits(first) != task_bits(second)
        learned[planner], states[planner] = [task_bits(first), task_bits(second)], second.counts.states
        assert states[planner] < first.counts.states
        poses = list(places_on(here.service.scene.obstacle("blue_block"), here.service.scene.obstacle("tray")))
        picked = planner.pick(planner.service, HOME, "blue_block", memory=second.memory)
        after = planner.of(picked.world).service
        placed = planner.place(after, picked.q, "blue_block", poses, memory=picked.memory)
        whole = planner.plan_pick_place(planner.service, "blue_block", "tray", request, memory=placed.memory)
        learned[planner] += map(task_bits, (picked, placed, whole))
    assert learned[here] == learned[there]


def test_a_server_refuses_the_memory_of_another_robot(url: str) -> None:
    steps = [{"kind": "MoveTo", "goal": [{"joints": "ready"}]}]
    body = {"scene": "bin", "q": "home", "steps": steps, "memory": MemoryRecord.of(Memory(("a", "b"))).document()}
    answer = httpx.post(f"{url}/solve", json=body, headers={"Prefer": "wait"}, timeout=60.0)
    assert answer.status_code == 422
    assert "memory: got 'motions of a, b'" in answer.json()["detail"]


def test_a_memory_of_another_robot_is_refused_before_anything_is_asked(here: Planner, there: Planner) -> None:
    for planner in (here, there):
        with pytest.raises(ps.InvalidRequest, match="memory: got 'motions of a, b'; expected of joint_0"):
            planner.service.solve(tasks.Task(PICKED), HOME, memory=Memory(("a", "b")))


VISITS = (
    Visit("left", [np.array([0.4, 0.95, 1.15, -1.25, 0.0, 0.0]), LOW]),
    Visit("above", [ps.Pose((0.3, 0.0, 0.3))], Visit("away", [[-0.5, 0.6, 0.9, -1.25, 0.0, 0.0]]), after=["left"]),
)


def order_bits(found: OrderResult) -> list[Any]:
    """All of an order but the clock's part."""
    stops = [(stop.name, stop.branch, bits(stop.leg)) for stop in found.stops]
    numbers = found.duration, found.bound, found.floor, found.gap, found.plans, found.counts, found.deterministic
    return [task_bits(found.task), stops, numbers, found.failed, found.refused, str(found.failure)]


@pytest.mark.parametrize(
    ("visits", "start", "settings", "failed"),
    [
        (VISITS, HOME, {"gap": 0.2}, 0),
        (VISITS, HOME, {"end": ASIDE, "plans": 1}, 0),
        ([Visit("low", [LOW])], HOME, {}, 0),
        (VISITS, LOW, {}, 2),
    ],
    ids=["in order", "with few plans", "blocked", "from where nothing is free"],
)
def test_orders_are_the_librarys_to_the_bit(
    here: Planner, there: Planner, visits: Any, start: Any, settings: dict[str, Any], failed: int
) -> None:
    request = asked(HOME, start=start)
    own, answer = (planner.order(planner.service, visits, request, **settings) for planner in (here, there))
    assert order_bits(answer) == order_bits(own)
    assert len(own.failed) == failed
    assert own.ok == (visits is VISITS and not failed)


def test_visits_that_cannot_be_sent_are_refused_and_a_cancelled_order_is_the_librarys(there: Planner) -> None:
    cancel = ps.CancelToken()
    cancel.cancel()
    with pytest.raises(Cancelled):
        there.order(there.service, VISITS, asked(HOME), cancel=cancel)
    with pytest.raises(ps.InvalidRequest, match="have no place in a file"):
        there.order(there.service, [Visit("moved", [Branch(HOME, ASIDE)])], asked(HOME))
    with pytest.raises(ps.UnknownName, match="unknown visit 'nothing'"):
        there.order(there.service, [Visit("one", [ASIDE], after=["nothing"])], asked(HOME))


def test_a_task_that_names_what_is_not_there_is_refused_by_the_server_as_by_the_library(
    here: Planner, there: Planner
) -> None:
    task = tasks.Task(tasks.pick_steps("blue_blok"))
    for planner in (here, there):
        with pytest.raises(ps.UnknownName, match="unknown obstacle 'blue_blok'; did you mean 'blue_block'"):
            planner.service.solve(task, HOME)


@pytest.mark.parametrize(
    ("goal", "settings"),
    [
        ([(0.0, 0.0, 0.05), (0.0, 0.05, 0.0)], {"zone": 0.01, "pace": Pace(ps.SCurve(), 0.5)}),
        ((0.0, 0.0, -0.5), {"partial": True, "free_axis": (0.0, 2.0, 0.0)}),
    ],
)
def test_lines_of_the_tool_are_the_librarys(here: Planner, there: Planner, goal: Any, settings: dict[str, Any]) -> None:
    results = [planner.move_linear(planner.service, HOME, goal, **settings) for planner in (here, there)]
    assert results[0].fraction is not None
    assert bits(results[0]) == bits(results[1])


# -- replanning, explanations, roadmaps -----------------------------------------------------------


def test_a_moving_robot_gets_the_librarys_motion(here: Planner, there: Planner) -> None:
    firsts = [planner.service.plan(asked()) for planner in (here, there)]
    tool = tuple(here.service.robot.tool_pose(ASIDE)[:3, 3])
    changed = here.service.scene.with_obstacle(ps.Obstacle("new", ps.Sphere(0.06), ps.Pose(tool)))
    outcomes = set()
    for scene, goal in ((None, ASIDE * 0.9), (changed, None)):
        seconds = [
            planner.service.replan(first, at_time=0.2, scene=scene, goal=goal)
            for planner, first in zip((here, there), firsts, strict=True)
        ]
        thirds = [
            planner.service.replan(second, at_time=0.05, latency=0.05)
            for planner, second in zip((here, there), seconds, strict=True)
        ]
        for own, other in (seconds, thirds):
            assert bits(own.result) == bits(other.result)
            assert (own.outcome, own.splice, str(own.failure)) == (other.outcome, other.splice, str(other.failure))
            assert own.ahead.tolist() == other.ahead.tolist()
            outcomes.add(own.outcome)
    assert {Outcome.NEW, Outcome.STOP} <= outcomes


def test_a_motion_that_the_server_has_not_made_is_not_replanned(here: Planner, there: Planner) -> None:
    with pytest.raises(ps.InvalidRequest, match="a motion that this server has not made"):
        there.service.replan(here.service.plan(asked()), at_time=0.1)


# -- scenes, worlds, and what a server's word is worth --------------------------------------------


def test_a_scene_of_ones_own_is_sent_once_and_deleted_at_the_end(url: str, here: Planner) -> None:
    own = here.service.scene.without("demo_post")
    with Remote(url, own) as remote:
        assert bits(remote.plan(asked())) == bits(here.with_scene(own).service.plan(asked()))
        name = f"client-{own.hash[:40]}"
        assert remote.with_scene(name).scene.hash == own.hash
        with Remote(url, own) as another:
            another.check([HOME])
        with pytest.raises(ServerRefused):
            remote.with_scene(name)
        assert remote.check([HOME]).states[0].free  # sent again
        with Remote(url, own) as another:
            another.check([HOME])
        with Remote(url, own) as another:
            another.check([HOME])  # as another version
            assert remote.check([HOME]).states[0].free
    with Remote(url, "bin") as remote, pytest.raises(ServerRefused, match="client-"):
        remote.with_scene(name)


def test_a_plan_of_a_server_is_saved_and_proven_as_any_other(here: Planner, there: Planner, tmp_path: Path) -> None:
    result = there.service.plan(asked())
    assert present(result.origin).elsewhere
    recertify(result, here.service).required()
    result.save(tmp_path / "plan.json")
    assert bits(load_plan(tmp_path / "plan.json").result) == bits(result)
    for segment in taken(there).segments:
        segment.result.save(tmp_path / "motion.json")
        world = present(segment.result.origin).world
        assert load_plan(tmp_path / "motion.json").begin.robot.gripper_width == world.robot.gripper_width


class Deaf(BaseHTTPRequestHandler):
    """A server that leaves out what was asked of the motions; ``url`` is of the server that it asks."""

    url = ""

    def answer(self) -> None:
        """What the other server answers."""
        length = int(self.headers.get("Content-Length", 0))
        body = json.dumps(self._heard(json.loads(self.rfile.read(length)))) if length else None
        kept = {name: value for name, value in self.headers.items() if name not in ("Host", "Content-Length")}
        answer = httpx.request(self.command, f"{self.url}{self.path}", content=body, headers=kept, timeout=60.0)
        content = self._said(answer.content)
        self.send_response(answer.status_code)
        for name, value in answer.headers.items():
            self.send_header(name, str(len(content)) if name == "content-length" else value)
        self.end_headers()
        self.wfile.write(content)

    def _said(self, content: bytes) -> bytes:
        return content

    def _heard(self, asked: Any) -> Any:
        if isinstance(asked, list):
            return [self._heard(each) for each in asked]
        if not isinstance(asked, dict):
            return asked
        usual: dict[str, Any] = {"constraints": [], "upright": None, "velocity_scale": 1.0}
        return {name: usual[name] if name in usual else self._heard(each) for name, each in asked.items()}

    def log_message(self, *_: object) -> None:
        """Nothing."""


class Elsewhere(Deaf):
    """A server whose motions begin elsewhere, and who says that this was not asked for."""

    def _heard(self, asked: Any) -> Any:
        return {name: ASIDE.tolist() if name in ("start", "q") else each for name, each in asked.items()} | (
            {"request": self._heard(asked["request"])} if "request" in asked else {}
        )

    def _said(self, content: bytes) -> bytes:
        if b'"format"' not in content:
            return content
        answer, there = json.loads(content), HOME.tolist()
        said = {"start": there} | ({"goals": [{"joints": there}]} if "segments" in answer else {})
        return json.dumps(answer | {"request": answer["request"] and answer["request"] | said}).encode()


@contextmanager
def asked_through(kind: type[Deaf], url: str) -> Iterator[Remote]:
    answers = {f"do_{method}": Deaf.answer for method in ("GET", "POST", "PUT", "DELETE")}
    handler = type("Handler", (kind,), {"url": url, **answers})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever).start()
        try:
            with Remote(f"http://127.0.0.1:{server.server_port}", "bin") as remote:
                yield remote
        finally:
            server.shutdown()


@pytest.fixture
def deaf(url: str) -> Iterator[Remote]:
    with asked_through(Deaf, url) as remote:
        yield remote


def test_a_motion_that_begins_elsewhere_is_refused_whatever_its_request_says(url: str) -> None:
    with asked_through(Elsewhere, url) as remote:
        grasps = ps.top_grasps(remote.robot, remote.scene.obstacle("blue_block"))
        for ask in (
            lambda: remote.plan(asked(ROUND)),
            lambda: ps.client.move_linear(remote, HOME, (0.0, 0.0, 0.02)),
            lambda: ps.client.pick(remote, HOME, "blue_block", grasps, ps.Handling("bin_floor", request=asked(HOME))),
            lambda: remote.solve(tasks.Task(PICKED), HOME, request=asked(HOME)),
        ):
            with pytest.raises(ps.InvalidFile, match="path: it begins at"):
                ask()


class Forger(Deaf):
    """A server whose answers have another memory than that of their motions."""

    change: Any = None

    def _said(self, content: bytes) -> bytes:
        answer = json.loads(content) if content.startswith(b"{") else {}
        if "memory" not in answer.get("sections", {}):
            return content
        answer["sections"]["memory"] |= self.change
        return json.dumps(answer).encode()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"hash": "0" * 64}, "hash: got '000"),
        ({"version": 2}, "version"),
        ({"memory": {"joint_names": ["a"], "motions": [], "grips": []}}, "hash: got"),
        (MemoryRecord.of(Memory(("a", "b"))).document(), "memory: got 'motions of a, b'"),
    ],
    ids=["hash", "version", "content", "another robot's"],
)
def test_a_memory_that_a_server_sends_is_read_as_strictly_as_a_file(url: str, change: Any, said: str) -> None:
    with (
        asked_through(type("Forging", (Forger,), {"change": change}), url) as remote,
        pytest.raises(ps.InvalidFile, match=said),
    ):
        remote.solve(tasks.Task([tasks.MoveTo(ASIDE)]), HOME, memory=Memory())


class Disorderly(Deaf):
    """A server that says something else of an order than it has made."""

    change: Any = staticmethod(lambda section: None)

    def _heard(self, asked: Any) -> Any:
        return asked

    def _said(self, content: bytes) -> bytes:
        answer = json.loads(content) if content.startswith(b"{") else {}
        if "order" not in answer.get("sections", {}):
            return content
        self.change(answer["sections"]["order"])
        return json.dumps(answer).encode()


def renamed(order: Any, names: list[str]) -> None:
    for stop, name in zip(order["stops"], names, strict=True):
        stop["visit"] = name


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda order: order["stops"].reverse(), "stops: got '3 of 4 motions'"),
        (lambda order: order["stops"].pop(), "stops: got '2 of 4 motions'"),
        (lambda order: order["stops"][0].update(visit="above"), "stops: expected each visit once"),
        (lambda order: order["stops"][0].update(branch=1), "stops: left is made where it has no branch 1"),
        (lambda order: order["stops"][0].update(branch=2), "stops: left is made where it has no branch 2"),
        (
            lambda order: renamed(order, ["above", "left", "away"]),
            "stops: away does not follow above",
        ),
        (
            lambda order: renamed(order, ["above", "away", "left"]),
            "stops: above comes before left",
        ),
        (lambda order: order.update(duration=order["duration"] / 2.0), "duration: got"),
        (lambda order: order.update(bound=order["duration"] * 2.0), "duration: got"),
        (lambda order: order.update(gap=0.0), "gap: got"),
        (lambda order: order.update(bound=None), "order: got 'times and visits'"),
        (lambda order: order.update(more=1), "more"),
    ],
)
def test_what_a_server_says_of_an_order_is_compared_with_its_motions(url: str, change: Any, said: str) -> None:
    kind = type("Disordered", (Disorderly,), {"change": staticmethod(change)})
    with asked_through(kind, url) as remote, pytest.raises(ps.InvalidFile, match=re.escape(said)):
        ps.client.order(remote, VISITS, asked(HOME), gap=0.2)


class Idle(Deaf):
    """A server that stays where it is, whatever is to be done."""

    def _heard(self, asked: Any) -> Any:
        return asked | ({"steps": [{"kind": "MoveTo", "goal": [{"joints": asked["q"]}]}]} if "steps" in asked else {})


def test_a_task_whose_object_is_never_taken_is_refused(url: str) -> None:
    with asked_through(Idle, url) as remote, pytest.raises(ps.InvalidFile, match="blue_block: never carried"):
        remote.solve(tasks.Task(PICKED), HOME)


LEVEL = tasks.Grasp("blue_block", support="bin_floor", upright=0.3)


def test_the_answer_to_another_question_is_refused(deaf: Remote) -> None:
    slowly, lying = asked(HOME, velocity_scale=0.5), [KeepUpright((0.0, 0.0, 1.0), 0.02)]
    grasps = ps.top_grasps(deaf.robot, deaf.scene.obstacle("blue_block"))
    underway = deaf.plan(asked())
    for ask in (
        lambda: deaf.plan(replace(slowly, goal=ASIDE)),
        lambda: deaf.explain(replace(slowly, goal=LOW), plans=1),
        lambda: deaf.replan(underway, at_time=0.1, request=slowly),
        lambda: deaf.certify([HOME, ASIDE], constraints=[KeepUpright((1.0, 0.0, 0.0), 3.0)]),
        lambda: ps.client.move_linear(deaf, HOME, (0.0, 0.0, 0.02), constraints=lying),
        lambda: ps.client.pick(deaf, HOME, "blue_block", grasps, ps.Handling("bin_floor", request=slowly)),
        lambda: ps.client.pick(deaf, HOME, "blue_block", grasps, ps.Handling("bin_floor", upright=0.3)),
        lambda: ps.client.plan_pick_place(deaf, "blue_block", "tray", slowly),
        lambda: ps.client.plan_pick_place(deaf, "blue_block", "tray", asked(HOME), upright=0.3),
        lambda: deaf.solve(tasks.Task(PICKED), HOME, request=slowly),
        lambda: deaf.solve(tasks.Task((tasks.Connect(), tasks.Approach(), LEVEL, tasks.Retreat())), HOME),
    ):
        with pytest.raises(ps.InvalidFile, match=r"(was sent|was asked|asked for)$"):
            ask()


def test_the_page_shows_what_works(url: str) -> None:
    code = present(re.search(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL))[1]
    names: dict[str, Any] = {}
    exec(code.replace("http://127.0.0.1:8080", url), names)
    assert names["result"].ok
    assert names["task"].ok
    assert names["back"].ok
