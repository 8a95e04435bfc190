"""``PlannerService.explain``: what it suggests gives plans, and what it calls proven has none."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from planner_service import Box, Cylinder, Obstacle, PlannerService, PlanRequest, Pose, Reason, Scene
from planner_service.collision import CollisionChecker
from planner_service.constraints import ToolRegion
from planner_service.infeasibility import Explanation
from planner_service.kinematics.inverse import inverse_is_complete, inverse_kinematics
from planner_service.robot_setup.loading import load_robot
from tests.support.command import run

ARM = load_robot("wxai")
HOME, READY = ARM.home, dict(ARM.named_poses)["ready"] + [1.2, 0.0, 0.0, 0.0, 0.0, 0.0]
AT = ARM.tool_pose(READY)

CAGE = Obstacle("cage", Box((0.3, 0.3, 0.3)), Pose((float(AT[0, 3]), float(AT[1, 3]), float(AT[2, 3]))))


def explained(scene: Scene, goal: Any, **settings: Any) -> Explanation:
    service = PlannerService(ARM, scene)
    return service.explain(PlanRequest(HOME, goal, time_limit=None), **settings)


def applied(explanation: Explanation) -> None:
    """Fail unless each remedy, asked for anew, gives the plan that it promises."""
    assert explanation.remedies
    for remedy in explanation.remedies:
        again = PlannerService(ARM, remedy.scene).plan(remedy.request)
        assert again.unwrap()[0].waypoints.tobytes() == remedy.result.unwrap()[0].waypoints.tobytes(), remedy.text


def test_an_object_at_the_goal_is_moved_by_as_little_as_helps_or_taken_away() -> None:
    found = explained(Scene((CAGE,)), READY)
    applied(found)
    assert found.proven
    texts = [remedy.text for remedy in found.remedies]
    moved = [text for text in texts if text.startswith("move cage")]
    assert moved
    distance = float(moved[0].split()[-2]) / 1e3
    place = found.remedies[texts.index(moved[0])].scene.obstacle("cage").pose.position
    assert np.linalg.norm(np.array(place) - CAGE.pose.position) == pytest.approx(distance)


def test_a_pose_of_which_every_solution_collides_is_proven_to_have_no_plan() -> None:
    pose = Pose.from_matrix(AT)
    assert inverse_is_complete(ARM, pose)
    count = len(inverse_kinematics(ARM, pose))
    result = PlannerService(ARM, Scene((CAGE,))).plan(PlanRequest(HOME, pose))
    assert result.failure is not None
    assert result.failure.reason is Reason.GOAL_IN_COLLISION
    assert result.failure.proven
    assert count == 1 or f"all {count} ends" in result.failure.detail
    assert "proven: no plan exists for this request" in str(result)


def test_a_pose_that_leaves_an_angle_free_proves_nothing() -> None:
    above = Pose((0.0, 0.0, 0.6), (float(np.sqrt(0.5)), 0.0, float(-np.sqrt(0.5)), 0.0))  # straight up, over the waist
    assert not inverse_is_complete(ARM, above)
    assert not inverse_is_complete(load_robot("ur5"), Pose.from_matrix(AT))
    pair = load_robot("wxai_dual")
    assert inverse_is_complete(pair, Pose.from_matrix(pair.tool_pose(pair.home)))


def test_a_pose_out_of_reach_is_replaced_by_the_nearest_configuration() -> None:
    found = explained(Scene(), Pose((2.0, 0.0, 0.3)))
    assert found.proven
    assert "comes nearest" in found.remedies[0].text
    applied(found)


def test_a_tilt_is_relaxed_by_as_little_as_helps() -> None:
    up = ToolRegion(frame=Pose.from_matrix(ARM.tool_pose(HOME)), tilt=0.05, name="upright")
    lean = READY.copy()
    lean[3] += 0.15
    service = PlannerService(ARM, Scene())
    found = service.explain(PlanRequest(HOME, lean, constraints=(up,), time_limit=None))
    assert found.result.failure is not None
    assert found.result.failure.reason is Reason.GOAL_VIOLATES_CONSTRAINT
    assert any(remedy.text.startswith("relax upright to") for remedy in found.remedies)
    applied(found)


def test_walls_between_start_and_goal_are_proven_and_moved_away() -> None:
    arm = load_robot("planar2")
    discs = [Obstacle(name, Cylinder(0.1, 0.2), Pose((0.5, y, 0.0))) for name, y in (("left", 0.5), ("right", -0.5))]
    service = PlannerService(arm, Scene(tuple(discs)))
    found = service.explain(PlanRequest([0.0, 0.0], [3.0, 0.0], max_checks=5_000, time_limit=None), remedies=1)
    assert found.no_path is not None
    assert found.result.failure is not None
    assert found.result.failure.proven
    assert "no path exists" in str(found)
    assert found.remedies[0].text.startswith("move left")


def test_the_command_says_what_helps() -> None:
    goal = "pose:0.35,0.0,0.005,0.7071,0,0.7071,0"
    told = run("explain", "--scene", "bin", "--start", "home", "--goal", goal)
    assert told.exit_code == 1
    assert "this helps: " in told.output
    document = json.loads(run("explain", "--scene", "bin", "--start", "home", "--goal", goal, "--json").output)
    assert document["proven"]
    assert document["remedies"]
    assert run("explain", "--scene", "table", "--start", "home", "--goal", "ready").exit_code == 0


SLIT = tuple(
    Obstacle(f"disc_{k}", Cylinder(radius, 0.2), Pose((x, y, 0.0)))
    for k, (x, y, radius) in enumerate(
        [(-0.047006, 0.038984, 0.056421), (0.907448, -0.759465, 0.108535), (0.418551, -0.118416, 0.104990)]
    )
)

SLIT_ENDS = (-1.199937, 2.240154), (-0.921082, 0.133948)
"""Between them the arm has less than a tenth of a millimetre of room."""

WITHIN_A_DISC = (-0.7, 0.0)


def test_a_way_too_narrow_for_a_search_is_found_by_dividing_joint_space() -> None:
    service = PlannerService("planar2", Scene(SLIT))
    start, goal = SLIT_ENDS
    goals = [WITHIN_A_DISC, goal]
    found = service.explain(PlanRequest(start, goals, max_checks=20_000, time_limit=None), plans=1)
    assert not found.result.ok
    assert not found.proven
    assert found.way is not None
    assert found.way.goal_index == 1
    path, trajectory = found.way.unwrap()
    assert [path.waypoints[k].tolist() for k in (0, -1)] == [list(start), list(goal)]
    checker = CollisionChecker(service.robot, service.scene)
    assert all(checker.state_is_free(q) for q in trajectory(np.linspace(0.0, trajectory.duration, 2_000)))
    assert service.certify(path).certified
    assert "yet a way was found by dividing joint space" in str(found)


def test_of_a_start_that_is_too_deep_it_says_how_a_plan_leaves_it() -> None:
    down = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)
    service = PlannerService(ARM, "table")
    start = inverse_kinematics(ARM, Pose((0.3, 0.0, -0.0055), down))[0]
    found = service.explain(PlanRequest(start, HOME, time_limit=None))
    applied(found)
    first = found.remedies[0]
    assert first.text == f"begin with a way out of the collision, with start_overlap={first.request.start_overlap:g}"
    assert 0.0045 < first.request.start_overlap < 0.0048
    assert first.request.start.tolist() == start.tolist()  # type: ignore[union-attr]
