"""The public problems and their robot: what they say of themselves, and three of them from end to end."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from auditor.checker import IndependentChecker, tables_of
from benchmarks.studies.problems import MOTION_STEP, ROBOT, kind_of, planned, public_problems
from planner_service import CollisionChecker, Stage
from planner_service.files.package_data import data_folder
from planner_service.robot_setup.loading import load_robot

PINNED = {
    "bookshelf_thin/0087": {
        "endpoints": 2,
        "straight line": 7,
        "search": 710,
        "shortcut": 332,
        "polish": 773,
        "edges": 14,
        "bounds": 1416,
    },
    "cage/0057": {
        "endpoints": 2,
        "straight line": 1,
        "search": 3374,
        "shortcut": 1569,
        "polish": 3396,
        "edges": 593,
        "bounds": 2451,
    },
    "table_under_pick/0037": {
        "endpoints": 2,
        "straight line": 2,
        "search": 905,
        "shortcut": 1543,
        "polish": 1638,
        "edges": 73,
        "bounds": 1237,
    },
}
"""States by stage, edges and bounds of the default request; a change that is meant has a line in CHANGELOG.md."""


def test_there_are_ten_problems_of_each_of_seven_scenes() -> None:
    kinds = [kind_of(problem) for problem in public_problems().problems]
    assert {kind: kinds.count(kind) for kind in kinds} == dict.fromkeys(
        ["bookshelf_small", "bookshelf_tall", "bookshelf_thin", "box", "cage", "table_pick", "table_under_pick"], 10
    )


def test_every_start_and_goal_is_free() -> None:
    robot = load_robot(ROBOT)
    for problem in public_problems().problems:
        assert CollisionChecker(robot, problem.scene).states_are_free([problem.start, *problem.goals]).all(), problem.id


def test_what_may_touch_is_what_the_srdf_disables_but_for_the_pair_that_does_collide() -> None:
    root = ElementTree.parse(data_folder("robots") / ROBOT / f"{ROBOT}.srdf").getroot()
    disabled = {frozenset((e.attrib["link1"], e.attrib["link2"])) for e in root.iter("disable_collisions")}
    robot = load_robot(ROBOT)
    assert {frozenset(c.links) for c in robot.allowed_contacts} == disabled - {
        frozenset(("panda_link2", "panda_link6"))
    }


@pytest.mark.parametrize("id", PINNED)
def test_a_problem_is_planned_at_exactly_its_price_and_coal_rejects_nothing(id: str) -> None:
    problem = public_problems().problem(id)
    result = planned(load_robot(ROBOT), problem)
    assert result.path is not None, result.failure
    stages = {r.stage.value: r.counts.states for r in result.stages if r.counts.states}
    bounds = result.stage(Stage.CERTIFY).counts.distances
    assert {**stages, "edges": result.counts.edges, "bounds": bounds} == PINNED[id]
    second = IndependentChecker(data_folder("robots") / ROBOT, tables_of(problem.scene))
    assert second.curve_touch(result.path, result.path.length, 5 * MOTION_STEP) is None


def test_states_in_a_batch_are_judged_and_counted_as_one_by_one() -> None:
    robot = load_robot(ROBOT)
    checker = CollisionChecker(robot, public_problems().problem("cage/0057").scene)
    rng = np.random.default_rng(1)
    Q = robot.limits.lower + (robot.limits.upper - robot.limits.lower) * rng.random((150, robot.n))
    alone = [checker.state_is_free(q) for q in Q]
    assert checker.counts.states == 150
    assert checker.states_are_free(Q).tolist() == alone
    assert checker.counts.states == 300
    assert 10 < sum(alone) < 140
