"""The proof that constraints are kept on a whole curve, between samples too; it shares no code with the search.

What a constraint bounds is written as deviations from what is wanted, functions of s that must not exceed a tolerance.
On a stretch of length h let a deviation be at most A at one end and B at the other, and let it be the size, or one
component, of something whose second derivative is at most M. That thing differs from the straight line between its
values at the ends by at most ``M/2 t (1 - t) h^2`` at the share t of the stretch, so the deviation is at most

    (1 - t) A + t B + 4 E t (1 - t),    E = M h^2 / 8,

whose largest value is known. A stretch of which this proves too little is cut in half. So a stretch may be as long as
the square root of the tolerance, and where the deviation falls away from its end, that end may lie on the tolerance.

The deviations (``relative_motion`` has the rates of position p and orientation Q, a unit quaternion (w, x, y, z)):

- a coordinate of p with two bounds: how far it is from the middle between them; with one: the coordinate itself.
  M is that of p.
- tilt: the chord 2 sin(tilt / 2) between the two z axes, which is twice the length of (x, y); M is twice that of Q.
- turn: abs(psi), psi = 2 atan2(z, w), the angle of the vector (w, z), whose length is r = cos(tilt / 2). In polar
  coordinates, with V and M bounding the first and second derivative of Q, ``abs(psi') <= 2 V / r`` and
  ``abs(psi'') <= 2 M / r + 2 V^2 / r^2``. r is computed for the largest tilt allowed: the proof of the tilt shows that
  it is never smaller. psi does not pass pi on a stretch on which ``A + 2 V h / r < pi``; nothing is concluded of
  others.
- a joint: how far q is from the middle of its range; M is abs(q'').

On a straight piece q'' is zero. On a blend each component of q' is monotone, so its largest size is at an end, and q''
is largest where it is nearest to the corner (``path.corner_blend``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np

from planner_service.certify.relative_motion import RelativeMotion
from planner_service.constraints.values import MAX_JOINT, Constraint, JointRange, ToolRegion
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import copied_in, finite_numbers, function_or_none, instance, items
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot

__all__ = ["SLACK", "Kept", "KeptBound", "KeptRefusal", "prove_kept"]

SLACK = 1e-9
"""Metres or radians by which a deviation may exceed its tolerance: rounding, so that a curve may end on it."""

ROUNDING = 1e-13
"""Of a deviation, relative to the lengths or angles that it is made of: ten times what a few dozen operations round."""

SHARE = 1e-9
"""Relative: the rates are made larger by it, for rounding."""

NANO = 1e9
"""Bounds are reported in whole nanometres and nanoradians, rounded up."""

FIRST = 8.0
"""The first stretches are so short that E is at most this part of the tolerance; half as many are soon cut in half."""

TIGHT, NEGLIGIBLE = 1.25, 0.19
"""A bound is good enough if it is at most so many times the largest deviation found, or that share of the tolerance."""

ONE_SIDED = 0.25
"""Where there is a bound on one side only: the share of what is left to it."""

MOST_AT_FIRST = 256
"""Stretches into which a piece is cut at first."""

MAX_CONFIGURATIONS = 200_000
"""A proof that needs more, and as many as the curve has ends of pieces, does not end: a deviation keeps to its
tolerance all along, or exceeds it by next to nothing. Ordinary ones take some dozens to some hundreds."""

LOCATING, MOST_LOCATED = 4, 1_000
"""Where a constraint is broken, stretches are cut in half so many times more to say where, if they are not so many."""

Span = tuple[float, float]
METRES, RADIANS = "m", "rad"


@dataclass(frozen=True)
class KeptBound:
    """What is proven of one quantity that a constraint bounds.

    Attributes:
        quantity: "tilt" or "turn"; "x", "y" or "z", measured from the middle between two bounds; "+x" (and so on) with
            an upper bound only: the coordinate itself; "-x" with a lower bound only: its negative; or a joint's name,
            measured from the middle of its range.
        bound: No deviation on the curve is larger; rounded up to a whole nanometre or nanoradian.
        tolerance: How large it may be; ``bound`` exceeds it by at most ``SLACK``.
        unit: Of both, "m" or "rad".
    """

    quantity: str
    bound: float
    tolerance: float
    unit: str

    def __str__(self) -> str:
        scale, steps, unit = (1e3, 1e3, "mm") if self.unit == METRES else (1.0, 1e4, self.unit)
        bound = math.ceil((self.bound - 2.0 * SLACK) * scale * steps) / steps
        return f"{self.quantity} {bound:g} of {self.tolerance * scale:g} {unit}"


@dataclass(frozen=True)
class Kept:
    """That a constraint is kept on a whole curve.

    Attributes:
        name: What the constraint is called; a joint's name for a ``JointRange``.
        bounds: What is proven of each quantity that it bounds.
    """

    name: str
    bounds: tuple[KeptBound, ...]

    def __post_init__(self) -> None:
        copied_in(self, "bounds")

    def __str__(self) -> str:
        return f"{self.name} kept ({', '.join(map(str, self.bounds))})"


@dataclass(frozen=True)
class KeptRefusal:
    """Where a constraint is not proven kept.

    Attributes:
        s_start: Where, in path length s, the stretch around ``s`` begins on which it is not proven.
        s_end: Where it ends.
        s: Where on it the deviation is largest, as far as was looked.
        index: Which of the constraints it is, counted from 0.
        name: What it is called.
        quantity: What it bounds, as in ``KeptBound``.
        deviation: The deviation at ``s``; if ``spent``, an upper bound of it on the stretch.
        tolerance: How large it may be.
        unit: Of both, "m" or "rad".
        spent: Whether no place was found where it is broken, but there was no end to the proof.
        broken: Every stretch that is not proven and holds a place where this constraint is broken, in order of s; the
            one from ``s_start`` to ``s_end`` among them, unless ``spent``.
    """

    s_start: float
    s_end: float
    s: float
    index: int
    name: str
    quantity: str
    deviation: float
    tolerance: float
    unit: str
    spent: bool = False
    broken: tuple[Span, ...] = ()

    def __post_init__(self) -> None:
        copied_in(self, "broken")

    def __str__(self) -> str:
        stretch = f"from s = {self.s_start:.6g} to {self.s_end:.6g}"
        where = "not excluded" if self.spent else f"at s = {self.s:.6g}"
        return f"{self.what} is not proven kept {stretch}: {self._amount} {where}, {self._limit}"

    @property
    def what(self) -> str:
        """The constraint, in words."""
        return self.name

    @property
    def _amount(self) -> str:
        if self.quantity in ("tilt", "turn"):
            return f"{self.quantity} of {_measured(self.deviation, self.unit)}"
        if self.quantity.startswith(("+", "-")):
            sign = 1.0 if self.quantity[0] == "+" else -1.0
            return f"{self.quantity[1:]} = {_measured(sign * self.deviation, self.unit)}"
        return f"{self.quantity} is {_measured(self.deviation, self.unit)} from the middle of its range"

    @property
    def _limit(self) -> str:
        if self.quantity.startswith("-"):
            return f"at least {_measured(-self.tolerance, self.unit)}"
        return f"at most {_measured(self.tolerance, self.unit)}"


def _measured(value: float, unit: str) -> str:
    return f"{value * 1e3:.6g} mm" if unit == METRES else f"{value:.6g} {unit}"


def prove_kept(
    robot: Robot,
    path: JointPath,
    constraints: Sequence[Constraint],
    *,
    part: Span | None = None,
    charge: Callable[[int], None] | None = None,
) -> tuple[Kept, ...] | KeptRefusal:
    """The proof that constraints are kept on a whole path, or the refusal of the first that is not.

    A bound is at most 1.25 times the largest deviation on the curve, or a fifth of the tolerance.

    Args:
        path: With or without blends; judged as the curve it is.
        part: The interval of s to judge; None for the whole path.
        charge: Called with 0 before each batch of configurations: what it raises passes through.

    Raises:
        InvalidRequest: ``path`` is not a ``JointPath`` of as many joints as the robot, or goes beyond 1e6 rad or m; a
            constraint is none; or the part is not on the path.
        UnknownName: A constraint names no link or joint of the robot.
    """
    instance("robot", robot, Robot, "a Robot")
    function_or_none("charge", charge, "a function of a number")
    given: tuple[Constraint, ...] = items(
        "constraints", constraints, (ToolRegion, JointRange), "a sequence of ToolRegion and JointRange"
    )
    if not given:
        return ()
    if type(path) is not JointPath:  # the curve of another class may be another one
        raise InvalidRequest("path", path, "a JointPath")
    if path.n != robot.n:
        raise InvalidRequest("path", path.n, f"a path of {robot.n} joints")
    if float(np.abs(path.waypoints).max()) > MAX_JOINT:  # of larger angles the sines are not right
        raise InvalidRequest("path", path.waypoints, f"joint values up to {MAX_JOINT:g}")
    stretches = _stretches(path, (0.0, path.length) if part is None else _part_of(path, part))
    kept: list[Kept] = []
    for index, constraint in enumerate(given):
        judged = _Joint(robot, constraint) if isinstance(constraint, JointRange) else _Region(robot, path, constraint)
        outcome = _Proof(path, judged, stretches, charge or (lambda bounds: None)).run(index)
        if isinstance(outcome, KeptRefusal):
            return outcome
        kept.append(Kept(judged.name, outcome))
    return tuple(kept)


def _part_of(path: JointPath, part: Span) -> Span:
    begin, end = finite_numbers("part", part, 2).tolist()
    if not 0.0 <= begin <= end <= path.length:
        raise InvalidRequest("part", (begin, end), f"0 <= begin <= end <= {path.length:.12g}")
    return begin, end


class _Stretches(NamedTuple):
    """Stretches of a curve, each within one of its pieces, in order of s.

    Attributes:
        piece: The piece of each, (m,); -1 where the path is a point.
        start, end: From where to where in s, (m,).
        speeds, bends: Bounds of abs(dq/ds) and abs(d2q/ds2) on each, (m, n).
    """

    piece: IntArray
    start: FloatArray
    end: FloatArray
    speeds: FloatArray
    bends: FloatArray


def _stretches(path: JointPath, judged: Span) -> _Stretches:
    """The pieces of a path, as far as they are judged."""
    if not len(path.blended):
        still = np.zeros((1, path.n))
        return _Stretches(np.full(1, -1), np.zeros(1), np.zeros(1), still, still)
    begin, finish = judged
    starts, ends = path.breaks[:-1], path.breaks[1:]
    piece = np.flatnonzero((ends > begin) & (starts < finish))
    if not len(piece):  # a point
        piece = path.pieces_at(np.array([begin]))
    start, end = np.maximum(starts[piece], begin), np.minimum(ends[piece], finish)
    end = np.maximum(start, end)
    corner = np.clip(0.5 * (starts[piece] + ends[piece]), start, end)
    speeds = np.maximum(np.abs(path.on_pieces(piece, start, 1)), np.abs(path.on_pieces(piece, end, 1)))
    return _Stretches(piece, start, end, speeds, np.abs(path.on_pieces(piece, corner, 2)))


class _Quantity(NamedTuple):
    """A deviation with its tolerance, in radians for angles; see the module's head.

    Attributes:
        size: Lengths or angles that it is made of, for rounding.
        one_sided: It has no scale but its distance from the tolerance.
        ceiling: It cannot be larger.
    """

    name: str
    tolerance: float
    unit: str
    size: float
    one_sided: bool = False
    ceiling: float = math.inf

    def measure(self, value: float) -> float:
        """A value as the proof has it: the chord of a tilt."""
        return 2.0 * math.sin(0.5 * min(value, math.pi)) if self.name == "tilt" else value

    def value(self, measure: float) -> float:
        """The opposite."""
        return 2.0 * math.asin(min(1.0, 0.5 * max(0.0, measure))) if self.name == "tilt" else measure

    @property
    def allowed(self) -> float:
        """The largest measure that is accepted."""
        return self.measure(self.tolerance + SLACK)

    def enough(self, largest: float) -> float:
        """The largest measure of a bound that is good enough, ``largest`` being the largest measure found."""
        if self.one_sided:
            return min(self.allowed, largest + ONE_SIDED * max(self.tolerance - largest, 0.0) + SLACK)
        return min(self.allowed, self.measure(max(TIGHT * self.value(largest), NEGLIGIBLE * self.tolerance)))


class _Measured(Protocol):
    """The deviations of a constraint and how strongly they curve; each of them a ``_Quantity``."""

    name: str
    quantities: list[_Quantity]

    def deviations(self, q: FloatArray) -> FloatArray:
        """At configurations q (m, n), (quantities, m)."""

    def curvatures(self, speeds: FloatArray, bends: FloatArray) -> tuple[FloatArray, FloatArray]:
        """M of each on stretches, (quantities, m), and how fast the turn may change at most, (m,)."""


class _Joint:
    """The deviation of a ``JointRange``."""

    def __init__(self, robot: Robot, constraint: JointRange) -> None:
        if constraint.joint not in robot.joint_names:
            raise UnknownName("joint", constraint.joint, robot.joint_names)
        self.name = constraint.joint
        self._column = robot.joint_names.index(constraint.joint)
        lower, upper = constraint.lower, constraint.upper
        self._middle = 0.5 * (lower + upper)
        slides = robot.sliding[self._column]
        size = abs(lower) + abs(upper)
        unit = METRES if slides else RADIANS
        self.quantities = [_Quantity(self.name, 0.5 * (upper - lower), unit, size)]

    def deviations(self, q: FloatArray) -> FloatArray:
        return np.abs(q[:, self._column] - self._middle)[None]

    def curvatures(self, speeds: FloatArray, bends: FloatArray) -> tuple[FloatArray, FloatArray]:
        return bends[:, self._column][None], np.zeros(len(bends))


class _Region:
    """The deviations of a ``ToolRegion``."""

    def __init__(self, robot: Robot, path: JointPath, region: ToolRegion) -> None:
        self.name = region.name
        self._motion = _motion_of(robot, region)
        self._farthest = np.abs(path.waypoints).max(axis=0)  # a blend stays in the triangle of its corner
        self._axes: list[tuple[int, float, float]] = []
        self.quantities: list[_Quantity] = []
        for axis, (lower, upper) in enumerate(zip(region.lower, region.upper, strict=True)):
            self._bounded(axis, lower, upper)
        self._tilted, self._turned = region.tilt is not None, region.turn is not None
        cosine = math.cos(0.5 * min(math.pi, (region.tilt or 0.0) + 2.0 * SLACK))
        self._cosine = cosine * (1.0 - SHARE)  # at most, what (w, z) is long
        for name, angle in (("tilt", region.tilt), ("turn", region.turn)):
            if angle is not None:
                self.quantities.append(_Quantity(name, angle, RADIANS, math.pi, ceiling=math.pi))

    def _bounded(self, axis: int, lower: float, upper: float) -> None:
        name, below, above = "xyz"[axis], math.isfinite(lower), math.isfinite(upper)
        size = self._motion.size(self._farthest) + sum(abs(bound) for bound in (lower, upper) if math.isfinite(bound))
        if below and above:
            self._axes.append((axis, 0.0, 0.5 * (lower + upper)))
            self.quantities.append(_Quantity(name, 0.5 * (upper - lower), METRES, size))
        elif above:
            self._axes.append((axis, 1.0, 0.0))
            self.quantities.append(_Quantity(f"+{name}", upper, METRES, size, one_sided=True))
        elif below:
            self._axes.append((axis, -1.0, 0.0))
            self.quantities.append(_Quantity(f"-{name}", -lower, METRES, size, one_sided=True))

    def deviations(self, q: FloatArray) -> FloatArray:
        rows: list[FloatArray] = []
        if self._axes:
            p = self._motion.positions(q)
            rows += [sign * p[axis] if sign else np.abs(p[axis] - middle) for axis, sign, middle in self._axes]
        if self._tilted:
            w, x, y, z = self._motion.orientations(q)
            rows.append(2.0 * np.sqrt(x * x + y * y))
            if self._turned:
                pairs = zip(np.abs(z).tolist(), np.abs(w).tolist(), strict=True)
                rows.append(np.array([2.0 * math.atan2(*pair) for pair in pairs]))  # libm's, as everywhere in proofs
        return np.stack(rows)

    def curvatures(self, speeds: FloatArray, bends: FloatArray) -> tuple[FloatArray, FloatArray]:
        rates, r = self._motion.rates(speeds, bends, self._farthest), self._cosine
        rows = [rates.position] * len(self._axes)
        if self._tilted:
            rows.append(2.0 * rates.orientation)
        if self._turned:
            half = 0.5 * rates.turning
            rows.append(2.0 * rates.orientation / r + 2.0 * half * half / (r * r))
        return np.stack(rows), rates.turning / r


@lru_cache(maxsize=64)
def _motion_of(robot: Robot, region: ToolRegion) -> RelativeMotion:
    """How the constrained frame of a region moves in it; built once for all curves.

    Raises:
        UnknownName: The robot has no such link.
    """
    inner = (0, np.eye(4)) if region.relative_to is None else robot.link_frame(region.relative_to)
    outer = (robot.tool_body, robot.tool_placement) if region.link is None else robot.link_frame(region.link)
    (a, T_a), (b, T_b) = inner, outer
    return RelativeMotion(robot, (a, Pose.from_matrix(T_a) @ region.frame), (b, Pose.from_matrix(T_b) @ region.tool))


@dataclass(frozen=True, eq=False)
class _Open:
    """Stretches that are not proven yet, in order of s.

    Attributes:
        parent: The piece of each, as a row of ``_Stretches``, (m,).
        start, end: From where to where in s, (m,).
        left, right: Deviations at the ends, (quantities, m).
    """

    parent: IntArray
    start: FloatArray
    end: FloatArray
    left: FloatArray
    right: FloatArray


class _Proof:
    """One proof of one constraint."""

    def __init__(self, path: JointPath, judged: _Measured, pieces: _Stretches, charge: Callable[[int], None]) -> None:
        self._path, self._judged, self._pieces, self._charge = path, judged, pieces, charge
        self._quantities = judged.quantities
        curvatures, turning = judged.curvatures(pieces.speeds, pieces.bends)
        self._curvatures, self._turning = curvatures * (1.0 + SHARE), turning * (1.0 + SHARE)
        self._rounding = np.array([ROUNDING * (1.0 + item.size) for item in self._quantities])[:, None]
        self._allowed = np.array([item.allowed for item in self._quantities])[:, None]
        self._ceiling = np.array([item.measure(item.ceiling) for item in self._quantities])[:, None]
        self._turns = [row for row, item in enumerate(self._quantities) if item.name == "turn"]
        self._configurations = 0
        self._most = MAX_CONFIGURATIONS + 2 * len(pieces.piece)
        self._largest = np.full(len(self._quantities), -math.inf)

    def run(self, index: int) -> tuple[KeptBound, ...] | KeptRefusal:
        """What is proven, or where it is not."""
        proven = np.full(len(self._quantities), -math.inf)
        open_ = self._first()
        while True:
            bounds = self._bounds(open_)
            if np.any(self._excess(open_) > 0.0):
                open_ = self._located(open_, bounds)
                return self._refusal(index, open_, self._bounds(open_), self._excess(open_))
            enough = [
                item.enough(float(largest)) for item, largest in zip(self._quantities, self._largest, strict=True)
            ]
            rest = np.any(bounds > np.array(enough)[:, None], axis=0)
            proven = np.maximum(proven, bounds[:, ~rest].max(axis=1, initial=-math.inf))
            if not np.any(rest):
                return tuple(map(_reported, self._quantities, proven.tolist()))
            open_, bounds = _taken(open_, rest), bounds[:, rest]
            middle = self._middle(open_)
            if np.any(_pointlike(open_, middle)) or self._configurations + len(middle) > self._most:
                return self._refusal(index, open_, bounds, None)
            open_ = self._halved(open_, middle)

    def _first(self) -> _Open:
        """The pieces, cut into equal stretches."""
        start, end = self._pieces.start, self._pieces.end
        count = np.ones(len(start))
        for item, row in zip(self._quantities, self._curvatures, strict=True):
            if not item.one_sided:
                count = np.maximum(count, np.sqrt(row * (FIRST / 8.0 / item.tolerance)) * (end - start))
        counts = np.minimum(np.ceil(count), MOST_AT_FIRST).astype(np.intp)
        parent = np.repeat(np.arange(len(start)), counts + 1)
        first = np.cumsum(counts + 1) - (counts + 1)
        step = np.arange(len(parent)) - first[parent]
        last = step == counts[parent]
        s = np.where(last, end[parent], start[parent] + (end - start)[parent] * (step / counts[parent]))
        values = self._looked(parent, s)
        (to,) = np.nonzero(step > 0)
        return _Open(parent[to], s[to - 1], s[to], values[:, to - 1], values[:, to])

    def _halved(self, open_: _Open, middle: FloatArray) -> _Open:
        values = self._looked(open_.parent, middle)
        return _Open(
            np.repeat(open_.parent, 2),
            _interleaved(open_.start, middle),
            _interleaved(middle, open_.end),
            _interleaved(open_.left, values),
            _interleaved(values, open_.right),
        )

    def _looked(self, parent: IntArray, s: FloatArray) -> FloatArray:
        """The deviations at s (m,) on pieces (m,), rounding included, (quantities, m)."""
        self._charge(0)
        self._configurations += len(s)
        piece = self._pieces.piece[parent]
        if len(self._path.blended):
            q = self._path.on_pieces(piece, s, 0)
        else:
            q = np.broadcast_to(self._path.waypoints[0], (len(s), self._path.n))
        values = self._judged.deviations(q)
        self._largest = np.maximum(self._largest, values.max(axis=1))
        return np.asarray(np.minimum(values + self._rounding, self._ceiling))

    def _bounds(self, open_: _Open) -> FloatArray:
        """The largest deviation that each stretch may have, (quantities, m)."""
        length = open_.end - open_.start
        E = self._curvatures[:, open_.parent] * (length * length / 8.0)
        a, b = open_.left, open_.right
        change = b - a
        inside = np.abs(change) < 4.0 * E
        top = 0.5 * (a + b) + E + change * change / np.where(inside, 16.0 * E, 1.0)
        bounds = np.where(inside, top, np.maximum(a, b)) + self._rounding
        for row in self._turns:
            passes = a[row] + self._turning[open_.parent] * length >= math.pi
            bounds[row, passes] = math.pi
        return np.asarray(np.minimum(bounds, self._ceiling))

    def _excess(self, open_: _Open) -> FloatArray:
        """By how much the larger value at the ends of each stretch exceeds what is allowed, (quantities, m)."""
        return np.asarray(np.maximum(open_.left, open_.right) - self._allowed)

    def _located(self, open_: _Open, bounds: FloatArray) -> _Open:
        """What is not proven of some stretches, cut a few times in half to tell where a tolerance is exceeded."""
        for _ in range(LOCATING):
            open_ = _taken(open_, np.any(bounds > self._allowed, axis=0))
            middle = self._middle(open_)
            if len(middle) > MOST_LOCATED or np.any(_pointlike(open_, middle)):
                break
            open_ = self._halved(open_, middle)
            bounds = self._bounds(open_)
        return open_

    def _refusal(self, index: int, open_: _Open, bounds: FloatArray, excess: FloatArray | None) -> KeptRefusal:
        """The refusal for where a tolerance is exceeded most, or with no ``excess`` for where least is proven."""
        over = bounds - self._allowed if excess is None else excess
        scale = np.array([1.0 if item.one_sided else item.tolerance for item in self._quantities])
        row = int((over.max(axis=1) / scale).argmax())
        k, item = int(over[row].argmax()), self._quantities[row]
        runs = _runs(open_, np.any(bounds > self._allowed, axis=0))
        spans = [(float(open_.start[i]), float(open_.end[j])) for i, j in runs]
        if excess is None:
            (start, end), s, measure = (open_.start[k], open_.end[k]), self._middle(open_)[k], bounds[row, k]
            broken = []
        else:
            at_start = open_.left[row, k] >= open_.right[row, k]
            s, measure = (open_.start[k], open_.left[row, k]) if at_start else (open_.end[k], open_.right[row, k])
            start, end = next(span for span, (i, j) in zip(spans, runs, strict=True) if i <= k <= j)
            exceeded = np.any(excess > 0.0, axis=0)
            broken = [span for span, (i, j) in zip(spans, runs, strict=True) if np.any(exceeded[i : j + 1])]
        return KeptRefusal(
            s_start=float(start),
            s_end=float(end),
            s=float(s),
            index=index,
            name=self._judged.name,
            quantity=item.name,
            deviation=item.value(float(measure)),
            tolerance=item.tolerance,
            unit=item.unit,
            spent=excess is None,
            broken=tuple(broken),
        )

    def _middle(self, open_: _Open) -> FloatArray:
        return np.asarray(0.5 * (open_.start + open_.end))


def _taken(open_: _Open, rows: BoolArray) -> _Open:
    ends = open_.left[:, rows], open_.right[:, rows]
    return _Open(open_.parent[rows], open_.start[rows], open_.end[rows], *ends)


def _pointlike(open_: _Open, middle: FloatArray) -> BoolArray:
    """Which stretches have no number between their ends."""
    return np.asarray((middle <= open_.start) | (middle >= open_.end))


def _interleaved(first: FloatArray, second: FloatArray) -> FloatArray:
    """One of the first, one of the second, and so on, along the last axis."""
    return np.stack([first, second], axis=-1).reshape(*first.shape[:-1], -1)


def _runs(open_: _Open, wanted: BoolArray) -> list[tuple[int, int]]:
    """First and last of each run of wanted stretches that follow one another without a gap."""
    out: list[tuple[int, int]] = []
    for k in np.flatnonzero(wanted).tolist():
        if out and out[-1][1] == k - 1 and open_.start[k] <= open_.end[k - 1]:
            out[-1] = (out[-1][0], k)
        else:
            out.append((k, k))
    return out


def _reported(item: _Quantity, measure: float) -> KeptBound:
    """A proven bound, rounded to the safe side."""
    up = math.ceil(item.value(measure) * (1.0 + ROUNDING) * NANO) / NANO
    return KeptBound(item.name, min(up, item.tolerance + SLACK), item.tolerance, item.unit)
