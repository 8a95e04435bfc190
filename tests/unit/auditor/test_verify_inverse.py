"""Proofs of complete inverse kinematics are checked without the package; none that says something false is accepted."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.__main__ import judged
from auditor.schema import Invalid, parsed
from benchmarks.studies.ik.forgeries import FALSE
from planner_service import InvalidRequest, Pose, PoseGoal, inverse_kinematics, load_robot
from planner_service.kinematics.inverse import ToolChain
from planner_service.records.exports.inverse_file import inverse_document, save_inverse
from planner_service.robot.model import Robot
from tests.support.random_robots import random_robot
from tests.support.small_robots import built

Document = dict[str, Any]
ARMS = ("planar2", "wxai", "ur5", "kinova")


def arm(name: str) -> Robot:
    whole = load_robot(name)
    return ToolChain.of(whole, whole.home).robot


def drawn(robot: Robot, seed: int) -> Pose:
    return Pose.from_matrix(robot.tool_pose(np.random.default_rng(seed).uniform(*robot.bounds)))


def written(robot: Robot, pose: Pose | PoseGoal) -> Document:
    document: Document = parsed(json.dumps(inverse_document(robot, pose)).encode())
    return document


@pytest.mark.parametrize("name", ARMS)
def test_an_honest_proof_is_accepted(name: str) -> None:
    robot = arm(name)
    for seed in range(3):
        pose = drawn(robot, seed)
        document = written(robot, pose)
        *_, last = judged(document)
        assert f"in {len(inverse_kinematics(robot, pose, complete=True))} configurations" in last


def test_honest_proofs_of_other_arms_and_goals_are_accepted(tmp_path: Path) -> None:
    wxai = load_robot("wxai")
    five = wxai.locked({"joint_5": 0.3})
    three = wxai.locked({"joint_3": 0.4, "joint_4": 0.1, "joint_5": 0.3})
    odd = built(tmp_path, random_robot(np.random.default_rng(24), joints=6, mimics=1))
    chain = ToolChain.of(odd, odd.home).robot
    cases: list[tuple[Robot, Pose | PoseGoal]] = [
        (five, PoseGoal(drawn(five, 1), free_axis=(1.0, 0.0, 0.0))),
        (three, PoseGoal(drawn(three, 2), orientation_tolerance=np.pi)),
        *((wxai, PoseGoal(drawn(wxai, k), position_tolerance=1e-4, orientation_tolerance=1e-4)) for k in range(4)),
        (wxai, Pose((0.02, 0.0, 0.1), (0.0, 0.0, 1.0, 0.0))),
        (chain, Pose.from_matrix(chain.tool_pose(chain.home))),
    ]
    accepted = 0
    for robot, goal in cases:
        if not inverse_kinematics(robot, goal, complete=True).complete:
            continue
        assert list(judged(written(robot, goal)))
        accepted += 1
    assert accepted >= 5


def test_a_proof_about_a_configuration_at_a_limit_is_accepted_and_none_beyond_rounding_is() -> None:
    robot = load_robot("wxai")
    q = np.array([0.3, 1.2, 1.0, 0.2, 0.4, robot.bounds[1][5]])
    document = written(robot, Pose.from_matrix(robot.tool_pose(q)))
    assert list(judged(document))
    document["robot"]["limits"]["upper"][5] -= 2e-9
    with pytest.raises(Invalid):
        list(judged(document))


def test_a_box_that_a_limit_cuts_needs_a_configuration_within_it_and_the_tolerances() -> None:
    robot = load_robot("wxai")
    q = np.array([0.3, 1.2, 1.0, 0.2, 0.4, robot.bounds[1][5]])
    goal = PoseGoal(Pose.from_matrix(robot.tool_pose(q)), position_tolerance=1e-5, orientation_tolerance=1e-5)
    document = written(robot, goal)
    assert list(judged(document))
    (listed,) = (k for k, row in enumerate(document["q"]) if np.abs(np.array(row) - q).max() < 1e-3)
    for joint, away in ((5, 1e-6), (0, 2e-5)):  # beyond the limit; in the box, with the tool elsewhere
        forged = deepcopy(document)
        forged["q"][listed][joint] += away
        assert forged["lower"][listed][joint] < forged["q"][listed][joint] < forged["upper"][listed][joint]
        with pytest.raises(Invalid, match="not listed"):
            list(judged(forged))


def test_a_file_is_written_whole_and_what_is_in_doubt_is_refused(tmp_path: Path) -> None:
    robot = load_robot("wxai")
    save_inverse(robot, drawn(robot, 0), tmp_path / "inverse.json")
    assert list(judged(parsed((tmp_path / "inverse.json").read_bytes())))
    singular = Pose.from_matrix(robot.tool_pose([0.3, 1.2, 1.0, 0.2, np.pi / 2, -0.5]))
    with pytest.raises(InvalidRequest, match="nothing is in doubt"):
        inverse_document(robot, singular)
    with pytest.raises(InvalidRequest, match="at most 6 joints"):
        inverse_document(load_robot("panda"), Pose())
    with pytest.raises(InvalidRequest, match="a Pose or a PoseGoal"):
        inverse_document(robot, "up")  # type: ignore[arg-type]


@pytest.mark.parametrize("forge", FALSE, ids=lambda forge: str(forge.__name__))
def test_a_forgery_is_refused(forge: Callable[[Document, random.Random], None]) -> None:
    chance = random.Random(7)
    for name in ("planar2", "wxai"):
        honest = written(arm(name), drawn(arm(name), 3))
        assert honest["q"]
        for _ in range(6):
            document = deepcopy(honest)
            forge(document, chance)
            with pytest.raises(Invalid):
                list(judged(document))


def test_a_joint_that_was_not_searched_is_noticed() -> None:
    robot = load_robot("wxai")
    document = written(robot, drawn(robot, 0))
    document["robot"]["limits"]["upper"][0] += 0.5
    with pytest.raises(Invalid, match="were not searched"):
        list(judged(document))


def bend_a_frame(document: Document) -> None:
    document["robot"]["bodies"][1]["placement"][3][1] = 0.05


def bend_the_tool(document: Document) -> None:
    document["robot"]["tool_placement"][3][1] = 0.05


def mirror_the_tool(document: Document) -> None:
    rows = document["robot"]["tool_placement"]
    rows[0] = [-x for x in rows[0]]


def stretch_the_orientation(document: Document) -> None:
    document["goal"]["pose"]["quaternion_wxyz"][0] += 0.5


def tolerate_more_than_a_half_turn(document: Document) -> None:
    document["goal"]["room"]["orientation_tolerance"] = 4.0


def carry_a_body_by_nothing(document: Document) -> None:
    document["robot"]["bodies"][1]["parent"] = -1


def move_by_mimics_only(document: Document) -> None:
    document["robot"]["bodies"][1]["multiplier"] = 0.5


def try_fewer_than_none(document: Document) -> None:
    document["goal"]["room"]["candidates"] = -16


@pytest.mark.parametrize(
    "spoil",
    [
        carry_a_body_by_nothing,
        move_by_mimics_only,
        try_fewer_than_none,
        bend_a_frame,
        bend_the_tool,
        mirror_the_tool,
        stretch_the_orientation,
        tolerate_more_than_a_half_turn,
    ],
    ids=lambda spoil: str(spoil.__name__),
)
def test_what_is_no_robot_or_no_goal_is_refused(spoil: Callable[[Document], None]) -> None:
    robot = load_robot("wxai").locked({"joint_3": 0.4, "joint_4": 0.1, "joint_5": 0.3})
    document = written(robot, PoseGoal(drawn(robot, 2), orientation_tolerance=np.pi))
    spoil(document)
    with pytest.raises(Invalid, match=r"last row|oddly|no unit|no goal has|what carries|by mimics"):
        list(judged(document))
