"""The queries that everything is measured on: from one side of a scene's obstacle to the other.

They come from a seed and the scene alone, and are stored with the code: a change to a planner is
measured on queries that were there before it. An end is a configuration that brings the tool into
a stated region at a sane tilt and is free; nothing is known of how hard the way between two is.
"""

from __future__ import annotations

import json
import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

import planner_service as ps
from planner_service.geometry.arrays import FloatArray, read_only, rpy_matrix

__all__ = ["PER_SCENE", "ROBOT", "SCENES", "SEED", "Query", "draw", "load", "stored_text", "text_of"]

ROBOT = "wxai"
SEED = 2026
PER_SCENE = 20

DECIMALS = 6
"""Joint values are rounded to a microradian: short in a file, and free of a library's last bits."""

DRAWS = 100_000
"""Draws in vain after which a region is a mistake."""

FOLDER = Path(__file__).parents[1] / "queries"

Range = tuple[float, float]


@dataclass(frozen=True)
class Region:
    """Where the tool's tip may be (metres, base frame), and how far its approach leans outwards (degrees)."""

    x: Range
    y: Range
    z: Range
    tilt: Range


@dataclass(frozen=True, eq=False)
class Query:
    """From ``start`` to ``goal``, each (n,); ``straight`` says whether the straight line between them is free."""

    scene: str
    number: int
    start: FloatArray
    goal: FloatArray
    straight: bool

    @property
    def name(self) -> str:
        """Such as ``bin-07``."""
        return f"{self.scene}-{self.number:02d}"


def _mirrored(region: Region) -> Region:
    return Region(region.x, (-region.y[1], -region.y[0]), region.z, region.tilt)


_IN_BIN = Region((0.25, 0.41), (-0.06, 0.06), (0.02, 0.09), (0.0, 25.0))
_BEHIND_POST = Region((0.12, 0.26), (0.22, 0.34), (0.03, 0.14), (0.0, 40.0))
_BESIDE_BIN = Region((0.20, 0.40), (-0.34, -0.20), (0.03, 0.14), (0.0, 60.0))
_LEFT_OF_POST = Region((0.22, 0.42), (0.10, 0.28), (0.05, 0.30), (30.0, 90.0))
_UNDER_BOARD = Region((0.38, 0.52), (-0.22, 0.22), (0.04, 0.11), (60.0, 95.0))
_OVER_BOARD = Region((0.38, 0.52), (-0.22, 0.22), (0.22, 0.40), (60.0, 100.0))
_GAP_AHEAD = Region((0.24, 0.40), (0.12, 0.24), (0.05, 0.35), (30.0, 100.0))
_GAP_BESIDE = Region((-0.08, 0.08), (0.26, 0.44), (0.05, 0.35), (30.0, 100.0))
_IN_CORRIDOR = Region((0.32, 0.50), (-0.06, 0.06), (0.05, 0.30), (30.0, 100.0))
_OUTSIDE_CORRIDOR = Region((0.10, 0.42), (0.24, 0.38), (0.05, 0.30), (30.0, 100.0))
_THROUGH_WINDOW = Region((0.38, 0.56), (-0.12, 0.12), (0.14, 0.36), (60.0, 110.0))
_BEFORE_WINDOW = Region((0.02, 0.22), (0.18, 0.36), (0.05, 0.30), (20.0, 90.0))

SCENES: Mapping[str, tuple[tuple[Region, Region], ...]] = MappingProxyType(
    {
        "bin": ((_IN_BIN, _BEHIND_POST), (_IN_BIN, _BESIDE_BIN), (_BEHIND_POST, _BESIDE_BIN)),
        "shelf": ((_UNDER_BOARD, _OVER_BOARD),),
        "post": ((_LEFT_OF_POST, _mirrored(_LEFT_OF_POST)),),
        "clutter": (
            (_GAP_AHEAD, _mirrored(_GAP_AHEAD)),
            (_GAP_AHEAD, _GAP_BESIDE),
            (_mirrored(_GAP_AHEAD), _mirrored(_GAP_BESIDE)),
        ),
        "narrow": ((_IN_CORRIDOR, _OUTSIDE_CORRIDOR), (_IN_CORRIDOR, _mirrored(_OUTSIDE_CORRIDOR))),
        "window": ((_THROUGH_WINDOW, _BEFORE_WINDOW), (_THROUGH_WINDOW, _mirrored(_BEFORE_WINDOW))),
    }
)
"""The scenes, each with pairs of regions on opposite sides of what stands in it."""


def draw(scene: str, count: int = PER_SCENE, seed: int = SEED) -> tuple[Query, ...]:
    """The first ``count`` queries of a scene; the same in every call and process of the pinned environment."""
    robot = ps.load_robot(ROBOT)
    checker = ps.CollisionChecker(robot, ps.load_scene(scene))
    # Python's own generator: its documentation promises the same numbers for ever.
    chance = random.Random(f"{seed} {scene}")
    queries: list[Query] = []
    for _ in range(count):
        sides = list(SCENES[scene][chance.randrange(len(SCENES[scene]))])
        chance.shuffle(sides)
        start, goal = (_free_end(robot, checker, side, chance) for side in sides)
        queries.append(Query(scene, len(queries), start, goal, checker.edge_is_free(start, goal)))
    return tuple(queries)


def _free_end(robot: ps.Robot, checker: ps.CollisionChecker, region: Region, chance: random.Random) -> FloatArray:
    for _ in range(DRAWS):
        solutions = ps.inverse_kinematics(robot, _tool(region, chance)).tolist()
        pick = chance.random()  # drawn in any case: what follows does not depend on whether the pose was reachable
        if not solutions:
            continue
        q = [round(value, DECIMALS) for value in solutions[int(pick * len(solutions))]]
        if _inside(robot, q) and checker.state_is_free(q):
            return read_only(q)
    raise ps.BrokenInvariant(f"no free configuration with the tool in {region}")


def _inside(robot: ps.Robot, q: Sequence[float]) -> bool:
    limits = robot.limits
    return bool(np.all(limits.lower <= q) and np.all(q <= limits.upper))


def _tool(region: Region, chance: random.Random) -> ps.Pose:
    """A tool pose: tip in the region, approach (tool x) tilted and turned a little off the arm's plane."""
    x, y, z = (chance.uniform(*side) for side in (region.x, region.y, region.z))
    pitch = math.radians(90.0 - chance.uniform(*region.tilt))
    yaw = math.atan2(y, x) + math.radians(chance.uniform(-25.0, 25.0))
    T = np.eye(4)
    T[:3, :3] = rpy_matrix(math.radians(chance.uniform(-60.0, 60.0)), pitch, yaw)
    T[:3, 3] = x, y, z
    return ps.Pose.from_matrix(T)


def text_of(queries: Sequence[Query]) -> str:
    """The content of a stored file: one query a line."""
    rows = [json.dumps({"start": q.start.tolist(), "goal": q.goal.tolist(), "straight": q.straight}) for q in queries]
    body = ",\n    ".join(rows)
    head = f'  "scene": "{queries[0].scene}",\n  "robot": "{ROBOT}",\n  "seed": {SEED},\n'
    return f'{{\n{head}  "queries": [\n    {body}\n  ]\n}}\n'


def stored_text(scene: str) -> str:
    """The stored file of a scene as it is."""
    return (FOLDER / f"{scene}.json").read_text("utf-8")


def load(scene: str) -> tuple[Query, ...]:
    """The stored queries of a scene."""
    rows = json.loads(stored_text(scene))["queries"]
    return tuple(
        Query(scene, number, read_only(row["start"]), read_only(row["goal"]), row["straight"])
        for number, row in enumerate(rows)
    )
