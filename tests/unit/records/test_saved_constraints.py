"""Constraints survive plan files; a plan that was made with them is not taken for one that was made without."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
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
from planner_service.planning.task_result import Segment
from planner_service.records import SavedPlan, SavedTask, load_plan, save_plan
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


def test_constraints_come_back_to_the_last_bit(there: Path) -> None:
    asked = (
        *(UPRIGHT, KeepUpright((0.1, 0.2, 0.3), 1 / 3, link="link_2", up=(0.1, 0.0, 1.0))),
        *(KeepOrientation(TURNED, 0.2), OnPlane(TURNED, 0.001, point=(0.1, 1 / 3, 0.0))),
        *(OnLine((0.1, 0.2, 0.3), (0.4, 0.1, 1 / 3), 0.002), InBox(TURNED, (0.1, INF, 1 / 3))),
        *(RelativePose("link_6", "link_1", TURNED, 0.002, 0.01), JointRange("joint_4", -1 / 3, 0.7)),
    )
    save_plan(SavedPlan(service().world, request(*asked), plain()), there)
    found = present(load_plan(there).request)
    same(found.constraints, asked)
    assert found.constraints == asked


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


def test_a_task_is_proven_again_with_the_constraints_of_its_request(tmp_path: Path) -> None:
    width = service().robot.gripper_width
    motions = (Segment("there", plain(), width, service().scene),)
    task = SavedTask(service().world, "swing", motions, CheckCounts(), 0.1, request=request(UPRIGHT))
    save_plan(task, tmp_path / "task.json")
    with pytest.raises(NotProven, match="there: upright is not proven kept"):
        recertify(load_task(tmp_path / "task.json")).required()
