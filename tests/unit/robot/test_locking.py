"""Locked joints: the same robot with fewer joints, wherever these stand, and nothing exempt that was not before."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from planner_service import PlannerService, PlanRequest
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.inverse import inverse_kinematics
from planner_service.robot.kinematic_tree import body_matrix
from planner_service.robot.model import Robot
from tests.support.optional import present
from tests.support.small_robots import MIMIC, MIXED

ROOT = Path(__file__).parents[3]
SAME = 1e-12
"""Metres: the same product of a few rotations, bracketed otherwise."""


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Oblique axes, turned origins, a sliding joint, a branch."""
    path = tmp_path_factory.mktemp("locking") / "mixed.urdf"
    path.write_text(MIXED.replace(MIMIC, ""))
    return Robot.from_urdf(path, tool_frame="tip")


def whole(robot: Robot, locked: Robot, positions: dict[str, float], q: FloatArray) -> FloatArray:
    """The robot's q for one of the locked robot."""
    values = dict(zip(locked.joint_names, q.tolist(), strict=True)) | positions
    return np.array([values[name] for name in robot.joint_names])


def shape_poses(robot: Robot, q: FloatArray) -> FloatArray:
    bodies = [body_matrix(pose) for pose in robot.body_poses(q)]
    return np.array([bodies[item.body] @ item.pose.matrix for item in robot.shapes])


LOCKS: list[dict[str, float]] = [
    {"z_turn": 0.7},
    {"branch": 0.4, "spare": -0.3},
    {"oblique": 0.6, "slide": -0.05, "branch": -0.9},
    {"z_turn": -2.0, "oblique": 2.2, "slide": 0.1, "x_turn": 1.0},
]


@pytest.mark.parametrize("positions", LOCKS, ids=[" ".join(lock) for lock in LOCKS])
def test_everything_is_where_the_whole_robot_has_it(mixed: Robot, positions: dict[str, float]) -> None:
    locked = mixed.locked(positions)
    assert [(s.link, s.shape) for s in locked.shapes] == [(s.link, s.shape) for s in mixed.shapes]
    columns = [mixed.joint_names.index(name) for name in locked.joint_names]
    rng = np.random.default_rng(3)
    for q in rng.uniform(locked.limits.lower, locked.limits.upper, (50, locked.n)):
        full = whole(mixed, locked, positions, q)
        assert np.abs(shape_poses(locked, q) - shape_poses(mixed, full)).max() <= SAME
        assert np.abs(locked.tool_pose(q) - mixed.tool_pose(full)).max() <= SAME
        assert np.abs(locked.tool_jacobian(q) - mixed.tool_jacobian(full)[:, columns]).max() <= SAME


def test_a_retreat_remains_only_where_its_pairs_move_as_they_did(wxai: Robot) -> None:
    (retreat,) = wxai.locked({"joint_1": 0.0}).retreats
    assert retreat.pairs == (("link_2", "link_5"), ("link_2", "link_4"))
    assert retreat.to.shape == (5,)
    assert wxai.locked({"joint_3": 0.05}).retreats == ()  # the vendor's meshes touch there
    assert wxai.locked({"joint_2": 0.0}).retreats == ()  # the way out leads along it


def test_the_closed_form_is_left_when_the_way_to_the_tool_is_another(wxai: Robot) -> None:
    locked = wxai.locked({"joint_0": 0.4})
    assert wxai.inverse == "wxai"
    assert locked.inverse == "numeric"
    q = np.array([1.2, 0.9, 0.3, 0.2, 0.5])
    pose = Pose.from_matrix(locked.tool_pose(q))
    found = inverse_kinematics(locked, pose, seeds=[q + 0.05])
    assert np.abs(found - q).max(axis=1).min() < 1e-6


def test_a_tool_that_no_joint_moves_has_no_pose_to_reach(mixed: Robot) -> None:
    locked = mixed.locked({"z_turn": 0.0, "oblique": 1.5, "slide": 0.0, "x_turn": 0.0})
    with pytest.raises(InvalidRequest, match="tool_frame: got 'tip'; expected a tool that a joint moves"):
        inverse_kinematics(locked, Pose())


@pytest.mark.parametrize("value", [math.nan, 3.2, "0.1", True, None])
def test_a_position_outside_the_limits_is_refused(wxai: Robot, value: Any) -> None:
    with pytest.raises(InvalidRequest, match=r"joints\['joint_1'\]: got .* expected a position in \[0, 3.14159\]"):
        wxai.locked({"joint_1": value})


def test_what_cannot_be_locked_is_refused(wxai: Robot) -> None:
    with pytest.raises(UnknownName, match="unknown joint 'joint_6'; did you mean 'joint_"):
        wxai.locked({"joint_6": 0.0})
    with pytest.raises(InvalidRequest, match=r"joints: got .* expected positions by joint name"):
        wxai.locked(["joint_1"])  # type: ignore[arg-type]
    with pytest.raises(
        InvalidRequest, match=r"joints: got .* expected at least one of the 6 joints to remain unlocked"
    ):
        wxai.locked(dict.fromkeys(wxai.joint_names, 0.0))


def test_a_plan_with_a_locked_wrist_is_certified_and_free_for_the_whole_robot(wxai: Robot) -> None:
    positions = {"joint_5": 0.8}
    service = PlannerService(wxai.locked(positions), "post")
    request = PlanRequest([0.9, 1.4, 0.9, 0.1, 0.0], [-0.9, 1.4, 0.9, 0.1, 0.0], seed=2, time_limit=None)
    result = service.plan(request)
    assert result.ok, result.failure
    assert len(result.stages) > 4, "a search, not a straight line"
    assert present(result.certificate).certified
    path = result.unwrap()[0]
    second = IndependentChecker(ROOT / "robots" / "wxai", ROOT / "scenes" / "post.toml")
    assert second.curve_touch(lambda s: np.c_[path(s), np.full(len(s), 0.8)], path.length) is None
