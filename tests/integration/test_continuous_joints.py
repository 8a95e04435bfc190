"""Joints that turn without end: planned the shortest way round, from wherever they are, and proven there."""

from __future__ import annotations

import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from auditor.checker import IndependentChecker, tables_of
from planner_service import PRM
from planner_service.certify import Certifier
from planner_service.collision import CollisionChecker, JointStep
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Pose
from planner_service.kinematics.inverse import straight_tool_line
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Origin, PlanResult, Reason
from planner_service.records.plan_file import load_plan
from planner_service.records.recertify import recertify
from planner_service.robot.model import MAX_TURNED, TURN, Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import plan_pick_place
from planner_service.view.playback import Playback
from planner_service.view.state import ViewState
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


@pytest.mark.parametrize("turns", [0, 1, -3, 150])
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


def test_a_goal_a_whole_turn_away_is_the_start(pendulum: Robot) -> None:
    begin, end = ends(PlannerService(pendulum, Scene()).plan(PlanRequest([0.3, 0.1], [0.3 + TURN, 0.1 - 3.0 * TURN])))
    assert begin.tolist() == end.tolist()


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


def test_its_file_is_proven_again(pendulum: Robot, tmp_path: Path) -> None:
    service = PlannerService(pendulum, Scene((POST,)))
    result = service.plan(PlanRequest([1.0 + 20.0 * TURN, 0.2], [2.0, 0.1]))
    result.save(tmp_path / "plan.json")
    saved = load_plan(tmp_path / "plan.json")
    assert saved.robot.hash == pendulum.hash
    assert saved.robot.continuous == (True, True)
    assert recertify(saved).certified


def test_a_robot_under_way_is_replanned_where_it_is(pendulum: Robot) -> None:
    service = PlannerService(pendulum, Scene())
    first = service.plan(PlanRequest([0.2 - 12.0 * TURN, 0.2], [2.0, 0.1]))
    _, end = ends(service.replan(first, at_time=0.3, goal=np.array([-2.0, 0.4])).result)
    assert end == pytest.approx([TURN - 2.0 - 12.0 * TURN, 0.4], abs=1e-9) or end == pytest.approx(
        [-2.0 - 12.0 * TURN, 0.4], abs=1e-9
    )


def test_what_is_farther_than_159_turns_is_refused(pendulum: Robot) -> None:
    service = PlannerService(pendulum, Scene())
    failure = service.plan(PlanRequest([MAX_TURNED + 1.0, 0.0], [0.0, 0.0])).failure
    assert failure is not None
    assert failure.reason is Reason.START_OUTSIDE_LIMITS
    assert "shoulder = 1001 is outside [-1000.0000, 1000.0000]" in failure.detail
    with pytest.raises(InvalidRequest, match=r"waypoints\[1\]\[0\]: got 1001"):
        service.certify(np.array([[0.0, 0.0], [1001.0, 0.0]]))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_start_a_hair_beyond_the_thousand_radians_is_taken_to_be_there(pendulum: Robot, side: float) -> None:
    start = np.array([side * (MAX_TURNED + 1e-9), 0.0])
    path, _ = PlannerService(pendulum, Scene()).plan(PlanRequest(start, [0.3, 0.1])).unwrap()
    assert path.waypoints[0].tolist() == [side * MAX_TURNED, 0.0]


def test_that_a_roadmap_does_not_reach_some_turns_away_is_no_proof_of_no_path(pendulum: Robot) -> None:
    service = PlannerService(pendulum, Scene())
    roadmap = service.build_roadmap(PRM(milestones=20))
    failure = present(service.plan(PlanRequest([8.0, 0.0], [0.0, 0.0], planner=roadmap)).failure)
    assert failure.detail.endswith("which is all that a roadmap covers")
    assert not failure.proven


def test_the_way_out_of_a_collision_is_short_some_turns_away(pendulum: Robot) -> None:
    q = np.array([math.pi + 8.0 * TURN + 0.12, 0.0])
    way = PlannerService(pendulum, Scene((POST,))).way_out(q)
    assert way is not None
    assert np.abs(way.path.waypoints - q).max() < 1.0


def test_a_tool_line_may_begin_some_turns_away(pendulum: Robot) -> None:
    q = np.array([0.4 + 7.0 * TURN, 0.9])
    far, near = (straight_tool_line(pendulum, at, (0.0, 0.02, 0.0)).waypoints for at in (q, q - [7.0 * TURN, 0.0]))
    assert far - near == pytest.approx(np.tile([7.0 * TURN, 0.0], (len(near), 1)), abs=1e-7)


def test_the_same_robot_is_planned_for_around_any_configuration(pendulum: Robot) -> None:
    assert pendulum.around([3.0, -3.0]) is pendulum
    turned = pendulum.around([8.0, -3.0])
    assert turned is pendulum.around([7.0, -3.0])
    assert turned.hash == pendulum.hash
    assert turned.limits.lower.tolist() == [0.0, -TURN]
    assert pendulum.locked({"elbow": 50.0}).continuous == (True,)


@pytest.mark.parametrize("seed", range(3))
def test_states_and_edges_outside_the_window_are_judged_as_fcl_does(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    robot, scene = built(tmp_path, random_robot(rng)), Scene((POST,))
    assert any(robot.continuous), "pick another seed"
    fast, slow = (CollisionChecker(robot, scene, edge_step=JointStep(0.02), backend=b) for b in ("native", "fcl"))
    certifier = Certifier(robot, scene)
    lower, upper = robot.limits.lower, robot.limits.upper
    shifts = np.where(robot.continuous, TURN, 0.0) * rng.integers(-150, 150, (150, robot.n))
    Q = rng.uniform(lower, upper, (150, robot.n)) + shifts
    assert fast.states_are_free(Q).tolist() == slow.states_are_free(Q).tolist() == [fast.state_is_free(q) for q in Q]
    assert slow.states_are_free(Q - shifts).tolist() == slow.states_are_free(Q).tolist()
    free = Q[slow.states_are_free(Q)]
    for q in free[:20]:
        end = np.where(robot.continuous, q + rng.normal(0.0, 0.3, robot.n), q)
        assert fast.edge_is_free(q, end) == slow.edge_is_free(q, end)
        if certifier.certify(np.array([q, end])).certified:
            assert slow.states_are_free(np.linspace(q, end, 300)).all()


def test_a_joint_is_not_continuous_if_a_mimic_turns_by_a_part_of_its_turn(tmp_path: Path) -> None:
    def with_mimic(multiplier: float) -> Robot:
        mimic = f'{ENDLESS}<mimic joint="shoulder" multiplier="{multiplier}"/>'
        more = link("vane", solid("box", "0.1 0.02 0.02")), joint("geared", "continuous base vane", more=mimic)
        return built(tmp_path, PENDULUM.replace("</robot>", "".join(more) + "</robot>"))

    assert with_mimic(2.0).continuous == (True, True)
    assert with_mimic(0.5).continuous == (False, True)
    assert with_mimic(0.5).limits.upper[0] == pytest.approx(2.0 * math.pi)


def test_no_way_round_leaves_the_thousand_radians(pendulum: Robot) -> None:
    service = PlannerService(pendulum, Scene())
    for start, goal in ((999.9, 997.4), (999.9, 0.0), (-999.9, -997.4)):
        path, _ = service.plan(PlanRequest([start, 0.0], [goal, 0.0])).unwrap()
        assert np.abs(path.waypoints).max() <= 1000.0
        assert service.explain(PlanRequest([start, 0.0], [goal, 0.0])).result.ok


@pytest.mark.parametrize("at", [998.0, 999.9, -999.9])
def test_a_pose_goal_near_the_thousand_radians_is_reached_within_them(endless_base: PlannerService, at: float) -> None:
    robot = endless_base.robot
    beyond = robot.home + 2.0 * np.sign(at) * np.eye(6)[0]  # which the shortest way round would go to
    aside = Pose.from_matrix(robot.tool_pose(beyond))
    path, _ = endless_base.plan(PlanRequest(robot.home + at * np.eye(6)[0], aside)).unwrap()
    assert np.abs(path.waypoints[:, 0]).max() <= MAX_TURNED


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
@pytest.mark.parametrize("turned", [0.0, 1.15, 20.0, -999.9])
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


def test_the_page_and_curves_show_a_robot_where_it_is_after_some_turns(pendulum: Robot) -> None:
    service = PlannerService(pendulum, Scene((POST,)))
    result = service.plan(PlanRequest(np.array([2.4 + 3.0 * TURN, 0.2]), np.array([-2.4, 0.1])))
    playback = present(Playback.of_result(service, result))
    for t in (0.0, 0.5 * playback.duration, playback.duration):
        assert ViewState.of(service, result).at(t).q.tolist() == playback.at(t).q.tolist()
    (clip,) = playback.clips
    instants = playback.samples.t
    assert playback.samples.clearance.min() > 0.0
    assert playback.samples.clearance == pytest.approx(
        Certifier(pendulum.around(clip.trajectory(0.0)), service.scene).clearances(clip.trajectory(instants))
    )
    assert np.abs(playback.samples.position).max() <= 1.0


def test_a_goal_is_dragged_from_where_it_is_after_some_turns(endless_base: PlannerService) -> None:
    goal = endless_base.robot.home + 3.0 * TURN * np.eye(6)[0]
    pose = Pose.from_matrix(endless_base.robot.tool_pose(goal + 0.1))
    dragged = ViewState.of(endless_base).posed(goal).with_goal().aimed(pose)
    assert dragged.goal == pytest.approx(goal + 0.1, abs=1e-3)
