"""Proofs, refusals and verdicts in a few worlds, with the bounds they take: the numbers since bounds along
one direction count, too.

The laws say why they are right. These notice a bound that still holds but is looser, or is asked for more often.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from planner_service.certify import Certifier, EdgeVerdict, ExemptInterval
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Scene
from tests.laws.test_crowd_laws import Crowded
from tests.support.hull_arm import NEEDLE, HullSetup, write_arm


class World(NamedTuple):
    """What is proven about."""

    robot: Robot
    scene: Scene
    allowed: tuple[tuple[str, str], ...] = ()
    padding: float = 0.0

    def certifier(self) -> Certifier:
        return Certifier(self.robot, self.scene, allowed=self.allowed)


def crowded(name: str, seed: int) -> World:
    setup = Crowded(name, seed)
    return World(setup.robot, setup.scene, setup.allowed, setup.padding)


def hulls(folder: Path) -> World:
    write_arm(folder)
    setup = HullSetup("proofs", folder, attached=(NEEDLE,))
    return World(setup.robot(), setup.whole_scene())


WORLDS: dict[str, Callable[[Path], World]] = {
    "bin": lambda folder: World(load_robot("wxai"), load_scene("bin")),
    "padded shelf": lambda folder: World(load_robot("wxai"), load_scene("shelf"), padding=0.004),
    "hulls": hulls,
    "crowds": lambda folder: crowded("wxai", 0),
    "crowds in the plane": lambda folder: crowded("planar2", 1),
    "crowds around a UR5": lambda folder: crowded("ur5", 2),
}


def drawn(world: World, count: int, spread: float, rng: np.random.Generator) -> FloatArray:
    """Configurations around the middle of the joints' ranges, (count, n)."""
    lower, upper = world.robot.limits.lower, world.robot.limits.upper
    home = 0.5 * (lower + upper)
    return np.asarray(home + spread * (rng.uniform(lower, upper, (count, world.robot.n)) - home))


def paths(world: World) -> list[JointPath]:
    """Of three waypoints each, every other one blended."""
    rng = np.random.default_rng(4)
    out = []
    for k in range(10):
        a, b, c = drawn(world, 3, 1.0, rng)
        points = JointPath(np.array([a, a + 0.2 * (b - a), a + 0.2 * (c - a)]))
        legs = np.diff(points.knots)
        out.append(points.with_blends([0.0, 0.4 * float(legs.min()), 0.0]) if k % 2 else points)
    return out


def proofs(world: World) -> tuple[int, int, float, float]:
    certifier = world.certifier()
    pair = (world.robot.shapes[-1].link, world.scene.names[0])
    found = []
    for k, path in enumerate(paths(world)):
        exempt = [ExemptInterval(0.0, 0.4 * path.length, (pair,), "")] if k % 3 == 0 else []
        part = (0.1 * path.length, 0.7 * path.length) if k % 4 == 3 else None
        found.append(certifier.certify(path, padding=world.padding, exempt=exempt, part=part))
    clearances = math.fsum(one.clearance for one in found if one.certified)
    places = math.fsum(one.refusal.s for one in found if one.refusal is not None)
    return sum(one.certified for one in found), sum(one.distances for one in found), clearances, places


def verdicts(world: World) -> tuple[int, int, float, float]:
    certifier, rng = world.certifier(), np.random.default_rng(5)
    Q = drawn(world, 40, 1.0, rng)
    edges = zip(Q, Q + 0.15 * (Q[::-1] - Q), strict=True)
    found = [certifier.certify_edge(a, b, padding=world.padding) for a, b in edges]
    free = sum(one.verdict is EdgeVerdict.FREE for one in found)
    colliding = sum(one.verdict is EdgeVerdict.COLLIDING for one in found)
    return free, colliding, math.fsum(one.s for one in found), math.fsum(certifier.clearances(Q).tolist())


EXPECTED: dict[str, tuple[tuple[int, int, float, float], tuple[int, int, float, float]]] = {
    "bin": ((5, 10620, 0.166118682, 2.893954040), (23, 17, 5.720374921, -0.253982173)),
    "padded shelf": ((5, 6981, 0.167801380, 1.762727723), (21, 19, 6.097064367, -0.392169907)),
    "hulls": ((6, 2098, 0.153658696, 0.152971366), (19, 21, 5.900187334, -0.324635747)),
    "crowds": ((8, 31492, 0.367743496, 1.849944195), (30, 10, 2.479075433, 2.660531684)),
    "crowds in the plane": ((7, 3239, 0.773668060, 3.006116689), (34, 6, 0.884433678, 7.295282142)),
    "crowds around a UR5": ((2, 2436, 0.021161802, 3.042551593), (10, 30, 11.844649527, -0.505593923)),
}
"""By world: paths that are proven, the bounds of distances that all took, the sum of their clearances, and that of the
places at which others are refused; then edges that are free and that collide, where, and their ends' clearances."""


@pytest.mark.slow
@pytest.mark.parametrize("name", WORLDS)
def test_proofs_and_their_bounds_are_as_they_were(name: str, tmp_path: Path) -> None:
    world = WORLDS[name](tmp_path)
    for found, expected in zip((proofs(world), verdicts(world)), EXPECTED[name], strict=True):
        assert found[:2] == expected[:2]
        assert found[2:] == pytest.approx(expected[2:], abs=2e-8)
