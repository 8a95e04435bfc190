"""Two pieces that are proven to overlap in a box of joint values collide at each configuration that is drawn in it."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service import Box, Obstacle, PlannerService, Pose, Scene
from planner_service.certify import Certifier
from planner_service.certify.overlap import proven_overlap
from planner_service.collision import CollisionChecker

SCENES = {"wxai": "bin", "ur5": "empty", "panda": "empty", "planar2": "empty"}


@pytest.mark.parametrize("name", SCENES)
def test_what_is_drawn_in_a_box_of_a_proven_overlap_collides(name: str) -> None:
    service, rng = PlannerService(name, SCENES[name]), np.random.default_rng(1)
    robot, checker = service.robot, service.checker
    certifier = Certifier(robot, service.scene)
    proven = 0
    for _ in range(150):
        half = 10.0 ** rng.uniform(-4.0, -1.0)
        q = rng.uniform(robot.limits.lower + half, robot.limits.upper - half)
        found = proven_overlap(certifier, q - half, q + half)
        if found is None:
            continue
        proven += 1
        assert found.motion < found.room
        for _ in range(10):
            inside = q + half * np.where(rng.random(robot.n) < 0.5, rng.uniform(-1, 1, robot.n), rng.choice([-1, 1]))
            assert (found.a, found.b) in checker.touching(inside) or (found.b, found.a) in checker.touching(inside)
    assert proven or name == "planar2"


@pytest.mark.parametrize("name", ["wxai", "ur5"])
def test_a_colliding_configuration_is_proven_to_collide_and_a_free_one_is_not(name: str) -> None:
    service, rng = PlannerService(name, SCENES[name]), np.random.default_rng(2)
    certifier = Certifier(service.robot, service.scene)
    for _ in range(60):
        q = rng.uniform(service.robot.limits.lower, service.robot.limits.upper)
        found = proven_overlap(certifier, q - 1e-10, q + 1e-10)
        assert (found is None) == service.checker.state_is_free(q)
        depths = {frozenset((contact.a, contact.b)): contact.depth for contact in service.checker.contacts(q)}
        assert found is None or found.room <= depths[frozenset((found.a, found.b))]


def test_what_is_allowed_to_touch_does_not_count() -> None:
    service = PlannerService("wxai", "empty")
    q = np.array(service.robot.home)
    at = service.robot.tool_pose(q)[:3, 3]
    scene = Scene((Obstacle("block", Box((0.2, 0.2, 0.2)), Pose(tuple(at.tolist()))),))
    touching = CollisionChecker(service.robot, scene).touching(q)
    assert proven_overlap(Certifier(service.robot, scene), q, q) is not None
    assert proven_overlap(Certifier(service.robot, scene, allowed=touching), q, q) is None
