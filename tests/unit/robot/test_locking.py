"""Locked joints: the same robot with fewer joints, wherever these stand, and nothing exempt that was not before."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from planner_service import CollisionChecker, PlannerService, PlanRequest, load_scene
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.inverse import inverse_kinematics
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
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
    R, t = robot.body_poses_batch(q[np.newaxis])
    bodies = np.tile(np.eye(4), (len(robot.bodies), 1, 1))
    bodies[:, :3, :3], bodies[:, :3, 3] = R[0], t[0]
    return np.array([bodies[item.body] @ item.pose.matrix for item in robot.shapes])


LOCKS: list[dict[str, float]] = [
    {"z_turn": 0.7},
    {"oblique": 1.1},
    {"slide": 0.2},
    {"x_turn": -1.3},
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


def test_what_is_told_by_joint_loses_the_locked_ones(wxai: Robot) -> None:
    locked = wxai.locked({"joint_4": 0.2, "joint_1": 1.0})
    assert locked.joint_names == ("joint_0", "joint_2", "joint_3", "joint_5")
    assert [body.name for body in locked.bodies] == ["base", *locked.joint_names]
    assert locked.limits.upper.tolist() == wxai.limits.upper[[0, 2, 3, 5]].tolist()
    assert locked.limits.jerk.tolist() == wxai.limits.jerk[[0, 2, 3, 5]].tolist()
    assert locked.pose("ready").tolist() == wxai.pose("ready")[[0, 2, 3, 5]].tolist()
    assert locked.base_links == ("base_link",)
    assert wxai.locked({"joint_0": 0.5}).base_links == ("base_link", "link_1")


def test_locking_nothing_changes_nothing_and_another_position_is_another_robot(wxai: Robot) -> None:
    assert wxai.locked({}) is wxai
    hashes = {robot.hash for robot in (wxai, wxai.locked({"joint_5": 0.0}), wxai.locked({"joint_5": 0.1}))}
    assert len(hashes) == 3
    assert wxai.locked({"joint_5": 0.1}).hash == wxai.locked({"joint_5": np.float64(0.1)}).hash


def test_locking_twice_is_locking_once(wxai: Robot) -> None:
    twice, once = wxai.locked({"joint_5": 0.3}).locked({"joint_0": 1.0}), wxai.locked({"joint_0": 1.0, "joint_5": 0.3})
    assert twice.hash == once.hash


@pytest.mark.slow
def test_links_that_still_move_are_judged_against_those_that_do_not(wxai: Robot) -> None:
    """The contacts of the whole robot but those between things that stand still."""
    scene = load_scene("bin")
    positions = {"joint_0": -0.4, "joint_1": 1.3, "joint_4": 0.9}
    locked = wxai.locked(positions)
    checker, full_checker = CollisionChecker(locked, scene), CollisionChecker(wxai, scene)
    still = {*locked.base_links, *scene.names}
    found = set()
    rng = np.random.default_rng(4)
    for q in rng.uniform(locked.limits.lower, locked.limits.upper, (200, locked.n)):
        touching = {frozenset((c.a, c.b)) for c in full_checker.contacts(whole(wxai, locked, positions, q))}
        expected = {pair for pair in touching if not pair <= still}
        assert {frozenset((c.a, c.b)) for c in checker.contacts(q)} == expected
        found |= expected
    assert frozenset(("link_2", "link_5")) in found
    assert any(pair & set(scene.names) for pair in found)


def test_a_gripper_opens_the_same_before_and_after_locking(wxai: Robot) -> None:
    positions = {"joint_4": 0.7, "joint_5": 1.1}
    before, after = wxai.with_gripper(0.02).locked(positions), wxai.locked(positions).with_gripper(0.02)
    assert before.gripper_width == after.gripper_width == 0.02
    q = before.home
    assert np.abs(shape_poses(before, q) - shape_poses(after, q)).max() <= SAME


@pytest.mark.parametrize(
    ("positions", "pairs"),
    [
        ({"joint_0": 0.3}, (("link_2", "link_5"), ("link_2", "link_4"))),
        ({"joint_5": 2.0}, (("link_2", "link_5"), ("link_2", "link_4"))),
        ({"joint_3": 0.0}, (("link_2", "link_5"), ("link_2", "link_4"))),
        ({"joint_1": 0.0}, (("link_2", "link_5"), ("link_2", "link_4"))),
        ({"joint_3": 0.05}, None),  # the vendor's meshes touch there
        ({"joint_2": 0.0}, None),  # the way out leads along it
    ],
)
def test_a_retreat_remains_only_where_its_pairs_move_as_they_did(
    wxai: Robot, positions: dict[str, float], pairs: tuple[tuple[str, str], ...] | None
) -> None:
    locked = wxai.locked(positions)
    if pairs is None:
        assert locked.retreats == ()
        return
    (retreat,) = locked.retreats
    assert retreat.pairs == pairs
    assert retreat.to.shape == (5,)
    assert locked.pose("sleep").shape == (5,)


def test_a_retreat_of_links_that_no_longer_move_is_gone(wxai: Robot) -> None:
    assert wxai.locked({"joint_2": 0.0, "joint_3": 0.0, "joint_4": 0.0}).retreats == ()


def test_the_closed_form_is_left_when_the_way_to_the_tool_is_another(wxai: Robot) -> None:
    locked = wxai.locked({"joint_0": 0.4})
    assert wxai.inverse == "wxai"
    assert locked.inverse == "numeric"
    q = np.array([1.2, 0.9, 0.3, 0.2, 0.5])
    pose = Pose.from_matrix(locked.tool_pose(q))
    found = inverse_kinematics(locked, pose, seeds=[q + 0.05])
    assert np.abs(found - q).max(axis=1).min() < 1e-6


def test_the_inverse_stays_when_the_way_to_the_tool_is_the_same(mixed: Robot) -> None:
    assert mixed.locked({"branch": 0.2}).inverse == "numeric"
    dual = load_robot("wxai_dual")
    assert dual.locked(dict.fromkeys(dual.joint_names[6:], 0.5)).inverse == "wxai"


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
