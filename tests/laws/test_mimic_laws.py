"""Joints that mimic others: where they stand, and what kernel and proof say, against checkers that share no code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from auditor.checker import IndependentChecker, tables_of
from benchmarks.studies.differential import STEP, compare, kernels, questions
from planner_service.certify import certify
from planner_service.certify.certifier import Certifier
from planner_service.collision import CollisionChecker, JointStep
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Pose
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle, Scene
from planner_service.timing.laws import tool_speeds
from tests.laws.test_proof_laws import agreed
from tests.support.random_robots import random_robot
from tests.support.small_robots import built, joint, link, solid, urdf

SEEDS = range(3)
WALL = Obstacle("wall", Box((0.1, 1.0, 1.0)), Pose((0.6, 0.0, 0.2)))
FLOOR = Obstacle("floor", Box((2.0, 2.0, 0.1)), Pose((0.0, 0.0, -0.6)))
SCENE = Scene((WALL, FLOOR))
FINE = 0.002
"""Metres that any point moves between two samples of the second checker."""


@dataclass(frozen=True)
class Case:
    """A random robot, and the second checker that reads its URDF once more."""

    robot: Robot
    auditor: IndependentChecker
    rng: np.random.Generator

    def anywhere(self, count: int) -> FloatArray:
        limits = self.robot.limits
        return self.rng.uniform(limits.lower, limits.upper, (count, self.robot.n))


@pytest.fixture(scope="module", params=SEEDS)
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    folder = tmp_path_factory.mktemp("random")
    rng = np.random.default_rng(request.param)
    robot = built(folder, random_robot(rng))
    limits = {"position": {"lower": robot.limits.lower, "upper": robot.limits.upper}}
    table = {
        "urdf": folder / "robot.urdf",
        "joints": list(robot.joint_names),
        "tool_frame": robot.tool_frame,
        "limits": limits,
        "allowed_contacts": [{"links": contact.links} for contact in robot.allowed_contacts],
    }
    return Case(robot, IndependentChecker(table, tables_of(SCENE)), rng)


def test_mimics_stand_where_pinocchio_has_them(case: Case) -> None:
    assert len(case.robot.bodies) == case.robot.n + 4
    links = [item.link for item in case.robot.link_frames]
    for q in case.anywhere(20):
        bodies = np.array(case.robot.body_poses(q))
        for frame, expected in zip(case.robot.link_frames, case.auditor.link_poses(q, links), strict=True):
            R, p = bodies[frame.body][:9].reshape(3, 3), bodies[frame.body][9:]
            assert R @ frame.pose.rotation == pytest.approx(expected[:3, :3], abs=1e-12)
            assert R @ frame.pose.position + p == pytest.approx(expected[:3, 3], abs=1e-12)


def test_reach_is_the_sum_of_what_a_joint_moves_itself_and_through_its_mimics(tmp_path: Path) -> None:
    mimic = '<mimic joint="first" multiplier="-3"/>'
    ball = solid("sphere", 'radius="0.1"', "1 0 0")
    parts = (
        link("base") + link("disc") + link("arm", ball) + link("slider", ball),
        joint("first", "revolute base disc -0.5 0.5"),
        joint("second", "revolute disc arm -2 2", more=mimic),
        joint("third", "prismatic base slider -2 2", axis="1 0 0", more=mimic),
    )
    assert built(tmp_path, urdf("gears", *parts)).reach() == pytest.approx([(1.0 + 3.0) * 1.1], rel=1e-6)
    assert built(tmp_path, urdf("rack", *parts[:2], parts[3], joint("fix", "fixed disc arm"))).reach() == pytest.approx(
        [3.0], rel=1e-6
    )


def test_the_jacobian_is_the_derivative(case: Case) -> None:
    robot, h = case.robot, 1e-6
    for q in case.anywhere(5):
        steps = h * np.eye(robot.n)
        moved = [robot.tool_pose(q + step)[:3, 3] - robot.tool_pose(q - step)[:3, 3] for step in steps]
        J = robot.tool_jacobian(q)[:3]
        assert pytest.approx(np.stack(moved).T / (2.0 * h), abs=1e-7) == J
        qd = case.rng.normal(size=robot.n)
        assert tool_speeds(robot, q[None], qd[None])[0] == pytest.approx(float(np.linalg.norm(J @ qd)), abs=1e-12)


def test_the_kernel_says_what_fcl_says(case: Case) -> None:
    made = kernels(case.robot, SCENE)
    made["fcl"] = CollisionChecker(case.robot, SCENE, edge_step=JointStep(STEP), backend="fcl")
    for (kind, what), tally in compare(made, questions(case.robot, SCENE, 100, 15, 0)).items():
        assert tally.differences == 0, (kind, what, tally.words)
    Q = case.anywhere(200)
    free = made["fcl"].states_are_free(Q)
    assert [case.auditor.free(q) for q in Q] == free.tolist()


def test_what_is_proven_free_is_free_between_samples(case: Case) -> None:
    """Two configurations that a second checker, sampling densely, says are joined by a free line, and others."""
    proven = 0
    for _ in range(12):
        start = case.anywhere(1)[0]
        limits = case.robot.limits
        end = np.clip(start + case.rng.normal(0.0, 0.1, case.robot.n), limits.lower, limits.upper)
        certifier, path = Certifier(case.robot, SCENE), JointPath(np.array([start, end]))
        agreed(certifier, path)
        touch = case.auditor.curve_touch(path, path.length, FINE)
        certificate = certify(case.robot, SCENE, path)
        assert not (certificate.certified and touch), (start, end, touch)
        proven += certificate.certified
        if not certificate.certified and touch is None and case.auditor.free(start):
            assert certificate.refusal is not None
    assert proven > 0
