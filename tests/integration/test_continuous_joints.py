"""Joints that turn without end: planned the shortest way round, from wherever they are, and proven there."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from auditor.checker import IndependentChecker, tables_of
from planner_service.certify import Certifier
from planner_service.collision import CollisionChecker, JointStep
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Pose
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Origin, PlanResult
from planner_service.records.recertify import recertify
from planner_service.robot.model import MAX_TURNED, TURN, Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import plan_pick_place
from tests.support.optional import present
from tests.support.random_robots import random_robot
from tests.support.small_robots import built, joint, link, solid, urdf

WXAI = Path(__file__).parents[2] / "robots" / "wxai"
ENDLESS = '<limit velocity="2" effort="1"/>'
PENDULUM = urdf(
    "pendulum",
    link("base", solid("box", "0.1 0.1 0.1")),
    *(link(name, solid("box", "0.4 0.04 0.04", "0.25 0 0")) for name in ("upper", "lower")),
    joint("shoulder", "continuous base upper", xyz="0 0 0.1", more=ENDLESS),
    joint("elbow", "continuous upper lower", xyz="0.45 0 0.05", more=ENDLESS),
)
"""A double pendulum that lies."""

POST = Obstacle("post", Box((0.1, 0.1, 0.5)), Pose((-0.5, 0.0, 0.1)))
"""Behind it, where the upper arm is at half a turn."""


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return built(tmp_path_factory.mktemp("pendulum"), PENDULUM)


def ends(result: PlanResult) -> tuple[FloatArray, FloatArray]:
    assert result.path is not None, result.failure
    assert result.certificate is not None
    assert result.certificate.certified
    return result.path.waypoints[0], result.path.waypoints[-1]


@pytest.mark.parametrize("turns", [0, -3])
def test_a_plan_goes_the_shortest_way_round_from_wherever_the_robot_is(pendulum: Robot, turns: int) -> None:
    service = PlannerService(pendulum, Scene())
    start, goal = np.array([3.0 + TURN * turns, 0.2]), np.array([-3.0, 0.2 + 2.0 * TURN])
    result = service.plan(PlanRequest(start, goal))
    begin, end = ends(result)
    assert begin.tolist() == start.tolist()
    assert end - begin == pytest.approx([TURN - 6.0, 0.0], abs=1e-9)
    assert result.path is not None
    assert service.certify(result.path).certified


def test_a_plan_is_proven_that_ends_whole_turns_from_its_goal_and_none_that_ends_elsewhere(pendulum: Robot) -> None:
    service = PlannerService(pendulum, Scene())
    result, off = service.plan(PlanRequest([3.0, 0.2], [-3.0, 0.2 + 2.0 * TURN])), PlanRequest([3.0, 0.2], [-3.0, 0.21])
    assert recertify(result).certified
    (problem,) = recertify(replace(result, origin=Origin(service.world, off))).problems
    assert problem.endswith("which is not goal 0")


def test_the_other_way_round_is_taken_if_the_short_one_is_blocked(pendulum: Robot, tmp_path: Path) -> None:
    scene = Scene((POST,))
    start, goal = np.array([2.6 + 10.0 * TURN, 0.2]), np.array([-2.6, 0.1])
    result = PlannerService(pendulum, scene).plan(PlanRequest(start, goal))
    begin, end = ends(result)
    assert end[0] - begin[0] == pytest.approx(-5.2, abs=1e-9)
    assert result.path is not None
    path = tmp_path / "robot.urdf"
    path.write_text(PENDULUM)
    limits = {"position": {"lower": [-MAX_TURNED] * 2, "upper": [MAX_TURNED] * 2}}
    adjacent = [{"links": contact.links} for contact in pendulum.allowed_contacts]
    table = {"urdf": path, "joints": list(pendulum.joint_names), "tool_frame": "lower", "limits": limits}
    auditor = IndependentChecker(table | {"allowed_contacts": adjacent}, tables_of(scene))
    assert auditor.curve_touch(result.path, result.path.length) is None


@pytest.mark.parametrize("seed", [0, 2])
def test_states_and_edges_outside_the_window_are_judged_as_fcl_does(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    robot, scene = built(tmp_path, random_robot(rng)), Scene((POST,))
    assert any(robot.continuous), "pick another seed"
    fast, slow = (CollisionChecker(robot, scene, edge_step=JointStep(0.02), backend=b) for b in ("native", "fcl"))
    certifier = Certifier(robot, scene)
    lower, upper = robot.limits.lower, robot.limits.upper
    shifts = np.where(robot.continuous, TURN, 0.0) * rng.integers(-150, 150, (60, robot.n))
    Q = rng.uniform(lower, upper, (60, robot.n)) + shifts
    assert fast.states_are_free(Q).tolist() == slow.states_are_free(Q).tolist() == [fast.state_is_free(q) for q in Q]
    assert slow.states_are_free(Q - shifts).tolist() == slow.states_are_free(Q).tolist()
    free = Q[slow.states_are_free(Q)]
    for q in free[:8]:
        end = np.where(robot.continuous, q + rng.normal(0.0, 0.3, robot.n), q)
        assert fast.edge_is_free(q, end) == slow.edge_is_free(q, end)
        if certifier.certify(np.array([q, end])).certified:
            assert slow.states_are_free(np.linspace(q, end, 100)).all()


@pytest.fixture(scope="module")
def endless_base(tmp_path_factory: pytest.TempPathFactory) -> PlannerService:
    """The WidowX AI on a base that turns without end, before the bin."""
    folder = tmp_path_factory.mktemp("endless") / "wxai"
    shutil.copytree(WXAI, folder)
    model = folder / "wxai.urdf"
    model.write_text(re.sub(r'(<joint\s+name="joint_0"\s+type=)"revolute"', r'\1"continuous"', model.read_text()))
    table = folder / "robot.toml"
    text = table.read_text().replace("lower = [-3.0543261909900767", f"lower = [{-TURN!r}")
    text = text.replace("upper = [3.0543261909900767", f"upper = [{TURN!r}")
    text = text.replace('inverse_kinematics = "wxai"', 'continuous = ["joint_0"]\ninverse_kinematics = "numeric"')
    table.write_text(text)
    return PlannerService(load_robot(table), "bin")


@pytest.mark.slow
@pytest.mark.parametrize("turned", [1.15, -999.9])
def test_the_motions_of_a_task_follow_one_another_wherever_the_robot_is(
    endless_base: PlannerService, turned: float
) -> None:
    start = endless_base.robot.home + turned * np.eye(6)[0]
    task = plan_pick_place(endless_base, "blue_block", "tray", PlanRequest(start, start, time_limit=None))
    assert task.ok
    recertify(task, endless_base).required()  # each motion begins where the last one ends, the gripper moves there
    ends = [end for segment in task.segments for end in present(segment.result.path).waypoints[[0, -1]].tolist()]
    assert [start.tolist(), *ends[1:-1:2]] == ends[::2]
    assert task.q.tolist() == ends[-1]
