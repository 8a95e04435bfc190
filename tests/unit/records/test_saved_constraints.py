"""Constraints survive plan files; a plan that was made with them is not taken for one that was made without."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from planner_service import (
    CheckCounts,
    InvalidFile,
    InvalidRequest,
    JointLimits,
    JointPath,
    NotProven,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    ToppRa,
    Trajectory,
    inverse_kinematics,
)
from planner_service.certify import Certificate, KeptRefusal
from planner_service.cli.commands import app
from planner_service.constraints import (
    Constraint,
    InBox,
    JointRange,
    KeepOrientation,
    KeepUpright,
    OnLine,
    OnPlane,
    RelativePose,
    ToolRegion,
)
from planner_service.planning.result import Failure, Reason, Stage
from planner_service.planning.task_result import Segment
from planner_service.records import SavedPlan, SavedTask, load_plan, read_problems, save_plan
from planner_service.records.plan_file import load_task
from planner_service.records.recertify import recertify
from tests.support.optional import present
from tests.unit.records.test_saved_world import same

DOWN = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
TURNED = Pose((0.9, -0.7, 1 / 3), (0.8, 0.0, 0.36, 0.48))
INF = math.inf
UPRIGHT = KeepUpright((-1, 0, 0), 0.1)


@cache
def service() -> PlannerService:
    return PlannerService("wxai", "post")


def request(*constraints: Constraint, **changes: Any) -> PlanRequest:
    """Past a post, the tool pointing down."""
    start = inverse_kinematics(service().robot, Pose((0.25, -0.2, 0.12), DOWN))[0]
    return PlanRequest(start, Pose((0.25, 0.2, 0.12), DOWN), seed=7, constraints=constraints, **changes)


@cache
def upright() -> PlanResult:
    return service().plan(request(UPRIGHT))


@cache
def plain() -> PlanResult:
    return service().plan(request())


@pytest.fixture
def there(tmp_path: Path) -> Path:
    return tmp_path / "plan.json"


@pytest.mark.parametrize(
    "region",
    [
        UPRIGHT,
        KeepUpright((0.1, 0.2, 0.3), 1 / 3, link="link_2", up=(0.1, 0.0, 1.0)),
        KeepOrientation(TURNED, 0.2),
        OnPlane(TURNED, 0.001, point=(0.1, 1 / 3, 0.0)),
        OnLine((0.1, 0.2, 0.3), (0.4, 0.1, 1 / 3), 0.002),
        InBox(TURNED, (0.1, INF, 1 / 3)),
        RelativePose("link_6", "link_1", TURNED, 0.002, 0.01),
        ToolRegion(TURNED, (-INF, 0.1, 0.2), (0.3, INF, 1 / 3), 0.2, 0.1, TURNED, "link_3", "link_1", "own"),
    ],
    ids=lambda region: str(region.name),
)
def test_a_region_comes_back_to_the_last_bit(region: ToolRegion, there: Path) -> None:
    save_plan(SavedPlan(service().world, request(region), plain()), there)
    found = load_plan(there).request
    assert found is not None
    same(found.constraints, (region,))
    assert found.constraints == (region,)
    save_plan(SavedPlan(service().world, found, plain()), there)
    again = load_plan(there).request
    assert again is not None
    same(again.constraints, found.constraints)


def test_a_joint_range_comes_back_to_the_last_bit(there: Path) -> None:
    asked = JointRange("joint_4", -1 / 3, 0.7)
    save_plan(SavedPlan(service().world, request(UPRIGHT, asked), plain()), there)
    found = load_plan(there).request
    assert found is not None
    same(found.constraints, (UPRIGHT, asked))


def test_a_saved_request_makes_the_same_plan_again(there: Path) -> None:
    upright().save(there)
    saved = load_plan(there)
    assert saved.request is not None
    again = saved.service().plan(saved.request)
    assert again.counts == upright().counts
    assert again.path is not None
    assert upright().path is not None
    assert again.path.waypoints.tobytes() == upright().path.waypoints.tobytes()  # type: ignore[union-attr]


def test_projections_come_back(there: Path) -> None:
    upright().save(there)
    found = load_plan(there).result
    assert found.counts.projections > 0
    assert [report.counts for report in found.stages] == [report.counts for report in upright().stages]


def test_a_plan_without_constraints_is_written_as_before() -> None:
    document = SavedPlan.of(plain()).document()
    assert "constraints" not in document["request"]
    assert set(document["result"]["counts"]) == {"states", "edges", "distances"}
    assert all("projections" not in stage for stage in document["result"]["stages"])


def test_a_file_of_before_constraints_is_read(there: Path) -> None:
    document = SavedPlan.of(plain()).document()
    del document["robot"]["link_frames"]
    document["request"].pop("constraints", None)
    for counted in (document["result"]["counts"], *document["result"]["stages"]):
        counted.pop("projections", None)
    there.write_text(json.dumps(document))
    saved = load_plan(there)
    assert saved.request is not None
    assert (saved.request.constraints, saved.result.counts) == ((), plain().counts)
    assert recertify(saved).certified


def _put(*path: Any) -> Callable[[Any, Any], None]:
    def put(document: Any, value: Any) -> None:
        for key in path[:-1]:
            document = document[key]
        document[path[-1]] = value

    return put


@pytest.mark.parametrize(
    ("path", "value", "problem"),
    [
        ((0, "kind"), "cone", "request.constraints[0] 'upright'.kind: got 'cone'; expected one of 'tool region'"),
        ((0, "tilt"), 5.0, "request.constraints[0] 'upright'.tilt: got 5.0; expected radians in [0.001, pi]"),
        ((0, "tilt"), "0.1", "request.constraints[0] 'upright'.tilt: got '0.1'; expected a finite number"),
        ((0, "lower"), [None, None], "request.constraints[0] 'upright'.lower: got [None, None]; expected 3 numbers"),
        ((0, "angle"), 0.1, "request.constraints[0] 'upright': unknown key 'angle'"),
        ((1, "upper"), None, "request.constraints[1].upper: got None; expected a finite number"),
        ((1, "upper"), -9.0, "request.constraints[1].upper: got -9.0; expected at least 0.001 above lower"),
    ],
)
def test_a_constraint_that_is_none_is_refused(path: Any, value: Any, problem: str, there: Path) -> None:
    document = SavedPlan(service().world, request(UPRIGHT, JointRange("joint_4", -1.0, 1.0)), plain()).document()
    _put("request", "constraints", *path)(document, value)
    there.write_text(json.dumps(document))
    with pytest.raises(InvalidFile) as caught:
        load_plan(there)
    assert problem in "\n".join(caught.value.problems)


def test_counts_of_projections_that_do_not_add_up_are_refused(there: Path) -> None:
    document = SavedPlan.of(upright()).document()
    document["result"]["counts"]["projections"] += 1
    there.write_text(json.dumps(document))
    with pytest.raises(InvalidFile, match=r"result\.counts: got"):
        load_plan(there)


@dataclass(frozen=True)
class OwnLaw:
    """A timing law that no file can name."""

    name: str = "own"

    def time_path(self, path: JointPath, limits: JointLimits) -> Trajectory:
        return ToppRa().time_path(path, limits)


def test_constraints_are_not_lost_with_a_request_that_has_no_record(there: Path) -> None:
    plan = SavedPlan(service().world, request(UPRIGHT, timing=OwnLaw()), plain())
    with pytest.raises(InvalidRequest, match=r"request\.timing: got OwnLaw\(.*expected one of this package"):
        save_plan(plan, there)
    assert not there.exists()


# Proven again.


def test_a_plan_is_proven_again_with_the_constraints_of_its_file(there: Path) -> None:
    upright().save(there)
    for plan in (upright(), load_plan(there)):
        (proven,) = recertify(plan).required().motions
        assert [kept.name for kept in proven.certificate.kept] == ["upright"]
    document = json.loads(there.read_text())
    _put("request", "constraints", 0, "tilt")(document, 0.002)
    there.write_text(json.dumps(document))
    found = recertify(load_plan(there))
    with pytest.raises(NotProven, match=r"upright is not proven kept from s = .*at most 0\.002 rad"):
        found.required()


def test_what_a_file_says_of_kept_constraints_is_not_believed(there: Path) -> None:
    """A plan that was made without them says that it keeps them."""
    document = SavedPlan(service().world, request(UPRIGHT), plain()).document()
    there.write_text(json.dumps(document))
    assert not recertify(load_plan(there)).certified


def test_a_result_alone_says_what_it_keeps(there: Path) -> None:
    upright().save(there)
    alone = load_plan(there).result
    assert alone.constraints == upright().constraints == (UPRIGHT,)
    (proven,) = recertify(alone, service()).required().motions
    assert [kept.name for kept in proven.certificate.kept] == ["upright"]


@pytest.mark.parametrize("path", [("constraints",), ("certificate", "kept")])
def test_a_result_that_names_its_constraints_in_one_place_alone_is_refused(path: Any, there: Path) -> None:
    document = SavedPlan.of(upright()).document()
    _put("result", *path)(document, [])
    there.write_text(json.dumps(document))
    with pytest.raises(InvalidFile, match=r"result\.certificate\.kept: got \d; expected a proof of each of the \d"):
        load_plan(there)


def test_a_file_that_says_where_a_link_is_does_not_say_so_for_a_robot_that_is_given(there: Path) -> None:
    """The camera never is 5 m high; in the file its frame is moved by 10 m."""
    high = ToolRegion(lower=(-INF, -INF, 5.0), link="camera", name="high")
    document = SavedPlan(service().world, request(high), plain()).document()
    (camera,) = (frame for frame in document["robot"]["link_frames"] if frame["link"] == "camera")
    camera["pose"]["position"] = [0.0, 0.0, 10.0]
    camera["pose"]["quaternion_wxyz"] = [1.0, 0.0, 0.0, 0.0]
    there.write_text(json.dumps(document))
    with pytest.raises(NotProven, match="high is not proven kept"):
        recertify(load_plan(there), service()).required()
    told = CliRunner().invoke(app, ["certify", str(there)])
    assert "robot wxai in this file differs from wxai of this package" in " ".join(told.output.split())


def test_a_refusal_by_a_constraint_is_saved(there: Path) -> None:
    good = upright()
    refusal = KeptRefusal(0.1, 0.4, 0.2, 0, "upright", "tilt", 0.31, 0.1, "rad", broken=((0.1, 0.4),))
    certificate = Certificate(-math.inf, 0, 0.0, refusal=refusal)
    failure = Failure(Stage.CERTIFY, Reason.CONSTRAINT_NOT_CERTIFIED, str(refusal))
    failed = replace(
        good, path=None, trajectory=None, motion=None, goal_index=None, certificate=certificate, failure=failure
    )
    failed.save(there)
    loaded = present(load_plan(there).result.certificate)
    assert loaded == certificate


def test_a_task_is_proven_again_with_the_constraints_of_its_request(tmp_path: Path) -> None:
    width = service().robot.gripper_width
    motions = (Segment("there", plain(), width, service().scene),)
    task = SavedTask(service().world, "swing", motions, CheckCounts(), 0.1, request=request(UPRIGHT))
    save_plan(task, tmp_path / "task.json")
    with pytest.raises(NotProven, match="there: upright is not proven kept"):
        recertify(load_task(tmp_path / "task.json")).required()


def test_a_problem_set_has_no_key_for_constraints(tmp_path: Path) -> None:
    problem = {"id": "a", "start": [0.0], "goals": [[1.0]], "obstacles": [], "constraints": []}
    (tmp_path / "set.json").write_text(json.dumps({"joints": ["joint_0"], "problems": [problem]}))
    with pytest.raises(InvalidFile, match="unknown key 'constraints'"):
        read_problems(tmp_path / "set.json")
