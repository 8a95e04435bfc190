"""What an arm of a cell holds moves with its tool, and is judged against all that the arm is judged against."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from planner_service import (
    Attached,
    Box,
    Compound,
    InvalidRequest,
    Obstacle,
    PlannerService,
    PlanRequest,
    PointCloud,
    Pose,
    Scene,
    Sphere,
    UnknownName,
    load_robot,
    load_scene,
)
from planner_service.cell import Arm, Cell
from planner_service.certify import Certifier
from planner_service.constraints import KeepUpright
from planner_service.geometry.arrays import FloatArray
from planner_service.records.cells import load_cell_plan, prove_cell, save_cell_plan

WXAI, DUAL = load_robot("wxai"), load_robot("wxai_dual")
TABLE = load_scene("table")
BAR = Attached("bar", Box((0.04, 0.3, 0.03)), Pose((0.05, 0.0, 0.0)), ("finger_left", "finger_right"), mass=0.4)
SIDES = {side: [name for name in DUAL.joint_names if name.startswith(side)] for side in ("left", "right")}


def free(cell: Cell, rng: np.random.Generator) -> FloatArray:
    while True:
        q = rng.uniform(*cell.robot.bounds)
        if cell.service.checker.state_is_free(q):
            return np.asarray(q)


@pytest.fixture(scope="module")
def cell() -> Cell:
    return Cell({"left": Arm(WXAI, Pose((0.0, 0.25, 0.0))), "right": Arm(WXAI, Pose((0.0, -0.25, 0.0)))}, TABLE)


@pytest.fixture(scope="module")
def carrying(cell: Cell) -> Cell:
    return cell.carrying({"left": [BAR], "right": [BAR]})


def test_an_arm_that_holds_something_touches_what_a_robot_with_it_attached_touches() -> None:
    one = Cell({"arm": WXAI}, TABLE).carrying({"arm": [BAR]})
    service = PlannerService(WXAI, Scene(TABLE.obstacles, (BAR,)))
    certifiers = Certifier(WXAI, service.scene), Certifier(one.robot, one.scene)
    rng = np.random.default_rng(1)
    outcomes = []
    for _ in range(400):
        q = rng.uniform(*WXAI.bounds)
        outcomes.append(service.checker.state_is_free(q))
        assert one.arm("arm").checker.state_is_free(q) == outcomes[-1]
        assert certifiers[0].clearances(q[None]) == pytest.approx(certifiers[1].clearances(q[None]), abs=1e-6)
    assert 40 < sum(outcomes) < 360


def test_what_an_arm_of_one_robot_holds_is_at_its_own_tool() -> None:
    dual = Cell.of(DUAL, SIDES, Scene(()), tools={"right": "right_ee_gripper_link"})
    held = Attached("ball", Sphere(0.03), Pose((0.1, 0.0, 0.0)))
    both = dual.carrying({"left": [held], "right": [held]})
    q = np.array(both.robot.home)
    poses = both.robot.body_poses(q)
    shapes = {item.link: item for item in both.robot.shapes}
    for name in both.arms:
        item = shapes[f"{name}_ball"]
        turn, at = np.reshape(poses[item.body][:9], (3, 3)), np.array(poses[item.body][9:])
        expected = both.arm(name).robot.tool_pose(both.of_arm(name, q)) @ [0.1, 0.0, 0.0, 1.0]
        assert at + turn @ item.pose.position == pytest.approx(expected[:3], abs=1e-12)


def test_arms_with_loads_do_not_touch_however_late(carrying: Cell) -> None:
    rng, planned = np.random.default_rng(4), 0
    for _ in range(6):
        start, goal = free(carrying, rng), free(carrying, rng)
        requests = {n: PlanRequest(carrying.of_arm(n, start), carrying.of_arm(n, goal)) for n in carrying.arms}
        plan = carrying.plan(requests, delay=0.05)
        planned += plan.ok
        if plan.ok:
            times, most = np.linspace(0.0, plan.duration, 100), min(plan.tolerates, 0.5)
            late = {name: rng.uniform(0.0, most, 100) for name in carrying.arms}
            assert all(carrying.service.checker.state_is_free(q) for q in plan(times, late))
    assert planned >= 4


def test_a_load_can_be_in_the_way_where_the_arm_is_not(cell: Cell, carrying: Cell) -> None:
    rng = np.random.default_rng(5)
    only = 0
    for _ in range(300):
        q = rng.uniform(*cell.robot.bounds)
        if carrying.service.checker.state_is_free(q):
            assert cell.service.checker.state_is_free(q)
        elif cell.service.checker.state_is_free(q):
            only += 1
    assert only > 10


def test_what_the_object_keeps_is_kept() -> None:
    level = Attached("cup", Sphere(0.02), Pose(), ("finger_left", "finger_right"), (KeepUpright((0, 0, 1), 1.5),))
    cell = Cell({"arm": WXAI}, Scene(())).carrying({"arm": [level]})
    start = [0.0, 1.4, 1.2, -0.2, 0.0, 0.0]
    plan = cell.plan({"arm": PlanRequest(start, [0.5, *start[1:]])})
    assert plan.ok
    assert plan.clocks[0].plan.constraints == level.constraints
    turned = cell.plan({"arm": PlanRequest(start, [0.5, *start[1:5], 3.0])})
    assert turned.failure is not None
    assert "CONSTRAINT" in turned.failure.reason.value


def test_a_plan_of_arms_with_loads_is_saved_and_proven_anew(carrying: Cell, tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    while True:
        start, goal = free(carrying, rng), free(carrying, rng)
        requests = {n: PlanRequest(carrying.of_arm(n, start), carrying.of_arm(n, goal)) for n in carrying.arms}
        plan = carrying.plan(requests, delay=0.02)
        if plan.ok:
            break
    save_cell_plan(plan, tmp_path / "plan.json")
    loaded = load_cell_plan(tmp_path / "plan.json")
    assert loaded.cell.robot.hash == carrying.robot.hash
    assert loaded.cell.layout.carried == {"left": (BAR,), "right": (BAR,)}
    assert prove_cell(loaded).certified


def test_all_as_one_are_as_slow_as_the_slowest_and_keep_the_most_padding() -> None:
    near = Cell({"left": Arm(WXAI, Pose((0.0, 0.2, 0.0))), "right": Arm(WXAI, Pose((0.0, -0.2, 0.0)))}, "empty")
    rng, shared = np.random.default_rng(1), 0
    for _ in range(25):
        start, goal = free(near, rng), free(near, rng)
        requests = {
            "left": PlanRequest(near.of_arm("left", start), near.of_arm("left", goal)),
            "right": PlanRequest(near.of_arm("right", start), near.of_arm("right", goal), velocity_scale=0.3),
        }
        plan = near.plan(requests)
        if len(plan.clocks) == 1:
            shared += 1
            trajectory = plan.clocks[0].plan.unwrap()[1]
            speeds = np.abs(trajectory(np.linspace(0.0, trajectory.duration, 500), 1))[:, 6:]
            assert (speeds <= 0.3 * WXAI.limits.velocity + 1e-9).all()
    assert shared


def test_what_cannot_be_held_is_refused(cell: Cell) -> None:
    ball = Attached("ball", Sphere(0.02), Pose())
    with pytest.raises(UnknownName, match="middle"):
        cell.carrying({"middle": [ball]})
    with pytest.raises(UnknownName, match="no_link"):
        cell.carrying({"left": [Attached("ball", Sphere(0.02), Pose(), ("no_link",))]})
    with pytest.raises(InvalidRequest, match="carried"):
        cell.carrying({"left": [ball, ball]})
    with pytest.raises(InvalidRequest, match="carried"):
        cell.carrying({"left": [Attached("link_1", Sphere(0.02), Pose())]})
    with pytest.raises(InvalidRequest, match="carried"):
        cell.carrying({"left": [3]})  # type: ignore[list-item]
    with pytest.raises(InvalidRequest, match="carried"):
        cell.carrying({"left": [Attached("cloud", PointCloud(np.zeros((4, 3)), 0.01), Pose())]})
    taken = Obstacle("left_ball", Sphere(0.02), Pose((3.0, 0.0, 0.0)))
    with pytest.raises(InvalidRequest, match="carried"):
        Cell({"left": WXAI}, Scene((taken,))).carrying({"left": [ball]})


def test_an_object_of_several_pieces_is_one_link(cell: Cell) -> None:
    cross = Compound(((Box((0.02, 0.2, 0.02)), Pose()), (Box((0.2, 0.02, 0.02)), Pose((0.0, 0.0, math.pi / 100)))))
    robot = cell.carrying({"left": [Attached("cross", cross, Pose((0.1, 0.0, 0.0)))]}).robot
    assert sum(item.link == "left_cross" for item in robot.shapes) == 2


def test_nothing_is_held_any_more_when_it_is_put_down(carrying: Cell, cell: Cell) -> None:
    assert carrying.carrying({}).robot.hash == cell.robot.hash
