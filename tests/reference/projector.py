"""The projector onto constraints, in Python: the same steps and bits as native/constraints/projector.cpp."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from planner_service.geometry.arrays import joint_distance
from planner_service.kinematics.constraint_set import ConstraintSet, Placed, _bounds

__all__ = ["ReferenceProjector"]

KEPT, AIM = 0.8, 0.5
"""The share up to which a configuration counts as projected, and the one that is aimed at from beyond it."""

SAMPLE, BOUND = 0.95, 0.97
"""Shares that an edge may use at its samples, and by a bound between them; or as much as its ends use."""

ROUNDING = 1e-9
"""By which an end may exceed its bound."""

STEPS = 12
"""Of least squares at most; two to four are usual."""

DAMPING, LEAST_DAMPING, LONGEST_STEP = 1e-6, 1e-12, 0.3
"""Relative and absolute damping, and radians that a joint may move in one step."""

MAX_DEPTH = 8
"""How often an edge is halved; what is then still near a bound is left to the proof."""

FACING_AWAY = 1e-9
"""The least of 1 plus the cosine of a tilt that is divided by."""

LEAST_STRIDE = 2e-3
"""Length of a step that is not halved any more if it does not keep the constraints."""

LEAST_PROGRESS, MOST_DETOUR = 0.1, 2.0
"""Shares of a step: by how much a projected one must come nearer to its target, and how long it may be."""

TILT, TURN = 3, 4
"""Numbers of these quantities of a region, after its three coordinates."""

Configuration = tuple[float, ...]
Matrix = list[list[float]]


class ReferenceProjector:
    """The same as native/constraints/projector.cpp, in Python."""

    def __init__(self, constraints: ConstraintSet) -> None:
        self._robot = constraints.robot
        self._lower, self._upper = constraints.lower.tolist(), constraints.upper.tolist()
        self._regions = [_Region(placed) for placed in constraints.regions]
        self._rows = [(region, kind) for region in self._regions for kind in region.kinds]
        self._projections = 0
        self._axes = [body.axis.tolist() for body in self._robot.bodies]
        self._signs = [self._sign(region) for region in self._regions]

    def share(self, q: Configuration) -> float:
        """As of ``_core.Projector``."""
        return max(self._measure(q)[0], default=-math.inf)

    def has_room(self, q: Configuration) -> bool:
        """As of ``_core.Projector``."""
        return self.share(q) <= SAMPLE

    def take(self) -> int:
        """As of ``_core.Projector``."""
        count, self._projections = self._projections, 0
        return count

    def project(self, q: Configuration) -> Configuration | None:
        """As of ``_core.Projector``."""
        self._projections += 1
        at = list(q)
        for _ in range(STEPS):
            shares, frames, places = self._measure(at)
            if max(shares, default=-math.inf) <= KEPT:
                return tuple(at)
            rows = [k for k, share in enumerate(shares) if share > AIM]
            J = [self._gradient(row, frames, places) for row in rows]
            A = [[_sum(x * y for x, y in zip(a, b, strict=True)) for b in J] for a in J]
            for k, row in enumerate(A):
                row[k] = row[k] * (1.0 + DAMPING) + LEAST_DAMPING
            y = _solved(A, [shares[row] - AIM for row in rows])
            if y is None:
                return None
            move = [_sum(J[i][k] * y[i] for i in range(len(rows))) for k in range(len(at))]
            widest = max(map(abs, move))
            if not math.isfinite(widest):
                return None
            part = LONGEST_STEP / widest if widest > LONGEST_STEP else 1.0
            at = [
                min(max(value - step * part, low), high)
                for value, step, low, high in zip(at, move, self._lower, self._upper, strict=True)
            ]
        return tuple(at) if self.share(tuple(at)) <= KEPT else None

    def keeps(self, a: Configuration, b: Configuration) -> bool:
        """As of ``_core.Projector``."""
        first, last = self._measure(a)[0], self._measure(b)[0]
        if not max((*first, *last), default=-math.inf) <= 1.0 + ROUNDING:
            return False
        difference = [y - x for x, y in zip(a, b, strict=True)]
        allowed = [max(SAMPLE, x, y) for x, y in zip(first, last, strict=True)]
        bends = [region.bend(kind, difference) for region, kind in self._rows]

        def part_is_kept(begin: float, end: float, first: list[float], last: list[float], depth: int) -> bool:
            square = (end - begin) * (end - begin)
            pairs = zip(first, last, bends, strict=True)
            if depth == MAX_DEPTH or all(max(x, y) + square * bend <= BOUND for x, y, bend in pairs):
                return True
            middle = (begin + end) / 2.0
            shares = self._measure([x + d * middle for x, d in zip(a, difference, strict=True)])[0]
            if any(share > most for share, most in zip(shares, allowed, strict=True)):
                return False
            return part_is_kept(begin, middle, first, shares, depth + 1) and part_is_kept(
                middle, end, shares, last, depth + 1
            )

        return part_is_kept(0.0, 1.0, first, last, 0)

    def step(
        self,
        start: Configuration,
        end: Configuration,
        target: Configuration,
        distance: float,
        step: float,
        fixed: bool,
    ) -> Configuration | None:
        """As of ``_core.Projector``."""
        kept = end if fixed else self.project(end)
        if kept is None or not joint_distance(kept, target) <= distance - LEAST_PROGRESS * step:
            return None
        return kept if joint_distance(start, kept) <= MOST_DETOUR * step and self.keeps(start, kept) else None

    def _sign(self, region: _Region) -> list[int]:
        """Of each body 1, -1 or 0, as its joint moves the one, the other, or both or none of the region's bodies."""
        signs = [0] * len(self._robot.bodies)
        for index, sign in ((region.body, 1), (region.base, -1)):
            while index > 0:
                signs[index] += sign
                index = self._robot.bodies[index].parent
        return signs

    def _measure(self, q: Sequence[float]) -> tuple[list[float], list[Matrix], list[_Measured]]:
        """The shares, and the frames of all bodies and of all regions that they come from."""
        rotations, positions = self._robot.body_poses_batch(np.array([q], dtype=np.float64), portable=True)
        frames = np.concatenate([rotations[0], positions[0][:, :, None]], axis=2).tolist()
        places = {id(region): _Measured(region, frames) for region in self._regions}
        shares = [places[id(region)].share(kind) for region, kind in self._rows]
        return shares, frames, list(places.values())

    def _gradient(self, row: int, frames: list[Matrix], places: list[_Measured]) -> list[float]:
        """How a share changes with each joint."""
        region, kind = self._rows[row]
        number = self._regions.index(region)
        out = [0.0] * self._robot.n
        for index, sign in enumerate(self._signs[number]):
            if sign:
                body, frame = self._robot.bodies[index], frames[index]
                axis = [sign * _dot(r, self._axes[index]) for r in frame]
                change = places[number].change(kind, axis, [r[3] for r in frame], slides=body.prismatic)
                out[body.q_index] += body.multiplier * change
        return out


class _Region:
    """A placed region as numbers."""

    def __init__(self, placed: Placed) -> None:
        region = placed.region
        self.body, self.base = placed.body, placed.base
        self.at, self.frame = placed.at.matrix[:3].tolist(), placed.frame.matrix[:3].tolist()
        self.lower, self.upper, self.room = region.lower, region.upper, placed.room
        self.chord, self.sine = _bounds(placed)
        self.reach, self.turns = placed.reach.tolist(), placed.turns.tolist()
        coordinates = [k for k in range(3) if math.isfinite(self.lower[k]) or math.isfinite(self.upper[k])]
        angles = [kind for kind, bound in ((TILT, self.chord), (TURN, self.sine)) if math.isfinite(bound)]
        self.kinds = [*coordinates, *angles]

    def bend(self, kind: int, difference: list[float]) -> float:
        """By how much a share can differ on an edge from what lies on the line between its values at the ends.

        A function differs from that line by at most an eighth of its largest second derivative.
        """
        turns = metres = 0.0
        for d, r, t in zip(difference, self.reach, self.turns, strict=True):
            if r != 0.0:
                turns += t * abs(d)
                for e, s, u in zip(difference, self.reach, self.turns, strict=True):
                    metres += abs(d) * abs(e) * min(r * u, s * t)
        if kind == TILT:
            return turns * turns / self.chord / 8.0
        if kind == TURN:
            return 0.354 * (turns * turns) / self.sine / 8.0
        return metres / self.room[kind] / 8.0


class _Measured:
    """Where the constrained frame of a region is in the region's."""

    def __init__(self, region: _Region, frames: list[Matrix]) -> None:
        self._region = region
        a, b = _composed(frames[region.base], region.frame), _composed(frames[region.body], region.at)
        self.rotation = [row[:3] for row in a]
        self.origin = [row[3] for row in b]
        self.at = _turned_back(self.rotation, [row[3] - other[3] for row, other in zip(b, a, strict=True)])
        columns = [_turned_back(self.rotation, [row[k] for row in b]) for k in range(3)]
        self.rows = [[column[i] for column in columns] for i in range(3)]
        R = self.rows
        lean = R[2][2] - 1.0
        self._chord = math.sqrt(R[0][2] * R[0][2] + R[1][2] * R[1][2] + lean * lean)
        self._f, self._g = 1.0 + (R[0][0] + R[1][1] + R[2][2]), R[1][0] - R[0][1]
        self._norm = math.sqrt(self._f * self._f + self._g * self._g)

    def share(self, kind: int) -> float:
        region = self._region
        if kind == TILT:
            return self._chord / region.chord
        if kind == TURN:
            return abs(self._g) / self._norm / region.sine if self._norm > 0.0 else 0.0
        below, above = self._beyond(kind)
        return max(below, above) + 1.0

    def _beyond(self, kind: int) -> tuple[float, float]:
        region, p = self._region, self.at[kind]
        room = region.room[kind]
        return (region.lower[kind] - p) / room, (p - region.upper[kind]) / room

    def change(self, kind: int, axis: list[float], pivot: list[float], *, slides: bool) -> float:
        """By how much a share changes with a joint."""
        region, R = self._region, self.rows
        if kind < TILT:
            arm = [x - y for x, y in zip(self.origin, pivot, strict=True)]
            moved = axis if slides else _cross(axis, arm)
            along = _turned_back(self.rotation, moved)[kind]
            below, above = self._beyond(kind)
            return (along if above >= below else -along) / region.room[kind]
        if slides:
            return 0.0
        turn = _turned_back(self.rotation, axis)
        if kind == TILT:
            return (turn[1] * R[0][2] - turn[0] * R[1][2]) / self._chord / region.chord
        twist = (turn[0] * R[0][2] + turn[1] * R[1][2] + turn[2] * (R[2][2] + 1.0)) / max(1.0 + R[2][2], FACING_AWAY)
        return (twist if self._g >= 0.0 else -twist) * (self._f / self._norm) / 2.0 / region.sine


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: list[float], b: list[float]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _turned_back(R: Matrix, v: list[float]) -> list[float]:
    return [R[0][k] * v[0] + R[1][k] * v[1] + R[2][k] * v[2] for k in range(3)]


def _composed(a: Matrix, b: Matrix) -> Matrix:
    """Frames of three rows of four."""
    columns = [[row[k] for row in b] for k in range(4)]
    return [[*(_dot(row, column) for column in columns[:3]), _dot(row, columns[3]) + row[3]] for row in a]


def _sum(values: Iterable[float]) -> float:
    """From left to right, without Python's compensation."""
    total = 0.0
    for value in values:
        total += value
    return total


def _solved(A: Matrix, b: list[float]) -> list[float] | None:
    """The solution of A y = b by Cholesky's method; None if A is not positive definite. Both are overwritten."""
    m = len(b)
    for i in range(m):
        for j in range(i + 1):
            total = A[i][j]
            for k in range(j):
                total -= A[i][k] * A[j][k]
            if i != j:
                A[i][j] = total / A[j][j]
            elif total > 0.0:
                A[i][i] = math.sqrt(total)
            else:
                return None
    for i in range(m):
        for k in range(i):
            b[i] -= A[i][k] * b[k]
        b[i] = b[i] / A[i][i]
    for i in reversed(range(m)):
        for k in range(i + 1, m):
            b[i] -= A[k][i] * b[k]
        b[i] = b[i] / A[i][i]
    return b
