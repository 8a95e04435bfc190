"""Stored queries under constraints, drawn from seeds without asking any planner, and the worlds they are in.

Ends are free and keep their constraints. Goals are all configurations found for the same tool pose, as a person would
ask for a pose: one configuration may be on a branch that no motion reaches. Whether a way exists is not known;
in space a straight joint line is none.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import planner_service as ps
from benchmarks.studies.problems import public_problems
from benchmarks.worlds.drawn import draw_objects
from benchmarks.worlds.queries import SEED
from planner_service.constraints import Constraint, InBox, KeepUpright, OnLine, OnPlane, RelativePose
from planner_service.geometry.arrays import FloatArray, Vector, read_only, vector

__all__ = ["FOLDER", "REGIONS", "ROBOTS", "UPRIGHT", "ConstrainedQuery", "load"]

FOLDER = Path(__file__).parents[1] / "queries" / "constrained"

UPRIGHT = ("panda", "bin", "shelf", "clutter", "carried")
"""Sets of queries with a cup; the same for every tolerance."""

REGIONS = ("plane", "line", "box", "hands")

ROBOTS: Mapping[str, str] = {
    **dict.fromkeys(("bin", "shelf", "clutter", "carried", "line", "box"), "wxai"),
    **dict.fromkeys(("panda", "plane"), "panda_mbm"),
    "hands": "wxai_dual",
}

PER_WORLD = 5
"""Queries in each of ten drawn worlds."""

GRIP = 0.14
"""Metres from the middle of the tray to each hand."""


@dataclass(frozen=True, eq=False)
class ConstrainedQuery:
    """From ``start`` (n,) to any of ``goals`` (m, n), constraints kept.

    Attributes:
        axis: The axis of the tool that stays up; None in a set without a cup.
        held: The constraints without a cup's.
    """

    set: str
    number: int
    scene: ps.Scene
    start: FloatArray
    goals: FloatArray
    axis: Vector | None = None
    held: tuple[Constraint, ...] = ()

    @property
    def name(self) -> str:
        """Such as ``line-07``."""
        return f"{self.set}-{self.number:02d}"

    def constraints(self, tolerance: float | None = None) -> tuple[Constraint, ...]:
        """What is to be kept; with a cup, upright within a tolerance in radians."""
        return self.held if self.axis is None or tolerance is None else (KeepUpright(self.axis, tolerance),)


@dataclass(frozen=True, eq=False)
class _World:
    """A scene, and the constraints that hold in it."""

    scene: ps.Scene
    held: tuple[Constraint, ...]


def _scene(name: str, number: int) -> ps.Scene:
    if name == "panda":
        return public_problems().problems[number].scene
    if name == "carried":
        cup = ps.Attached("cup", ps.Box((0.04, 0.02, 0.06)), ps.Pose((0.02, 0.0, 0.0)), ("finger_left", "finger_right"))
        return ps.load_scene("bin").with_attached(cup)
    return ps.load_scene(name) if name in UPRIGHT else _world(name, number // PER_WORLD).scene


# Regions of space.


@cache
def _world(name: str, number: int) -> _World:
    return _WORLDS[name](random.Random(f"{SEED} {name} world {number}"))


def _board(chance: random.Random) -> _World:
    """A tilted board before the arm with two blocks on it; a pen of 5 cm keeps its point 5 mm above it, to 1 mm."""
    position = (chance.uniform(0.45, 0.55), chance.uniform(-0.1, 0.1), chance.uniform(0.25, 0.45))
    board = ps.Pose.from_rpy(position, (chance.uniform(-0.3, 0.3), chance.uniform(-1.0, -0.2), 0.0))
    obstacles = [ps.Obstacle("board", ps.Box((0.5, 0.6, 0.02)), board)]
    for k, y in enumerate((chance.uniform(-0.15, -0.05), chance.uniform(0.05, 0.15))):
        at = board @ ps.Pose((chance.uniform(-0.1, 0.1), y, 0.04))
        obstacles.append(ps.Obstacle(f"block_{k}", ps.Box((0.05, 0.05, 0.06)), at))
    plane, pen = board @ ps.Pose((0.0, 0.0, 0.015)), (0.0, 0.0, 0.05)
    return _World(ps.Scene(tuple(obstacles), name="board"), (OnPlane(plane, 0.001, point=pen),))


def _line(chance: random.Random) -> _World:
    """A line before the arm, 1 or 2 mm wide either way, and objects at least 5 cm from it."""
    start, end = (
        (chance.uniform(0.22, 0.36), y, chance.uniform(0.12, 0.32)) for y in (chance.uniform(-0.3, -0.2), 0.25)
    )
    held = OnLine(start, end, chance.choice((0.001, 0.002)))
    stations = np.asarray(np.linspace(start, end, 30), dtype=np.float64)
    return _World(_cluttered(chance, stations, 0.05), (held,))


def _box(chance: random.Random) -> _World:
    """A box of space before the arm, and objects in it and about it."""
    size = (chance.uniform(0.12, 0.25), 0.5, chance.uniform(0.12, 0.25))
    centre = ps.Pose((chance.uniform(0.28, 0.36), 0.0, chance.uniform(0.18, 0.3)))
    return _World(_cluttered(chance, np.array([centre.position]), 0.02), (InBox(centre, size),))


def _tray(chance: random.Random) -> _World:
    """Both hands on a tray, over a table with a post between them and objects about it."""
    held = RelativePose("right_ee_gripper_link", "left_ee_gripper_link", ps.Pose((0.0, -2.0 * GRIP, 0.0)), 0.002, 0.01)
    places = np.array([(0.3, 0.0, 0.2), (0.0, 0.25, 0.1), (0.0, -0.25, 0.1)])  # the middle, and the bases of the arms
    scene, height = _cluttered(chance, places, 0.15, (2, 4)), chance.uniform(0.05, 0.2)
    at = ps.Pose((chance.uniform(0.22, 0.4), chance.uniform(-0.12, 0.12), height / 2))
    return _World(scene.with_obstacle(ps.Obstacle("post", ps.Box((0.06, 0.06, height)), at)), (held,))


_WORLDS: Mapping[str, Callable[[random.Random], _World]] = {
    "plane": _board,
    "line": _line,
    "box": _box,
    "hands": _tray,
}


def _cluttered(chance: random.Random, places: FloatArray, apart: float, count: tuple[int, int] = (5, 9)) -> ps.Scene:
    """A table with objects that keep some distance from places."""
    scene = ps.load_scene("table")
    for obstacle in draw_objects(chance, chance.randint(*count)):
        back = obstacle.pose.inverse()
        local = places @ back.rotation.T + np.array(back.position)
        if float(obstacle.shape.distance(local).min()) > apart:
            scene = scene.with_obstacle(obstacle)
    return scene


def load(name: str) -> tuple[ConstrainedQuery, ...]:
    """The stored queries of a set."""
    return tuple(_stored(name, **row) for row in json.loads((FOLDER / f"{name}.json").read_text("utf-8"))["queries"])


def _stored(
    name: str, number: int, axis: Vector | None, start: list[float], goals: list[list[float]]
) -> ConstrainedQuery:
    up = None if axis is None else vector(axis)
    held = () if name in UPRIGHT else _world(name, number // PER_WORLD).held
    return ConstrainedQuery(name, number, _scene(name, number), read_only(start), read_only(goals), up, held)
