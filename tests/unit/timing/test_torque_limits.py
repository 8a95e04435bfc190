"""Torque limits: Pinocchio's torques, toppra's durations, and bounds that hold between samples."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.path.joint_path import JointPath
from planner_service.robot.inertia import LinkInertia
from planner_service.robot.model import Robot
from planner_service.robot.package_files import example_urdf
from planner_service.robot_setup.loading import load_robot
from planner_service.timing.laws import SCurve, Timing, TimingFailed, ToppRa, Trapezoidal, stop_duration
from planner_service.timing.torque_bound import InverseDynamics, torque_curvature
from planner_service.timing.torque_limits import BETWEEN, EXCESS, TorqueLimits
from tests.support.small_robots import joint, link, solid, urdf

INERTIA = '<inertia ixx="0.02" ixy="0.001" ixz="-0.002" iyy="0.03" iyz="0.003" izz="0.025"/>'


def mass(kilograms: float, xyz: str = "0 0 0", rpy: str = "0 0 0", inertia: str = INERTIA) -> str:
    return f'<inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass value="{kilograms}"/>{inertia}</inertial>'


SPREAD = urdf(
    "spread",
    link("world", solid("box", "0.1 0.1 0.1"), mass(5.0)) + link("cart", solid("box", "0.1 0.1 0.1"), mass(1.0)),
    link("boom", mass(2.0, "0.1 0.2 0.3", "0.3 0.2 0.1")) + link("cap", mass(0.5, "0.1 0 0")),
    link("side", mass(0.7, "0 0.1 0")) + link("rod", mass(0.4, "0 0 0.2", "1 2 3")),
    joint("slide", "prismatic world cart -1 1", axis="0 0.6 0.8", xyz="0 0 0.5", rpy="0 0 0.3"),
    joint("swing", "revolute cart boom -2 2", axis="0 0.6 0.8", xyz="0.2 0 0.3", rpy="0.1 0.2 0.3"),
    joint("weld", "fixed boom cap", xyz="0.1 0.2 0.3", rpy="0.4 0.5 0.6"),
    joint("turn", "revolute boom side -2 2", axis="-1 0 0", xyz="0 0.2 0.3"),
    joint("reach", "prismatic cap rod -1 1", axis="1 0 0", xyz="0.3 0 0"),
)
"""A tree of joints that slide, turn about oblique axes and branch, with a link welded on."""

PENDULUM = urdf(
    "pendulum",
    link("base", solid("box", "0.1 0.1 0.1")),
    link("bob", mass(2.0, "0.5 0 0", inertia='<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>')),
    joint("hinge", "revolute base bob -3 3", axis="0 -1 0").replace('effort="1"', 'effort="12"'),
)
"""2 kg on half a metre: 9.81 Nm when it is level, and 12 Nm to move it."""


SWING = next(line for line in SPREAD.splitlines() if 'name="swing"' in line)
FOLLOWS = '<mimic joint="turn" multiplier="-0.5" offset="0.2"/></joint>'
FOLLOWING = SPREAD.replace(SWING, SWING.replace("</joint>", FOLLOWS))
"""The same with a joint that follows another, half as far and the other way."""


@pytest.fixture
def pendulum(tmp_path: Path) -> Robot:
    return built(tmp_path, PENDULUM)


def built(folder: Path, text: str) -> Robot:
    file = folder / "robot.urdf"
    file.write_text(text, "utf-8")
    return Robot.from_urdf(file)


@cache
def ur5() -> Robot:
    return load_robot("example-robot-data:ur5_robot", tool_frame="ee_link")


def loaded(robot: Robot, kilograms: float) -> TorqueLimits:
    """The limits of a robot that carries a point 5 cm before its tool."""
    place = Pose.from_matrix(robot.tool_placement) @ Pose((0.0, 0.0, 0.05))
    return TorqueLimits(robot, (LinkInertia("load", robot.tool_body, kilograms, (0.0,) * 6, place),))


def motions(robot: Robot, count: int, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(robot.limits.lower, robot.limits.upper, (count, robot.n)), *rng.normal(size=(2, count, robot.n))


def theirs(file: Path, robot: Robot, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
    """Pinocchio's torques, by the model that it reads itself."""
    pin: Any = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf(str(file))
    data, order = model.createData(), [robot.joint_names.index(name) for name in model.names.tolist()[1:]]
    out = np.empty_like(q)
    for row, rates in enumerate(zip(q[:, order], qd[:, order], qdd[:, order], strict=True)):
        out[row, order] = pin.rnea(model, data, *rates)
    return out


def blended_path(robot: Robot, seed: int) -> JointPath:
    points = np.random.default_rng(seed).uniform(robot.limits.lower / 2.0, robot.limits.upper / 2.0, (4, robot.n))
    return JointPath(points).with_blends([0.0, 0.3, 0.2, 0.0])


def test_torques_are_those_of_pinocchio(tmp_path: Path) -> None:
    for file, robot in (
        (tmp_path / "robot.urdf", built(tmp_path, SPREAD)),
        (example_urdf("ur5_robot"), ur5()),
    ):
        states = motions(robot, 30, 1)
        limits = TorqueLimits(robot)
        assert np.abs(limits.torques(*states) - theirs(file, robot, *states)).max() < 1e-12


def test_a_pendulum_is_held_to_its_torque(pendulum: Robot) -> None:
    limits, path = TorqueLimits(pendulum), JointPath(np.array([[-1.0], [1.0]]))
    fast = replace(pendulum.limits, velocity=np.array([50.0]), acceleration=np.array([500.0]))
    motion = ToppRa(torque=True).time_path(path, fast, torque_limits=limits)
    t = np.linspace(0.0, motion.duration, 5000)
    torque = 2.0 * 0.25 * motion(t, 2)[:, 0] + 2.0 * 9.81 * 0.5 * np.cos(motion(t)[:, 0])
    assert 1.0 - 1e-3 < np.abs(torque).max() / 12.0 <= 1.0 + EXCESS
    (peak,) = limits.samples(motion).peaks()
    assert abs(peak.ratio - np.abs(torque).max() / 12.0) <= BETWEEN


@pytest.mark.parametrize("backend", ["own", "toppra"])
def test_durations_are_those_of_toppras_own_torque_constraint(backend: Any) -> None:
    toppra: Any = pytest.importorskip("toppra")
    constraint: Any = pytest.importorskip("toppra.constraint")
    algorithm: Any = pytest.importorskip("toppra.algorithm")
    robot, limits = ur5(), loaded(ur5(), 10.0)
    strong = replace(robot.limits, acceleration=4.0 * robot.limits.acceleration)
    ends = np.array([[0.3, -1.2, 1.5, -0.5, 0.2, 0.1], [1.5, -0.3, 0.2, 0.5, 1.0, 1.0]])

    def torque(q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        return np.asarray(limits.torques(q[None], qd[None], qdd[None])[0])

    both = [np.stack([-row, row], axis=1) for row in (strong.velocity, strong.acceleration, limits.limit)]
    kept = [constraint.JointVelocityConstraint(both[0]), constraint.JointAccelerationConstraint(both[1])]
    kept.append(constraint.JointTorqueConstraint(torque, both[2], np.zeros(robot.n)))
    for each in kept[1:]:
        each.set_discretization_type(constraint.DiscretizationType.Interpolation)
    solver = algorithm.TOPPRA(kept, toppra.SplineInterpolator([0.0, 1.0], ends), gridpoints=np.linspace(0.0, 1.0, 400))
    _, speeds, _ = solver.compute_parameterization(0.0, 0.0)
    expected = float((2.0 / 399.0 / (speeds[1:] + speeds[:-1])).sum())
    motion = ToppRa(400, backend, torque=True).time_path(JointPath(ends), strong, torque_limits=limits)
    free = ToppRa().time_path(JointPath(ends), strong)
    assert motion.duration > 1.02 * free.duration  # the torques count
    assert motion.duration == pytest.approx(expected, rel=5e-4)


@pytest.mark.parametrize("seed", range(6))
def test_torques_bend_no_more_than_their_bound_says(seed: int, tmp_path: Path) -> None:
    robot = (ur5(), built(tmp_path, SPREAD), built(tmp_path, FOLLOWING))[seed % 3]
    assert robot.dynamics is not None
    dynamics, rng, span = InverseDynamics(robot, robot.dynamics.links), np.random.default_rng(seed), 0.3
    start, v, a, j = rng.normal(size=(4, 1, robot.n)) * rng.choice([0.0, 0.3, 3.0], (4, 1, robot.n))
    t = np.linspace(0.0, span, 3001)[:, None]
    q, qd, qdd = start + t * (v + t * (a / 2.0 + t * j / 6.0)), v + t * (a + t * j / 2.0), a + t * j
    torques = TorqueLimits(robot).torques(q, qd, qdd)
    bending = np.abs(torques[:-20] - 2.0 * torques[10:-10] + torques[20:]).max(axis=0) / (10.0 * span / 3000.0) ** 2
    rates = [np.abs(each).max(axis=0)[None] for each in (qd, qdd, j + 0.0 * t, 0.0 * q)]
    (bound,) = torque_curvature(dynamics, np.abs(q).max(axis=0), rates)
    assert np.all(bending <= bound * (1.0 + 1e-6) + 1e-5)
    assert bending.max() >= 1e-4 * bound.max()  # a bound of use


@pytest.mark.parametrize("seed", range(6))
def test_no_torque_between_samples_is_higher_than_the_bound_says(seed: int) -> None:
    robot = ur5() if seed % 2 else load_robot("panda")
    limits, path = loaded(robot, 8.0), blended_path(robot, seed)
    law: Timing = (ToppRa(), Trapezoidal(), SCurve())[seed % 3]
    motion = law.time_path(path, robot.limits)
    t = np.linspace(0.0, motion.duration, 20_000)
    shares = np.abs(limits.torques(motion(t), motion(t, 1), motion(t, 2))) / limits.limit
    for k, peak in enumerate(limits.samples(motion).peaks()):
        assert shares[:, k].max() <= peak.ratio + BETWEEN
        assert peak.ratio <= shares[:, k].max() * (1.0 + 1e-2)  # and it is a torque of the motion


@pytest.mark.parametrize("seed", range(6))
def test_motions_keep_their_torques_and_use_them(seed: int) -> None:
    robot = ur5()
    limits, path = loaded(robot, 14.0), blended_path(robot, seed)
    if limits.objection_on(path):
        with pytest.raises(TimingFailed, match="cannot hold 14 kg at s = "):
            ToppRa(torque=True).time_path(path, robot.limits, torque_limits=limits)
        return
    motion = ToppRa(torque=True).time_path(path, robot.limits, torque_limits=limits)
    t = np.linspace(0.0, motion.duration, 20_000)
    shares = np.abs(limits.torques(motion(t), motion(t, 1), motion(t, 2))) / limits.limit
    assert shares.max() <= 1.0 + EXCESS
    assert motion.dilation <= 1.0 + EXCESS
    assert stop_duration(path, ToppRa(torque=True), robot.limits, limits) > motion.duration


def test_what_cannot_be_held_is_told_in_newton_metres(pendulum: Robot) -> None:
    weak = TorqueLimits(pendulum, scale=0.5)
    assert weak.objection(np.array([0.0])) == "hinge cannot hold the arm here: 9.81 of 6 Nm"
    assert weak.objection(np.array([math.pi / 2.0])) == ""
    carrying = TorqueLimits(pendulum, (LinkInertia("load", 1, 3.0, (0.0,) * 6, Pose((0.5, 0.0, 0.0))),))
    assert "hinge cannot hold 3 kg here: " in carrying.objection(np.array([0.0]))
    path = JointPath(np.array([[-math.pi / 2.0], [math.pi / 2.0]]))
    with pytest.raises(TimingFailed, match=r"hinge cannot hold the arm at s = 0.6\d*: 6\.\d* of 6 Nm"):
        ToppRa(torque=True).time_path(path, pendulum.limits, torque_limits=weak)


def test_robots_without_masses_or_efforts_are_refused_by_name(tmp_path: Path) -> None:
    weak = built(tmp_path, PENDULUM.replace('effort="12"', 'effort="0"'))
    with pytest.raises(InvalidRequest, match="robot pendulum: hinge has no effort"):
        TorqueLimits(weak)
    light = built(tmp_path, SPREAD.replace(mass(0.7, "0 0.1 0"), ""))
    with pytest.raises(InvalidRequest, match="robot spread: side has no mass"):
        TorqueLimits(light)
    with pytest.raises(InvalidRequest, match="has no mass"):
        TorqueLimits(load_robot("planar2"))


def test_a_law_and_its_torque_limits_go_together(pendulum: Robot) -> None:
    path, limits = JointPath(np.array([[0.0], [1.0]])), TorqueLimits(pendulum)
    with pytest.raises(InvalidRequest, match="torque_limits: got None"):
        ToppRa(torque=True).time_path(path, pendulum.limits)
    with pytest.raises(InvalidRequest, match=r"timing: got .*no other law keeps torque limits"):
        ToppRa().time_path(path, pendulum.limits, torque_limits=limits)
    with pytest.raises(InvalidRequest, match="scale: got 2"):
        TorqueLimits(pendulum, scale=2.0)
