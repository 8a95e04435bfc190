"""Plans and tasks survive their files bit for bit, and a file that is wrong says everything that is wrong."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service.certify import Certificate, ExemptInterval, Refusal
from planner_service.collision import CheckCounts, Contact, JointStep
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.json_reader import MAX_BYTES
from planner_service.files.writing import require_writable
from planner_service.geometry.shapes import Pose
from planner_service.kinematics import Cause, LimitExcess, Slip, Suggestion, Unreachable
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.path.joint_path import JointPath
from planner_service.planners import PLANNERS, RRT, BalancedRRTConnect
from planner_service.planning.request import PlanRequest, World
from planner_service.planning.result import Failure, MotionReport, PlanResult, Reason, Stage, StageReport
from planner_service.planning.task_result import Segment
from planner_service.records.evidence import save_plan
from planner_service.records.plan_file import SavedPlan, SavedTask, load_plan, load_task
from planner_service.roadmap import Roadmap, RoadmapReference
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.search.problem import SearchProblem, SearchResult
from planner_service.service import PlannerService
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
    padding=0.0,
    velocity_scale=0.5,
    acceleration_scale=1 / 3,
    start_tolerance=0.0,
)
NOT_PROVEN = Refusal(0.1, 1 / 3, 0.2, "link_1", "post", "at s = 0.2 nothing is proven", True)
POSE = Pose((0.1, 0.2, 1 / 3), (0.6, 0.0, 0.8, 0.0))
REQUESTS = [
    *(EVERY_SETTING, *(request(planner=planner()) for planner in PLANNERS.values())),
    request(goal=(np.array([0.25, 0.5]), POSE, np.array([1.0, 1.5]))),
    request(goal=(PoseGoal(POSE, 0.01, 1 / 7, (0.0, 0.6, 0.8), 5), PoseGoal(POSE))),
]
RESULTS = [
    *(
        failed(),
        unreached(with_all=True),
        unreached(with_all=False),
        planned(ToppRa()),
        planned(Trapezoidal()),
        planned(SCurve()),
    ),
    replace(planned(), certificate=Certificate(math.inf, 0, 0.0)),
    replace(planned(), certificate=Certificate(-math.inf, 7, 0.002, (), NOT_PROVEN)),
]


@pytest.mark.parametrize("asked", REQUESTS, ids=lambda asked: str(asked.planner.name))
def test_a_request_comes_back_to_the_last_setting(asked: PlanRequest, there: Path) -> None:
    same(reloaded(SavedPlan(MADE_FOR, asked, planned()), there).request, asked)


@pytest.mark.parametrize("result", RESULTS, ids=repr)
def test_a_result_comes_back_to_the_last_bit(result: PlanResult, there: Path) -> None:
    same(replace(reloaded(SavedPlan(MADE_FOR, request(), result), there).result, origin=None), result)


def test_what_it_was_made_for_comes_back(there: Path) -> None:
    begin = replace(MADE_FOR, allowed=(("lesson_disc", "link_1"),), edge_step=JointStep(0.01))
    same(reloaded(SavedPlan(begin, request(), planned()), there).begin, begin)


SQUARE = Roadmap.judged([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [(0, 1), (1, 2)])


def test_of_a_roadmap_the_hash_comes_back(there: Path) -> None:
    asked = request(planner=SQUARE, seed=3)
    first = reloaded(SavedPlan(MADE_FOR, asked, planned()), there)
    assert first.request is not None
    assert first.request.planner == RoadmapReference(SQUARE.hash)
    assert first.request.seed == 3
    assert json.loads(there.read_text())["request"]["planner"] == {
        "name": "roadmap",
        "settings": {"hash": SQUARE.hash},
    }
    again = present(reloaded(first, there).request)
    assert again.planner == first.request.planner


def test_the_hash_of_a_roadmap_searches_nothing_and_says_which_one_is_needed() -> None:
    service = PlannerService("planar2", "discs")
    start, goal = service.robot.pose("lesson_start"), service.robot.pose("lesson_goal")
    asked = PlanRequest(start, goal, planner=RoadmapReference(SQUARE.hash))
    with pytest.raises(
        InvalidRequest, match=f"planner: the hash of a roadmap searches nothing; .* whose hash is {SQUARE.hash}"
    ):
        service.plan(asked)


@pytest.mark.parametrize("value", ["", "ab", "x" * 64, "AB" * 32, 7, None])
def test_a_hash_that_is_none_is_a_problem_of_the_file(value: Any, there: Path) -> None:
    save_plan(SavedPlan(MADE_FOR, request(planner=SQUARE), planned()), there)
    document = json.loads(there.read_text())
    document["request"]["planner"]["settings"]["hash"] = value
    there.write_text(json.dumps(document))
    with pytest.raises(InvalidFile, match=r"request.planner: hash: got .* 64 hexadecimal digits"):
        load_plan(there)


def test_a_planner_without_a_name_leaves_no_request_but_a_plan(there: Path) -> None:
    class Own:
        name = "own"

        def search(self, problem: SearchProblem) -> SearchResult:
            raise NotImplementedError

    read = reloaded(SavedPlan(MADE_FOR, request(planner=Own()), planned()), there)
    assert read.request is None
    assert read.result.ok


def test_a_loaded_request_plans_the_loaded_path_again(there: Path) -> None:
    service = PlannerService("planar2", "discs")
    asked = request(start=service.robot.pose("lesson_start"), goal=service.robot.pose("lesson_goal"), time_limit=None)
    read = reloaded(SavedPlan(service.world, asked, service.plan(asked)), there)
    again = service.plan(present(read.request))
    assert again.unwrap()[0].waypoints.tobytes() == read.result.unwrap()[0].waypoints.tobytes()
    assert again.counts == read.result.counts


def test_a_task_comes_back_motion_by_motion(there: Path) -> None:
    segments = (Segment("descend", planned(), 0.069), Segment("lift", failed(), 0.045))
    task = SavedTask(MADE_FOR, "pick a block", segments, CheckCounts(5, 4, 3), 1 / 3, failed().failure, ("way 1",))
    save_plan(task, there)
    read = load_task(there)
    assert [(s.name, s.width, s.result.ok) for s in read.segments] == [("descend", 0.069, True), ("lift", 0.045, False)]
    assert (read.task, read.choosing, read.seconds) == ("pick a block", task.choosing, 1 / 3)
    assert (read.robot.hash, read.scene) == (MADE_FOR.robot.hash, MADE_FOR.scene)
    assert (read.counts, read.notes) == (CheckCounts(42 + 9 + 5, 3 + 4, 3), ("way 1",))
    assert str(read.failure) == str(task.failure)


def test_a_file_has_no_nan_and_its_seconds_and_counts_are_numbers(there: Path) -> None:
    save_plan(SavedPlan(MADE_FOR, request(seed=np.int64(3), padding=np.float64(0.002)), planned()), there)
    document = json.loads(there.read_text(), parse_constant=lambda name: pytest.fail(name))
    assert (document["format"], document["version"]) == ("planner-service/plan", 3)
    assert document["request"]["seed"] == 3
    assert document["result"]["counts"] == {"states": 42, "edges": 3, "distances": 0}


def damaged(there: Path, change: Callable[[Document], object], *, result: PlanResult | None = None) -> str:
    """The message of loading a good file after one change to its content."""
    save_plan(SavedPlan(MADE_FOR, request(), result or planned()), there)
    document = json.loads(there.read_text())
    change(document)
    there.write_text(json.dumps(document))
    with pytest.raises(InvalidFile) as caught:
        load_plan(there)
    assert caught.value.path == there
    return "\n".join(caught.value.problems)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda d: d.pop("format"), "format: missing"),
        (lambda d: d.update(format="other"), "format: got 'other'; expected 'planner-service/plan'"),
        (lambda d: d.update(version=1), "version: got 1; expected 3: this file does not hold its robot and scene"),
        (lambda d: d.update(version=4), "version: got 4; expected 3"),
        (lambda d: d["robot"].update(joint_names="ab"), "robot.joint_names: got 'ab'; expected a list"),
        (lambda d: d["scene"].pop("hash"), "scene.hash: missing"),
        (lambda d: d.update(request=7), "request: got 7; expected an object"),
        (lambda d: d["request"].update(seed=-1), "request.seed: got -1; expected at least 0"),
        (lambda d: d["request"].update(seed=True), "request.seed: got True"),
        (lambda d: d["request"].update(padding=True), "request.padding: got True; expected a finite number"),
        (lambda d: d["request"].update(padding=9.0), "request.padding: got 9.0; expected a number in [0, 0.1]"),
        (lambda d: d["request"].update(goals=[]), "request.goals: got []; expected at least 1 of them"),
        (lambda d: d["request"]["start"].append(1.0), "request.start: got [0.1, 0.333"),
        (lambda d: d["request"]["planner"].update(name="rrtconect"), "did you mean 'rrtconnect'?"),
        (lambda d: d["request"]["planner"]["settings"].update(reach=1), "no other keys than range"),
        (lambda d: d["request"]["planner"]["settings"].update(range=-1), "range: got -1; expected a number from 1e-06"),
        (lambda d: d["request"]["planner"].update(settings=[]), "request.planner.settings: got []"),
        (lambda d: d["result"].update(attempts=1.5), "result.attempts: got 1.5"),
        (lambda d: d["result"].update(deterministic=1), "result.deterministic: got 1; expected true or false"),
        (
            lambda d: d["result"]["stages"][1].update(stage="thinking"),
            "result.stages[1].stage: got 'thinking'; expected",
        ),
        (lambda d: d["result"]["path"]["waypoints"][1].pop(), "result.path.waypoints[1]: got [0.7]; expected 2 finite"),
        (lambda d: d["result"]["path"].update(waypoints=[]), "result.path.waypoints: got"),
        (
            lambda d: d["result"]["path"]["waypoints"].insert(0, [0.1, 1 / 3]),
            "blends: got [0.0, 0.3333333333333333, 0.0, 0.0]; expected 5",
        ),
        (lambda d: d["result"]["trajectory"]["durations"].pop(), "result.trajectory: coefficients"),
        (lambda d: d["result"]["trajectory"].update(coefficients=[]), "result.trajectory: coefficients: got (0, 4)"),
        (lambda d: d["result"]["trajectory"]["durations"].__setitem__(0, 10**400), "durations[0]: got 1000000000"),
        (lambda d: d["result"].update(trajectory=None), "expected either a failure, or a path, a trajectory"),
        (
            lambda d: d["result"]["certificate"]["exempt"][0].update(pairs=[["link_1"]]),
            "result.certificate.exempt[0].pairs[0]: got ['link_1']",
        ),
        (
            lambda d: d["result"]["certificate"]["exempt"][0].update(s_start=-1.0),
            "result.certificate.exempt[0].s_start: got -1.0",
        ),
        (
            lambda d: d["result"]["certificate"].update(certified=False),
            "result.certificate.certified: got False; expected true",
        ),
        (lambda d: d["result"].update(certificate=None), "a path, a trajectory, a certificate and a motion"),
        (lambda d: d["result"]["path"].update(blends=[0.0, 9.0, 0.0, 0.0]), "no more together than the piece"),
        (lambda d: d["result"]["motion"]["peaks"]["jerk"].update(joint="elbow"), "peaks.jerk.joint: got 'elbow'"),
    ],
)
def test_a_damaged_file_names_the_place_and_what_would_be_right(
    change: Callable[[Document], object], problem: str, there: Path
) -> None:
    assert problem in damaged(there, change)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda d: d.update(cause="tired"), "unreachable.cause: got 'tired'; expected one of out of reach"),
        (lambda d: d["nearest"].append("x"), "unreachable.nearest: got [0.1, 0.333"),
        (lambda d: d["suggestion"]["slips"].append("inches"), "unreachable.suggestion.slips: got"),
        (lambda d: d["suggestion"]["pose"].update(quaternion_wxyz=[2, 0, 0, 0]), "a unit quaternion"),
        (lambda d: d["suggestion"]["pose"].update(quaternion=[1, 0, 0, 0]), "did you mean 'quaternion_wxyz'?"),
        (lambda d: d["beyond"].update(needed=None), "unreachable.beyond.needed: got None"),
    ],
)
def test_a_damaged_reason_names_the_place_too(change: Callable[[Document], object], problem: str, there: Path) -> None:
    def inside(document: Document) -> None:
        change(document["result"]["failure"]["unreachable"])

    assert problem in damaged(there, inside, result=unreached(with_all=True))


def test_all_problems_are_named_not_the_first(there: Path) -> None:
    def change(document: Document) -> None:
        document["request"]["seed"] = "x"
        document["result"]["path"]["waypoints"][0][1] = None
        del document["result"]["stages"][0]["seconds"]
        document["result"]["notes"] = [1]

    problems = damaged(there, change).splitlines()
    assert [line.partition(":")[0] for line in problems] == [
        "request.seed",
        "result.notes[0]",
        "result.stages[0].seconds",
        "result.path.waypoints[0][1]",
    ]


def test_a_law_that_leaves_its_path_is_refused(there: Path) -> None:
    message = damaged(there, lambda d: d["result"]["trajectory"]["coefficients"][3].__setitem__(0, 99.0))
    assert "without a jump" in message


def test_a_task_is_not_loaded_as_a_plan(there: Path) -> None:
    save_plan(SavedTask(MADE_FOR, "pick", (), CheckCounts(), 0.0), there)
    with pytest.raises(InvalidFile, match="expected 'planner-service/plan'"):
        load_plan(there)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "malformed JSON"),
        (b"[]", "got \\[\\]; expected an object"),
        (b"{", "malformed JSON: .*line 1"),
        (b'{"format": NaN}', "NaN is not a number"),
        (b'{"a": 1, "a": 2}', "key 'a' occurs twice in one object"),
        (b"\xff", "not UTF-8"),
        (b"[" * 200_000, "nested too deeply"),
        (b'{"version": ' + b"9" * 10_000 + b"}", "malformed JSON|expected a whole number|format: missing"),
        (b" " * (MAX_BYTES + 1), "too large"),
    ],
    ids=["empty", "list", "cut", "nan", "twice", "bytes", "deep", "digits", "large"],
)
def test_what_is_no_plan_is_refused_in_words(content: bytes, problem: str, there: Path) -> None:
    there.write_bytes(content)
    with pytest.raises(InvalidFile, match=problem):
        load_plan(there)


@pytest.mark.parametrize("place", ["missing/plan.json", ".", "/dev/null", "a\0b"])
def test_a_place_that_takes_no_file_is_known_before_there_is_a_plan(place: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match="cannot be written"):
        require_writable(place if "\0" in place else tmp_path / place)


def test_asking_for_a_place_leaves_nothing_there(tmp_path: Path) -> None:
    require_writable(tmp_path / "plan.json")
    assert list(tmp_path.iterdir()) == []


def test_a_refused_plan_leaves_the_old_file_as_it_was(there: Path) -> None:
    there.write_text("old")
    bad = SavedPlan(MADE_FOR, request(), planned())
    object.__setattr__(bad.result, "padding", float("nan"))
    with pytest.raises(InvalidRequest, match=r"plan.result.padding: got nan; expected a finite number"):
        save_plan(bad, there)
    assert there.read_text() == "old"


def test_default_planner_settings_are_written_out(there: Path) -> None:
    save_plan(SavedPlan(MADE_FOR, request(), planned()), there)
    planner = json.loads(there.read_text())["request"]["planner"]
    assert planner == {"name": "balancedrrtconnect", "settings": {"range": BalancedRRTConnect().range}}
