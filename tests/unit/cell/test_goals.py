"""Where arms would touch at the goals that each would choose alone, they take others of their goals."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service import PlanRequest, Pose, Reason, inverse_kinematics, load_robot
from planner_service.cell import Arm, Cell

WXAI = load_robot("wxai")
LEFT_IN, LEFT_OUT = ([turn, 1.4, 1.2, -0.8, 0.0, 0.0] for turn in (-0.6, 0.5))
RIGHT_IN, RIGHT_OUT = ([turn, 1.4, 1.2, -0.8, 0.0, 0.0] for turn in (0.6, -0.5))
START = [-0.4, 0.4, 0.4, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def cell() -> Cell:
    return Cell({"left": Arm(WXAI, Pose((0.0, 0.2, 0.0))), "right": Arm(WXAI, Pose((0.0, -0.2, 0.0)))}, "table")


def test_an_arm_takes_another_of_its_goals(cell: Cell) -> None:
    right = PlanRequest(RIGHT_OUT, RIGHT_IN)
    alone = cell.plan({"left": PlanRequest(START, [LEFT_IN, LEFT_OUT])}, standing={"right": RIGHT_OUT})
    assert alone(alone.duration)[:6] == pytest.approx(LEFT_IN), "it is the nearer one"
    plan = cell.plan({"left": PlanRequest(START, [LEFT_IN, LEFT_OUT]), "right": right}, delay=0.05)
    assert plan.ok
    assert plan(plan.duration) == pytest.approx([*LEFT_OUT, *RIGHT_IN])
    assert plan.notes[0].startswith("left: another goal")
    for q in plan(np.linspace(0.0, plan.duration, 200)):
        assert cell.service.checker.state_is_free(q)


def test_where_no_goals_go_together_it_says_so(cell: Cell) -> None:
    plan = cell.plan({"left": PlanRequest(START, LEFT_IN), "right": PlanRequest(RIGHT_OUT, RIGHT_IN)})
    assert plan.failure is not None
    assert plan.failure.reason is Reason.GOAL_IN_COLLISION


def test_both_arms_may_have_several(cell: Cell) -> None:
    asked = {
        "left": PlanRequest(START, [LEFT_IN, LEFT_OUT]),
        "right": PlanRequest([0.4, *START[1:]], [RIGHT_IN, RIGHT_OUT]),
    }
    plan = cell.plan(asked)
    assert plan.ok
    end = plan(plan.duration)
    assert cell.service.checker.state_is_free(end)
    assert any(
        end == pytest.approx([*a, *b]) for a, b in ((LEFT_IN, RIGHT_OUT), (LEFT_OUT, RIGHT_IN), (LEFT_OUT, RIGHT_OUT))
    )
    again = cell.plan(dict(reversed(asked.items())))
    assert np.array_equal(again(again.duration), end)


def test_poses_are_reached_by_another_configuration(cell: Cell) -> None:
    rng, planned, changed = np.random.default_rng(8), 0, 0
    left = cell.arm("left").robot
    while planned < 4:
        goal = rng.uniform(*cell.robot.bounds)
        if not cell.arm("right").checker.state_is_free(goal[6:]):
            continue
        pose = Pose.from_matrix(left.tool_pose(goal[:6]))
        ways = [q for q in inverse_kinematics(left, pose) if cell.arm("left").checker.state_is_free(q)]
        free = [cell.service.checker.state_is_free(np.concatenate([q, goal[6:]])) for q in ways]
        if all(free) or not any(free):
            continue  # it makes no difference
        plan = cell.plan({"left": PlanRequest(WXAI.home, pose), "right": PlanRequest(WXAI.home, goal[6:])})
        assert plan.ok
        planned += 1
        changed += "another goal" in " ".join(plan.notes)
        end = plan(plan.duration)
        assert left.tool_pose(end[:6]) == pytest.approx(pose.matrix, abs=1e-6)
        assert cell.service.checker.state_is_free(end)
    assert changed
