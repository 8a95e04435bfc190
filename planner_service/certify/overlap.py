"""The proof that a robot collides at every configuration of a box of joint values: two pieces overlap in all of it.

Let w_1 ... w_4 be differences a_i - b_i of points of two convex pieces, seen from the second, and let a ball of radius
r about the origin lie in their tetrahedron. Wherever the pieces have moved by less than r against each other, each w_i
has moved by less than r. Then along every direction some w_i is still beyond the origin, so that the tetrahedron still
holds it (separating hyperplanes): the same shares of the a_i and of the b_i make one point, which both pieces have. How
the points were found does not matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planner_service.certify.certifier import Certifier
from planner_service.certify.hulls import dot, nearest_of
from planner_service.certify.separation import Facing
from planner_service.geometry.arrays import FloatArray, IntArray

__all__ = ["Overlap", "proven_overlap"]

MOST_PAIRS = 12
"""Pairs of pieces tried, the deepest first."""

MOST_POINTS = 24
"""Points of the difference set that are added, each where the tetrahedron is thinnest."""

ROUNDING = 1e-9
"""Metres, far above what a few dozen operations on coordinates below 1,000 m round."""

_HEIGHTS, _TURNS = np.linspace(-1.0, 1.0, 26), np.arange(26) * (math.pi * (3.0 - math.sqrt(5.0)))
DIRECTIONS = np.stack(
    [np.sqrt(1.0 - _HEIGHTS**2) * np.cos(_TURNS), np.sqrt(1.0 - _HEIGHTS**2) * np.sin(_TURNS), _HEIGHTS]
)
"""Unit vectors all around, (3, 26)."""

FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Corners of a tetrahedron's faces; the one that is missing is that of the same number."""


@dataclass(frozen=True)
class Overlap:
    """Two things that overlap wherever the joints are in a box.

    Attributes:
        a: A link of the robot, or an object it carries.
        b: What it overlaps.
        motion: Metres by which the joints can move the one against the other within half of the box.
        room: Metres by which they could move and still overlap; larger than ``motion``.
    """

    a: str
    b: str
    motion: float
    room: float


def proven_overlap(certifier: Certifier, lower: FloatArray, upper: FloatArray) -> Overlap | None:
    """Two things that overlap at each q within a box (n,), n each, of joint values within the limits, or next to them.

    None if it is not proven of any: pieces that only touch, or less deeply than the box is wide.
    """
    middle, half = (lower + upper) / 2.0, (upper - lower) / 2.0
    listed, motion = certifier.listed, certifier.motion
    _, pairs, bounds = certifier.prover.near(middle[None], listed.roots, 0.0)
    deepest = np.argsort(bounds.gaps, kind="stable")[:MOST_PAIRS]
    pairs, ways = pairs[deepest], bounds.n[:, deepest]
    if not len(pairs):
        return None
    poses, _ = motion.nodes(middle[None])
    anywhere = np.full((1, motion.depth, motion.riding), np.inf)
    moved = motion.pair_motions(
        motion.motions(anywhere, anywhere, half[None]), pairs, np.zeros(len(pairs), dtype=np.intp)
    )
    for k, pair in enumerate(pairs.tolist()):
        facing = motion.facing(poses, np.array([pair]), np.zeros(1, dtype=np.intp))
        room = _room(facing, ways[:, k], float(moved[k]) + ROUNDING) - ROUNDING
        if room > float(moved[k]):
            return Overlap(*listed.names(pair), float(moved[k]), room)
    return None


def _room(facing: Facing, way: FloatArray, enough: float) -> float:
    """The radius of a ball about the origin within a tetrahedron of points of a - b; negative if none was found.

    No better one is looked for once it is twice what is ``enough``.
    """
    directions = np.column_stack([DIRECTIONS, way, -way])
    points = _farthest(facing, directions / np.sqrt((directions**2).sum(axis=0)))
    enclosing = _enclosing(facing, way)
    inside = float(_inside(enclosing[:, :, None])[0][0])
    if inside > 2.0 * enough:
        return inside
    points = np.column_stack([enclosing, points])
    corners: IntArray = np.arange(4)
    for _ in range(MOST_POINTS):
        corners, inside, outward = _exchanged(points, corners)
        if inside > 2.0 * enough:
            break
        other = _farthest(facing, outward[:, None])
        if float(np.abs(points - other).max(axis=0).min()) < 1e-12:
            break
        points = np.column_stack([points, other])
    return inside


def _enclosing(facing: Facing, way: FloatArray) -> FloatArray:
    """Four points of a - b around the origin, (3, 4), if the walk to its nearest point comes that far.

    (Gilbert, Johnson & Keerthi, IEEE J. Robotics and Automation 4(2), 1988.)
    """
    point = _farthest(facing, way[:, None])
    kept = np.repeat(point[None], 3, axis=0)
    for _ in range(MOST_POINTS):
        before = np.concatenate([kept, point[None]])[:, :, 0].T
        nearest, kept, going = nearest_of(kept, point)
        size = float(np.sqrt(dot(nearest, nearest))[0])
        if not going[0] or size < 1e-12:
            return before
        point = _farthest(facing, -nearest / size)
    return before


def _farthest(facing: Facing, n: FloatArray) -> FloatArray:
    """Points of a - b that are farthest along unit directions (3, k), (3, k)."""
    one = facing.take(np.zeros(n.shape[1], dtype=np.intp))
    return np.asarray(one.difference(-n) + n * one.balls)


def _exchanged(points: FloatArray, corners: IntArray) -> tuple[IntArray, float, FloatArray]:
    """Corners changed one by one while the ball inside grows, its radius, and in which direction that ends."""
    best, outward = _inside(points[:, corners][:, :, None])
    inside, out = float(best[0]), outward[:, 0]
    while True:
        tries = np.repeat(corners[None], 4 * points.shape[1], axis=0)
        for place in range(4):
            rows = slice(place * points.shape[1], (place + 1) * points.shape[1])
            tries[rows, place] = np.arange(points.shape[1])
        radii, ways = _inside(points[:, tries.T])
        first = int(radii.argmax())
        if not radii[first] > inside + 1e-12:
            return corners, inside, out
        corners, inside, out = tries[first], float(radii[first]), ways[:, first]


def _inside(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of tetrahedra (3, 4, k) the least distance of the origin from a face (negative outside), and its normal."""
    least: FloatArray = np.full(corners.shape[2], np.inf)
    normals: FloatArray = np.zeros((3, corners.shape[2]))
    for opposite, (i, j, k) in enumerate(FACES.tolist()):
        a = corners[:, i]
        n = np.cross(corners[:, j] - a, corners[:, k] - a, axis=0)
        size = np.sqrt((n**2).sum(axis=0))
        n = n / np.maximum(size, 1e-300)
        across = (n * (corners[:, opposite] - a)).sum(axis=0)
        n = np.where(across > 0.0, -n, n)
        flat = (size < 1e-12) | (np.abs(across) < 1e-9)
        distance = np.where(flat, -1e3, (n * a).sum(axis=0))
        nearer = distance < least
        least, normals = np.where(nearer, distance, least), np.where(nearer, n, normals)
    return least, normals
