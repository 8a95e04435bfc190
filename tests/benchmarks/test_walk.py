"""The walk of README's first plan is counted as it happens, and short."""

from __future__ import annotations

from benchmarks.studies import walk
from planner_service import load_robot


def test_each_call_and_each_return_into_another_file_is_a_step() -> None:
    robot = load_robot("wxai")
    steps = walk.walked(lambda: robot.pose("home"))
    there, back = ("robot/model.py", "geometry/validation.py"), ("geometry/validation.py", "robot/model.py")
    assert steps == [("", "robot/model.py", "pose"), (*there, "text"), (*back, "")]


def test_the_first_plan_of_the_readme_is_a_short_walk() -> None:
    assert [promise for promise in walk.run().promises if not promise.kept] == []
