"""The solids of a robot and its scene whose overlap is a collision, as compiled covers of voxels know them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from planner_service.certify.pairs import FIXED, Piece, ProofPairs
from planner_service.decomposition.depth import inside_of
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Sphere
from planner_service.native.loading import load_core
from planner_service.robot.kinematic_tree import body_matrix, chain_to_base
from planner_service.robot.model import Robot
from planner_service.scene.names import Names
from planner_service.scene.scene import Scene

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["obstructed"]

SPHERE, CAPSULE, CYLINDER, BOX, PLANES = range(5)
"""``Solid.Kind`` in native/kinematics/obstruction.hpp."""

MOST_PAIRS = 20_000
"""Pairs of solids from which on nothing is shown to collide everywhere: each box would ask all of them."""


def obstructed(robot: Robot, scene: Scene) -> _core.Obstructed | None:
    """Pairs whose overlap is a collision wherever the robot is; None if there is none, or there are too many.

    Pairs of a fixed way out of a pose are left out, and pieces that joints move which do not move the tool.
    """
    listed, labels = ProofPairs(robot, scene, ()), Names(robot, scene)
    if listed.judged > MOST_PAIRS:
        return None
    excepted = {frozenset(names) for retreat in robot.retreats for names in labels.links(retreat.pairs)}
    pieces = [*listed.riding, *listed.standing]
    links = [_link(robot, piece.body) for piece in pieces]
    pairs, used = list[tuple[int, int]](), dict[int, int]()
    for row, (a, b) in zip((leaves := listed.leaves()).tolist(), listed.of(leaves).tolist(), strict=True):
        one, two = links[a], links[b]
        if one is None or two is None or one == two or frozenset(listed.names(row)) in excepted:
            continue
        pairs.append((used.setdefault(a, len(used)), used.setdefault(b, len(used))))
    if not pairs:
        return None
    rows, balls, planes = list[list[float]](), list[FloatArray](), list[FloatArray]()
    for index in used:
        row, inside, behind = _solid(robot, pieces[index], links[index] or 0)
        rows.append(row)
        balls.append(inside)
        planes.append(behind)
    made: _core.Obstructed = load_core().Obstructed(
        np.array(rows), *_joined(balls), *_joined(planes), np.array(pairs, dtype=np.int64)
    )
    return made


def _joined(tables: list[FloatArray]) -> tuple[IntArray, FloatArray]:
    offsets = np.concatenate([[0], np.cumsum([len(table) for table in tables])]).astype(np.int64)
    return offsets, np.ascontiguousarray(np.concatenate(tables))


def _link(robot: Robot, body: int) -> int | None:
    """How many joints of the tool's chain move a body; None if others do, too."""
    if body == FIXED:
        return 0
    chain = list(reversed(chain_to_base(robot.bodies, robot.tool_body)))
    own = chain_to_base(robot.bodies, body)
    return len(own) if set(own) <= set(chain) else None


def _solid(robot: Robot, piece: Piece, link: int) -> tuple[list[float], FloatArray, FloatArray]:
    """A piece's numbers, balls inside of it (b, 4) and planes that bound it (p, 4), in the base frame at q = 0."""
    T = np.vstack([np.array(piece.frame), [0.0, 0.0, 0.0, 1.0]])
    if piece.body != FIXED:
        T = body_matrix(robot.body_poses(np.zeros(robot.n))[piece.body]) @ T
    shape, R, p = piece.shape, T[:3, :3], T[:3, 3]
    planes, middle = np.zeros((0, 4)), np.zeros(3)
    if isinstance(shape, Sphere):
        kind, size, radius = SPHERE, (shape.radius, 0.0, 0.0), shape.radius
    elif isinstance(shape, Capsule):
        kind, size, radius = CAPSULE, (shape.radius, shape.length / 2.0, 0.0), shape.radius + shape.length / 2.0
    elif isinstance(shape, Cylinder):
        kind, size = CYLINDER, (shape.radius, shape.length / 2.0, 0.0)
        radius = math.hypot(shape.radius, shape.length / 2.0)
    elif isinstance(shape, Box):
        x, y, z = shape.half
        kind, size, radius = BOX, (x, y, z), math.hypot(x, y, z)
    else:
        assert isinstance(shape, Mesh)
        kind, size = PLANES, (0.0, 0.0, 0.0)
        middle = (shape.vertices.min(axis=0) + shape.vertices.max(axis=0)) / 2.0
        radius = float(np.sqrt(((shape.vertices - middle) ** 2).sum(axis=1)).max())
        normals = shape.normals @ R.T
        planes = np.column_stack([normals, shape.offsets + normals @ p])
    inside = inside_of(shape)
    balls = np.column_stack([inside.centres @ R.T + p, inside.radii])
    row = [link, kind, *size, *np.column_stack([R, p]).ravel().tolist(), *(R @ middle + p).tolist(), radius]
    return row, balls, planes
