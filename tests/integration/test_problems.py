"""The public problems and their robot: what they say of themselves, and three of them from end to end."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from auditor.checker import IndependentChecker, tables_of
from benchmarks.studies.problems import MOTION_STEP, ROBOT, planned, public_problems
from planner_service import CollisionChecker, Stage
from planner_service.files.package_data import data_folder
from planner_service.robot_setup.loading import load_robot

PINNED = {"cage/0057": (2, 1, 2179, 2043, 645, 210, 2184), "table_under_pick/0037": (2, 2, 1074, 1233, 1701, 86, 1542)}
"""States of ends, line, search, shortcut and polish; edges; bounds. A meant change has a line in CHANGELOG.md."""


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
    assert (*stages.values(), result.counts.edges, bounds) == PINNED[id]
    second = IndependentChecker(data_folder("robots") / ROBOT, tables_of(problem.scene))
    assert second.curve_touch(result.path, result.path.length, 5 * MOTION_STEP) is None
