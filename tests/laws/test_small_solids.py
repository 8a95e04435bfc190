"""Solids of any size get FCL's verdict from every backend: down to a micrometre and below, thin ones and flat ones.

A few thousand states take seconds. The figures in docs/explanation/limitations.md are of 100,000 states for each size:

    SMALL_STATES=100000 pytest tests/laws/test_small_solids.py
"""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np
import pytest

from planner_service.collision import CollisionChecker
from planner_service.collision.backends import BackendName
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.robot.model import Body, JointLimits, LinkShape, Robot
from planner_service.scene.scene import Obstacle, Scene

BACKENDS: list[BackendName] = ["native", "fcl"]
STATES = int(os.environ.get("SMALL_STATES", "1500"))
EACH = 40
"""States of each pair of shapes; so many that the sieves are asked, too."""
KINDS = ("box", "sphere", "cylinder", "capsule", "mesh")


def shape_of(kind: str, decade: float, rng: np.random.Generator) -> Shape:
    """A shape whose smallest length is about 10^decade m, its others up to a hundred times that."""
    least = float(10.0 ** (decade + rng.random()))

    def length() -> float:
        return least * float(10.0 ** rng.uniform(0.0, rng.choice([0.7, 2.0])))

    makers: dict[str, Callable[[], Shape]] = {
        "box": lambda: Box((length(), least, length())),
        "sphere": lambda: Sphere(least / 2.0),
        "cylinder": lambda: Cylinder(least / 2.0, length()) if rng.random() < 0.5 else Cylinder(length() / 2.0, least),
        "capsule": lambda: Capsule(least / 2.0, length()) if rng.random() < 0.5 else Capsule(length() / 2.0, least),
        "mesh": lambda: Mesh(rng.normal(size=(int(rng.integers(4, 12)), 3)) * [length(), least, length()]),
    }
    return makers[kind]()


def slider(shape: Shape, pose: Pose) -> Robot:
    """A robot that is one shape, sliding along x."""
    still, one = np.eye(4), np.ones(1)
    limits = JointLimits(-one, one, one, one, one)
    bodies = (Body("base", -1, still, np.zeros(3), False, -1), Body("slide", 0, still, np.array([1.0, 0, 0]), True, 0))
    shapes = (LinkShape("tip", 1, shape, pose),)
    return Robot("slider", ("slide",), limits, (("home", 0.0 * one),), ("base",), "tip", 1, still, bodies, shapes)


def turned(rng: np.random.Generator) -> Pose:
    """At the origin, one in four upright."""
    q = rng.normal(size=4) if rng.random() < 0.75 else np.array([1.0, 0.0, 0.0, 0.0])
    w, x, y, z = (q / np.sqrt((q * q).sum())).tolist()
    return Pose((0.0, 0.0, 0.0), (w, x, y, z))


def farthest(shape: Shape, pose: Pose, x: float) -> FloatArray:
    """A point of a shape at a pose that is farthest along x, forwards or backwards."""
    R = pose.matrix[:3, :3]
    return np.asarray(R @ shape.support(R.T @ np.array([x, 0.0, 0.0])))


def face_to_face(one: Shape, other: Shape, rng: np.random.Generator) -> tuple[Robot, Scene]:
    """A robot of one shape whose q is the overlap along x with the other one, minus the gap."""
    first, second = turned(rng), turned(rng)
    x, y, z = (farthest(one, first, 1.0) - farthest(other, second, -1.0)).tolist()
    return slider(one, first), Scene((Obstacle("other", other, Pose((x, y, z), second.quaternion)),))


@pytest.mark.parametrize("decade", [-9.0, -6.0, -4.0, -3.0])
def test_small_solids_get_the_verdict_of_fcl(decade: float) -> None:
    rng = np.random.default_rng(round(10 * decade) % 1000)
    judged = colliding = 0
    while judged < STATES:
        kinds = rng.choice(KINDS, 2)
        try:
            shapes = [shape_of(kinds[0], decade, rng), shape_of(kinds[1], rng.uniform(decade, -1.0), rng)]
        except InvalidRequest:  # a mesh thinner than 1 um
            continue
        if rng.random() < 0.5:
            shapes.reverse()
        robot, scene = face_to_face(shapes[0], shapes[1], rng)
        gaps = 10.0 ** rng.uniform(-5.7, -2.5, (EACH // 4, 3))
        Q = np.concatenate([-gaps.ravel(), 10.0 ** rng.uniform(-5.7, -2.0, EACH // 4)])[:, None]
        found = [CollisionChecker(robot, scene, backend=name).states_are_free(Q) for name in BACKENDS]
        for verdicts in found[:-1]:
            wrong = np.flatnonzero(verdicts != found[-1])
            assert not len(wrong), (decade, shapes, robot.shapes[0].pose, scene, Q[wrong].tolist())
        judged += len(Q)
        colliding += int((~found[-1]).sum())
    assert 0 < colliding < judged
