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
from benchmarks.studies.starts import starts_of
from planner_service import (
    PRM,
    Box,
    CancelToken,
    Cylinder,
    Handling,
    InvalidFile,
    InvalidRequest,
    Obstacle,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Reason,
    RRTConnect,
    Scene,
    SCurve,
    Sphere,
    TaskResult,
    Trapezoidal,
    UnknownName,
    client,
    top_grasps,
)
from planner_service.certify import Certifier, ExemptInterval
from planner_service.client import Remote, ServerRefused, StaleVersion
from planner_service.collision import Cancelled
from planner_service.constraints import KeepUpright
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.planning.request import Pace
from planner_service.records.exports.no_path_file import no_path_document
from planner_service.records.plan_file import load_plan
from planner_service.records.recertify import recertify
from planner_service.records.result import result_record
from planner_service.replanning.result import Outcome
from planner_service.tasks import places_on, plan_pick_place
from tests.support.optional import present
from tests.support.served import served
from tests.unit.infeasibility.test_remedies import SLIT, SLIT_ENDS

pytestmark = pytest.mark.slow

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "client.md"


@dataclass(frozen=True)
class Planner:
    """The library, or a server through its client, by the same names."""

    service: Any
    pick: Callable[..., TaskResult]
    place: Callable[..., TaskResult]
    plan_pick_place: Callable[..., TaskResult]
    move_linear: Callable[..., PlanResult]

    def with_scene(self, scene: Any) -> Planner:
        return replace(self, service=self.service.with_scene(scene))

    def of(self, world: Any) -> Planner:
        return replace(self, service=self.service.of(world))


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    options = ("--robot", "wxai", "--scene", "bin", "--scene", "post", "--workers", "1")
    with served(tmp_path_factory.mktemp("served"), *options) as address:
        yield address


@pytest.fixture(scope="module")
def there(url: str) -> Iterator[Planner]:
    with Remote(url, "bin") as remote:
        yield Planner(remote, client.pick, client.place, client.plan_pick_place, client.move_linear)


@pytest.fixture(scope="module")
def here() -> Planner:
    service = PlannerService("wxai", "bin")
    return Planner(service, library.pick, library.place, plan_pick_place, library.move_linear)


def bits(result: PlanResult) -> dict[str, Any]:
    """All of a result but the clock's part."""
    record = result_record(result)
    for stage in record["stages"]:
        del stage["seconds"]
    return {**record, "fraction": result.fraction}


def task_bits(task: TaskResult) -> list[Any]:
    """The same of a task, with the worlds before and after it."""
    motions = [
        (
            *(segment.name, bits(segment.result), segment.width, segment.timing),
            None if segment.gripper is None else replace(segment.gripper, seconds=0.0),
        )
        for segment in task.segments
    ]
    worlds = [(world.robot.hash, world.scene.hash, world.allowed) for world in (task.begin, task.world)]
    return [motions, worlds, task.q.tolist(), str(task.failure), task.choosing, task.notes, task.task]


HOME = PlannerService("wxai", "empty").robot.home
ASIDE = HOME + np.array([0.8, 0.1, -0.1, 0.1, 0.0, 0.0])
ROUND = HOME + np.array([1.6, 0.0, 0.0, 0.0, 0.0, 0.0])
LOW = np.array([0.0, 2.3, 0.0, 0.0, 0.0, 0.0])
"""In the table."""

ABOVE = Pose((0.25, -0.2, 0.2), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))


def asked(goal: Any = ASIDE, start: Any = HOME, **settings: Any) -> PlanRequest:
    return PlanRequest(**{"start": start, "goal": goal, "time_limit": None, **settings})


# -- plans ----------------------------------------------------------------------------------------


def test_a_start_that_touches_a_little_is_left_alike_here_and_there(here: Planner, there: Planner) -> None:
    service = PlannerService("wxai", "bin")
    start = next(starts_of(service, Certifier(service.robot, service.scene), np.random.default_rng(1), itself=False))[0]
    asked_for = [asked(HOME, start, start_overlap=most) for most in (0.003, 0.0)]
    (left, refused), answers = ([planner.service.plan(each) for each in asked_for] for planner in (here, there))
    assert [present(stretch.depth) > 0.0 for stretch in left.exempt] == [True]
    assert present(refused.failure).reason is Reason.START_IN_COLLISION
    assert [bits(answer) for answer in answers] == [bits(left), bits(refused)]
    tasks = [planner.plan_pick_place(planner.service, "blue_block", "tray", asked_for[0]) for planner in (here, there)]
    assert tasks[0].segments[0].name == "leave"
    assert task_bits(tasks[0]) == task_bits(tasks[1])


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (asked([0.0, 1.0]), "goal: got 'shape (2,)'; expected 6 joint values, shape (6,)"),
        (asked(start=()), "start: got 'shape (0,)'; expected 6 joint values, shape (6,)"),
        (asked(constraints=[KeepUpright((0.0, 0.0, 1.0), 0.1, link="lonk")]), "unknown link 'lonk'"),
    ],
)
def test_a_mistake_in_a_request_is_refused(there: Planner, request_: PlanRequest, message: str) -> None:
    with pytest.raises(InvalidRequest, match=re.escape(message)):
        there.service.plan(request_)


REQUESTS = {
    "straight": asked(),
    "seed": asked(ROUND, seed=5),
    "rrt-connect": asked(ROUND, planner=RRTConnect(), seed=2),
    "prm": asked(ROUND, planner=PRM(milestones=60)),
    "pose": asked(ABOVE),
    "pose with room": asked(PoseGoal(ABOVE, 0.01, 0.1)),
    "several goals": asked([ABOVE, ASIDE, HOME]),
    "nowhere": asked(Pose((3.0, 0.0, 0.3))),
    "upright": asked(constraints=[KeepUpright((1.0, 0.0, 0.0), 3.0)]),
    "slowly": asked(timing=SCurve(), velocity_scale=0.3, acceleration_scale=0.5, max_tool_speed=0.1),
    "corners": asked(ROUND, timing=Trapezoidal(), blend=0.0),
    "touching": asked(LOW),
    "from a touch": asked(start=LOW),
    "beyond the limits": asked([9.0, 1.0, 1.0, 0.0, 0.0, 0.0]),
    "in no time": asked(time_limit=0.0),
    "with one check": asked(max_checks=1),
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


def test_of_many_requests_the_one_that_cannot_be_planned_is_named(there: Planner) -> None:
    with pytest.raises(InvalidRequest, match=r"requests\[1\].goal"):
        there.service.plan_many([asked(), asked([0.0])], progress=False)


def test_a_running_plan_is_cancelled_at_once(there: Planner) -> None:
    d, cancel = 0.5**0.5, CancelToken()
    across = (math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8))  # between the start and the goal, to both sides
    walls = [
        Obstacle(f"wall_{k}", Box((1.15, 0.02, 1.8)), Pose((d * r, d * r, 0.9), across))
        for k, r in ((0, 0.7), (1, -0.7))
    ]
    closed = there.with_scene(Scene((*walls, Obstacle("lintel", Box((0.5, 0.02, 1.0)), Pose((0.0, 0.0, 1.1), across)))))
    began = time.monotonic()
    threading.Timer(0.5, cancel.cancel).start()
    result = closed.service.plan(asked(ROUND, max_checks=10**9), cancel=cancel)
    assert present(result.failure).reason is Reason.PREEMPTED
    assert time.monotonic() - began >= 0.5


# -- proofs and checks ----------------------------------------------------------------------------


def test_a_certificate_is_the_librarys(here: Planner, there: Planner) -> None:
    path = present(here.service.plan(asked(ROUND)).path)
    names = ("link_1", "table")
    for curve, settings in (
        ([HOME, ASIDE], {}),
        (path, {"padding": 0.002}),
        (path, {"part": (0.1, 0.5)}),
        (path, {"exempt": [ExemptInterval(0.0, 0.3, (names,), "meant")]}),
        (path, {"constraints": [KeepUpright((1.0, 0.0, 0.0), 3.0)]}),
        ([HOME, LOW], {}),
    ):
        assert there.service.certify(curve, **settings) == here.service.certify(curve, **settings)


@pytest.mark.parametrize(
    ("line", "message"), [([HOME * 100, ASIDE], "joint_"), ([[0.0, 0.0]], "6 "), ("line", "waypoints of shape")]
)
def test_what_is_no_path_of_the_robot_is_refused(there: Planner, line: Any, message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        there.service.certify(line)


def test_states_and_edges_are_judged_as_by_the_library(here: Planner, there: Planner) -> None:
    found = there.service.check([HOME, LOW], [(HOME, ASIDE), (HOME, LOW)])
    checker = here.service.changed().checker
    assert [state.free for state in found.states] == [True, False]
    assert found.edges == (True, False)
    verdicts = [checker.state_is_free(q) for q in (HOME, LOW)] + [checker.edge_is_free(HOME, q) for q in (ASIDE, LOW)]
    assert verdicts == [True, False, True, False]
    assert found.states[1].contacts == checker.contacts(LOW)
    assert found.counts == checker.counts
    assert there.service.check().states == ()


# -- tasks ----------------------------------------------------------------------------------------


def taken(planner: Planner, **handling: Any) -> TaskResult:
    service = planner.service
    grasps = top_grasps(service.robot, service.scene.obstacle("blue_block"))
    return planner.pick(service, HOME, "blue_block", grasps, Handling(**{"support": "bin_floor", **handling}))


def test_a_pick_holds_the_object_and_a_place_leaves_it(there: Planner) -> None:
    pick = taken(there)
    assert [segment.name for segment in pick.segments] == ["to pregrasp", "descend", "lift"]
    assert [held.name for held in pick.world.scene.attached] == ["blue_block"]
    carrying, scene = there.of(pick.world), there.service.scene
    poses = places_on(scene.obstacle("blue_block"), scene.obstacle("tray"))
    place = there.place(carrying.service, pick.q, "blue_block", list(poses), Handling(support="tray"))
    assert place.ok
    assert place.world.scene.attached == ()
    assert place.world.scene.obstacle("blue_block").pose in poses
    back = there.of(place.world).service.plan(asked(HOME, place.q))
    assert back.ok


def test_picks_and_places_are_the_librarys_to_the_bit(here: Planner, there: Planner) -> None:
    request = asked(seed=4, velocity_scale=0.5)
    for handling in ({}, {"request": request, "line_timing": SCurve(), "upright": 0.3, "open_width": 0.07}):
        assert task_bits(taken(there, **handling)) == task_bits(taken(here, **handling))
    pick = taken(here)
    scene = here.service.scene
    poses = list(places_on(scene.obstacle("blue_block"), scene.obstacle("tray")))
    results = [
        planner.place(planner.of(pick.world).service, pick.q, "blue_block", poses, Handling(support="tray"))
        for planner in (here, there)
    ]
    assert task_bits(results[0]) == task_bits(results[1])
    far = [Pose((3.0, 0.0, 0.0))]
    results = [
        planner.pick(planner.service, HOME, "blue_block", far, Handling(support="bin_floor"))
        for planner in (here, there)
    ]
    assert not results[0].ok
    assert task_bits(results[0]) == task_bits(results[1])


def test_a_whole_pick_and_place_is_the_librarys_to_the_bit(here: Planner, there: Planner, tmp_path: Path) -> None:
    tasks = [planner.plan_pick_place(planner.service, "blue_block", "tray", asked(HOME)) for planner in (here, there)]
    assert tasks[0].ok
    assert task_bits(tasks[0]) == task_bits(tasks[1])
    recertify(tasks[1], here.service).required()
    tasks[1].save(tmp_path / "task.json")


@pytest.mark.parametrize(
    ("target", "onto", "message"),
    [("blue_blok", "tray", "did you mean 'blue_block'"), ("blue_block", "trey", "did you mean 'tray'")],
)
def test_an_object_that_is_not_there_is_named(there: Planner, target: str, onto: str, message: str) -> None:
    with pytest.raises(UnknownName, match=message):
        there.plan_pick_place(there.service, target, onto, asked(HOME))


def test_an_unknown_support_is_named(there: Planner) -> None:
    with pytest.raises(UnknownName, match="unknown obstacle 'flor'"):
        taken(there, support="flor")


def test_an_explanation_is_cancelled(there: Planner) -> None:
    cancel = CancelToken()
    timer = threading.Timer(0.1, cancel.cancel)
    timer.start()
    with pytest.raises(Cancelled):
        there.service.explain(asked(LOW), plans=1_000, remedies=1_000, cancel=cancel)
    timer.join()


def test_a_task_is_cancelled(there: Planner) -> None:
    cancel = CancelToken()
    threading.Timer(0.03, cancel.cancel).start()
    task = there.plan_pick_place(there.service, "blue_block", "tray", asked(HOME), cancel=cancel)
    assert present(task.failure).reason is Reason.PREEMPTED


@pytest.mark.parametrize(
    ("goal", "settings"),
    [
        ((0.0, 0.0, 0.05), {}),
        ([(0.0, 0.0, 0.05), (0.0, 0.05, 0.0)], {"zone": 0.01, "pace": Pace(SCurve(), 0.5)}),
        ((0.0, 0.0, -0.5), {"partial": True}),
        ((0.0, 0.0, -0.5), {}),
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
    changed = here.service.scene.with_obstacle(Obstacle("new", Sphere(0.06), Pose(tool)))
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


def test_a_line_is_replanned_at_its_own_pace(here: Planner, there: Planner) -> None:
    pace, start = Pace(Trapezoidal(), velocity_scale=0.2, acceleration_scale=0.3), here.service.robot.pose("ready")
    replanned = []
    for planner in (here, there):
        line = planner.move_linear(planner.service, start, (0.0, 0.0, 0.02), pace=pace)
        replanned.append(planner.service.replan(line, at_time=0.1, goal=start + 0.1))
    own, other = replanned
    assert bits(own.result) == bits(other.result)
    assert other.request.velocity_scale == own.request.velocity_scale == 0.2
    assert other.request.acceleration_scale == 0.3


def test_a_motion_that_the_server_has_not_made_is_not_replanned(here: Planner, there: Planner) -> None:
    with pytest.raises(InvalidRequest, match="a motion that this server has not made"):
        there.service.replan(here.service.plan(asked()), at_time=0.1)


def test_an_explanation_is_the_librarys(here: Planner, there: Planner) -> None:
    request = asked(LOW)
    own, other = (planner.service.explain(request, plans=8, remedies=2) for planner in (here, there))
    assert str(own) == str(other)
    assert own.remedies
    assert [bits(remedy.result) for remedy in own.remedies] == [bits(remedy.result) for remedy in other.remedies]
    assert [remedy.scene for remedy in own.remedies] == [remedy.scene for remedy in other.remedies]
    for remedy in other.remedies:
        recertify(remedy.result, here.service.with_scene(remedy.scene)).required()


def test_an_explanation_has_the_librarys_proof_or_way(tmp_path: Path) -> None:
    sides = tuple(Obstacle(f"disc {y}", Cylinder(0.1, 0.2), Pose((0.5, y, 0.0))) for y in (0.5, -0.5))
    closed = Scene(sides), PlanRequest((0.0, 0.0), (3.0, 0.0), max_checks=3_000, time_limit=None)
    narrow = Scene(SLIT), PlanRequest(*SLIT_ENDS, max_checks=3_000, time_limit=None)
    with served(tmp_path, "--robot", "planar2", "--scene", "discs", "--workers", "1") as url:
        for scene, request in (closed, narrow):
            own = PlannerService("planar2", scene).explain(request, plans=1)
            with Remote(url, scene) as remote:
                other = remote.explain(request, plans=1)
            assert str(own) == str(other)
            if scene is narrow[0]:
                assert bits(present(own.way)) == bits(present(other.way))
                origins = [present(present(explanation.way).origin) for explanation in (own, other)]
                assert len({(origin.request, origin.pace) for origin in origins}) == 1
                continue
            reached = [present(explanation.reached) for explanation in (own, other)]
            assert reached[0].nearest.tolist() == reached[1].nearest.tolist()
            proofs = [present(explanation.no_path) for explanation in (own, other)]
            files = [no_path_document(proof, remote.world, request.start, [(3.0, 0.0)]) for proof in proofs]
            assert files[0] == files[1]


def test_a_roadmap_is_grown_kept_and_used(here: Planner, there: Planner) -> None:
    roadmaps = [planner.service.build_roadmap(PRM(milestones=50), seed=2) for planner in (here, there)]
    assert roadmaps[0].hash == roadmaps[1].hash
    results = [
        planner.service.plan(asked(planner=roadmap)) for planner, roadmap in zip((here, there), roadmaps, strict=True)
    ]
    assert bits(results[0]) == bits(results[1])


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


def test_a_stored_scene_has_versions(here: Planner, there: Planner) -> None:
    first, second = here.service.scene.without("demo_post"), here.service.scene.without("tray")
    assert there.service.store_scene("cell", first, version=0) == 1
    cell = there.service.with_scene("cell")
    assert there.service.store_scene("cell", second, version=1) == 2
    with pytest.raises(StaleVersion, match="cell"):
        there.service.store_scene("cell", first, version=1)
    with pytest.raises(StaleVersion):
        there.service.store_scene("cell", first, version=0)
    assert there.service.with_scene("cell").scene.hash == second.hash
    assert bits(cell.plan(asked())) == bits(here.with_scene(first).service.plan(asked()))  # as it was found


def test_a_gripper_stands_as_it_is_said_to(here: Planner, there: Planner) -> None:
    results = [planner.service.changed(gripper=0.03).plan(asked()) for planner in (here, there)]
    assert bits(results[0]) == bits(results[1])
    assert present(results[1].origin).world.robot.gripper_width == 0.03


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
        grasps = top_grasps(remote.robot, remote.scene.obstacle("blue_block"))
        for ask in (
            lambda: remote.plan(asked(ROUND)),
            lambda: client.move_linear(remote, HOME, (0.0, 0.0, 0.02)),
            lambda: client.pick(remote, HOME, "blue_block", grasps, Handling("bin_floor", request=asked(HOME))),
        ):
            with pytest.raises(InvalidFile, match="path: it begins at"):
                ask()


def test_the_answer_to_another_question_is_refused(deaf: Remote) -> None:
    slowly, lying = asked(HOME, velocity_scale=0.5), [KeepUpright((0.0, 0.0, 1.0), 0.02)]
    grasps = top_grasps(deaf.robot, deaf.scene.obstacle("blue_block"))
    underway = deaf.plan(asked())
    for ask in (
        lambda: deaf.plan(replace(slowly, goal=ASIDE)),
        lambda: deaf.explain(replace(slowly, goal=LOW), plans=1),
        lambda: deaf.replan(underway, at_time=0.1, request=slowly),
        lambda: deaf.certify([HOME, ASIDE], constraints=[KeepUpright((1.0, 0.0, 0.0), 3.0)]),
        lambda: client.move_linear(deaf, HOME, (0.0, 0.0, 0.02), constraints=lying),
        lambda: client.pick(deaf, HOME, "blue_block", grasps, Handling("bin_floor", request=slowly)),
        lambda: client.pick(deaf, HOME, "blue_block", grasps, Handling("bin_floor", upright=0.3)),
        lambda: client.plan_pick_place(deaf, "blue_block", "tray", slowly),
        lambda: client.plan_pick_place(deaf, "blue_block", "tray", asked(HOME), upright=0.3),
    ):
        with pytest.raises(InvalidFile, match=r"(was sent|was asked|asked for)$"):
            ask()


def ends(planner: Planner, pick: TaskResult, cancel: CancelToken) -> Iterator[tuple[str, str, str]]:
    """How every verb ends."""
    service, handling = planner.service, Handling(cancel=cancel)
    grasps = top_grasps(service.robot, service.scene.obstacle("blue_block"))
    carrying, moving = planner.of(pick.world).service, service.plan(asked())
    verbs: list[Callable[[], Any]] = [
        lambda: service.plan(asked(ROUND), cancel=cancel),
        lambda: service.certify([HOME, ASIDE], cancel=cancel),
        lambda: service.explain(asked(LOW), cancel=cancel),
        lambda: service.build_roadmap(PRM(milestones=50), cancel=cancel),
        lambda: service.replan(moving, at_time=0.1, goal=ASIDE * 0.9, cancel=cancel),
        lambda: planner.move_linear(service, HOME, (0.0, 0.0, 0.02), cancel=cancel),
        lambda: planner.pick(service, HOME, "blue_block", grasps, handling),
        lambda: planner.place(carrying, pick.q, "blue_block", [ABOVE], handling),
        lambda: planner.plan_pick_place(service, "blue_block", "tray", asked(HOME), cancel=cancel),
    ]
    for verb in verbs:
        try:
            result = verb()
        except Cancelled as error:
            yield "Cancelled", "", str(error)
        else:
            yield type(result).__name__, str(result.failure), str(result.counts)


def test_what_was_cancelled_before_it_was_asked_ends_as_in_the_library(here: Planner, there: Planner) -> None:
    over, pick = CancelToken(), taken(here)
    over.cancel()
    own, others = (list(ends(planner, pick, over)) for planner in (here, there))
    assert own == others
    assert [kind for kind, _, _ in own] == [
        "PlanResult",
        *["Cancelled"] * 3,
        "Replanned",
        "PlanResult",
        *["TaskResult"] * 3,
    ]


def test_a_world_of_another_robot_is_refused(there: Planner) -> None:
    with pytest.raises(InvalidRequest, match="a world of the server's robot, wxai"):
        there.of(PlannerService("planar2", "discs").world)


def test_there_is_no_such_scene(url: str) -> None:
    with pytest.raises(ServerRefused, match="bon"):
        Remote(url, "bon")


def test_the_page_shows_what_works(url: str) -> None:
    code = present(re.search(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL))[1]
    names: dict[str, Any] = {}
    exec(code.replace("http://127.0.0.1:8080", url), names)
    assert names["result"].ok
    assert names["task"].ok
    assert names["back"].ok
