"""Where the pieces of a proof are, and how far any of their points can move: forward kinematics for the proof alone.

All arithmetic is elementwise, in one fixed order, sines and cosines are libm's: counts and verdicts have equal bits on
every processor. Poses are the first three rows of homogeneous matrices, (3, 4, ...).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from planner_service.certify.pairs import Frame, Piece, ProofPairs
from planner_service.certify.separation import Bounds, Facing, Solids, centre_of
from planner_service.geometry.arrays import FloatArray, IntArray, read_only
from planner_service.robot.model import Body, Robot

__all__ = ["Motion"]


ROUNDING = 1e-9
"""Relative, and far above what a few dozen operations round."""

CLEARANCE_ROUNDS = 20
"""Steps of the search for the best direction of a clearance."""

STEP = 1e-6
"""Radians (or metres) by which a joint is moved to either side for a slope."""


class _Joints:
    """What moves the bodies of a robot, whatever rides on them.

    Attributes:
        parents: Of each body.
        columns: The entry of q that moves each; 0 for what no joint moves.
        multipliers: How far each moves per unit of that entry.
        moved: Which a joint moves.
        sliding: Which slide.
        tables: The poses of all in their parents, as ``_joint`` splits them, (3, 4, 1, bodies) each.
        axes: Unit vectors in the joint frames, (3, 1, bodies).
        steps: Of each two bodies how many joints move only the one and only the other, (bodies, bodies, 2).
        numbers: All of this for compiled code, as ``Motion.tables`` has it, (bodies, 55).
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        self.parents = [body.parent for body in bodies]
        self.columns = np.array([max(body.q_index, 0) for body in bodies], dtype=np.intp)
        self.multipliers = np.array([body.multiplier for body in bodies])
        self.moved = np.array([body.q_index >= 0 for body in bodies])
        self.sliding = np.array([body.prismatic for body in bodies])
        self.tables = [np.stack(tables, axis=2)[:, :, None] for tables in zip(*map(_joint, bodies), strict=True)]
        self.axes = np.array([body.axis.tolist() for body in bodies]).T[:, None, :]
        chains = [_chain(self.parents, body) for body in range(len(bodies))]
        self.steps = np.array([[_steps(one, two) for two in chains] for one in chains], dtype=np.intp)
        columns = np.where(self.moved, self.columns, -1)
        tables = [table[:, :, 0].transpose(2, 0, 1).reshape(-1, 12) for table in self.tables]
        self.numbers = read_only(
            np.column_stack([self.parents, columns, self.sliding, self.axes[:, 0].T, *tables, self.multipliers])
        )


@lru_cache(maxsize=16)
def _joints_of(bodies: tuple[Body, ...]) -> _Joints:
    """Built once for all grippers, windows of endless joints and scenes."""
    return _Joints(bodies)


class _Arm:
    """Poses and motion bounds of the pieces that ride on a robot; they do not depend on what stands around it.

    Between two nodes of a path joint k travels ``t_k``, its total variation (a multiple of that of the joint that it
    mimics). Against the parent of an ancestor j a
    point of a body moves by at most ``sum r_k t_k`` over the joints k from j outwards to the body, r_k its largest
    distance from axis k on the way: an arc is no longer than radius times angle, and joints inside j move both alike.
    r_k changes only by the joints outside k: if m bounds the motion by these, then at x between nodes a and b
    ``r_k(x) <= min(r_k(a) + m(a, x), r_k(b) + m(x, b)) <= (r_k(a) + r_k(b) + m(a, b)) / 2``. So the sum is built from
    the outermost joint inwards. Two bodies move against each other by no more than each moves against the last body
    that carries both, together.

    Along one direction they come closer by less (native/places.cpp: bends). Let the joints go evenly from a to b, by
    d_k each. The second derivative of where a point is, by joints k and j, is no longer than r_k where j is at or
    inside k, for joint j turns the velocity that k gives. So a point leaves the line from its one place to the other by
    no more than ``sum r_k d_k (d_k / 8 + sum d_j / 4)``, j inside k; and along a direction that stays as it is for the
    last body that carries both, two bodies come no closer than at the nearer end, less what each leaves its line there.
    Where joint k strays from going evenly by e_k at most, ``r_k e_k`` is added: a function whose slopes are in [m, M]
    leaves the line between its ends, h apart, by no more than ``h (M - m) / 4``. A straight line strays by nothing, and
    around a corner, blended or not, slopes go from those before it to those after it and not back.

    Attributes:
        n: Length of q.
        limits: Of q, lower and upper, (2, n).
        depth: How many joints move the piece that most joints move.
        joints: How many move each piece, (pieces,).
        steps: Of each two pieces how many joints move only the one and only the other, (2, pieces, pieces).
        body: Of each piece, (pieces,).
        local: The pose of each piece in its body, (3, 4, 1, pieces).
    """

    def __init__(self, robot: Robot, riding: Sequence[Piece]) -> None:
        self.n = robot.n
        self.limits = np.stack(robot.bounds)
        self._joints = joints = _joints_of(robot.bodies)
        self._riding = len(riding)
        self._solids = Solids.of([piece.shape for piece in riding])
        self.local = _table([_centred(piece) for piece in riding])[:, :, None]
        self.body = np.array([piece.body for piece in riding], dtype=np.intp)
        self._links = chains = [_chain(joints.parents, piece.body) for piece in riding]
        self.depth = max(map(len, chains), default=0)
        padded = [chain + [0] * (self.depth - len(chain)) for chain in chains]  # with the base, which no joint moves
        self._chains = np.array(padded, dtype=np.intp).reshape(len(riding), self.depth).T
        self._slides = joints.sliding[self._chains]
        self._radius = self._solids.radius()
        self._far = self._farthest(robot, chains)
        self.joints: IntArray = np.array([len(chain) for chain in chains], dtype=np.intp)
        self.steps: IntArray = joints.steps[self.body[:, None], self.body].transpose(2, 0, 1)

    @cached_property
    def tables(self) -> tuple[FloatArray, FloatArray]:
        """Bodies and links as ``Motion.tables`` has them."""
        links = [(k, body, self._far[row, k]) for k, chain in enumerate(self._links) for row, body in enumerate(chain)]
        return self._joints.numbers, read_only(np.array(links).reshape(-1, 3))

    def _farthest(self, robot: Robot, chains: Sequence[Sequence[int]]) -> FloatArray:
        """Distances from the joint axes that no configuration within the limits exceeds, (depth, pieces)."""
        ends = np.maximum(np.abs(robot.limits.lower), np.abs(robot.limits.upper)).tolist()
        out = np.zeros(self._chains.shape)
        for column, chain in enumerate(chains):
            total = _length(self.local[:, 3, 0, column]) + float(self._radius[column])
            for row, body in enumerate(robot.bodies[index] for index in chain):
                out[row, column] = total * (1.0 + ROUNDING)
                slide = abs(body.multiplier) * ends[body.q_index] if body.prismatic else 0.0
                total += _length(body.placement[:3, 3]) + slide
        return out

    def nodes(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Configurations q (m, n) as nodes of a proof.

        Returns:
            World poses of the riding pieces, (3, 4, m * riding), and upper bounds of how far points of each of them are
            from the axes that move it, its own body's first, then inwards, (m, depth, riding).
        """
        bodies = self._body_poses(q)
        poses = self._poses(bodies)
        return poses.reshape(3, 4, -1), self._radii(bodies, poses)

    def poses(self, q: FloatArray) -> FloatArray:
        """World poses of the riding pieces at configurations q (m, n), (3, 4, m, riding)."""
        return self._poses(self._body_poses(q))

    def _poses(self, bodies: FloatArray) -> FloatArray:
        return _composed(bodies[..., self.body], self.local)

    def _body_poses(self, q: FloatArray) -> FloatArray:
        """World poses (3, 4, m, bodies)."""
        joints = self._joints
        angles = q[:, joints.columns] * joints.multipliers
        flat = angles.ravel().tolist()
        cos = np.fromiter(map(math.cos, flat), np.float64, len(flat)).reshape(angles.shape)
        sin = np.fromiter(map(math.sin, flat), np.float64, len(flat)).reshape(angles.shape)
        still, with_cos, with_sin, with_q = joints.tables
        out: FloatArray = still + with_cos * cos + with_sin * sin + with_q * angles
        for index, parent in enumerate(joints.parents[1:], start=1):
            out[..., index] = _composed(out[..., parent], out[..., index])
        return out

    def _radii(self, bodies: FloatArray, poses: FloatArray) -> FloatArray:
        """Bounds of the distances from the axes, (m, depth, pieces).

        Let c lead from the axis to the centre of a piece, square to the axis, and w from there to one of its points.
        The part of ``c + w`` across the axis has a square of at most ``|c|^2 + 2 c . w + |w|^2``, and ``c . w`` is at
        most |c| times the support value of the piece along c.
        """
        R, axis = bodies[:, :3], self._joints.axes
        axes = R[:, 0] * axis[0] + R[:, 1] * axis[1] + R[:, 2] * axis[2]
        z = axes[:, :, self._chains]
        x = poses[:, 3, :, None] - bodies[:, 3][:, :, self._chains]
        c = x - (x[0] * z[0] + x[1] * z[1] + x[2] * z[2]) * z
        S = poses[:, :3, :, None]
        u, v, w = c[0] * S[0] + c[1] * S[1] + c[2] * S[2]
        across = u * u + v * v
        square = across + w * w
        half, disc, ball = self._solids.half, self._solids.disc, self._solids.ball
        support = np.abs(u) * half[0] + np.abs(v) * half[1] + np.abs(w) * half[2]
        support = support + disc * np.sqrt(across) + ball * np.sqrt(square)
        if self._solids.hulls is not None:  # along c itself, of whatever length
            support = self._solids.hulls.extended(np.stack([u, v, w], axis=-2), support)
        radii = np.sqrt(square + 2.0 * support + self._radius * self._radius)
        return np.asarray(np.minimum(radii, self._far))

    def motions(self, radii_a: FloatArray, radii_b: FloatArray, travel: FloatArray) -> FloatArray:
        """How far points of the riding pieces move between nodes a and b, at most, (depth + 1, m, pieces).

        Entry k is the motion against the parent of the k-th joint of the piece's chain, its own joint being the first.

        Args:
            radii_a, radii_b: Of the nodes at both ends of m stretches, (m, depth, pieces).
            travel: What the joints of q travel in between, (m, n).
        """
        radii = 0.5 * (radii_a + radii_b)
        joints = self._joints
        per_body = np.where(joints.moved, travel[:, joints.columns] * np.abs(joints.multipliers), 0.0)
        out = np.zeros((self.depth + 1, len(travel), self._riding))
        for k, chain in enumerate(self._chains):
            radius = np.minimum(radii[:, k] + 0.5 * out[k], self._far[k])
            out[k + 1] = out[k] + np.where(self._slides[k], 1.0, radius) * per_body[:, chain]
        return out


@lru_cache(maxsize=64)
def _arm_of(robot: Robot, riding: tuple[Piece, ...]) -> _Arm:
    """Built once for all scenes in which the robot holds nothing else."""
    return _Arm(robot, riding)


class Motion:
    """Poses, gaps and motion bounds of the listed pairs of one robot.

    Attributes:
        n: Length of q.
        limits: Of q, lower and upper, (2, n).
        listed: The pairs.
        riding: How many pieces ride.
        depth: How many joints move the piece that most joints move.
    """

    def __init__(self, robot: Robot, listed: ProofPairs) -> None:
        self._arm = arm = _arm_of(robot, listed.riding)
        self.listed, self.n, self.limits = listed, arm.n, arm.limits
        self.riding, self.depth = len(listed.riding), arm.depth
        self._kinds = (*(piece.shape for piece in listed.riding), *listed.standing.shapes)
        self._solids = Solids.of(self._kinds)
        self._solid_of = np.concatenate([np.arange(self.riding), listed.standing.kinds + self.riding])

    @property
    def tables(self) -> tuple[Any, ...]:
        """All of this as numbers, for compiled code.

        The length of q; of each body parent, entry of q (-1: none), whether it slides, axis, and four 3 x 4 tables
        (``_joint``), and multiplier, (bodies, 55); of each piece that rides body and frame, (riding, 13); of each and
        each body that carries it, its own first, piece, body and distance from the axis, (k, 3); corners (v, 3) of the
        hulls; solids, those of bundles last: half lengths, disc, ball, radius, number of its hull (-1: none), (s, 7);
        the solid of each piece, (pieces,); rotations, (r, 9); that of each piece and bundle that stands, (k,), and
        where it is, (k, 3); of plain pairs pieces, joints that move only the one and only the other, (p, 4); of trees
        the first piece and how many, the first bundle and how many, (t, 4); children of their bundles, (b, 2); of each
        block piece, tree and joints that move the piece, (b, 3); limits of q, lower and upper, (2, n).
        """
        arm, listed, standing = self._arm, self.listed, self.listed.standing
        solids, trees = self._solids, listed.trees
        sizes = np.concatenate([np.zeros((0, 3)), *(tree.size for tree in trees)])
        bundles = Solids(0.5 * sizes.T, np.zeros(len(sizes)), np.zeros(len(sizes)))
        rows = [
            np.column_stack([each.half.T, each.disc, each.ball, each.radius(), _hull_numbers(each)])
            for each in (solids, bundles)
        ]
        solid_of = np.concatenate([self._solid_of, np.arange(len(sizes)) + len(solids.disc)])
        counts = [len(tree.bundles) for tree in trees]
        rotations = np.concatenate([standing.rotations, *(tree.rotation[None] for tree in trees)])
        turns = [standing.turns, len(standing.rotations) + np.repeat(np.arange(len(trees)), counts)]
        positions = [self._centres(np.arange(len(standing))), *(tree.centre for tree in trees)]
        own = [[tree.pieces.start, len(tree.pieces), tree.bundles.start, len(tree.bundles)] for tree in trees]
        bodies, links = arm.tables
        frames = arm.local[:, :, 0].transpose(2, 0, 1).reshape(-1, 12)
        riders = np.column_stack([arm.body, frames])
        hulls = [] if solids.hulls is None else solids.hulls.clouds()
        pairs = np.column_stack([listed.plain, self._steps(listed.plain).T])
        children = np.concatenate([np.zeros((0, 2), dtype=np.intp), *(tree.children for tree in trees)])
        blocks = np.column_stack([listed.blocks, arm.joints[listed.blocks[:, 0]]])
        return (
            *(self.n, bodies, riders, links, hulls, np.concatenate(rows), solid_of),
            *(rotations.reshape(-1, 9), np.concatenate(turns), np.concatenate(positions)),
            *(pairs, np.array(own, dtype=np.intp).reshape(-1, 4), children, blocks, self.limits),
        )

    def _steps(self, pieces: IntArray) -> IntArray:
        """Of pairs of pieces (k, 2) how many joints move only the one and only the other, (2, k)."""
        first, second = pieces.T
        rides = second < self.riding
        out = np.zeros((2, len(pieces)), dtype=np.intp)
        out[0] = self._arm.joints[first]
        out[:, rides] = self._arm.steps[:, first[rides], second[rides]]
        return out

    def _centres(self, number: IntArray) -> FloatArray:
        """Where the solids of pieces that stand have their centres, these counted without those that ride, (k, 3)."""
        standing = self.listed.standing
        centre = np.array([centre_of(shape) for shape in standing.shapes]).reshape(-1, 3)
        x, y, z = centre[standing.kinds[number]].T
        positions = standing.positions[number].T
        moved = np.flatnonzero((x != 0.0) | (y != 0.0) | (z != 0.0))
        if len(moved):
            rows = standing.rotations[standing.turns[number[moved]]].transpose(1, 2, 0)
            x, y, z = x[moved], y[moved], z[moved]
            positions = positions.copy()
            positions[:, moved] = rows[:, 0] * x + rows[:, 1] * y + rows[:, 2] * z + positions[:, moved]
        return np.ascontiguousarray(positions.T)

    def fixed(self, pieces: IntArray) -> FloatArray:
        """World poses of pieces that stand, (3, 4, k)."""
        number = pieces - self.riding
        standing = self.listed.standing
        rotations = standing.rotations[standing.turns[number]]
        frames: FloatArray = np.concatenate([rotations, self._centres(number)[:, :, None]], axis=2)
        return frames.transpose(1, 2, 0)

    def poses(self, q: FloatArray) -> FloatArray:
        """As ``_Arm.poses``."""
        return self._arm.poses(q)

    def nodes(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As ``_Arm.nodes``."""
        return self._arm.nodes(q)

    def motions(self, radii_a: FloatArray, radii_b: FloatArray, travel: FloatArray) -> FloatArray:
        """As ``_Arm.motions``."""
        return self._arm.motions(radii_a, radii_b, travel)

    def pair_motions(self, motions: FloatArray, pair: IntArray, stretch: IntArray) -> FloatArray:
        """How far the pieces of pairs move against each other on stretches, at most: picked from ``motions``."""
        pieces = self.listed.of(pair)
        own, other = self._steps(pieces)
        first, second = pieces.T
        partner = np.where(second < self.riding, second, 0)  # an obstacle has no steps: entry 0 is no motion
        return np.asarray(motions[own, stretch, first] + motions[other, stretch, partner])

    def _placed(self, poses: FloatArray, piece: IntArray, node: IntArray) -> FloatArray:
        """World poses of pieces at nodes, (3, 4, k)."""
        rides = piece < self.riding
        out = np.empty((3, 4, len(piece)))
        out[:, :, rides] = poses[:, :, node[rides] * self.riding + piece[rides]]
        out[:, :, ~rides] = self.fixed(piece[~rides])
        return out

    def second_axes(self, poses: FloatArray, pair: IntArray) -> FloatArray:
        """Which way the second pieces of pairs stand at the first node, as columns, (3, 3, pairs)."""
        return self._placed(poses, self.listed.of(pair)[:, 1], np.zeros(len(pair), dtype=np.intp))[:, :3]

    def facing(self, poses: FloatArray, pair: IntArray, node: IntArray) -> Facing:
        """Pairs without bundles as they stand at nodes; ``poses`` are those of one node after the other."""
        first, second = self.listed.of(pair).T
        a, b = (self._solids.take(self._solid_of[piece]) for piece in (first, second))
        return Facing.of(a, b, *(self._placed(poses, piece, node) for piece in (first, second)))

    def slopes(self, q: FloatArray, pair: IntArray, n: FloatArray) -> FloatArray:
        """How gaps of pairs change with each joint at q (n,), metres per rad or m, (pairs, n).

        Along fixed directions (3, pairs): where a gap is the largest along any, this is how the gap itself changes.
        """
        Q = np.repeat(q[None], 2 * len(q), axis=0)
        joints = np.arange(len(q))
        Q[2 * joints, joints] += STEP
        Q[2 * joints + 1, joints] -= STEP
        poses = self.nodes(Q)[0]
        node = np.repeat(np.arange(len(Q)), len(pair))
        facing = self.facing(poses, np.tile(pair, len(Q)), node)
        gaps = facing.along(np.tile(n, len(Q))).reshape(len(q), 2, len(pair))
        return np.asarray((gaps[:, 0] - gaps[:, 1]).T / (2.0 * STEP))

    def along_deepest(self, q: FloatArray, pair: IntArray, owner: IntArray, found: Bounds) -> Bounds:
        """Gaps of pairs at q (n,) along one direction for all of an owner (p,): that of its smallest in ``found``."""
        poses = self.nodes(q[None])[0]
        facing = self.facing(poses, pair, np.zeros(len(pair), dtype=np.intp))
        turns = self.second_axes(poses, pair)
        out = found.n.copy()
        for each in np.unique(owner).tolist():
            rows = np.flatnonzero(owner == each)
            deepest = rows[found.gaps[rows].argmin()]
            u, v, w = found.n[:, deepest]
            R = turns[:, :, deepest]
            x, y, z = R[:, 0] * u + R[:, 1] * v + R[:, 2] * w  # in the world
            S = turns[:, :, rows]
            out[:, rows] = S[0] * x + S[1] * y + S[2] * z
        return Bounds(facing.along(out), out)


def _hull_numbers(solids: Solids) -> IntArray:
    """The number of the hull that each solid is, -1 for others."""
    return np.full(len(solids.disc), -1, dtype=np.intp) if solids.hulls is None else solids.hulls.rows


def _centred(piece: Piece) -> Frame:
    """The frame of a piece, moved to the centre of its solid."""
    x, y, z = centre_of(piece.shape)
    a, b, c = ((row[0], row[1], row[2], row[0] * x + row[1] * y + row[2] * z + row[3]) for row in piece.frame)
    return (a, b, c)


def _table(frames: Sequence[Sequence[Sequence[float]]]) -> FloatArray:
    """Frames one after the other, (3, 4, k)."""
    return np.ascontiguousarray(np.array(frames, dtype=np.float64).reshape(-1, 3, 4).transpose(1, 2, 0))


def _joint(body: Body) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """T_parent_body as the sum of four 3 x 4 tables: constant, times cos x, times sin x, times x (Rodrigues).

    x is what the body moves by: its multiplier times its entry of q.
    """
    still, with_cos, with_sin, with_q = (np.zeros((3, 4)) for _ in range(4))
    P = body.placement[:3, :3]
    x, y, z = body.axis.tolist()
    unit = np.eye(3)
    along = np.array([[a * b for b in (x, y, z)] for a in (x, y, z)])
    still[:, 3] = body.placement[:3, 3]
    if body.q_index < 0:
        still[:, :3] = P
    elif body.prismatic:
        still[:, :3] = P
        with_q[:, 3] = P[:, 0] * x + P[:, 1] * y + P[:, 2] * z
    else:
        still[:, :3] = _product(P, along)
        with_cos[:, :3] = _product(P, unit - along)
        with_sin[:, :3] = _product(P, np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))
    return still, with_cos, with_sin, with_q


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """3 x 3 times 3 x n, with additions in a fixed order."""
    return np.asarray(a[:, 0, None] * b[0] + a[:, 1, None] * b[1] + a[:, 2, None] * b[2])


def _composed(a: FloatArray, b: FloatArray) -> FloatArray:
    """Poses b, given in a, in what a is given in; (3, 4, ...) each, broadcast."""
    out: FloatArray = a[:, 0, None] * b[0] + a[:, 1, None] * b[1] + a[:, 2, None] * b[2]
    out[:, 3] += a[:, 3]
    return out


def _chain(parents: Sequence[int], body: int) -> list[int]:
    """Moving bodies from ``body`` inwards."""
    out = []
    while body > 0:
        out.append(body)
        body = parents[body]
    return out


def _steps(first: Sequence[int], second: Sequence[int]) -> tuple[int, int]:
    """How many of the outermost joints of each of two chains do not move the other one too."""
    return sum(k not in second for k in first), sum(k not in first for k in second)


def _length(vector: FloatArray) -> float:
    x, y, z = vector.tolist()
    return math.sqrt(x * x + y * y + z * z)
