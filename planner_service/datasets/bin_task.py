"""Pick-and-place out of random bins.

The ranges vary ``scenes/bin.toml`` as far as the wxai arm can still do the task: bins 5 to 10 cm high,
 a block far enough from their walls for a gripper, a tray beside the bin, and often a post in between.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.datasets.task import EpisodeWorld, RandomDraws
from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Cylinder, Pose
from planner_service.planning.request import PlanRequest
from planner_service.planning.task_result import TaskResult
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import plan_pick_place

__all__ = ["BinPickPlace"]

WALL = 0.008
"""Thickness of floor and walls in metres, as in ``scenes/bin.toml``."""

GAP = 0.001
"""Metres between the block and the floor of the bin: objects never touch what they stand on."""

WALL_ROOM = 0.055
"""Smallest distance in metres from a wall to the middle of the block. Within 75 mm of a corner a rotated block may
leave no room for the fingers: about one request in a hundred fails for that."""

APART = 0.015
"""Smallest distance in metres between objects on the table."""

START_ROOM = 0.01
"""Proven clearance of the start, in metres."""

START_SPREAD = (0.5, 0.12, 0.12, 0.15, 0.2, 0.3)
"""Largest difference in radians of the start from home, for each joint from the base."""

MAX_DRAWS, MAX_STARTS = 100, 20
"""Draws of one object before it is left out, and of worlds before the ranges count as wrong; draws of a start."""

Footprint = tuple[float, float, float, float]
"""The rectangle an object covers on the table: x, y, half its length along x, half along y."""

FOOT: Footprint = (0.0, 0.0, 0.15, 0.15)
"""The robot's own place, where nothing is put."""


@dataclass(frozen=True)
class BinPickPlace:
    """Take a block out of a bin, put it on a tray, go back."""

    name: str = "pick-place"
    sentence: str = "Take the block out of the bin and put it on the tray."
    carrying: tuple[str, ...] = ("lift", "transfer", "lower")

    def draw(self, robot: Robot, draws: RandomDraws) -> EpisodeWorld:
        """A bin with a block in it, a tray, sometimes a post and other objects, and a start with 1 cm of clearance.

        Raises:
            InvalidRequest: the robot does not have six joints.
            BrokenInvariant: no world has a free start; with the wxai arm this cannot happen.
        """
        if robot.n != len(START_SPREAD):
            raise InvalidRequest("robot", robot.name, "an arm of six joints with a gripper, such as wxai")
        for _ in range(MAX_DRAWS):
            scene = _world(draws)
            start = _start(robot, scene, draws)
            if start is not None:
                return EpisodeWorld(scene, start, "block", "tray")
        raise BrokenInvariant(f"{robot.name} has no free start in {MAX_DRAWS} worlds")

    def solve(self, service: PlannerService, drawn: EpisodeWorld, request: PlanRequest) -> TaskResult:
        """See ``plan_pick_place``."""
        return plan_pick_place(service, drawn.target, drawn.onto, request)


def _world(draws: RandomDraws) -> Scene:
    table = Obstacle("table", Box((1.4, 1.4, 0.1)), Pose((0.0, 0.0, -0.051)))
    size = (draws.between(0.26, 0.34), draws.between(0.20, 0.28), draws.between(0.05, 0.10))
    middle = (draws.between(0.30, 0.36), draws.between(-0.08, 0.08))
    bin_area = (*middle, size[0] / 2, size[1] / 2)
    side = draws.one_of(-1.0, 1.0)
    tray = _tray(draws, side, bin_area)
    things = [*_bin(size, middle), _block(draws, size, middle), tray]
    taken = [bin_area, _footprint(tray)]
    if draws.happens(0.5):
        _add(things, taken, lambda: _post(draws, side, bin_area))
    for number in range(int(draws.between(0.0, 3.0))):
        _add(things, taken, partial(_object, draws, f"thing_{number}"))
    return Scene((table, *things), name="episode")


def _bin(size: Sequence[float], middle: Sequence[float]) -> list[Obstacle]:
    """An open bin of five boxes that touch without overlap, from its outer size and its middle (x, y)."""
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


def _block(draws: RandomDraws, size: Sequence[float], middle: Sequence[float]) -> Obstacle:
    edges = (draws.between(0.03, 0.05), draws.between(0.03, 0.05), draws.between(0.03, 0.05))
    room = [outer / 2.0 - WALL - WALL_ROOM for outer in size[:2]]
    x, y = (at + draws.between(-free, free) for at, free in zip(middle, room, strict=True))
    return Obstacle("block", Box(edges), draws.turned(x, y, WALL + GAP + edges[2] / 2.0))


def _tray(draws: RandomDraws, side: float, bin_area: Footprint) -> Obstacle:
    """A tray on one side of the bin, at least 3 cm from it."""
    length, width = draws.between(0.12, 0.17), draws.between(0.12, 0.17)
    edge = side * bin_area[1] + bin_area[3] + 0.03 + width / 2.0
    y = side * draws.between(max(edge, 0.24), max(edge, 0.24) + 0.05)
    return Obstacle("tray", Box((length, width, 0.01)), Pose((draws.between(0.14, 0.26), y, 0.005)))


def _post(draws: RandomDraws, side: float, bin_area: Footprint) -> Obstacle:
    """A post between bin and tray, often in the way of the straight line."""
    radius, height = draws.between(0.015, 0.03), draws.between(0.20, 0.38)
    y = bin_area[1] + side * (bin_area[3] + draws.between(0.04, 0.14))
    return Obstacle("post", Cylinder(radius, height), Pose((draws.between(0.20, 0.40), y, height / 2.0)))


def _object(draws: RandomDraws, name: str) -> Obstacle:
    """A box or a cylinder anywhere on the table."""
    x, y = draws.between(-0.4, 0.55), draws.between(-0.45, 0.45)
    height = draws.between(0.03, 0.15)
    if draws.happens(0.5):
        return Obstacle(name, Cylinder(draws.between(0.015, 0.04), height), Pose((x, y, height / 2.0)))
    return Obstacle(name, Box((draws.between(0.03, 0.08), draws.between(0.03, 0.08), height)), Pose((x, y, height / 2)))


def _add(things: list[Obstacle], taken: list[Footprint], make: Callable[[], Obstacle]) -> None:
    """Add the first object made that keeps its distance from all others; none if there is no such object."""
    for _ in range(MAX_DRAWS):
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


def _start(robot: Robot, scene: Scene, draws: RandomDraws) -> FloatArray | None:
    """A configuration near home with enough clearance; None if none was drawn."""
    checker = CollisionChecker(robot, scene)
    limits = robot.limits
    for _ in range(MAX_STARTS):
        spread = [draws.between(-most, most) for most in START_SPREAD]
        q: FloatArray = np.clip(robot.home + np.array(spread), limits.lower, limits.upper)
        if checker.clearance(q) >= START_ROOM:
            return q
    return None
