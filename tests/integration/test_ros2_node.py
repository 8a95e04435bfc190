"""The example node for ROS 2, run with stand-ins for ROS: modules whose messages have the same fields."""

from __future__ import annotations

import copy
import re
import runpy
import sys
from collections.abc import Callable
from dataclasses import make_dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from planner_service import PlannerService, PlanRequest
from planner_service.errors import PlannerServiceError

NODE = Path(__file__).parents[2] / "examples" / "ros2" / "planner_node.py"

DEFAULTS: dict[str, dict[str, Any]] = {
    "Header": {"frame_id": ""},
    "Duration": {"sec": 0, "nanosec": 0},
    "Point": {"x": 0.0, "y": 0.0, "z": 0.0},
    "Quaternion": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    "JointState": {"name": [], "position": []},
    "JointTrajectoryPoint": {
        "positions": [], "velocities": [], "accelerations": [], "effort": [], "time_from_start": "Duration",
    },
    "JointTrajectory": {"header": "Header", "joint_names": [], "points": []},
    "RobotTrajectory": {"joint_trajectory": "JointTrajectory"},
    "RobotState": {"joint_state": "JointState", "attached_collision_objects": []},
    "JointConstraint": {"joint_name": "", "position": 0.0},
    "Pose": {"position": "Point", "orientation": "Quaternion"},
    "BoundingVolume": {"primitives": [], "primitive_poses": []},
    "PositionConstraint": {
        "header": "Header", "link_name": "", "target_point_offset": "Point", "constraint_region": "BoundingVolume",
    },
    "OrientationConstraint": {"header": "Header", "orientation": "Quaternion", "link_name": ""},
    "Constraints": {
        "name": "", "joint_constraints": [], "position_constraints": [], "orientation_constraints": [],
        "visibility_constraints": [],
    },
    "TrajectoryConstraints": {"constraints": []},
    "MotionPlanRequest": {
        "start_state": "RobotState", "goal_constraints": [], "path_constraints": "Constraints",
        "trajectory_constraints": "TrajectoryConstraints", "group_name": "", "allowed_planning_time": 0.0,
        "max_velocity_scaling_factor": 0.0, "max_acceleration_scaling_factor": 0.0,
        "cartesian_speed_limited_link": "", "max_cartesian_speed": 0.0,
    },
    "MoveItErrorCodes": {"val": 0},
    "MotionPlanResponse": {
        "trajectory_start": "RobotState", "group_name": "", "trajectory": "RobotTrajectory", "planning_time": 0.0,
        "error_code": "MoveItErrorCodes",
    },
}  # fmt: skip
"""Messages by name: their fields, with the default or the name of the message that a field holds."""

CODES = {
    "SUCCESS": 1, "FAILURE": 99999, "PLANNING_FAILED": -1, "INVALID_MOTION_PLAN": -2, "TIMED_OUT": -6,
    "START_STATE_IN_COLLISION": -10, "GOAL_IN_COLLISION": -12, "NO_IK_SOLUTION": -31,
}  # fmt: skip


def message(name: str, /, **values: Any) -> Any:
    """A message; a field that it does not have is refused, as by ROS."""
    defaults = DEFAULTS[name]
    made = make_dataclass(name, defaults)(
        **{
            key: message(value) if isinstance(value, str) and value else copy.copy(value)
            for key, value in defaults.items()
        }
    )
    for key, value in values.items():
        assert hasattr(made, key), f"{name} has no {key}"
        setattr(made, key, value)
    return made


def kind(name: str, **constants: int) -> Any:
    """A class of messages."""
    return type(name, (), {"__new__": lambda _, **values: message(name, **values), **constants})


class Ros:
    """rclpy as far as the node uses it: one node with one service, whose messages to the user are kept."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.callbacks: dict[str, Callable[[Any, Any], Any]] = {}
        self.names: dict[str, Any] = {}

    def init(self) -> None: ...

    def spin(self, _: Any) -> None: ...

    def create_node(self, _: str) -> Ros:
        return self

    def declare_parameter(self, name: str, default: str) -> Any:
        return SimpleNamespace(value="bin" if name == "scene" else default)

    def get_logger(self) -> Any:
        return SimpleNamespace(error=self.told.append, info=self.told.append)

    def create_service(self, _: Any, name: str, callback: Callable[[Any, Any], Any]) -> None:
        self.callbacks[name] = callback


class Remote:
    """The client's verbs, of a planner in this process."""

    def __init__(self, url: str, scene: str) -> None:
        assert url == "http://127.0.0.1:8080"
        self._service = PlannerService("wxai", scene)
        self.robot = self._service.robot

    def plan(self, request: Any) -> Any:
        if not self.reachable:
            raise PlannerServiceError("the server is gone")
        return self._service.plan(request)

    reachable = True


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> Ros:
    """The node, started."""
    ros = Ros()
    errors = kind("MoveItErrorCodes", **CODES)
    modules: dict[str, dict[str, Any]] = {
        "rclpy": {name: getattr(ros, name) for name in ("init", "spin", "create_node")},
        "builtin_interfaces.msg": {"Duration": kind("Duration")},
        "moveit_msgs.msg": {"MoveItErrorCodes": errors},
        "moveit_msgs.srv": {"GetMotionPlan": object},
        "trajectory_msgs.msg": {name: kind(name) for name in ("JointTrajectory", "JointTrajectoryPoint")},
        "planner_service.client": {"Remote": Remote},
    }
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    for package in ("builtin_interfaces", "moveit_msgs", "trajectory_msgs"):
        monkeypatch.setitem(sys.modules, package, ModuleType(package))
    ros.names = runpy.run_path(str(NODE), run_name="__main__")
    return ros


SERVICE = PlannerService("wxai", "bin")
ROBOT = SERVICE.robot


def joints(name: str) -> Any:
    """A goal that is a named pose."""
    constraints = [
        message("JointConstraint", joint_name=joint, position=float(value))
        for joint, value in zip(ROBOT.joint_names, ROBOT.pose(name), strict=True)
    ]
    return message("Constraints", joint_constraints=constraints)


def tool_goal(frame: str = "base_link") -> Any:
    """A goal that is a pose of the tool, above the tray."""
    pose = message("Pose", position=message("Point", x=0.2, y=0.28, z=0.15))
    place = message("PositionConstraint", link_name=ROBOT.tool_frame, header=message("Header", frame_id=frame))
    place.constraint_region.primitive_poses = [pose]
    turned = message("Quaternion", w=0.70711, x=0.0, y=0.70711, z=0.0)
    turn = message("OrientationConstraint", link_name=ROBOT.tool_frame, orientation=turned)
    turn.header.frame_id = frame
    return message("Constraints", position_constraints=[place], orientation_constraints=[turn])


def asked(goal: Any, **values: Any) -> Any:
    """A request from home, its joints named in another order."""
    state = message("JointState", name=[*ROBOT.joint_names[::-1]], position=ROBOT.home[::-1].tolist())
    start = message("RobotState", joint_state=state)
    return message("MotionPlanRequest", start_state=start, goal_constraints=[goal], group_name="arm", **values)


def answer(ros: Ros, request: Any) -> Any:
    response = SimpleNamespace(motion_plan_response=message("MotionPlanResponse"))
    return ros.callbacks["plan_kinematic_path"](
        SimpleNamespace(motion_plan_request=request), response
    ).motion_plan_response


@pytest.mark.slow
def test_the_node_answers_with_the_planners_trajectory(ros: Ros) -> None:
    told = answer(ros, asked(joints("ready"), max_velocity_scaling_factor=0.5))
    assert (told.error_code.val, told.group_name) == (CODES["SUCCESS"], "arm")
    assert ros.told == [f"planned {len(told.trajectory.joint_trajectory.points)} points"]
    plan = SERVICE.plan(PlanRequest(ROBOT.home, ROBOT.pose("ready"), velocity_scale=0.5))
    _, q, qd, qdd = plan.unwrap()[1].sample(0.01)
    trajectory = told.trajectory.joint_trajectory
    assert (trajectory.header.frame_id, trajectory.joint_names) == ("base_link", list(ROBOT.joint_names))
    for name, values in (("positions", q), ("velocities", qd), ("accelerations", qdd)):
        assert [getattr(point, name) for point in trajectory.points] == (values + 0.0).tolist()
    last = trajectory.points[-1].time_from_start
    assert last.sec + 1e-9 * last.nanosec == pytest.approx(plan.unwrap()[1].duration)


def test_the_node_takes_a_pose_of_the_tool(ros: Ros) -> None:
    told = answer(ros, asked(tool_goal()))
    assert told.error_code.val == CODES["SUCCESS"]
    end = ROBOT.tool_pose(told.trajectory.joint_trajectory.points[-1].positions)
    assert end[:3, 3] == pytest.approx([0.2, 0.28, 0.15], abs=1e-4)


def _constrained(request: Any) -> None:
    request.path_constraints.visibility_constraints = [object()]


def _unnamed(request: Any) -> None:
    request.start_state.joint_state.name = request.start_state.joint_state.position = []


def _half_a_goal(request: Any) -> None:
    request.goal_constraints[0].joint_constraints = request.goal_constraints[0].joint_constraints[:2]


def _twice(request: Any) -> None:
    request.start_state.joint_state.name = [*ROBOT.joint_names, "joint_0"]
    request.start_state.joint_state.position = [*ROBOT.home.tolist(), 1.0]


def _no_number(request: Any) -> None:
    request.allowed_planning_time = float("nan")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_constrained, "motion_plan_request: got 'arm'; expected no constraints but goals"),
        (_unnamed, "start_state: got .*; expected a position of each of joint_0"),
        (_half_a_goal, "goal_constraints: got .*; expected a position of each of joint_0"),
        (_no_number, "time_limit: got nan"),
        (_twice, "start_state: got .*; expected a position of each of joint_0, .*, once"),
    ],
)
def test_the_node_refuses_what_it_cannot_keep_and_goes_on(
    ros: Ros, change: Callable[[Any], None], message: str
) -> None:
    request = asked(joints("ready"))
    change(request)
    told = answer(ros, request)
    assert told.error_code.val == CODES["INVALID_MOTION_PLAN"]
    assert told.trajectory.joint_trajectory.points == []
    assert len(ros.told) == 1
    assert re.search(message, ros.told[0])
