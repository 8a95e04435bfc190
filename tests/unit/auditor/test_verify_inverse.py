"""Proofs of complete inverse kinematics are checked without the package; none that says something false is accepted."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.__main__ import judged
from auditor.schema import Invalid, parsed
from auditor.trails import unpacked
from planner_service import InvalidRequest, Pose, PoseGoal, inverse_kinematics, load_robot
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics.inverse import ToolChain
from planner_service.records.evidence import packed
from planner_service.records.exports.inverse_file import inverse_document, save_inverse
from planner_service.robot.model import Robot
from tests.support.random_robots import random_robot
from tests.support.small_robots import built

Document = dict[str, Any]
Forgery = Callable[[Document, np.random.Generator], None]
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
    place = drawn(wxai, 0)
    five = wxai.locked({"joint_5": 0.3})
    three = wxai.locked({"joint_3": 0.4, "joint_4": 0.1, "joint_5": 0.3})
    odd = built(tmp_path, random_robot(np.random.default_rng(24), joints=6, mimics=1))
    chain = ToolChain.of(odd, odd.home).robot
    cases: list[tuple[Robot, Pose | PoseGoal]] = [
        (five, PoseGoal(drawn(five, 1), free_axis=(1.0, 0.0, 0.0))),
        (three, PoseGoal(drawn(three, 2), orientation_tolerance=np.pi)),
        (wxai, PoseGoal(place, position_tolerance=1e-4, orientation_tolerance=1e-4)),
        (wxai, Pose((0.02, 0.0, 0.1), (0.0, 0.0, 1.0, 0.0))),
        (chain, Pose.from_matrix(chain.tool_pose(chain.home))),
    ]
    accepted = 0
    for robot, goal in cases:
        if not inverse_kinematics(robot, goal, complete=True).complete:
            continue
        assert list(judged(written(robot, goal)))
        accepted += 1
    assert accepted >= 4


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


def table(document: Document, key: str, columns: int) -> FloatArray:
    return np.array(unpacked(document[key], "<f8", columns))


def unlisted(document: Document, rng: np.random.Generator) -> None:
    """One solution is not in the list."""
    k = int(rng.integers(len(document["q"])))
    for key in ("q", "lower", "upper"):
        del document[key][k]


def doubled(document: Document, rng: np.random.Generator) -> None:
    k = int(rng.integers(len(document["q"])))
    for key in ("q", "lower", "upper"):
        document[key].append(document[key][k])


def elsewhere(document: Document, rng: np.random.Generator) -> None:
    """One listed solution is moved."""
    k = int(rng.integers(len(document["q"])))
    off = 10.0 ** rng.uniform(-7.0, 0.0) * np.sign(rng.normal(size=len(document["q"][0])))
    for key in ("q", "lower", "upper"):
        document[key][k] = (np.array(document[key][k]) + off).tolist()


def wide(document: Document, rng: np.random.Generator) -> None:
    """The box of one is so wide that nobody knows how many are in it."""
    k = int(rng.integers(len(document["q"])))
    document["lower"][k] = (np.array(document["lower"][k]) - 1.5).tolist()


def forgotten(document: Document, rng: np.random.Generator) -> None:
    """One solution is nowhere, and where it was alone is said to have none for some other reason."""
    n = len(document["joints"])
    found, steps = table(document, "found", 5 * n), table(document, "steps", 6)
    k = int(rng.integers(len(found)))
    known = (steps[:, 0] == 5) & (steps[:, 1] == k)
    count = len(table(document, "equations", 6))
    reason = int(rng.choice([2, 3, 4, 6]))
    steps[known, 0] = reason
    steps[known, 1] = rng.integers(count if reason != 4 else max(1, len(table(document, "sums", 14))))
    steps[known, 2] = -1 if reason == 4 else rng.integers(n)
    steps[(steps[:, 0] == 5) & (steps[:, 1] > k), 1] -= 1
    near = [j for j, q in enumerate(document["q"]) if turned_to(np.array(q), found[k, :n])]
    for key in ("q", "lower", "upper"):
        document[key] = [row for j, row in enumerate(document[key]) if j not in near]
    document["found"] = packed(np.delete(found, k, axis=0), "<f8")
    document["steps"] = packed(steps, "<f8")


def turned_to(q: FloatArray, other: FloatArray) -> bool:
    off = (q - other) / (2.0 * np.pi)
    return bool(np.abs(off - np.round(off)).max() < 1e-6)


def cut_away(document: Document, rng: np.random.Generator) -> None:
    """A cut takes away a solution, and the steps that follow in its box, too."""
    n = len(document["joints"])
    forgotten(document, rng)
    steps = table(document, "steps", 6)
    cuts = np.flatnonzero(steps[:, 0] <= 1)
    k = int(rng.choice(cuts))
    low, high = steps[k, 3:5]
    at = low + (high - low) * rng.uniform(0.0, 1.0)
    steps[k, 3:5] = (low, at) if rng.random() < 0.5 else (at, high)
    document["steps"] = packed(steps, "<f8")
    assert n


def ended_early(document: Document, rng: np.random.Generator) -> None:
    forgotten(document, rng)
    steps = table(document, "steps", 6)
    document["steps"] = packed(steps[: int(rng.integers(len(steps)))], "<f8")


def other_goal(document: Document, rng: np.random.Generator) -> None:
    document["goal"]["pose"]["position"][int(rng.integers(3))] += 10.0 ** rng.uniform(-6.0, -1.0)


def other_arm(document: Document, rng: np.random.Generator) -> None:
    body = document["robot"]["bodies"][document["robot"]["tool_body"]]
    body["placement"][int(rng.integers(3))][3] += 10.0 ** rng.uniform(-6.0, -1.0)


def narrower(document: Document, rng: np.random.Generator) -> None:
    """A limit, which leaves a listed solution outside."""
    robot = document["robot"]
    joint = int(rng.integers(len(document["joints"])))
    column = robot["joint_names"].index(document["joints"][joint])
    robot["limits"]["upper"][column] = document["q"][-1][joint] - 1e-6


FORGERIES: tuple[Forgery, ...] = (
    *(unlisted, doubled, elsewhere, wide, forgotten, cut_away, ended_early, other_goal, other_arm, narrower),
)


@pytest.mark.parametrize("forge", FORGERIES, ids=lambda forge: str(forge.__name__))
def test_a_forgery_is_refused(forge: Forgery) -> None:
    rng = np.random.default_rng(7)
    for name in ("planar2", "wxai"):
        honest = written(arm(name), drawn(arm(name), 3))
        assert honest["q"]
        for _ in range(6):
            document = deepcopy(honest)
            forge(document, rng)
            with pytest.raises(Invalid):
                list(judged(document))


def test_a_joint_that_was_not_searched_is_noticed() -> None:
    robot = load_robot("wxai")
    document = written(robot, drawn(robot, 0))
    document["robot"]["limits"]["upper"][0] += 0.5
    with pytest.raises(Invalid, match="were not searched"):
        list(judged(document))
