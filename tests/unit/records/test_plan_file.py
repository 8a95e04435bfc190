"""Plans and tasks survive their files bit for bit, and a file that is wrong says everything that is wrong."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import suppress
from copy import deepcopy
from dataclasses import replace
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service.certify import Certificate, ExemptInterval, Refusal
from planner_service.certify.colliding_solutions import CollidingSolution
from planner_service.collision import CheckCounts, Contact, JointStep
from planner_service.constraints import JointRange, ToolRegion
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.json_reader import MAX_BYTES
from planner_service.geometry.shapes import Pose
from planner_service.kinematics import Cause, LimitExcess, Slip, Suggestion, Unreachable
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.path.joint_path import JointPath
from planner_service.planners import PLANNERS, RRT
from planner_service.planning.request import PlanRequest, World
from planner_service.planning.result import Failure, ImproveReport, MotionReport, PlanResult, Reason, Stage, StageReport
from planner_service.planning.task_result import Segment
from planner_service.records.evidence import save_plan
from planner_service.records.http.robot_by_hash import robot_by_hash
from planner_service.records.plan_file import SavedPlan, SavedTask, load_plan, load_task
from planner_service.records.plan_reader import PlanReader
from planner_service.roadmap import Roadmap, RoadmapReference
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.timing.laws import SCurve, ToppRa, Trapezoidal
from planner_service.timing.limit_check import peaks
from tests.support.optional import present
from tests.unit.records.test_saved_world import same

Document = dict[str, Any]

MADE_FOR = World(load_robot("planar2"), load_scene("discs"))
LIMITS = MADE_FOR.robot.limits


def planned(timing: Any = None) -> PlanResult:
    """A result with a stop and a blend, and with numbers that have no short decimal form."""
    path = JointPath(
        np.array([[0.1, 1 / 3], [0.7, -0.2], [2**0.5, 1e-9], [1.3, 0.3]]), np.array([0.0, 1 / 3, 0.0, 0.0])
    )
    trajectory = (timing or ToppRa()).time_path(path, LIMITS)
    stages = (
        StageReport(Stage.ENDPOINTS, CheckCounts(2, 0, 0), 0.1 + 0.2),
        StageReport(Stage.SEARCH, CheckCounts(40, 3, 0), 1e-4, path.length, "rrtconnect, try 2"),
    )
    exempt = (ExemptInterval(0.0, 1 / 7, (("link_1", "link_2"),), "they touch when folded"),)
    certificate = Certificate(1 / 300, 1234, 0.0, exempt)
    measured = peaks(trajectory, LIMITS)
    motion = MotionReport(measured, 1 / 3, trajectory.duration, trajectory.duration * 4 / 3, 0.3)
    return PlanResult(path, trajectory, None, stages, 1, 2, 0.001, False, certificate, motion, ("start: clamped",))


def failed() -> PlanResult:
    failure = Failure(
        Stage.ENDPOINTS,
        Reason.GOAL_IN_COLLISION,
        "goal in collision: link_2 x disc_1",
        (Contact("link_2", "disc_1", 1 / 30),),
        np.array([0.1, 0.2]),
        (("link_2", "disc_1", 2 / 3),),
    )
    return PlanResult(None, None, failure, (StageReport(Stage.ENDPOINTS, CheckCounts(9, 0, 0), 0.01),))


def unreached(*, with_all: bool) -> PlanResult:
    meant = Suggestion((Slip.MILLIMETRES, Slip.XYZW), Pose((0.1, 1 / 3, 0.0), (0.6, 0.0, 0.8, 0.0)))
    why = Unreachable(
        cause=Cause.JOINT_LIMIT,
        nearest=np.array([0.1, 1 / 3]),
        position=(0.1, 0.2, 1 / 3),
        gap=1e-3,
        turn=1 / 7,
        beyond=LimitExcess("elbow", 2 / 3, 0.5),
        suggestion=meant,
    )
    failure = Failure(Stage.ENDPOINTS, Reason.NO_IK_SOLUTION, "goal: the arm cannot reach", unreachable=why)
    bare = replace(failure, unreachable=replace(why, beyond=None, suggestion=None))
    return replace(failed(), failure=failure if with_all else bare)


def all_collide() -> PlanResult:
    q = np.array([0.1, 1 / 3])
    each = CollidingSolution(q, q - 1e-9, q + 1e-9, "forearm", "post")
    return replace(failed(), failure=replace(present(failed().failure), proven=True, colliding=(each, each)))


def request(**changes: Any) -> PlanRequest:
    return PlanRequest(**{"start": (0.1, 1 / 3), "goal": (2**0.5, 1e-9), **changes})


@pytest.fixture
def there(tmp_path: Path) -> Path:
    return tmp_path / "plan.json"


def reloaded(plan: SavedPlan, there: Path) -> SavedPlan:
    save_plan(plan, there)
    return load_plan(there)


EVERY_SETTING = request(
    planner=RRT(range=0.3, goal_bias=0.1),
    timing=SCurve(jerk=20.0),
    seed=2**62,
    max_checks=77,
    time_limit=None,
    retries=0,
    improve=3,
    padding=0.0,
    velocity_scale=0.5,
    acceleration_scale=1 / 3,
    start_tolerance=0.0,
)
NOT_PROVEN = Refusal(0.1, 1 / 3, 0.2, "link_1", "post", "at s = 0.2 nothing is proven", True)
POSE = Pose((0.1, 0.2, 1 / 3), (0.6, 0.0, 0.8, 0.0))
REGION = ToolRegion(POSE, (-math.inf, 0.1, 0.2), (0.3, math.inf, 1 / 3), 0.2, 0.1, POSE, "forearm", "upper_arm", "own")
KEEPING = request(constraints=(REGION, JointRange("elbow", -1 / 3, 0.7)))
ROOM = request(goal=(PoseGoal(POSE, 0.01, 1 / 7, (0.0, 0.6, 0.8), 5), np.array([1.0, 1.5]), POSE))
REQUESTS = [EVERY_SETTING, KEEPING, ROOM, *(request(planner=planner()) for planner in PLANNERS.values())]
RESULTS = [
    replace(planned(), improvement=ImproveReport(3, 5.0, 4.0, 1 / 3)),
    *(
        failed(),
        all_collide(),
        unreached(with_all=True),
        unreached(with_all=False),
        planned(Trapezoidal()),
        planned(SCurve()),
    ),
    replace(planned(), certificate=Certificate(math.inf, 0, 0.0)),
    replace(planned(), certificate=Certificate(-math.inf, 7, 0.002, (), NOT_PROVEN)),
]


def test_what_was_asked_comes_back_to_the_last_setting_and_what_came_of_it_to_the_last_bit(there: Path) -> None:
    for asked in REQUESTS:
        same(reloaded(SavedPlan(MADE_FOR, asked, planned()), there).request, asked)
    for result in RESULTS:
        same(replace(reloaded(SavedPlan(MADE_FOR, request(), result), there).result, origin=None), result)


IN_WORDS = replace(MADE_FOR, allowed=(("lesson_disc", "upper_arm"),), edge_step=JointStep(0.01))
SEGMENTS = (Segment("descend", planned(), 0.069), Segment("lift", failed(), 0.045))
TASK = SavedTask(IN_WORDS, "pick a block", SEGMENTS, CheckCounts(5, 4, 3), 1 / 3, failed().failure, ("way 1",), ROOM)
DOCUMENTS = (
    SavedPlan(IN_WORDS, KEEPING, planned()),
    SavedPlan(IN_WORDS, replace(EVERY_SETTING, goal=POSE), unreached(with_all=True)),
    replace(TASK, segments=SEGMENTS[1:]),
)
USUAL = {"constraints", "unreachable", "request", "gripper", "sections"}
"""May be left out or empty."""

OTHERS: tuple[Any, ...] = (..., None, "x", -1.0, [], 1e300)
"""What an entry is changed to; ... takes it out."""


def entries(value: Any, *path: Any) -> Iterator[tuple[Any, ...]]:
    """The place of each entry of a document, of lists that of the first; robot and scene have hashes."""
    if path:
        yield path
    parts = value.items() if isinstance(value, dict) else enumerate(value[:1]) if isinstance(value, list) else ()
    for key, part in parts if path not in (("robot",), ("scene",)) else ():
        yield from entries(part, *path, key)


def changed(document: Document, path: tuple[Any, ...], value: Any) -> Document:
    copy: Any = deepcopy(document)
    here = reduce(getitem, path[:-1], copy)
    if value is ...:
        del here[path[-1]]
    else:
        here[path[-1]] = value
    return dict(copy)


@pytest.mark.slow
@pytest.mark.parametrize("plan", DOCUMENTS, ids=["plan", "failure", "task"])
def test_each_entry_of_a_file_that_is_changed_is_refused_by_name_or_kept(plan: SavedPlan | SavedTask) -> None:
    reader, document = PlanReader(IN_WORDS), json.loads(plan.file_text())
    read = reader.plan if isinstance(plan, SavedPlan) else reader.task
    for path in entries(document):
        if path[-1] in USUAL or "free_axis" in path:  # which is made a unit vector
            continue
        for value in OTHERS:
            if value is ... and "settings" in path:  # those left out are as usual
                continue
            other = changed(document, path, value)
            names = [key for key in path if isinstance(key, str)][-2:]
            with suppress(InvalidFile):
                assert json.loads(read(other, "plan").file_text()) == other, (path, value)
                continue
            with pytest.raises(InvalidFile, match="|".join([*names, "counts"])):
                read(other, "plan")


@pytest.mark.parametrize("plan", DOCUMENTS, ids=["plan", "failure", "task"])
def test_one_line_says_the_same_and_ends_with_the_robot(plan: SavedPlan | SavedTask) -> None:
    line = plan.compact()
    assert json.loads(line) == json.loads(plan.file_text())
    assert b"\n" not in line
    assert list(json.loads(line))[-1] == "robot"
    named = json.loads(robot_by_hash(line))
    assert named == {**json.loads(line), "robot": {"hash": plan.robot.hash}}
    assert json.loads(robot_by_hash(plan.file_text().encode())) == named  # as older servers have stored it


def test_a_file_without_its_robot_is_refused(there: Path) -> None:
    there.write_bytes(robot_by_hash(DOCUMENTS[0].compact()))
    with pytest.raises(InvalidFile, match=r"robot: its hash alone.*without robot=hash"):
        load_plan(there)


SQUARE = Roadmap.judged([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [(0, 1), (1, 2)])


def test_of_a_roadmap_the_hash_comes_back(there: Path) -> None:
    asked = request(planner=SQUARE, seed=3)
    first = reloaded(SavedPlan(MADE_FOR, asked, planned()), there)
    assert first.request is not None
    assert first.request.planner == RoadmapReference(SQUARE.hash)
    assert first.request.seed == 3
    again = present(reloaded(first, there).request)
    assert again.planner == first.request.planner


def test_a_task_comes_back_motion_by_motion(there: Path) -> None:
    save_plan(TASK, there)
    read = load_task(there)
    assert [(s.name, s.width, s.result.ok) for s in read.segments] == [("descend", 0.069, True), ("lift", 0.045, False)]
    assert (read.task, read.choosing, read.seconds) == ("pick a block", TASK.choosing, 1 / 3)
    assert (read.robot.hash, read.scene) == (MADE_FOR.robot.hash, MADE_FOR.scene)
    assert (read.allowed, read.begin.edge_step) == (IN_WORDS.allowed, JointStep(0.01))
    assert (read.counts, read.notes) == (CheckCounts(42 + 9 + 5, 3 + 4, 3), ("way 1",))
    assert str(read.failure) == str(TASK.failure)


def damaged(there: Path, *changes: tuple[tuple[Any, ...], Any]) -> str:
    """The message of loading a good file after changes to its content."""
    document = json.loads(SavedPlan(MADE_FOR, request(), planned()).file_text())
    for path, value in changes:
        document = changed(document, path, value)
    there.write_text(json.dumps(document))
    with pytest.raises(InvalidFile) as caught:
        load_plan(there)
    assert caught.value.path == there
    return "\n".join(caught.value.problems)


@pytest.mark.parametrize(
    ("path", "value", "problem"),
    [
        (("format",), "planner-service/task", "got 'planner-service/task'; expected 'planner-service/plan'"),
        (("version",), 1, "version: got 1; expected 3: this file does not hold its robot and scene"),
        (("version",), 4, "version: got 4; expected 3"),
        (("request", "seed"), True, "request.seed: got True"),
        (("request", "padding"), 9.0, "request.padding: got 9.0; expected a number in [0, 0.1]"),
        (("request", "start"), [0.1, 0.2, 0.3], "request.start: got [0.1, 0.2, 0.3]"),
        (("request", "planner", "name"), "rrtconect", "did you mean 'rrtconnect'?"),
        (("request", "planner", "settings"), {"reach": 1}, "no other keys than range"),
        (("result", "path", "waypoints", 1), [0.7], "result.path.waypoints[1]: got [0.7]; expected 2 finite"),
        (("result", "path", "blends"), [0.0, 9.0, 0.0, 0.0], "no more together than the piece"),
        (("result", "path", "blends"), [0.0] * 5, "blends: got [0.0, 0.0, 0.0, 0.0, 0.0]; expected 4"),
        (("result", "trajectory", "durations", 0), 10**400, "durations[0]: got 1000000000"),
        (("result", "trajectory", "coefficients", 3, 0), 99.0, "without a jump"),
        (("result", "trajectory"), None, "expected either a failure, or a path, a trajectory"),
        (("result", "certificate", "certified"), False, "result.certificate.certified: got False; expected true"),
        (("result", "certificate"), None, "a path, a trajectory, a certificate and a motion"),
        (("result", "motion", "peaks", "jerk", "joint"), "wrist", "peaks.jerk.joint: got 'wrist'"),
    ],
)
def test_a_damaged_file_names_the_place_and_what_would_be_right(
    path: tuple[Any, ...], value: Any, problem: str, there: Path
) -> None:
    assert problem in damaged(there, (path, value))


def test_all_problems_are_named_not_the_first(there: Path) -> None:
    problems = damaged(
        there,
        (("request", "seed"), "x"),
        (("result", "path", "waypoints", 0, 1), None),
        (("result", "stages", 0, "seconds"), ...),
        (("result", "notes"), [1]),
    )
    assert [line.partition(":")[0] for line in problems.splitlines()] == [
        *("request.seed", "result.notes[0]", "result.stages[0].seconds", "result.path.waypoints[0][1]")
    ]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "malformed JSON"),
        (b"{", "malformed JSON: .*line 1"),
        (b'{"format": NaN}', "NaN is not a number"),
        (b'{"a": 1, "a": 2}', "key 'a' occurs twice in one object"),
        (b"\xff", "not UTF-8"),
        (b"[" * 200_000, "nested too deeply"),
        (b" " * (MAX_BYTES + 1), "too large"),
    ],
    ids=["empty", "cut", "nan", "twice", "bytes", "deep", "large"],
)
def test_what_is_no_plan_is_refused_in_words(content: bytes, problem: str, there: Path) -> None:
    there.write_bytes(content)
    with pytest.raises(InvalidFile, match=problem):
        load_plan(there)


def test_a_refused_plan_leaves_the_old_file_as_it_was(there: Path) -> None:
    there.write_text("old")
    bad = SavedPlan(MADE_FOR, request(), planned())
    object.__setattr__(bad.result, "padding", float("nan"))
    with pytest.raises(InvalidRequest, match=r"plan.result.padding: got nan; expected a finite number"):
        save_plan(bad, there)
    assert there.read_text() == "old"
