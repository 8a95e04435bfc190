"""Robots: kinematics against Pinocchio and by law, shipped models against published numbers, bad requests by name."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box
from planner_service.robot.kinematic_tree import body_matrix
from planner_service.robot.model import JointLimits, Robot
from planner_service.robot_setup.loading import load_robot
from tests.support.small_robots import MIMIC, MIXED, built, joint, link, urdf


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path = tmp_path_factory.mktemp("mixed") / "mixed.urdf"
    path.write_text(MIXED)
    return Robot.from_urdf(path, tool_frame="tip", locked_joints={"branch": 0.4})


def random_q(robot: Robot, count: int, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(robot.limits.lower, robot.limits.upper, (count, robot.n))


def matrices(robot: Robot, q: FloatArray) -> FloatArray:
    return np.array([body_matrix(pose) for pose in robot.body_poses(q)])


class Reference:
    """Pinocchio on the file itself, with no code of ours between; fingers and locked joints at given positions."""

    def __init__(self, text: str, robot: Robot, others: dict[str, float]) -> None:
        import pinocchio as pin

        self.pin: Any = pin
        self.text = text
        self.model: Any = pin.buildModelFromXML(text)
        self.data: Any = self.model.createData()
        self.robot, self.others = robot, others

    def place(self, q: FloatArray) -> FloatArray:
        full = self.pin.neutral(self.model)
        for name, value in [*zip(self.robot.joint_names, q, strict=True), *self.others.items()]:
            joint = self.model.joints[self.model.getJointId(name)]
            full[joint.idx_q : joint.idx_q + joint.nq] = (
                [value] if joint.nq == 1 else [math.cos(value), math.sin(value)]
            )
        self.pin.framesForwardKinematics(self.model, self.data, full)
        return np.asarray(full)

    def frame(self, name: str) -> FloatArray:
        return np.asarray(self.data.oMf[self.model.getFrameId(name)].homogeneous)

    def jacobian(self, q: FloatArray, frame: str) -> FloatArray:
        J = self.pin.computeFrameJacobian(
            self.model, self.data, self.place(q), self.model.getFrameId(frame), self.pin.LOCAL_WORLD_ALIGNED
        )
        columns = [self.model.joints[self.model.getJointId(name)].idx_v for name in self.robot.joint_names]
        return np.asarray(J[:, columns])


@pytest.fixture(scope="module", params=["wxai", "mixed", "planar2"])
def pair(request: pytest.FixtureRequest, mixed: Robot) -> tuple[Robot, Reference]:
    if request.param == "mixed":
        return mixed, Reference(MIXED, mixed, {"branch": 0.4, "spare": -0.3})
    robot = load_robot(request.param)
    text = (data_folder("robots") / request.param / f"{request.param}.urdf").read_text()
    return robot, Reference(
        text.partition("?>")[2], robot, dict.fromkeys(robot.gripper.joints, 0.04) if robot.gripper else {}
    )


def test_body_and_tool_poses_are_pinocchios(pair: tuple[Robot, Reference]) -> None:
    robot, reference = pair
    for q in random_q(robot, 200):
        reference.place(q)
        bodies = matrices(robot, q)
        for T, body in zip(bodies[1:], robot.bodies[1:], strict=True):
            assert np.abs(T - reference.frame(body.name)).max() <= 1e-12
        assert np.abs(robot.tool_pose(q) - reference.frame(robot.tool_frame)).max() <= 1e-12


def test_the_jacobian_is_pinocchios(pair: tuple[Robot, Reference]) -> None:
    robot, reference = pair
    for q in random_q(robot, 50):
        assert np.abs(robot.tool_jacobian(q) - reference.jacobian(q, robot.tool_frame)).max() <= 1e-12


def test_a_configuration_of_the_wrong_length_is_refused(wxai: Robot) -> None:
    with pytest.raises(InvalidRequest, match=r"q: got .* expected 6 finite numbers"):
        wxai.body_poses([0.0] * 5)
    with pytest.raises(InvalidRequest, match=r"Q: got \(3, 5\); expected configurations of shape \(m, 6\)"):
        wxai.body_poses_batch(np.zeros((3, 5)))


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), joint=st.integers(0, 3))
def test_no_point_moves_farther_than_reach_says(mixed: Robot, seed: int, joint: int) -> None:
    """Turning one joint by a small angle moves no point of any shape by more than reach times the angle."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(mixed.limits.lower, mixed.limits.upper)
    step = np.zeros(mixed.n)
    step[joint] = 1e-4
    before, after = matrices(mixed, q), matrices(mixed, q + step)
    for item in mixed.shapes:
        points = item.shape.support(rng.normal(size=(50, 3))) @ item.pose.rotation.T + item.pose.position
        moved = points @ (after - before)[item.body, :3, :3].T + (after - before)[item.body, :3, 3]
        assert np.sqrt((moved**2).sum(axis=1)).max() <= mixed.reach()[joint] * 1e-4 * (1 + 1e-6)


def test_wxai_limits_are_the_tighter_of_the_sources(wxai: Robot) -> None:
    limits = wxai.limits
    assert limits.upper == pytest.approx([3.0543262, math.pi, 2.3561945, math.pi / 2, math.pi / 2, math.pi])
    assert limits.lower == pytest.approx([-3.0543262, 0, 0, -math.pi / 2, -math.pi / 2, -math.pi])
    assert limits.velocity.tolist() == [3.375] * 3 + [7.0] * 3
    assert limits.acceleration.tolist() == [3.141596] * 6
    assert wxai.settle_time == 0.3
    assert wxai.inverse == "wxai"


def inner_faces(robot: Robot) -> tuple[float, float]:
    """y of the pads' inner faces in the tool's body: the last box of each finger is its tip."""
    tips = {s.link: s for s in robot.shapes if s.link.startswith("finger")}
    left, right = tips["finger_left"], tips["finger_right"]
    assert isinstance(left.shape, Box)
    half = left.shape.half[1]
    return left.pose.position[1] - half, right.pose.position[1] + half


def test_opening_the_gripper_moves_each_pad_by_half_the_width(wxai: Robot) -> None:
    closed, opened = inner_faces(wxai.with_gripper(0.0)), inner_faces(wxai.with_gripper(0.06))
    assert opened[0] - closed[0] == pytest.approx(0.03, abs=1e-12)
    assert opened[1] - closed[1] == pytest.approx(-0.03, abs=1e-12)
    assert opened[0] - opened[1] == pytest.approx(0.06, abs=2.1e-4)  # the covering boxes stand 0.1 mm proud each
    assert inner_faces(wxai) == inner_faces(wxai.with_gripper(0.08)), "open when loaded"


def test_a_gripper_of_one_width_is_one_robot_from_wherever_it_is_opened(wxai: Robot) -> None:
    wide = wxai.with_gripper(0.06)
    assert wxai.with_gripper(0.02).with_gripper(0.06) is wide
    assert wide.unopened is wxai.unopened
    assert wide.hash != wxai.hash


@pytest.mark.parametrize("width", [-0.001, 0.081, math.nan, "wide"])
def test_a_width_outside_the_range_is_refused(wxai: Robot, width: Any) -> None:
    with pytest.raises(InvalidRequest, match=r"width: got .* expected a gap between the finger pads in \[0, 0.08\] m"):
        wxai.with_gripper(width)


def test_unknown_names_are_refused_with_the_nearest(wxai: Robot) -> None:
    with pytest.raises(UnknownName, match="unknown robot 'wxia'; did you mean 'wxai'"):
        load_robot("wxia")
    with pytest.raises(UnknownName, match="unknown pose 'slep'; did you mean 'sleep'"):
        wxai.pose("slep")


def test_a_urdf_alone_gets_conventions_for_what_it_does_not_say(mixed: Robot) -> None:
    assert mixed.joint_names == ("z_turn", "oblique", "slide", "x_turn")
    assert mixed.home.tolist() == [0.0, 1.5, 0.0, 0.0], "zero where the limits allow it, else their middle"
    assert mixed.limits.lower.tolist() == [-2 * math.pi, 0.5, -0.1, -2.0]
    assert mixed.limits.acceleration.tolist() == [3.141596, 3.141596, 0.5, 3.141596]
    assert mixed.base_links == ("world", "stand")
    assert mixed.gripper is None
    assert [(contact.links, contact.reason) for contact in mixed.allowed_contacts] == [
        (("stand", "a"), "adjacent"),
        (("a", "b"), "adjacent"),
        (("b_cap", "c"), "adjacent"),
    ]
    assert ("b", "side") in mixed.link_pairs, "on neighbouring bodies, yet no neighbours"
    assert ("b", "b_cap") not in mixed.link_pairs, "fixed to each other"


def test_a_mimic_of_a_moving_joint_moves_with_it(tmp_path: Path) -> None:
    robot = built(tmp_path, MIXED)
    free = built(tmp_path, MIXED.replace(MIMIC, ""))
    assert (robot.n, free.n) == (5, 6)
    spare = next(body for body in robot.bodies if body.name == "spare")
    assert (robot.joint_names[spare.q_index], spare.multiplier) == ("branch", -1.0)
    q = {"z_turn": 0.1, "oblique": 1.0, "slide": 0.1, "x_turn": 0.5, "branch": 0.4, "spare": -0.3}
    poses = [arm.body_poses([q[name] for name in arm.joint_names]) for arm in (robot, free)]
    assert np.array(poses[0]) == pytest.approx(np.array(poses[1]), abs=1e-14)
    assert "spare  -1 x branch" in str(robot)


def test_limits_of_a_joint_are_as_tight_as_its_mimics_need(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    robot = built(tmp_path, MIXED)
    branch = robot.joint_names.index("branch")
    assert (robot.limits.lower[branch], robot.limits.upper[branch]) == pytest.approx((-0.9, 1.0))
    fast = built(tmp_path, MIXED.replace('multiplier="-1"', 'multiplier="-4"')).limits
    assert (fast.lower[branch], fast.upper[branch]) == pytest.approx((-0.225, 0.275))
    assert fast.velocity[branch] == 0.25
    assert fast.acceleration[branch] == robot.limits.acceleration[branch] / 4.0
    assert not caplog.records
    loose = built(tmp_path, MIXED.replace('offset="0.1"', 'offset="3"')).limits
    assert (loose.lower[branch], loose.upper[branch]) == (-1.0, 1.0)
    assert "joint spare mimics branch; its limits -1 .. 1 leave branch no room: they are not used" in caplog.text


def test_limits_that_make_no_sense_are_refused() -> None:
    one = np.ones(1)
    with pytest.raises(InvalidRequest, match=r"velocity: got .* expected positive numbers"):
        JointLimits(-one, one, 0 * one, one, one)
    with pytest.raises(InvalidRequest, match=r"lower: got .* expected below upper"):
        JointLimits(2 * one, one, one, one, one)
    with pytest.raises(InvalidRequest, match=r"jerk: got .* expected finite numbers"):
        JointLimits(-one, one, one, one, one * math.inf)


def test_a_robot_without_collision_shapes_is_refused(tmp_path: Path) -> None:
    text = urdf("bare", link("base"), link("bar"), joint("only", "revolute base bar -1 1.5"))
    (tmp_path / "single.urdf").write_text(text)
    with pytest.raises(InvalidFile, match="no link of the URDF has a collision shape, so nothing could ever collide"):
        Robot.from_urdf(tmp_path / "single.urdf")


def test_a_joint_without_a_range_is_fixed_where_it_is(tmp_path: Path) -> None:
    path = tmp_path / "mixed.urdf"
    path.write_text(MIXED.replace('lower="-0.1" upper="0.3"', 'lower="0.1" upper="0.1"'))
    robot = Robot.from_urdf(path, locked_joints={"branch": 0.4})
    assert "slide" not in robot.joint_names
    assert dict(robot.locked_joints)["slide"] == 0.1
    with pytest.raises(InvalidFile, match=r"joint 'slide': lower and upper are both 0.1, it cannot move; leave it out"):
        Robot.from_urdf(path, joints=["slide", "branch"])


@pytest.mark.parametrize("name", ["wxai", "panda", "ur5_vacuum", "wxai_dual"])
def test_the_tools_origin_along_many_configurations_is_that_of_each(name: str) -> None:
    robot = load_robot(name)
    Q = np.random.default_rng(0).uniform(robot.limits.lower, robot.limits.upper, (20, robot.n))
    assert robot.tool_origins(Q).tolist() == [robot.tool_pose(q)[:3, 3].tolist() for q in Q]
    assert robot.tool_origins(np.zeros((0, robot.n))).shape == (0, 3)
