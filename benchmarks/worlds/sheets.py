"""Thin sheets planted where a robot passes between two samples of its path: what sampling misses, a proof must not."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import planner_service as ps
from planner_service.certify import Certifier, Refusal
from planner_service.geometry.arrays import FloatArray
from planner_service.robot import LinkShape

__all__ = ["STEPS", "THICKNESS", "Planted", "Site", "plant", "samples"]

STEPS = (0.02, 0.05, 0.1)
"""Radians (L2) between the samples that are to miss a sheet."""

THICKNESS = 0.002

SIDES = (0.02, 0.1)

MISSES, TRIES = 3, 300
"""Sheets that are to be missed on a path, and placements tried for them."""

NAME = "sheet"


@dataclass(frozen=True, eq=False)
class Site:
    """A certified path to plant on.

    Attributes:
        name: Decides the random choices.
        touches: An independent judge: whether the robot touches anything of a scene between two s of its path.
    """

    name: str
    robot: ps.Robot
    scene: ps.Scene
    path: ps.JointPath
    touches: Callable[[ps.Scene, float, float], bool]


@dataclass
class Planted:
    """How many sheets were planted, and how those that the robot touches fared.

    Attributes:
        tried: Placements.
        touched: Those touched between two samples, but not at these.
        missed: Of these, those that no sample at all touches.
        caught: Of the touched, those for which the certificate is refused because of the sheet.
    """

    tried: int = 0
    touched: int = 0
    missed: int = 0
    caught: int = 0


def samples(path: ps.JointPath, step: float) -> FloatArray:
    """Path lengths at most ``step`` apart, with all ends of straight pieces and blends."""
    parts = [
        np.linspace(a, b, 1 + max(1, math.ceil((b - a) / step)))[:-1]
        for a, b in zip(path.breaks[:-1].tolist(), path.breaks[1:].tolist(), strict=True)
    ]
    return np.append(np.concatenate(parts), path.length)


def plant(site: Site, step: float) -> Planted:
    """Plant sheets on a path, one at a time, until samples at a step have missed enough that the robot touches."""
    found = Planted()
    robot, path, s = site.robot, site.path, samples(site.path, step)
    chance = random.Random(f"{site.name} {step}")
    while found.tried < TRIES and found.missed < MISSES:
        found.tried += 1
        k = chance.randrange(len(s) - 1)
        start, end = float(s[k]), float(s[k + 1])
        sheet = _sheet(robot, path, (start, end), chance)
        alone = ps.CollisionChecker(robot, ps.Scene((sheet,)))
        if not (alone.state_is_free(path(start)) and alone.state_is_free(path(end))):
            continue  # samples find it
        world = site.scene.with_obstacle(sheet)
        if not site.touches(world, start, end):
            continue
        found.touched += 1
        checker = ps.CollisionChecker(robot, world)
        found.missed += all(checker.state_is_free(q) for q in path(s))
        refusal = Certifier(robot, world).certify(path).refusal
        found.caught += isinstance(refusal, Refusal) and NAME in (refusal.a, refusal.b)
    return found


def _sheet(robot: ps.Robot, path: ps.JointPath, between: tuple[float, float], chance: random.Random) -> ps.Obstacle:
    """A sheet whose edge reaches a little into a link halfway between two samples.

    Seen from a point of the link that is farthest along a direction across the motion, the sheet begins a little inside
    of it and ends outside. It stands across the motion, along it, or in between.
    """
    start, end = between
    middle = start + (end - start) * chance.uniform(0.3, 0.7)
    shape = chance.choice([shape for shape in robot.shapes if shape.body > 1])
    frames = [_frame(robot, shape, path(s)) for s in (start, middle, end)]
    motion = _unit(frames[2][:3, 3] - frames[0][:3, 3], chance)
    outwards = _across(motion, chance)
    local = shape.shape.support(frames[1][:3, :3].T @ outwards)
    before, point, after = (T[:3, :3] @ local + T[:3, 3] for T in frames)
    moved = math.sqrt(math.fsum(((after - before) ** 2).tolist()))
    motion = _unit(after - before, chance)
    turn = chance.gauss(0.0, 0.2) if chance.random() < 0.7 else chance.uniform(-math.pi, math.pi)
    y = _unit(outwards - motion * math.fsum((motion * outwards).tolist()), chance)
    x = math.cos(turn) * motion + math.sin(turn) * np.cross(motion, y)
    size = (THICKNESS, chance.uniform(*SIDES), chance.uniform(*SIDES))
    depth = chance.uniform(0.02, 0.4) * moved
    T = np.eye(4)
    T[:3, :3] = np.stack([x, y, np.cross(x, y)], axis=1)
    T[:3, 3] = point + y * (size[1] / 2 - depth)
    return ps.Obstacle(NAME, ps.Box(size), ps.Pose.from_matrix(T))


def _frame(robot: ps.Robot, shape: LinkShape, q: FloatArray) -> FloatArray:
    """The pose of a link's shape in the world, 4 x 4."""
    pose = robot.body_poses(q)[shape.body]
    T = np.eye(4)
    T[:3, :3] = np.reshape(pose[:9], (3, 3))
    T[:3, 3] = pose[9:]
    return np.asarray(T @ shape.pose.matrix)


def _unit(v: FloatArray, chance: random.Random) -> FloatArray:
    """The direction of a vector, any if it has none."""
    norm = math.sqrt(math.fsum((v * v).tolist()))
    return v / norm if norm > 1e-9 else _unit(np.array([chance.gauss(0.0, 1.0) for _ in range(3)]), chance)


def _across(v: FloatArray, chance: random.Random) -> FloatArray:
    """A random unit vector square to the unit vector v."""
    w = np.array([chance.gauss(0.0, 1.0) for _ in range(3)])
    return _unit(w - v * math.fsum((v * w).tolist()), chance)
