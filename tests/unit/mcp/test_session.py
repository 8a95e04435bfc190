"""Tools called by the SDK's client: what they return is proven, what they refuse says what to do."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

import planner_service as ps
from planner_service.certify import certify
from planner_service.collision import CancelToken
from planner_service.errors import InvalidRequest
from planner_service.execute import ArmContact, ExecutionReport
from planner_service.geometry.arrays import FloatArray
from planner_service.mcp import Session
from planner_service.mcp.motion import Done
from planner_service.planning.task_result import TaskResult
from planner_service.records.recertify import recertify
from tests.support.agents import answered, called, refused

BLOCK, TRAY = "blue_block", "tray"


class Pretender:
    """A mover that proves tasks again, as any, and then says that all went well, or that it stopped."""

    name = "pretender"

    def __init__(self, seen: Mapping[str, ps.Pose] | None = None, stopped: str | None = None) -> None:
        self.where, self.stopped = seen or {}, stopped
        self.done: list[TaskResult] = []

    def seen(self, scene: ps.Scene) -> ps.Scene:
        return scene

    def positions(self) -> FloatArray:
        return np.zeros(6)

    def run(self, task: TaskResult, cancel: CancelToken) -> Done:
        recertify(task).required()
        self.done.append(task)
        report = ExecutionReport((), 1.0, 0.1, True, self.stopped)
        contacts: tuple[ArmContact, ...] = ()
        return Done(report, task.q, task.world.robot.gripper_width, self.where, contacts)

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def service() -> ps.PlannerService:
    return ps.PlannerService("wxai", "bin")


@pytest.fixture
def session(service: ps.PlannerService) -> Session:
    return Session(service)


def test_a_plan_is_kept_by_its_id_with_what_is_proven_of_it(session: Session) -> None:
    plan = answered(session, "plan", goal={"named": "ready"})
    assert plan["plan"] == "plan-1"
    assert plan["seconds"] > 0.5
    assert plan["motions"][0]["clearance_mm"] > 5.0
    assert plan["ends"]["joints"] == pytest.approx(session.robot.pose("ready").tolist(), abs=1e-6)
    assert answered(session, "certify", plan="plan-1")["proven"]
    (listed,) = answered(session, "describe_scene")["plans"]
    assert (listed["plan"], listed["state"]) == ("plan-1", "ready")


def test_a_pick_and_a_place_after_it_are_planned_before_anything_moves(session: Session) -> None:
    pick = answered(session, "pick", object=BLOCK, upright=0.3)
    place = answered(session, "place", onto=TRAY, at=[0.22, 0.27], after=pick["plan"])
    assert pick["ends"]["holding"] == [BLOCK]
    assert place["ends"]["holding"] == []
    scene = answered(session, "describe_scene", after=place["plan"])
    (block,) = [thing for thing in scene["objects"] if thing["name"] == BLOCK]
    assert block["middle"][:2] == pytest.approx([0.22, 0.27], abs=1e-6)
    assert block["middle"][2] - block["size"][2] / 2 == pytest.approx(0.01, abs=1e-6)
    assert answered(session, "describe_scene")["stand"]["holding"] == []


def test_a_line_of_the_tool_ends_where_it_should(session: Session) -> None:
    before = answered(session, "check")["stand"]["tool"]
    line = answered(session, "move_linear", by=[0.0, 0.02, 0.03])
    after = line["ends"]["tool"]
    assert np.subtract(after["position"], before["position"]) == pytest.approx([0.0, 0.02, 0.03], abs=1e-4)
    assert after["quaternion_wxyz"] == pytest.approx(before["quaternion_wxyz"], abs=1e-3)
    back = answered(session, "move_linear", to={"position": before["position"]}, after=line["plan"])
    assert back["ends"]["tool"]["position"] == pytest.approx(before["position"], abs=1e-4)


def test_a_tool_that_may_turn_about_its_axis_on_a_line_does_and_keeps_that_axis(session: Session) -> None:
    line = answered(session, "move_linear", by=[0.0, 0.3, -0.1], free_axis=[1.0, 0.0, 0.0])
    stands = answered(session, "check")["stand"], line["ends"]
    before, after = (ps.Pose((0.0, 0.0, 0.0), each["tool"]["quaternion_wxyz"]).rotation for each in stands)
    assert before[:, 0] @ after[:, 0] == pytest.approx(1.0, abs=1e-4)
    assert before[:, 1] @ after[:, 1] < 0.99


def test_a_check_says_what_touches_and_by_how_much(session: Session) -> None:
    free = answered(session, "check")
    assert (free["free"], free["touching"]) == (True, [])
    assert free["clearance_mm"] > 0.0
    hit = answered(session, "check", at={"joints": [0.0, 1.9, 1.0, 0.0, 0.0, 0.0]})
    assert not hit["free"]
    assert hit["touching"][0]["depth_mm"] > 0.0


@pytest.mark.parametrize(
    ("tool", "given", "reason", "do"),
    [
        ("plan", {"goal": {"named": "redy"}}, "UNKNOWN_NAME", "did you mean 'ready'"),
        ("plan", {"goal": {"position": [0.3, 0.0, 0.0]}}, "GOAL_IN_COLLISION", "check at the goal"),
        ("plan", {"goal": {"position": [3.0, 0.0, 0.0]}}, "NO_IK_SOLUTION", "nearer to the arm"),
        ("plan", {"goal": {"joints": [9.0] * 6}}, "GOAL_OUTSIDE_LIMITS", "describe_scene lists"),
        ("plan", {"goal": {"named": "ready"}, "after": "plan-9"}, "UNKNOWN_NAME", "available: none"),
        ("plan", {"goal": {}}, "INVALID_REQUEST", "one of joints, named and position"),
        ("plan", {"goal": {"named": "ready", "joints": [0.0] * 6}}, "INVALID_REQUEST", "got 'joints and named'"),
        ("plan", {"goal": {"joints": [0.0] * 5}}, "INVALID_REQUEST", "6 finite numbers, one for each joint"),
        ("plan", {"goal": {"joints": ["0"] * 6}}, "INVALID_REQUEST", "expected a finite number"),
        ("plan", {}, "INVALID_REQUEST", "goal: missing"),
        ("plan", {"goal": {"named": "ready"}, "fast": True}, "INVALID_REQUEST", "unknown key 'fast'"),
        ("move_linear", {"by": [0.0, 0.0, 0.9]}, "LINE_BLOCKED", "or use plan"),
        ("move_linear", {}, "INVALID_REQUEST", "one of by and to"),
        ("pick", {"object": "table"}, "INVALID_REQUEST", "an object at most"),
        ("pick", {"object": "blue_blok"}, "UNKNOWN_NAME", "did you mean 'blue_block'"),
        ("place", {"onto": TRAY}, "NOT_HOLDING", "Pick something first"),
        ("certify", {}, "INVALID_REQUEST", "one of plan and waypoints"),
        ("certify", {"waypoints": [[9.0] * 6] * 2}, "INVALID_REQUEST", "got 9.0; expected joint_0"),
        ("execute", {"plan": "plan-1"}, "MAY_NOT_MOVE", "--execute"),
        ("fly", {}, "UNKNOWN_NAME", "available: certify"),
    ],
)
def test_a_refusal_says_why_and_what_to_do(
    session: Session, tool: str, given: dict[str, Any], reason: str, do: str
) -> None:
    fields = refused(session, tool, **given)
    assert fields["refused"] == reason
    assert do in f"{fields['detail']} {fields['do']}"


def test_a_polyline_of_ones_own_is_proven_or_is_said_where_not(session: Session) -> None:
    robot = session.robot
    free = [robot.home.tolist(), robot.pose("ready").tolist()]
    fields = answered(session, "certify", waypoints=free)
    proof = certify(robot, ps.load_scene("bin"), free)
    assert (fields["proven"], proof.certified) == (True, True)
    assert fields["clearance_mm"] == pytest.approx(proof.clearance * 1e3, abs=0.01)
    hit = answered(session, "certify", waypoints=[robot.home.tolist(), [0.0, 1.9, 1.0, 0.0, 0.0, 0.0]])
    assert not hit["proven"]
    assert "not proven apart" in hit["problems"][0]


def test_an_explanation_names_what_helps(session: Session) -> None:
    why = answered(session, "explain", goal={"position": [0.3, 0.18, 0.1]})
    assert not why["has_plan"]
    assert "GOAL_IN_COLLISION" in why["why"]
    assert "remove demo_post" in why["helps"]
    assert answered(session, "explain", goal={"named": "ready"})["has_plan"]


def test_a_look_is_a_picture(session: Session) -> None:
    plan = answered(session, "plan", goal={"named": "ready"})["plan"]
    for given in ({}, {"plan": plan}):
        result = called(session, "look", **given)
        (picture,) = [part for part in result.content if part.type == "image"]
        assert picture.mime_type == "image/png"
        assert len(picture.data) > 10_000


def test_what_is_executed_is_the_plan_and_those_before_it_once(service: ps.PlannerService) -> None:
    mover = Pretender()
    session = Session(service, mover=mover)
    pick = answered(session, "pick", object=BLOCK)["plan"]
    place = answered(session, "place", onto=TRAY, after=pick)["plan"]
    assert answered(session, "execute", plan=place)["plans"] == [pick, place]
    assert [segment.name for segment in mover.done[0].segments][:3] == ["to pregrasp", "descend", "lift"]
    assert refused(session, "execute", plan=pick)["refused"] == "EXECUTED"
    scene = answered(session, "describe_scene")
    assert [kept["state"] for kept in scene["plans"]] == ["executed", "executed"]
    (block,) = [thing for thing in scene["objects"] if thing["name"] == BLOCK]
    assert block["middle"][:2] == pytest.approx([0.2, 0.28], abs=1e-6)


def test_a_plan_from_where_the_arm_no_longer_stands_is_outdated(service: ps.PlannerService) -> None:
    mover = Pretender()
    session = Session(service, mover=mover)
    first, second = (answered(session, "plan", goal={"named": name})["plan"] for name in ("ready", "upright"))
    answered(session, "execute", plan=first)
    assert refused(session, "execute", plan=second)["refused"] == "OUTDATED"
    assert len(mover.done) == 1


def test_plans_are_outdated_when_something_lies_elsewhere_than_planned(service: ps.PlannerService) -> None:
    where = service.scene.obstacle(BLOCK).pose
    moved = ps.Pose((where.position[0] + 0.01, *where.position[1:]), where.quaternion)
    session = Session(service, mover=Pretender({BLOCK: moved}))
    first = answered(session, "plan", goal={"named": "ready"})["plan"]
    second = answered(session, "plan", goal={"named": "home"}, after=first)["plan"]
    assert answered(session, "execute", plan=first)["notes"] == [f"{BLOCK} lies 10.0 mm from where it was planned to"]
    assert refused(session, "execute", plan=second)["refused"] == "OUTDATED"


def test_what_was_dropped_is_not_held(service: ps.PlannerService) -> None:
    session = Session(service, mover=Pretender({BLOCK: service.scene.obstacle(BLOCK).pose}))
    pick = answered(session, "pick", object=BLOCK)["plan"]
    done = answered(session, "execute", plan=pick)
    assert done["stand"]["holding"] == []
    assert "is not held" in done["notes"][0]
    assert refused(session, "place", onto=TRAY)["refused"] == "NOT_HOLDING"


def test_a_stopped_arm_is_known_to_stand_where_it_stopped(service: ps.PlannerService) -> None:
    session = Session(service, mover=Pretender(stopped="stopped by TimeoutError: late; the arm was told to hold"))
    plan = answered(session, "plan", goal={"named": "ready"})["plan"]
    fields = refused(session, "execute", plan=plan)
    assert fields["refused"] == "STOPPED"
    assert "told to hold" in fields["detail"]
    assert refused(session, "execute", plan=plan)["refused"] == "OUTDATED"


def test_only_the_newest_plans_are_kept(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planner_service.mcp.session.MAX_PLANS", 2)
    for name in ("ready", "upright", "ready"):
        answered(session, "plan", goal={"named": name})
    kept = [plan["plan"] for plan in answered(session, "describe_scene")["plans"]]
    assert kept == ["plan-2", "plan-3"]


def test_long_scenes_are_listed_by_pages() -> None:
    boxes = tuple(ps.Obstacle(f"box_{k}", ps.Box((0.01, 0.01, 0.01)), ps.Pose((2.0 + k, 0.0, 0.0))) for k in range(120))
    session = Session(ps.PlannerService("wxai", ps.Scene(boxes)))
    pages = [answered(session, "describe_scene", first=first) for first in (0, 50, 100)]
    assert [len(page["objects"]) for page in pages] == [50, 50, 20]
    assert [page["left_off"] for page in pages] == [70, 20, 0]


def test_extents_are_along_the_axes_of_the_base() -> None:
    turned = ps.Pose((0.5, 0.1, 0.2), (math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4)))
    scene = ps.Scene((ps.Obstacle("slab", ps.Box((0.1, 0.2, 0.3)), turned),))
    (slab,) = answered(Session(ps.PlannerService("wxai", scene)), "describe_scene")["objects"]
    assert slab["middle"] == pytest.approx([0.5, 0.1, 0.2])
    assert slab["size"] == pytest.approx([0.2, 0.1, 0.3])


@pytest.mark.parametrize("start", [[0.0] * 5, "home"])
def test_a_start_that_is_none_is_refused(service: ps.PlannerService, start: ArrayLike) -> None:
    with pytest.raises(InvalidRequest, match="start"):
        Session(service, start)
