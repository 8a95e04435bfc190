"""Boxes of joint values in which a robot collides wherever it is: its walls.

At the centre of a box a ball inside of one solid reaches into another one by some depth. While the joints stay in the
box, the centre of the ball does not move by more than a bound against the other solid: for each joint, from the
outermost inwards, half of the box's width times the distance from the axis, and never more than twice this distance.
Where the depth is larger than the bound, every configuration of the box collides. A joint that the box says nothing
about may be anywhere in its range; that costs little where the ball lies on its axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.certify import MARGIN
from planner_service.certify.pairs import FIXED, Piece, ProofPairs
from planner_service.decomposition.depth import inside_of
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Shape, Sphere
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot.model import Robot
from planner_service.scene.names import Names
from planner_service.scene.scene import Scene

__all__ = ["Judgement", "Middle", "SolidPair", "Walls", "Witness", "solid_pairs"]

ROUNDING = 1e-9
"""Relative, and far above what rounding does to a motion bound."""

PROJECTIONS = 8
"""Of a ball's centre on both cores: each about halves how far it is from the deepest place."""

SHARES = (1.0, 0.25, 0.05)
"""Of the largest radius, of the balls that slide: a small one in a corner shows what barely overlaps."""

CHORD = 2.0
"""Times the distance from an axis: no turn moves a point farther."""


MOST_PAIRS = 2_000_000
"""Pairs of solids, as of a cloud of 50,000 boxes around an arm of 40 pieces."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Where all bodies are in m configurations.

    Attributes:
        R, p: Orientations (bodies, 3, 3, m) and positions (bodies, 3, m).
        axes: Those of the joints, in the world, (bodies, 3, m).
    """

    R: FloatArray
    p: FloatArray
    axes: FloatArray

    @classmethod
    def at(cls, robot: Robot, Q: FloatArray) -> Frames:
        """In configurations Q (m, n)."""
        R, p = robot.body_poses_batch(Q, portable=True)
        R, p = np.ascontiguousarray(R.transpose(1, 2, 3, 0)), np.ascontiguousarray(p.transpose(1, 2, 0))
        x, y, z = np.array([body.axis for body in robot.bodies]).T[:, :, None, None]
        return cls(R, p, R[:, :, 0] * x + R[:, :, 1] * y + R[:, :, 2] * z)

    def of(self, rows: IntArray | BoolArray) -> Frames:
        """In some of the configurations."""
        return Frames(self.R[..., rows], self.p[..., rows], self.axes[..., rows])

    def from_axis(self, points: FloatArray, body: int) -> FloatArray:
        """How far points (3, m, b) of the world are from the axis of a body, (m, b)."""
        a, b, c = self.axes[body, :, :, None]
        x, y, z = points - self.p[body, :, :, None]
        i, j, k = y * c - z * b, z * a - x * c, x * b - y * a
        return np.asarray(np.sqrt(i * i + j * j + k * k))


@dataclass(frozen=True, eq=False)
class SolidPair:
    """Two convex solids that must be apart.

    Attributes:
        names: Of their owners.
        solids: The two; the second may stand in the world.
        moving: For each of the two the bodies that move it against the other, its own first.
        columns: The entries of q on which their relative pose depends.
    """

    names: tuple[str, str]
    solids: tuple[_Solid, _Solid]
    moving: tuple[tuple[int, ...], tuple[int, ...]]
    columns: frozenset[int]


@dataclass(frozen=True, eq=False)
class Judgement:
    """What was found out about m boxes.

    Attributes:
        pair: The number of a pair that overlaps all over the box, (m,); -1 where none is known to.
        doubtful: Of each pair whether it may be shown to overlap in some box within, (m, pairs).
    """

    pair: IntArray
    doubtful: BoolArray


@dataclass(frozen=True, eq=False)
class Witness:
    """What shows that boxes are walls: a point of each of the two solids, and how deep it lies in it.

    Attributes:
        centres: (m, 2, 3), in the frame of the body that each solid is fixed to, or of the world.
        depths: (m, 2), at least; of the second, negative where the point is outside by no more than that.
    """

    centres: FloatArray
    depths: FloatArray


def solid_pairs(robot: Robot, scene: Scene, allowed: Iterable[tuple[str, str]]) -> list[SolidPair]:
    """The pairs whose overlap is a collision wherever the robot is: those of a fixed way out are not.

    None where there are more than ``MOST_PAIRS``: so few boxes could be judged that there would be no proof.
    """
    listed, labels = ProofPairs(robot, scene, allowed), Names(robot, scene)
    if listed.judged > MOST_PAIRS:
        return []
    excepted = {frozenset(names) for retreat in robot.retreats for names in labels.links(retreat.pairs)}
    solids = [_Solid(piece) for piece in (*listed.riding, *listed.standing)]
    chains = [() if s.body == FIXED else tuple(chain_to_base(robot.bodies, s.body)) for s in solids]
    out = []
    for row, (a, b) in zip((leaves := listed.leaves()).tolist(), listed.of(leaves).tolist(), strict=True):
        names, one, two = listed.names(row), chains[a], chains[b]
        moving = tuple(k for k in one if k > 0 and k not in two), tuple(k for k in two if k > 0 and k not in one)
        columns = frozenset(robot.bodies[body].q_index for body in (*moving[0], *moving[1]))
        if columns and frozenset(names) not in excepted:
            out.append(SolidPair(names, (solids[a], solids[b]), moving, columns))
    return out


class Middle:
    """A robot with all joints in the middle of their ranges.

    Attributes:
        q: The configuration, (n,); 0 for a joint without end.
        half: Half of the ranges, (n,), or infinite.
    """

    def __init__(self, robot: Robot) -> None:
        lower, upper = robot.bounds
        self.robot = robot
        self.q = np.where(np.isfinite(lower + upper), 0.5 * (lower + upper), 0.0)
        self.half = np.asarray(0.5 * (upper - lower) * (1.0 + ROUNDING))
        self._frames = Frames.at(robot, self.q[None])
        self._distances: dict[tuple[_Solid, int], FloatArray] = {}

    def distances(self, solid: _Solid, body: int) -> FloatArray:
        """How far the centres of the balls of a solid are from the axis of a body that turns, (b,)."""
        key = solid, body
        if key not in self._distances:
            self._distances[key] = self._frames.from_axis(solid.points(self._frames), body)[0]
        return self._distances[key]


class _FreeMotion:
    """How far the balls of solids move, at most, with the joints that boxes say nothing about."""

    def __init__(self, middle: Middle, columns: Sequence[int]) -> None:
        self._middle = middle
        self.half = middle.half.copy()
        self.half[list(columns)] = 0.0
        self._known: dict[tuple[_Solid, tuple[int, ...]], tuple[FloatArray, float]] = {}

    def of(self, solid: _Solid, chain: tuple[int, ...]) -> tuple[FloatArray, float]:
        """With a chain of bodies against the one that carries them, (b,), and the least of these."""
        key = solid, chain
        if key not in self._known:
            out: FloatArray = np.zeros(solid.centres.shape[1])
            for index in chain:
                body = self._middle.robot.bodies[index]
                way = float(self.half[body.q_index]) * abs(body.multiplier)
                if way > 0.0:
                    turned = 0.0 if body.prismatic else self._middle.distances(solid, index) + out
                    out = out + (way if body.prismatic else min(way, CHORD) * turned)
            self._known[key] = out, float(out.min(initial=math.inf))
        return self._known[key]

    def loose(self, chain: tuple[int, ...]) -> tuple[tuple[int, ...], float]:
        """The bodies of a chain that boxes say nothing about; 1 and what these move by, if their axes were 1 away."""
        bodies, change = self._middle.robot.bodies, 1.0
        out = tuple(index for index in chain if self.half[bodies[index].q_index] > 0.0)
        for body in (bodies[index] for index in out if not bodies[index].prismatic):
            change += min(float(self.half[body.q_index]) * abs(body.multiplier), CHORD) * change
        return out, change


class Walls:
    """Judges boxes of some joints of a robot, by the pairs that can overlap whatever the other joints do.

    Attributes:
        columns: The entries of q of these joints.
        pairs: Those pairs.
        asked: (box, pair) bounds so far.
    """

    def __init__(self, middle: Middle, pairs: Sequence[SolidPair], columns: Sequence[int]) -> None:
        self._robot, self._middle, self.columns = middle.robot, middle.q, tuple(columns)
        free = _FreeMotion(middle, columns)
        self._free = free.half
        chains = {chain for pair in pairs for chain in pair.moving}
        alike = {chain for chain in chains if self._outermost(chain)}
        self.pairs: list[SolidPair] = []
        self._overlaps: list[tuple[_Overlap, ...]] = []
        for pair in pairs:
            if alike.issuperset(pair.moving) and not pair.columns.isdisjoint(columns):
                found = _balls(pair, free)
                if found:
                    self.pairs.append(pair)
                    self._overlaps.append(found)
        self._near = _Near(self._overlaps)
        self.asked = 0

    def _outermost(self, chain: tuple[int, ...]) -> bool:
        """Whether no joint of a box comes after one that is free to move: then it moves the solid always alike."""
        boxed = [self._robot.bodies[body].q_index in self.columns for body in chain]
        return boxed == sorted(boxed)

    def reaches(self) -> list[float]:
        """How far a solid can be from the axis of each of the joints, about, in metres; 1 for one that slides."""
        far = dict.fromkeys(self.columns, 0.0)
        bodies = self._robot.bodies
        for pair in self.pairs:
            for chain, solid in zip(pair.moving, pair.solids, strict=True):
                length = solid.radius + _norm(solid.middle[:, 0])
                for body in (bodies[k] for k in chain):
                    reach = abs(body.multiplier) * (1.0 if body.prismatic else length)
                    if body.q_index in far:
                        far[body.q_index] = max(far[body.q_index], reach)
                    length += _norm(body.placement[:3, 3])
        return list(far.values())

    def judged(self, centres: FloatArray, half: FloatArray, doubtful: BoolArray | None = None) -> Judgement:
        """Judge boxes.

        Args:
            centres: Their centres (m, k), in the order of the joints.
            half: Half of their widths, (m, k).
            doubtful: The pairs that were in a box around each, (m, pairs); all if None.
        """
        bodies, travel = self._placed(centres, half)
        wall = np.full(len(centres), -1, dtype=np.intp)
        left = np.ones((len(centres), len(self.pairs)), dtype=np.bool_) if doubtful is None else doubtful.copy()
        self.asked += int(left.sum())
        near = self._near.may_touch(bodies, left, lambda chain, points: self._motion(chain, points, bodies, travel))
        somewhere = near.any(axis=0)
        left &= somewhere
        for row in np.flatnonzero(somewhere).tolist():
            overlaps, asked = self._overlaps[row], wall < 0
            rows = np.flatnonzero(asked & near[:, row])
            left[asked, row] = False
            at, ways = (bodies.of(rows), travel[rows]) if len(rows) else (bodies, travel)
            sure, hope = np.full((2, len(rows)), -math.inf)
            for overlap in overlaps if len(rows) else ():
                some = (sure <= 2.0 * MARGIN) & ((overlap.gap == 0.0) | (hope + overlap.gap > 2.0 * MARGIN))
                if some.any():
                    depth, motion, free = self._depth(overlap, at.of(some), ways[some])
                    best = depth - free + overlap.change * (motion - free)
                    sure[some] = np.maximum(sure[some], (depth - motion).max(axis=-1))
                    hope[some] = np.maximum(hope[some], best.max(axis=-1))
            wall[rows[sure > 2.0 * MARGIN]] = row
            left[rows, row] |= hope > 2.0 * MARGIN
        return Judgement(wall, left)

    def witness(self, centres: FloatArray, half: FloatArray, pair: IntArray) -> Witness:
        """What shows that boxes are walls, each by the pair (m,) that it was judged to be."""
        bodies, travel = self._placed(centres, half)
        out = Witness(np.zeros((len(centres), 2, 3)), np.zeros((len(centres), 2)))
        for row in np.unique(pair).tolist():
            best = np.full(len(centres), -math.inf)
            rows = np.flatnonzero(pair == row)
            at = bodies.of(rows)
            for overlap in self._overlaps[row]:
                depth, motion, _ = self._depth(overlap, at, travel[rows])
                ball = (depth - motion).argmax(axis=-1)
                sure = (depth - motion)[np.arange(len(rows)), ball]
                better = sure > best[rows]
                best[rows[better]] = sure[better]
                order = [1, 0] if overlap.solid is self.pairs[row].solids[1] else [0, 1]
                found = overlap.witness(at.of(better), ball[better])
                out.centres[rows[better]] = found.centres[:, order]
                out.depths[rows[better]] = found.depths[:, order]
        return out

    def _placed(self, centres: FloatArray, half: FloatArray) -> tuple[Frames, FloatArray]:
        """Where bodies are at the centres of boxes, and how far each entry of q may be from there, (m, n)."""
        Q = np.repeat(self._middle[None], len(centres), axis=0)
        Q[:, list(self.columns)] = centres
        travel = np.repeat(self._free[None], len(centres), axis=0)
        travel[:, list(self.columns)] = half * (1.0 + ROUNDING)
        return Frames.at(self._robot, Q), travel

    def _depth(
        self, overlap: _Overlap, bodies: Frames, travel: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """How deep balls reach into a solid, at least, and how far they move against it, at most, (m, balls) each.

        The third is what joints that boxes say nothing about do of the second: smaller boxes do not lessen it.
        """
        points = overlap.points(bodies)
        depth = overlap.radii + overlap.other.depth(points, bodies)
        motion = self._motion(overlap.own, points, bodies, travel)
        free = np.broadcast_to(overlap.free, motion.shape)
        if overlap.against:
            beside = overlap.other.beside(points, bodies)
            motion += self._motion(overlap.against, points, bodies, travel, beside=beside)
            if overlap.loose:
                free = free + self._motion(overlap.loose, points, bodies, travel, beside=beside)
        return depth, motion * (1.0 + ROUNDING), free

    def _motion(
        self,
        chain: Sequence[int],
        points: FloatArray,
        bodies: Frames,
        travel: FloatArray,
        beside: FloatArray | float = 0.0,
    ) -> FloatArray:
        """How far points (3, m, b) move, at most, with a chain of bodies against the one that carries them, (m, b).

        Args:
            beside: How far the points that are meant are from these, at most.
        """
        out = np.zeros(points.shape[1:])
        for index in chain:
            body = self._robot.bodies[index]
            way = travel[:, body.q_index, None] * abs(body.multiplier)
            if body.prismatic:
                out += way
            else:
                out += np.minimum(way, CHORD) * (bodies.from_axis(points, index) + beside + out)
        return out


Motion = Callable[[tuple[int, ...], FloatArray], FloatArray]
"""How far points (3, m, b) move, at most, with a chain of bodies, (m, b)."""


class _Near:
    """Looks by balls around solids which pairs may overlap at all; all solids that move by one chain at once."""

    def __init__(self, overlaps: Sequence[tuple[_Overlap, ...]]) -> None:
        groups: dict[tuple[int, ...], dict[_Solid, None]] = {}
        sides = [((one.solid, one.own), (one.other, one.against)) for one, *_ in overlaps]
        for solid, chain in (side for both in sides for side in both):
            groups.setdefault(chain, {})[solid] = None
        self._groups = [(chain, tuple(solids)) for chain, solids in groups.items()]
        keys = [(solid, chain) for chain, solids in self._groups for solid in solids]
        number = {key: k for k, key in enumerate(keys)}
        self._sides = np.array([[number[solid, chain] for solid, chain in both] for both in sides], dtype=np.intp)
        self._radii = [np.array([both[k][0].radius for both in sides]) for k in (0, 1)]

    def may_touch(self, bodies: Frames, asked: BoolArray, motion: Motion) -> BoolArray:
        """Where, of what is asked, the balls around two solids may overlap, (m, pairs)."""
        pairs = np.flatnonzero(asked.any(axis=0))
        out = np.zeros_like(asked)
        needed = np.zeros(sum(len(solids) for _, solids in self._groups), dtype=np.bool_)
        needed[self._sides[pairs]] = True
        points, moved = np.zeros((3, len(asked), len(needed))), np.zeros((len(asked), len(needed)))
        first = 0
        for chain, solids in self._groups:
            mine = first + np.flatnonzero(needed[first : first + len(solids)])
            if len(mine):
                for k in mine.tolist():
                    points[..., k] = solids[k - first].around(bodies)[..., 0]
                moved[:, mine] = motion(chain, points[..., mine])
            first += len(solids)
        one, two = self._sides[pairs].T
        apart = _length(points[..., one] - points[..., two]) - self._radii[0][pairs] - self._radii[1][pairs]
        out[:, pairs] = asked[:, pairs] & (moved[:, one] + moved[:, two] - apart > 0.0)
        return out


def _balls(pair: SolidPair, free: _FreeMotion) -> tuple[_Overlap, ...]:
    """The balls of a pair's solids that other joints do not move too far, and what they reach into.

    The last are sliding balls, if both solids have a core and none of those joints moves them.
    """
    out, sliding, (first, second) = list[_Overlap](), list[_Overlap](), pair.solids
    cores = None not in (first.inside.to_core, second.inside.to_core)
    for solid, other, turned in ((first, second, False), (second, first, True)):
        if turned and not other.inside.exact:  # balls in balls are the same the other way round
            continue
        own, against = pair.moving[::-1] if turned else pair.moving
        (by_own, least), (by_other, least_too) = free.of(solid, own), free.of(solid, against)
        if least + least_too >= solid.largest + other.largest:
            continue
        kept = by_own + by_other < solid.inside.radii + other.largest
        if kept.any():
            balls = solid.centres[:, kept], solid.inside.radii[kept], by_own[kept]
            out.append(_Overlap(solid, other, own, against, *free.loose(against), *balls))
            gap = solid.inside.gap
            for share in SHARES if cores and not free.loose(own)[0] else ():
                farther = gap + (1.0 - share) * solid.inside.corner * float(solid.inside.radii[0])
                if farther > 0.0 and (share == 1.0 or solid.inside.corner > 0.0):
                    one = solid.centres[:, :1], share * solid.inside.radii[:1], by_own[:1]
                    sliding.append(_Overlap(solid, other, own, against, *free.loose(against), *one, farther, share))
    return (*out, *sliding)


class _Solid:
    """A piece: a ball around it, balls inside of it, all in the frame of its body or of the world."""

    def __init__(self, piece: Piece) -> None:
        rows = np.array(piece.frame)
        self.body, self._R, self._p = piece.body, rows[:, :3, None, None], rows[:, 3, None, None]
        self.inside = inside_of(piece.shape)
        self.largest = float(self.inside.radii.max(initial=-math.inf))
        middle = _middle(piece.shape)
        self.radius = _radius(piece.shape, middle)
        self.middle = self._in_body(middle[None])
        self.centres = self._in_body(self.inside.centres)

    def _in_body(self, points: FloatArray) -> FloatArray:
        """Points (b, 3) of its own frame, (3, b)."""
        return np.asarray(_turned(self._R, points.T[:, None]) + self._p)[:, 0]

    def points(self, bodies: Frames) -> FloatArray:
        """The centres of its balls, (3, m, b)."""
        return _carried(self.body, self.centres, bodies)

    def around(self, bodies: Frames) -> FloatArray:
        """The centre of the ball around it, (3, m, 1)."""
        return _carried(self.body, self.middle, bodies)

    def own(self, points: FloatArray, bodies: Frames) -> FloatArray:
        """Points (3, m, b) of the world in the frame of its body."""
        if self.body == FIXED:
            return points
        return _turned_back(bodies.R[self.body, ..., None], points - bodies.p[self.body, ..., None])

    def pose(self, bodies: Frames) -> tuple[FloatArray, FloatArray]:
        """Its own frame in the world, (3, 3, m) and (3, m)."""
        R, p = self._R[..., 0], self._p[..., 0]
        if self.body == FIXED:
            return R, p
        turned = np.stack([_turned(bodies.R[self.body], R[:, k]) for k in range(3)], axis=1)
        return turned, _turned(bodies.R[self.body], p) + bodies.p[self.body]

    def depth(self, points: FloatArray, bodies: Frames) -> FloatArray:
        """At least how deep points (3, m, b) of the world lie in it; outside, minus at least the distance."""
        return self.inside.depth(_turned_back(self._R, self.own(points, bodies) - self._p))

    def beside(self, points: FloatArray, bodies: Frames) -> FloatArray | float:
        """How far the centre of the ball that tells the depth of points is from them; 0 if the depth is exact."""
        if self.inside.exact:
            return 0.0
        own = self.own(points, bodies)
        return _length(self.deepest(own)[0] - own)

    def deepest(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """For points (3, m, b) in the frame of its body, a point inside it near each, and how deep that one lies."""
        if self.inside.exact:
            return points, self.inside.depth(_turned_back(self._R, points - self._p))
        ball, best = np.zeros(points.shape[1:], dtype=np.intp), np.full(points.shape[1:], -math.inf)
        for k, radius in enumerate(self.inside.radii.tolist()):
            depth = radius - _length(points - self.centres[:, k, None, None])
            ball[depth > best] = k
            np.maximum(best, depth, out=best)
        return self.centres[:, ball], self.inside.radii[ball]


@dataclass(frozen=True, eq=False)
class _Overlap:
    """Balls of one solid that may reach into another.

    Attributes:
        own, against: The bodies that move the solid, and the other one, against each other; outermost first.
        loose: Those of ``against`` that boxes say nothing about.
        change: How much the depth less the motion by such joints can change at most while a ball moves by 1.
        centres, radii: Of the balls, (3, b) in the frame of their body and (b,).
        free: How far the bodies of ``own`` that boxes say nothing about move them, (b,).
        gap: 0 for balls at fixed places. One ball slides: it is put in each configuration where it reaches deep, and
            may reach so much deeper than a fixed one, about, in metres.
        share: Its radius, as a share of that of the fixed ones.
    """

    solid: _Solid
    other: _Solid
    own: tuple[int, ...]
    against: tuple[int, ...]
    loose: tuple[int, ...]
    change: float
    centres: FloatArray
    radii: FloatArray
    free: FloatArray
    gap: float = 0.0
    share: float = 1.0

    def points(self, bodies: Frames) -> FloatArray:
        """The centres of the balls in the world, (3, m, b)."""
        return self._deep(bodies)[..., None] if self.gap else _carried(self.solid.body, self.centres, bodies)

    def _deep(self, bodies: Frames) -> FloatArray:
        """The centre of a sliding ball in the world, (3, m): projected on both cores by turns."""
        own, against = self.solid.inside.to_core, self.other.inside.to_core
        assert own is not None
        assert against is not None
        (R, p), (other_R, other_p) = self.solid.pose(bodies), self.other.pose(bodies)
        turn = np.stack([_turned_back(other_R, R[:, k]) for k in range(3)], axis=1)
        shift = _turned_back(other_R, p - other_p)
        centre: FloatArray = np.zeros_like(shift)
        for _ in range(PROJECTIONS):
            centre = own(_turned_back(turn, against(_turned(turn, centre) + shift, self.share) - shift), self.share)
        return _turned(R, centre) + p

    def witness(self, bodies: Frames, ball: IntArray) -> Witness:
        """The chosen balls (m,), and what they reach into."""
        points = self.points(bodies)[:, np.arange(len(ball)), ball][..., None]
        second, depth = self.other.deepest(self.other.own(points, bodies))
        centres = np.stack([self.solid.own(points, bodies)[..., 0], second[..., 0]])
        return Witness(centres.transpose(2, 0, 1), np.stack([self.radii[ball], depth[:, 0]], axis=1))


def _carried(body: int, points: FloatArray, bodies: Frames) -> FloatArray:
    """Points (3, b) of a body in the world, (3, m, b)."""
    if body == FIXED:
        return np.broadcast_to(points[:, None], (3, bodies.R.shape[-1], points.shape[1]))
    return np.asarray(_turned(bodies.R[body, ..., None], points[:, None]) + bodies.p[body, ..., None])


def _middle(shape: Shape) -> FloatArray:
    """The middle of the box around a mesh; 0 for other shapes."""
    if not isinstance(shape, Mesh):
        return np.zeros(3)
    return np.asarray(0.5 * (shape.vertices.min(axis=0) + shape.vertices.max(axis=0)), dtype=np.float64)


def _radius(shape: Shape, middle: FloatArray) -> float:
    """Of a ball about ``middle`` that holds a shape, in metres."""
    if isinstance(shape, Mesh):
        return float(_length((shape.vertices - middle).T).max()) * (1.0 + ROUNDING)
    if isinstance(shape, Sphere):
        return shape.radius
    if isinstance(shape, Capsule):
        return shape.radius + shape.length / 2.0
    if isinstance(shape, Cylinder):
        return float(np.hypot(shape.radius, shape.length / 2.0)) * (1.0 + ROUNDING)
    assert isinstance(shape, Box)
    return _norm(np.array(shape.half)) * (1.0 + ROUNDING)


def _length(vectors: FloatArray) -> FloatArray:
    x, y, z = vectors
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _turned(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """R v for matrices (3, 3, ...) and vectors (3, ...)."""
    return np.asarray(R[:, 0] * vectors[0] + R[:, 1] * vectors[1] + R[:, 2] * vectors[2])


def _turned_back(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """R^T v for matrices (3, 3, ...) and vectors (3, ...)."""
    return np.asarray(R[0] * vectors[0] + R[1] * vectors[1] + R[2] * vectors[2])


def _norm(vector: FloatArray) -> float:
    return float(_length(vector))
