"""Which motions a few obstacles cannot touch: so that, when these come or move, no other motion is judged again.

The robot's moving pieces are covered by balls, obstacles by boxes; between two configurations no point moves farther
than ``sum(reach_i * |dq_i|)``. So an edge is out of reach if at its middle every ball is farther from every box than
half of that motion; if not, its halves may be (Schwarzer, Saha & Latombe, IEEE T-RO 21(3), 2005). All of it is only
ever too careful: where it is not sure, FCL is asked as ever.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from planner_service.collision.bounds import Solids, centres_of, doubt_of
from planner_service.collision.checker import CollisionChecker
from planner_service.collision.pairs import MANY, Part
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray, along

__all__ = ["Sweep"]

MARGIN = 1e-5
"""Metres that motions stay away beyond the padding: ten times the resolution of FCL."""

FINEST = 0.01
"""Metres of motion below which a stretch is not halved again."""

GROWN = 1.75
"""Where a box, a cylinder or a hull is grown by a padding, its corners go so many times as far: sqrt(3), and more."""

BLOCK, AT_ONCE = 4_096, 1_000_000
"""Edges looked at together, and the robot's balls at the stretches of these, for the sake of memory."""

MIN_BALL, MAX_CUTS = 0.02, 6
"""Pieces are cut into cells not much thinner than this (metres) or than the piece, at most so many along an axis."""


class Sweep:
    """A robot's motions next to some obstacles of its scene, with a checker's padding; bounds are counted there.

    Args:
        names: The obstacles.
    """

    def __init__(self, checker: CollisionChecker, names: Collection[str]) -> None:
        self._robot, self._ledger = checker.robot, checker.ledger
        parts = checker.parts
        riding = [part for part in parts.parts[: parts.riding] if part.moves]
        self._clusters = [_Cluster.of(body, riding) for body in sorted({part.body for part in riding})]
        standing = [parts.parts[first:end] for first, end in parts.runs if parts.parts[first].owner.name in names]
        solids = Solids.of([part.shape for part in (*riding, *chain(*standing))])
        self._kept = GROWN * checker.padding + MARGIN + doubt_of(solids)
        self._boxes = [box for pieces in standing for box in _boxes(pieces)]
        self._pairs = len(riding) * len(self._boxes)
        self._reach: list[float] = checker.robot.reach(parts.carried).tolist()

    def still_free(self, A: FloatArray, B: FloatArray) -> BoolArray:
        """Of edges from A (m, n) to B (m, n), which keep more than the padding from the obstacles all along, (m,).

        True is certain; False means that it could not be told, as of an edge that is not finite.
        """
        blocks = [slice(start, start + BLOCK) for start in range(0, len(A), BLOCK)]
        return np.concatenate([np.zeros(0, dtype=bool), *(self._some(A[rows], B[rows]) for rows in blocks)])

    def _some(self, A: FloatArray, B: FloatArray) -> BoolArray:
        clear = np.asarray(np.isfinite(A).all(axis=1) & np.isfinite(B).all(axis=1))
        owner: IntArray = np.flatnonzero(clear)
        A, B = A[owner], B[owner]
        while len(owner):
            middle = A + (B - A) * 0.5
            half: FloatArray = np.zeros(len(owner))
            for joint, reach in enumerate(self._reach):
                half = half + 0.5 * reach * np.abs(B[:, joint] - A[:, joint])
            room = self._gaps(middle, half + self._kept) - self._kept
            left = ~(room > half)  # also where either is no number
            clear[owner[left & ~((room > 0.0) & (half > 0.5 * FINEST) & (half < np.inf))]] = False
            left &= clear[owner]
            A, B = np.concatenate([A[left], middle[left]]), np.concatenate([middle[left], B[left]])
            owner = np.concatenate([owner[left], owner[left]])
        return clear

    def _gaps(self, Q: FloatArray, enough: FloatArray) -> FloatArray:
        """Lower bounds (metres) of the gaps between robot and obstacles at configurations Q (m, n), (m,).

        Args:
            enough: Beyond this a bound need not be good, (m,).
        """
        balls = sum(len(cluster.radius) for cluster in self._clusters)
        if not self._boxes or not balls:
            self._ledger.charge_distances(len(Q) * self._pairs)
            return np.full(len(Q), np.inf)
        blocks = [slice(start, start + AT_ONCE // balls + 1) for start in range(0, len(Q), AT_ONCE // balls + 1)]
        return np.concatenate([self._gaps_of(Q[rows], enough[rows]) for rows in blocks])

    def _gaps_of(self, Q: FloatArray, enough: FloatArray) -> FloatArray:
        self._ledger.poll()
        self._ledger.charge_distances(len(Q) * self._pairs)
        least = np.full(len(Q), np.inf)
        R, t = self._robot.body_poses_batch(Q)
        for cluster in self._clusters:
            turned, moved = R[:, cluster.body], t[:, cluster.body]
            gap = self._beyond(turned, moved, cluster.middle[None])[:, 0] - cluster.around
            near = np.flatnonzero(gap <= enough)
            if len(near):
                gap[near] = (self._beyond(turned[near], moved[near], cluster.centre) - cluster.radius).min(axis=1)
            least = np.minimum(least, gap)
        return least

    def _beyond(self, R: FloatArray, t: FloatArray, points: FloatArray) -> FloatArray:
        """Metres from points (b, 3) of a body at poses R (m, 3, 3) and t (m, 3) to the nearest box, (m, b)."""
        x, y, z = points.T
        at = [t[:, k, None] + R[:, k, :1] * x + R[:, k, 1:2] * y + R[:, k, 2:] * z for k in range(3)]
        nearest = np.full(at[0].shape, np.inf)
        for R_box, t_box, half in self._boxes:
            square = np.zeros(at[0].shape)
            for axis, reach in zip(R_box.T.tolist(), half.tolist(), strict=True):
                local = sum((a - c) * u for a, c, u in zip(at, t_box.tolist(), axis, strict=True))
                beyond = np.maximum(np.abs(local) - reach, 0.0)
                square = square + beyond * beyond
            nearest = np.minimum(nearest, square)
        return np.asarray(np.sqrt(nearest))


@dataclass(frozen=True, eq=False)
class _Cluster:
    """Balls that cover all pieces on a body, and one around these.

    Attributes:
        body: The body.
        centre: Of each ball, in the body's frame, (b, 3).
        radius: Of each, (b,).
        middle: Centre of the one around all, (3,).
        around: Its radius.
    """

    body: int
    centre: FloatArray
    radius: FloatArray
    middle: FloatArray
    around: float

    @classmethod
    def of(cls, body: int, parts: list[Part]) -> _Cluster:
        """The balls of the parts that ride on a body."""
        centre, radius = _balls([part for part in parts if part.body == body])
        middle = 0.5 * (centre.min(axis=0) + centre.max(axis=0))
        away = centre - middle
        around = np.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2 + away[:, 2] ** 2) + radius
        return cls(body, centre, radius, middle, float(around.max()))


def _balls(parts: list[Part]) -> tuple[FloatArray, FloatArray]:
    """Balls that cover parts on one body: their centres in it (b, 3), and radii (b,)."""
    solids, centres = Solids.of([part.shape for part in parts]), centres_of([part.shape for part in parts])
    at: list[FloatArray] = [np.zeros((0, 3))]
    radius: list[float] = []
    for part, core, middle, round_part in zip(parts, solids.half, centres, solids.ball + solids.disc, strict=True):
        thick = max(MIN_BALL, float(round_part), float(core.min()))
        cuts = np.clip(np.ceil(core / thick), 1, MAX_CUTS)
        lines = [h * ((2 * np.arange(int(n)) + 1) / n - 1) for h, n in zip(core.tolist(), cuts.tolist(), strict=True)]
        cells = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3) + middle
        cell = core / cuts
        at.append(along(part.T[:3, :3], cells) + part.T[:3, 3])
        radius += [float(np.sqrt(cell[0] ** 2 + cell[1] ** 2 + cell[2] ** 2)) + float(round_part)] * len(cells)
    return np.concatenate(at), np.array(radius)


def _boxes(parts: Sequence[Part]) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Boxes that cover the pieces of an obstacle, turned by R (3, 3) at t (3,) with half lengths (3,); of many, one."""
    shapes = [part.shape for part in parts]
    turned = [part.T[:3, :3] for part in parts]
    centres = zip(parts, centres_of(shapes), strict=True)
    at = [along(part.T[:3, :3], centre[None])[0] + part.T[:3, 3] for part, centre in centres]
    halves = list(Solids.of(shapes).box)
    if len(parts) < MANY:
        return list(zip(turned, at, halves, strict=True))
    reach = np.array([along(np.abs(R), half[None])[0] for R, half in zip(turned, halves, strict=True)])
    low, high = (np.array(at) - reach).min(axis=0), (np.array(at) + reach).max(axis=0)
    return [(np.eye(3), 0.5 * (low + high), 0.5 * (high - low))]
