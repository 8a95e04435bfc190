"""Pick-and-place out of bins that differ from episode to episode.

The ranges are those around ``scenes/bin.toml`` in which the wxai arm has work to do and can do it: bins 5 to 10 cm
high, a block far enough from their walls for a gripper, a tray beside, and in half of the episodes a post between.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.datasets.random_draws import Draws
from planner_service.datasets.task import Drawn
from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.shapes import Box, Cylinder, FloatArray, Pose
from planner_service.planning.request import PlanRequest
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import plan_pick_place
from planner_service.tasks.result import TaskResult

__all__ = ["BinPickPlace"]

WALL = 0.008
"""Metres: of floor and walls, as in ``scenes/bin.toml``."""

GAP = 0.001
"""Metres between the block and the floor of the bin: what stands on something is never in contact with it here."""

WALL_ROOM = 0.055
"""Metres from a wall's inside to the middle of the block, at least. Nearer a corner than 75 mm a turned block now and
then has no room for the fingers: about one episode in a hundred, which is a row with its reason."""

APART = 0.015
"""Metres between things on the table, at least."""

START_ROOM = 0.01
"""Metres that the start keeps from everything, by a proven bound."""

START_SPREAD = (0.5, 0.12, 0.12, 0.15, 0.2, 0.3)
"""Radians by which a start differs from home at most, joint by joint from the base on."""

TRIES, STARTS = 100, 20
"""Draws of one thing before it is left out, or of worlds before these ranges are wrong; and of starts in a world."""

Footprint = tuple[float, float, float, float]
"""The rectangle (x, y, half of its length along x, half along y) that something takes of the table."""

FOOT: Footprint = (0.0, 0.0, 0.15, 0.15)
"""Where nothing is put: the robot turns there."""


@dataclass(frozen=True)
class BinPickPlace:
    """Take a block out of a bin, put it on a tray, go back."""

    name: str = "pick-place"
    sentence: str = "Take the block out of the bin and put it on the tray."
    carrying: tuple[str, ...] = ("lift", "transfer", "lower")

    def draw(self, robot: Robot, draws: Draws) -> Drawn:
        """A bin with a block in it, a tray, sometimes a post or other things, and a start with 1 cm of room.

        Raises:
            InvalidRequest: the robot is no arm of six joints.
            BrokenInvariant: no start has room in any world, which these ranges rule out for the wxai arm.
        """
        if robot.n != len(START_SPREAD):
            raise InvalidRequest("robot", robot.name, "an arm of six joints with a gripper, such as wxai")
        for _ in range(TRIES):
            scene = _world(draws)
            start = _start(robot, scene, draws)
            if start is not None:
                return Drawn(scene, start, "block", "tray")
        raise BrokenInvariant(f"{robot.name} has no start with room in {TRIES} worlds")

    def solve(self, service: PlannerService, drawn: Drawn, request: PlanRequest) -> TaskResult:
        """See ``plan_pick_place``."""
        return plan_pick_place(service, drawn.target, drawn.onto, request)


def _world(draws: Draws) -> Scene:
    table = Obstacle("table", Box((1.4, 1.4, 0.1)), Pose((0.0, 0.0, -0.051)))
    size = (draws.between(0.26, 0.34), draws.between(0.20, 0.28), draws.between(0.05, 0.10))
    middle = (draws.between(0.30, 0.36), draws.between(-0.08, 0.08))
    around = (*middle, size[0] / 2, size[1] / 2)
    side = draws.one_of(-1.0, 1.0)
    tray = _tray(draws, side, around)
    things = [*_bin(size, middle), _block(draws, size, middle), tray]
    taken = [around, _footprint(tray)]
    if draws.happens(0.5):
        _add(things, taken, lambda: _post(draws, side, around))
    for number in range(int(draws.between(0.0, 3.0))):
        _add(things, taken, partial(_thing, draws, f"thing_{number}"))
    return Scene((table, *things), name="episode")


def _bin(size: Sequence[float], middle: Sequence[float]) -> list[Obstacle]:
    """Five boxes that meet without overlap: a bin of an outer size, open above, standing around a middle (x, y)."""
    (length, width, height), (x, y) = size, middle
    inside = width - 2.0 * WALL
    aside, before = (width - WALL) / 2.0, (length - WALL) / 2.0
    parts = {
        "bin_floor": ((length - 2.0 * WALL, inside, WALL), (x, y, WALL / 2.0)),
        "bin_front": ((WALL, inside, height), (x - before, y, height / 2.0)),
        "bin_back": ((WALL, inside, height), (x + before, y, height / 2.0)),
        "bin_left": ((length, WALL, height), (x, y + aside, height / 2.0)),
        "bin_right": ((length, WALL, height), (x, y - aside, height / 2.0)),
    }
    return [Obstacle(name, Box(box), Pose(at)) for name, (box, at) in parts.items()]


def _block(draws: Draws, size: Sequence[float], middle: Sequence[float]) -> Obstacle:
    edges = (draws.between(0.03, 0.05), draws.between(0.03, 0.05), draws.between(0.03, 0.05))
    room = [outer / 2.0 - WALL - WALL_ROOM for outer in size[:2]]
    x, y = (at + draws.between(-free, free) for at, free in zip(middle, room, strict=True))
    return Obstacle("block", Box(edges), draws.turned(x, y, WALL + GAP + edges[2] / 2.0))


def _tray(draws: Draws, side: float, around: Footprint) -> Obstacle:
    """On one side of the bin, as near as 3 cm."""
    length, width = draws.between(0.12, 0.17), draws.between(0.12, 0.17)
    edge = side * around[1] + around[3] + 0.03 + width / 2.0
    y = side * draws.between(max(edge, 0.24), max(edge, 0.24) + 0.05)
    return Obstacle("tray", Box((length, width, 0.01)), Pose((draws.between(0.14, 0.26), y, 0.005)))


def _post(draws: Draws, side: float, around: Footprint) -> Obstacle:
    """Beside the bin on the side of the tray, where the straight way there often passes."""
    radius, height = draws.between(0.015, 0.03), draws.between(0.20, 0.38)
    y = around[1] + side * (around[3] + draws.between(0.04, 0.14))
    return Obstacle("post", Cylinder(radius, height), Pose((draws.between(0.20, 0.40), y, height / 2.0)))


def _thing(draws: Draws, name: str) -> Obstacle:
    """Anything, anywhere on the table but at the robot's foot."""
    x, y = draws.between(-0.4, 0.55), draws.between(-0.45, 0.45)
    height = draws.between(0.03, 0.15)
    if draws.happens(0.5):
        return Obstacle(name, Cylinder(draws.between(0.015, 0.04), height), Pose((x, y, height / 2.0)))
    return Obstacle(name, Box((draws.between(0.03, 0.08), draws.between(0.03, 0.08), height)), Pose((x, y, height / 2)))


def _add(things: list[Obstacle], taken: list[Footprint], make: Callable[[], Obstacle]) -> None:
    """Add the first of what is made that stands apart from all that is there; nothing if none does."""
    for _ in range(TRIES):
        thing = make()
        x, y, half_x, half_y = _footprint(thing)
        apart = [max(abs(x - u) - half_x - a, abs(y - v) - half_y - b) for u, v, a, b in (*taken, FOOT)]
        if min(apart) >= APART:
            things.append(thing)
            taken.append((x, y, half_x, half_y))
            return


def _footprint(thing: Obstacle) -> Footprint:
    x, y, _ = thing.pose.position
    if isinstance(thing.shape, Cylinder):
        return x, y, thing.shape.radius, thing.shape.radius
    half_x, half_y, _ = thing.shape.half if isinstance(thing.shape, Box) else (0.0, 0.0, 0.0)
    return x, y, half_x, half_y


def _start(robot: Robot, scene: Scene, draws: Draws) -> FloatArray | None:
    """A configuration near home that keeps its distance from everything; None if none was drawn."""
    checker = CollisionChecker(robot, scene)
    limits = robot.limits
    for _ in range(STARTS):
        spread = [draws.between(-most, most) for most in START_SPREAD]
        q: FloatArray = np.clip(robot.home + np.array(spread), limits.lower, limits.upper)
        if checker.clearance(q) >= START_ROOM:
            return q
    return None
