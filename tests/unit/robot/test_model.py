"""Robots: kinematics against Pinocchio and by law, shipped models against published numbers, bad requests by name."""

from __future__ import annotations

import math
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Cylinder, Pose, Sphere
from planner_service.robot.model import JointLimits, Robot, robot_names
from planner_service.robot.urdf_reader import read_urdf
from planner_service.robot_setup.loading import load_robot
from tests.support.small_robots import MIMIC, MIXED, built, joint, link, solid, urdf


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path = tmp_path_factory.mktemp("mixed") / "mixed.urdf"
    path.write_text(MIXED)
    return Robot.from_urdf(path, tool_frame="tip", locked_joints={"branch": 0.4})


def random_q(robot: Robot, count: int, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(robot.limits.lower, robot.limits.upper, (count, robot.n))


def matrices(robot: Robot, q: FloatArray) -> FloatArray:
    out = np.zeros((len(robot.bodies), 4, 4))
    for T, pose in zip(out, robot.body_poses(q), strict=True):
        T[:3, :3], T[:3, 3], T[3, 3] = np.reshape(pose[:9], (3, 3)), pose[9:], 1.0
    return out


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


def test_shapes_ride_with_their_links_at_the_files_origins(pair: tuple[Robot, Reference], tmp_path: Path) -> None:
    robot, reference = pair
    (tmp_path / "same.urdf").write_text(reference.text)
    origins = [
        (link.name, item.shape, Pose.from_rpy(item.xyz, item.rpy).matrix)
        for link in read_urdf(tmp_path / "same.urdf").links
        for item in link.collisions
    ]
    assert [(item.link, item.shape) for item in robot.shapes] == [(link, shape) for link, shape, _ in origins]
    for q in random_q(robot, 20):
        reference.place(q)
        bodies = matrices(robot, q)
        for item, (name, _, origin) in zip(robot.shapes, origins, strict=True):
            expected = reference.frame(name) @ origin
            assert np.abs(bodies[item.body] @ item.pose.matrix - expected).max() <= 1e-12


def test_a_batch_has_the_bits_of_single_poses(pair: tuple[Robot, Reference]) -> None:
    robot, _ = pair
    Q = random_q(robot, 30, seed=3)
    R, t = robot.body_poses_batch(Q)
    assert R.shape == (30, len(robot.bodies), 3, 3)
    assert t.shape == (30, len(robot.bodies), 3)
    for q, rotations, positions in zip(Q, R, t, strict=True):
        single = np.array(robot.body_poses(q))
        assert np.array_equal(single[:, :9].reshape(-1, 3, 3), rotations)
        assert np.array_equal(single[:, 9:], positions)


def test_an_empty_batch_is_no_special_case(wxai: Robot) -> None:
    R, t = wxai.body_poses_batch(np.empty((0, 6)))
    assert R.shape == (0, 7, 3, 3)
    assert t.shape == (0, 7, 3)


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


@pytest.mark.slow
def test_reach_is_a_bound_and_tight(wxai: Robot) -> None:
    """The arm stretched out comes within 3 % of the bound of every joint; nothing passes it."""
    farthest = np.zeros(6)
    stretched = np.array([0.0, math.pi, math.pi - 0.24, 0.24, 0.0, 0.0])  # beyond joint_2's range: reach is for any q
    rng = np.random.default_rng(5)
    poses = [stretched, *(stretched + rng.normal(scale=0.1, size=(100, 6))), *random_q(wxai, 100)]
    poses += [np.array([*stretched[:5], angle]) for angle in np.linspace(0, math.pi, 30)]
    directions = rng.normal(size=(200, 3))
    for q in poses:
        bodies = matrices(wxai, q)
        for item in wxai.shapes:
            T = bodies[item.body] @ item.pose.matrix
            points = item.shape.support(directions) @ T[:3, :3].T + T[:3, 3]
            for index in range(1, item.body + 1):
                axis = bodies[index, :3, :3] @ wxai.bodies[index].axis
                across = np.cross(points - bodies[index, :3, 3], axis)
                farthest[index - 1] = max(farthest[index - 1], np.sqrt((across**2).sum(axis=1)).max())
    reach = wxai.reach()
    assert np.all(farthest <= reach)
    assert np.all(farthest >= 0.97 * reach)


def test_reach_of_the_planar_arm_is_its_lengths() -> None:
    """Links of 1.0 and 0.5 m, radius 0.01 m: sqrt(0.5^2 + 0.01^2) from the elbow, 1 m more from the shoulder."""
    corner = math.hypot(0.5, 0.01)
    reach = load_robot("planar2").reach()
    assert reach == pytest.approx([1.0 + corner, corner], rel=1e-5)  # the rim is a polygon around the circle
    assert np.all(reach >= [1.0 + corner, corner])


def test_reach_counts_what_rides_along(wxai: Robot) -> None:
    ball = (6, Sphere(0.05), Pose((0.3, 0.0, 0.0)))
    # On joint_5's axis it is 0.05 m away; from joint_4's, 0.02895 m before it, 0.37895 m.
    assert wxai.reach([ball])[4] == pytest.approx(0.02895 + 0.35)
    assert wxai.reach([ball])[5] == wxai.reach()[5]
    assert np.all(wxai.reach([ball]) >= wxai.reach())


def test_a_sliding_joint_has_reach_one(mixed: Robot) -> None:
    assert mixed.reach()[mixed.joint_names.index("slide")] == 1.0


PUBLISHED = {"sleep": (0.253762, 0.0, 0.1635), "ready": (0.381554, 0.0, 0.288013), "upright": (0.517762, 0.0, 0.4275)}


@pytest.mark.parametrize("name", PUBLISHED)
def test_wxai_named_poses_put_the_tool_where_the_vendors_model_does(wxai: Robot, name: str) -> None:
    assert wxai.tool_pose(wxai.pose(name))[:3, 3] == pytest.approx(PUBLISHED[name], abs=1e-6)  # published to 1 um


def test_wxai_has_its_29_shapes_on_10_links(wxai: Robot) -> None:
    assert len(wxai.shapes) == 29
    counts = {link: [s.link for s in wxai.shapes].count(link) for link in dict.fromkeys(s.link for s in wxai.shapes)}
    assert counts == {
        "base_link": 3, "link_1": 3, "link_2": 3, "link_3": 3, "link_4": 3,
        "link_5": 3, "link_6": 2, "camera": 3, "finger_left": 3, "finger_right": 3,
    }  # fmt: skip


def test_wxai_judges_20_link_pairs_made_of_171_shape_pairs(wxai: Robot) -> None:
    """The published list: everything of base_link, link_1 and link_2 against what is two joints out or more."""
    outer = ("link_3", "link_4", "link_5", "link_6", "camera", "finger_left", "finger_right")
    expected = {(a, b) for a in ("base_link", "link_1", "link_2") for b in outer} - {("link_2", "link_3")}
    assert set(wxai.link_pairs) == expected
    count = {s.link: [t.link for t in wxai.shapes].count(s.link) for s in wxai.shapes}
    assert sum(count[a] * count[b] for a, b in wxai.link_pairs) == 171


def test_wxai_home_is_clear_of_limits_and_holds_the_tool_above_the_table(wxai: Robot) -> None:
    assert np.all(wxai.home[1:4] - wxai.limits.lower[1:4] > 0.3)
    assert np.all(wxai.limits.upper[1:4] - wxai.home[1:4] > 0.3)
    lowest = min(
        (T[:3, :3] @ s.shape.support(-T[2, :3]) + T[:3, 3])[2]
        for s in wxai.shapes
        if s.body > 4
        for T in [matrices(wxai, wxai.home)[s.body] @ s.pose.matrix]
    )
    assert lowest > 0.15


def test_wxai_limits_are_the_tighter_of_the_sources(wxai: Robot) -> None:
    limits = wxai.limits
    assert limits.upper == pytest.approx([3.0543262, math.pi, 2.3561945, math.pi / 2, math.pi / 2, math.pi])
    assert limits.lower == pytest.approx([-3.0543262, 0, 0, -math.pi / 2, -math.pi / 2, -math.pi])
    assert limits.velocity.tolist() == [3.375] * 3 + [7.0] * 3
    assert limits.acceleration.tolist() == [3.141596] * 6
    assert wxai.settle_time == 0.3
    assert wxai.inverse == "wxai"


def test_wxai_sleep_has_one_narrow_way_out(wxai: Robot) -> None:
    (retreat,) = wxai.retreats
    assert retreat.pose == "sleep"
    assert retreat.to.tolist() == [0.0, 0.08, 0.08, 0.0, 0.0, 0.0]
    assert retreat.pairs == (("link_2", "link_5"), ("link_2", "link_4"))
    assert set(retreat.pairs) <= set(wxai.link_pairs), "elsewhere they are judged"


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


def test_a_gripper_moved_twice_stands_as_if_moved_once(wxai: Robot) -> None:
    assert wxai.with_gripper(0.013).with_gripper(0.06).hash == wxai.with_gripper(0.06).hash
    assert wxai.with_gripper(0.08).hash == wxai.hash
    assert wxai.opened_like(wxai.with_gripper(0.02)).hash == wxai.with_gripper(0.02).hash


@pytest.mark.parametrize("width", [-0.001, 0.081, math.nan, "wide"])
def test_a_width_outside_the_range_is_refused(wxai: Robot, width: Any) -> None:
    with pytest.raises(InvalidRequest, match=r"width: got .* expected a gap between the finger pads in \[0, 0.08\] m"):
        wxai.with_gripper(width)


def test_a_robot_without_gripper_cannot_open_it() -> None:
    with pytest.raises(InvalidRequest, match="robot 'planar2' has no gripper"):
        load_robot("planar2").with_gripper(0.01)


def test_the_planar_arm_is_the_textbooks() -> None:
    robot = load_robot("planar2")
    for a, b in [(0.0, 0.0), (math.pi / 2, -math.pi / 2), (0.3, 1.1)]:
        tip = (math.cos(a) + 0.5 * math.cos(a + b), math.sin(a) + 0.5 * math.sin(a + b), 0.0)
        assert robot.tool_pose([a, b])[:3, 3] == pytest.approx(tip, abs=1e-12)
    assert robot.tool_pose(robot.pose("lesson_start"))[:2, 3] == pytest.approx((1.5, 0.0), abs=1e-12)
    assert robot.tool_pose(robot.pose("lesson_goal"))[:2, 3] == pytest.approx((0.5, 1.0), abs=1e-12)
    assert [s.shape for s in robot.shapes] == [Cylinder(0.01, 1.0), Cylinder(0.01, 0.5)]
    assert robot.link_pairs == ()


@pytest.mark.slow
def test_the_hash_is_the_same_in_another_process(wxai: Robot) -> None:
    code = "from planner_service import load_robot; print(load_robot('wxai').hash)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == wxai.hash


def test_the_hash_tells_robots_and_widths_apart(wxai: Robot) -> None:
    assert len({wxai.hash, wxai.with_gripper(0.01).hash, load_robot("planar2").hash}) == 3


def test_a_robot_survives_pickling(wxai: Robot) -> None:
    again = pickle.loads(pickle.dumps(wxai))
    assert again.hash == wxai.hash
    assert again.body_poses(wxai.home) == wxai.body_poses(wxai.home)


def test_a_robots_arrays_cannot_be_written(wxai: Robot) -> None:
    with pytest.raises(ValueError, match="read-only"):
        wxai.home[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        wxai.limits.upper[0] = 9.0


def test_unknown_names_are_refused_with_the_nearest(wxai: Robot) -> None:
    with pytest.raises(UnknownName, match="unknown robot 'wxia'; did you mean 'wxai'"):
        load_robot("wxia")
    with pytest.raises(UnknownName, match="unknown pose 'slep'; did you mean 'sleep'"):
        wxai.pose("slep")


@pytest.mark.slow
def test_the_shipped_robots_load() -> None:
    assert set(robot_names()) >= {"planar2", "wxai", "wxai_mesh"}
    for name in set(robot_names()) - {"wxai_mesh"}:  # which needs an extra: see test_example_robots
        assert load_robot(name).name == name


def test_a_path_loads_what_the_name_does(wxai: Robot) -> None:
    path = data_folder("robots") / "wxai" / "robot.toml"
    assert load_robot(path).hash == wxai.hash
    assert load_robot(str(path)).hash == wxai.hash


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


def test_the_tool_of_a_urdf_alone_is_the_end_of_its_longest_chain(tmp_path: Path) -> None:
    (tmp_path / "mixed.urdf").write_text(MIXED)
    assert Robot.from_urdf(tmp_path / "mixed.urdf", locked_joints={"branch": 0.0}).tool_frame == "tip"


def test_an_srdf_allows_contacts_with_its_reasons(tmp_path: Path) -> None:
    (tmp_path / "mixed.urdf").write_text(MIXED)
    (tmp_path / "mixed.srdf").write_text(
        '<robot name="mixed"><disable_collisions link1="stand" link2="c" reason="Never"/></robot>'
    )
    robot = Robot.from_urdf(tmp_path / "mixed.urdf", srdf=tmp_path / "mixed.srdf", locked_joints={"branch": 0.0})
    assert robot.allowed_contacts[-1].links == ("stand", "c")
    assert robot.allowed_contacts[-1].reason == "Never"
    assert ("stand", "c") not in robot.link_pairs


def test_an_srdf_about_another_robot_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mixed.urdf").write_text(MIXED)
    (tmp_path / "other.srdf").write_text('<robot name="x"><disable_collisions link1="stand" link2="gone"/></robot>')
    with pytest.raises(InvalidFile, match=r"disable_collisions\[0\]: 'gone' is not a link of the URDF"):
        Robot.from_urdf(tmp_path / "mixed.urdf", srdf=tmp_path / "other.srdf", locked_joints={"branch": 0.0})


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


def test_a_mimic_stands_if_it_is_locked_or_does_not_follow(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(MIXED)
    locked = Robot.from_urdf(tmp_path / "robot.urdf", locked_joints={"spare": 0.7})
    assert locked.locked_joints == (("spare", 0.7),)
    assert "spare" not in [body.name for body in locked.bodies]
    still = built(tmp_path, MIXED.replace('multiplier="-1"', 'multiplier="0"'))
    assert still.locked_joints == (("spare", 0.1),)
    (tmp_path / "robot.urdf").write_text(MIXED)
    with pytest.raises(InvalidFile, match="joint 'spare' mimics 'branch': it moves with it; leave it out of joints"):
        Robot.from_urdf(tmp_path / "robot.urdf", joints=["branch", "spare"])


def test_joints_are_in_order_from_the_base_to_the_tips(tmp_path: Path) -> None:
    head, joints, tail = MIXED.partition("<joint")[0], MIXED[MIXED.index("<joint") :], ""
    parts = joints.replace("</robot>", "").strip().split("\n")
    shuffled = head + "\n".join(reversed(parts)) + tail + "</robot>"
    assert built(tmp_path, MIXED).joint_names == ("z_turn", "oblique", "slide", "x_turn", "branch")
    assert built(tmp_path, shuffled).joint_names == ("z_turn", "branch", "oblique", "slide", "x_turn")


def test_locked_joints_are_named_with_their_values(tmp_path: Path) -> None:
    robot = built(tmp_path, MIXED).locked({"slide": 0.2})
    assert robot.locked_joints == (("slide", 0.2),)
    lines = str(robot).splitlines()
    assert [line.split() for line in lines[lines.index("locked joint      at") + 1 :]] == [["slide", "0.2000"]]
    assert robot.hash == replace(robot, locked_joints=()).hash


def test_unknown_locked_joints_and_tools_are_refused(tmp_path: Path) -> None:
    (tmp_path / "mixed.urdf").write_text(MIXED)
    with pytest.raises(UnknownName, match="unknown joint 'brunch'; did you mean 'branch'"):
        Robot.from_urdf(tmp_path / "mixed.urdf", locked_joints={"brunch": 0.0})
    with pytest.raises(InvalidRequest, match=r"locked_joints\['branch'\]: got 7; expected a position in \[-1, 1\]"):
        Robot.from_urdf(tmp_path / "mixed.urdf", locked_joints={"branch": 7})
    with pytest.raises(UnknownName, match="unknown tool frame 'tipp'; did you mean 'tip'"):
        Robot.from_urdf(tmp_path / "mixed.urdf", tool_frame="tipp", locked_joints={"branch": 0.0})


def test_limits_that_make_no_sense_are_refused() -> None:
    one = np.ones(1)
    with pytest.raises(InvalidRequest, match=r"velocity: got .* expected positive numbers"):
        JointLimits(-one, one, 0 * one, one, one)
    with pytest.raises(InvalidRequest, match=r"lower: got .* expected below upper"):
        JointLimits(2 * one, one, one, one, one)
    with pytest.raises(InvalidRequest, match=r"jerk: got .* expected finite numbers"):
        JointLimits(-one, one, one, one, one * math.inf)


def single(kind: str, effort: str = "1") -> str:
    """A bar on one joint with an oblique axis."""
    turn = joint("only", f"{kind} base bar -1 1.5", axis="1 2 -2", xyz="0.1 0 0.3", rpy="0.2 -0.4 0.5")
    return urdf(
        "single",
        link("base"),
        link("bar", solid("box", "0.4 0.1 0.1")),
        turn.replace('effort="1"', f'effort="{effort}"'),
    )


@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic"])
def test_a_robot_of_one_joint_moves_as_pinocchio_says(tmp_path: Path, kind: str) -> None:
    text = single(kind)
    (tmp_path / "single.urdf").write_text(text)
    robot = Robot.from_urdf(tmp_path / "single.urdf")
    reference = Reference(text, robot, {})
    assert robot.joint_names == ("only",)
    assert robot.bodies[1].prismatic == (kind == "prismatic")
    for q in random_q(robot, 5):
        reference.place(q)
        frame = reference.model.getFrameId("bar", reference.pin.FrameType.BODY)
        assert np.abs(robot.tool_pose(q) - reference.data.oMf[frame].homogeneous).max() < 1e-12


@pytest.mark.parametrize("effort", ["-3.14", "nan", "inf", "-inf"])
def test_an_effort_that_makes_no_sense_is_a_problem_of_the_file(tmp_path: Path, effort: str) -> None:
    (tmp_path / "single.urdf").write_text(single("revolute", effort))
    with pytest.raises(InvalidFile, match=r"joint 'only'.*effort"):
        Robot.from_urdf(tmp_path / "single.urdf")


def test_a_robot_without_collision_shapes_is_refused(tmp_path: Path) -> None:
    text = urdf("bare", link("base"), link("bar"), joint("only", "revolute base bar -1 1.5"))
    (tmp_path / "single.urdf").write_text(text)
    with pytest.raises(InvalidFile, match="no link of the URDF has a collision shape, so nothing could ever collide"):
        Robot.from_urdf(tmp_path / "single.urdf")


def test_a_joint_without_a_range_has_to_be_locked(tmp_path: Path) -> None:
    path = tmp_path / "mixed.urdf"
    path.write_text(MIXED.replace('lower="-0.1" upper="0.3"', 'lower="0.1" upper="0.1"'))
    with pytest.raises(InvalidFile, match=r"joint 'slide': lower and upper are both 0.1, it cannot move; lock it"):
        Robot.from_urdf(path, locked_joints={"branch": 0.4})
    assert "slide" not in Robot.from_urdf(path, locked_joints={"branch": 0.4, "slide": 0.1}).joint_names


def test_a_mesh_folder_with_an_impossible_name_is_refused() -> None:
    path = data_folder("robots") / "wxai" / "wxai.urdf"
    with pytest.raises(InvalidRequest, match="package_dirs: got"):
        Robot.from_urdf(path, package_dirs=["a\0b"])


def test_limits_that_are_no_real_numbers_are_refused() -> None:
    values: Any
    for values in [[10**400], ["1"], [True], None]:
        one = np.ones(1)
        with pytest.raises(InvalidRequest, match="velocity: got"):
            JointLimits(-one, one, values, one, one)


def test_axes_parallel_but_for_a_rounded_angle_have_the_reach_of_parallel_ones(tmp_path: Path) -> None:
    ball = solid("sphere", 'radius="0.05"', "0.5 0 0")
    reaches = []
    for tilt in ("0", "4e-6", "7e-4"):
        arm = urdf(
            "arm",
            *(link(name) for name in ("base", "one", "two")),
            link("tip", ball),
            joint("a", "revolute base one -2 2"),
            joint("b", "revolute one two -2 2", xyz="0.5 0.1 0", rpy=f"{tilt} 0 0"),
            joint("c", "revolute two tip -2 2", xyz="0.5 0 0", rpy="0 1.57 0"),
        )
        robot = built(tmp_path, arm)
        reaches.append(robot.reach().tolist())
    assert np.abs(np.array(reaches[1:]) - reaches[0]).max() < 0.01
