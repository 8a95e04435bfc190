"""Paths: curves q(s) through joint space, polylines whose corners may be blended.

Angles in radians (metres for prismatic joints). The path parameter ``s`` is arc length, in the L2 norm of joint space,
along the polyline through the waypoints, also where corners are blended.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray, as_sent, frozen
from planner_service.geometry.validation import FLOAT64, numbers, whole
from planner_service.native.loading import load_core
from planner_service.path.corner_blend import Blends

__all__ = ["OVERSHOOT", "JointPath", "polyline_length", "require_order", "within"]

OVERSHOOT = 1e-9
"""An argument at most this far outside its interval is rounding, and is moved to the interval's end."""

MIN_WIDTH = 1e-9
"""Radians. A narrower blend is refused: its curvature would be rounding noise."""

MIN_FORWARD = 0.2
"""The least abs(u + v) of the tangents at a blended corner. In a blend that almost turns back, within 12 degrees, s
would advance while the robot stands still."""

ORDERS = range(4)

WAYPOINTS = "rows of equally many numbers, shape (N, n)"

NO_BLENDS = frozen(np.zeros(0))


def polyline_length(points: FloatArray) -> float:
    """L2 length of a polyline (N, n)."""
    length: float = load_core().polyline_length(points)
    return length


def within(name: str, value: ArrayLike, end: float) -> FloatArray:
    """``value`` as an array within [0, end], clipped if it exceeds that by rounding; not copied if it need not be."""
    x = value if _are_floats(value) else numbers(name, value, f"numbers in [0, {end:.9g}]")
    if not x.size:
        return x
    low, high = x.min(), x.max()
    if low >= 0.0 and high <= end:
        return x
    if not (low >= -OVERSHOOT and high <= end + OVERSHOOT):  # also for NaN
        raise InvalidRequest(name, value, f"numbers in [0, {end:.9g}]")
    return np.clip(x, 0.0, end)


def _are_floats(value: ArrayLike) -> TypeGuard[FloatArray]:
    """Whether the value is a float64 array, as calls inside the package pass."""
    return type(value) is np.ndarray and value.dtype is FLOAT64


def require_order(order: object) -> int:
    """The order of a derivative, checked."""
    if not isinstance(order, int) or isinstance(order, bool) or order not in ORDERS:
        raise InvalidRequest("order", order, "0, 1, 2 or 3")
    return order


def _waypoints(values: Any) -> FloatArray:
    points = np.array(values) if _are_floats(values) else numbers("waypoints", values, WAYPOINTS)
    if points.ndim != 2 or 0 in points.shape:
        raise InvalidRequest("waypoints", points.shape, "shape (N, n) with N >= 1 waypoints of n >= 1 joints")
    return points


def _not_finite(points: FloatArray) -> InvalidRequest:
    """The refusal of points without a finite length: of the first number that is not finite, if there is one."""
    at = np.argwhere(~np.isfinite(points))
    if not len(at):
        expected = "joint values whose path has a finite length"
        return InvalidRequest("waypoints", float(np.abs(points).max()), expected)
    row, joint = at[0].tolist()
    return InvalidRequest(f"waypoints[{row}][{joint}]", float(points[row, joint]), "a finite number")


def _widths(values: Any, count: int) -> list[float]:
    """Blend widths for ``count`` waypoints, all 0 if none are given."""
    if values is NO_BLENDS:
        return [0.0] * count
    expected = f"{count} finite numbers, each 0 or at least {MIN_WIDTH:g}, the first and the last 0, or none"
    given = values if _are_floats(values) else numbers("blends", values, expected)
    if given.shape == (0,):
        return [0.0] * count
    widths: list[float] = given.tolist()
    good = given.shape == (count,) and all(width == 0.0 or MIN_WIDTH <= width < math.inf for width in widths)
    if not good or widths[0] > 0.0 or widths[-1] > 0.0:
        raise InvalidRequest("blends", widths, expected)
    return widths


@dataclass(frozen=True, eq=False)
class _Polyline:
    """The part of a path that does not depend on its blends.

    Attributes:
        points: Shape (N, n).
        knots: s at each point, (N,).
        tangents: Unit tangents of the pieces, (N - 1, n).
        turns: Indices of inner points where the direction changes by more than rounding.
    """

    points: FloatArray
    knots: FloatArray
    tangents: FloatArray
    turns: tuple[int, ...]

    @classmethod
    def through(cls, points: FloatArray, *, merged: bool = True) -> _Polyline:
        """The polyline through points (N, n), ``merged`` without those that coincide with the one before them."""
        laid = load_core().laid_polyline(points, merged)
        if laid is None:
            raise _not_finite(points)
        kept, knots, tangents, turns = laid
        points = points if kept is None else points[kept]
        points.flags.writeable = False
        return cls(points, knots, tangents, turns)

    @cached_property
    def lengths(self) -> FloatArray:
        """Of the pieces, (N - 1,)."""
        return self.knots[1:] - self.knots[:-1]

    @cached_property
    def lines(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Start, difference and end of each piece, (N - 1, n) each."""
        return self.points[:-1], self.points[1:] - self.points[:-1], self.points[1:]

    def blended(self, widths: Sequence[float]) -> tuple[NDArray[Any], ...]:
        """The widths at corners, 0 elsewhere, and the pieces of the curve: breaks, lines, rows and table of blends.

        Raises:
            InvalidRequest: A blend at a corner that turns back, or two that overlap.
        """
        back, over, tables = load_core().laid_blends(self.points, self.knots, self.tangents, self.turns, widths)
        if back >= 0:
            raise InvalidRequest(f"blends[{back}]", widths[back], "0 at a corner that turns back")
        if over >= 0:
            pair = [widths[k] if k in self.turns else 0.0 for k in (over, over + 1)]
            expected = "no more together than the piece between them is long"
            raise InvalidRequest(f"blends[{over}:{over + 2}]", pair, expected)
        blended: tuple[NDArray[Any], ...] = tables
        return blended


@dataclass(frozen=True, eq=False, repr=False)
class JointPath:
    """A polyline through joint space whose corners may be blended, ``path(s)`` for s in [0, ``path.length``].

    Waypoints within 1e-12 rad of the one before them are dropped (the first and the last always stay), so that
    every piece has a length and a direction; all other waypoints are kept as they are.

    Args:
        waypoints: Shape (N, n), N >= 1; copied.
        blends: For each waypoint the arc length before and after it that its blend replaces, shape (N,); 0 keeps the
            corner, a full stop. Empty for no blends. Where the path does not turn, it becomes 0.

    Attributes:
        knots: s at each waypoint, shape (N,), from 0 to ``length``.
        breaks: s from 0 to ``length`` where straight pieces and blends meet, and at waypoints that are not blended,
            shape (m + 1,).
        length: L2 joint arc length of the polyline.
        n: Number of joints.
        tangents: Unit tangents of the lines between waypoints, (N - 1, n).
        turns: Indices of inner waypoints where the polyline turns, blended or not.

    Raises:
        InvalidRequest: Another shape, a number that is not finite, blends that overlap, or one at a corner that turns
            back.
    """

    waypoints: FloatArray
    blends: FloatArray = field(default_factory=lambda: NO_BLENDS)
    knots: FloatArray = field(init=False)
    breaks: FloatArray = field(init=False)
    length: float = field(init=False)
    n: int = field(init=False)
    tangents: FloatArray = field(init=False)
    turns: tuple[int, ...] = field(init=False)
    _polyline: _Polyline = field(init=False)
    _lines: IntArray = field(init=False)
    _rows: IntArray = field(init=False)
    _table: FloatArray = field(init=False)
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        given = _waypoints(self.waypoints)
        widths = _widths(self.blends, len(given))
        polyline = _Polyline.through(given)
        merged = len(given) - len(polyline.points)
        if merged and any(widths):
            raise InvalidRequest("blends", merged, "waypoints that do not coincide")
        self._lay(polyline, widths[: len(polyline.points)])

    def _lay(self, polyline: _Polyline, widths: Sequence[float]) -> None:
        """Set all fields: the curve along a polyline with these blend widths."""
        blends, breaks, lines, rows, table = polyline.blended(widths)
        self.__dict__.update(
            waypoints=polyline.points,
            blends=blends,
            knots=polyline.knots,
            breaks=breaks,
            length=float(polyline.knots[-1]),
            n=polyline.points.shape[1],
            tangents=polyline.tangents,
            turns=polyline.turns,
            _polyline=polyline,
            _lines=lines,
            _rows=rows,
            _table=table,
        )

    @cached_property
    def blended(self) -> BoolArray:
        """Which of the m pieces between breaks are blends, shape (m,)."""
        blended: BoolArray = self._rows >= 0
        blended.flags.writeable = False
        return blended

    @cached_property
    def _curves(self) -> Blends:
        rows = np.flatnonzero(self.blends > 0.0)
        tangents = self._polyline.tangents
        around = tangents[rows - 1], tangents[rows]
        return Blends.at(self.knots[rows], self.blends[rows], self.waypoints[rows], around)

    @cached_property
    def _travelled(self) -> FloatArray:
        """The total distance that each joint has moved up to each break, (m + 1, n)."""
        moves = self._moved(np.arange(len(self._lines)), self.breaks[1:])
        return np.concatenate([np.zeros((1, self.n)), np.cumsum(moves, axis=0)])

    def __repr__(self) -> str:
        blended = f", {int(self.blended.sum())} blends" if np.any(self.blended) else ""
        return f"JointPath(<{len(self.waypoints)} waypoints{blended}, {self.n} joints, length {self.length:.6g}>)"

    @cached_property
    def corners(self) -> tuple[int, ...]:
        """Indices of inner waypoints where the direction jumps, so that the robot has to stop."""
        blends = self.blends.tolist()
        return tuple(k for k in self._polyline.turns if not blends[k] > 0.0)

    def turns_back(self, k: int) -> bool:
        """Whether the corner at inner waypoint k almost turns back, so that it cannot be blended.

        Raises:
            InvalidRequest: ``k`` is not the index of an inner waypoint.
        """
        inner = whole("k", k, 1, len(self.waypoints) - 2)
        back: bool = load_core().turns_back(self.tangents[inner - 1 : inner + 1])
        return back

    def with_blends(self, blends: ArrayLike | None) -> JointPath:
        """The same polyline with other blends, shape (N,); None for a stop at every corner."""
        path = object.__new__(JointPath)
        path._lay(self._polyline, _widths(NO_BLENDS if blends is None else blends, len(self.waypoints)))
        return path

    def with_stops(self, places: ArrayLike) -> JointPath:
        """The same curve, up to rounding, for a timing law that is to stop at some s, too: on lines, not on blends.

        Raises:
            InvalidRequest: A place outside the path, on a blend, or within 1e-9 of a waypoint or another place.
        """
        at = np.sort(numbers("places", places, "numbers s, shape (k,)").reshape(-1))
        near = np.abs(at[:, None] - self.knots).min(axis=1, initial=math.inf)
        near[1:] = np.minimum(near[1:], np.diff(at))
        outside = ~((at > 0.0) & (at < self.length) & (near > MIN_WIDTH))
        wrong = outside | self.blended[self.pieces_at(np.where(outside, 0.0, at))] if len(self._lines) else outside
        if np.any(wrong):
            raise InvalidRequest("places", float(at[wrong.argmax()]), "s on a line of the path, off its waypoints")
        order = np.argsort([*self.knots, *at], kind="stable")
        path = JointPath(
            np.concatenate([self.waypoints, self(at)])[order], np.concatenate([self.blends, np.zeros(len(at))])[order]
        )
        more = np.flatnonzero(order >= len(self.knots)).tolist()
        path.__dict__["corners"] = tuple(sorted({*path.corners, *more}))
        return path

    def __call__(self, s: ArrayLike, order: int = 0) -> FloatArray:
        """Configurations (order 0), tangents dq/ds (1), their derivatives (2, 3), shape (..., n) for s of shape (...).

        Tangents are of unit length on straight pieces and not longer on blends. At a break the derivatives are those
        of the piece after it, at the end those of the last piece.

        Raises:
            InvalidRequest: ``s`` is outside [0, length] by more than 1e-9, or ``order`` is not 0, 1, 2 or 3.
        """
        at = within("s", s, self.length)
        require_order(order)
        if not len(self._lines):
            value = np.zeros(self.n) if order else self.waypoints[0]
            return np.broadcast_to(value, (*at.shape, self.n)).copy()
        flat = np.ascontiguousarray(at.reshape(-1))
        if order > 1:
            return self.on_pieces(self.pieces_at(flat), flat, order).reshape(*at.shape, self.n)
        found: FloatArray = load_core().path_at(
            *self.tables, flat, order
        )  # the bits of ``on_pieces``; exact at both ends
        return found.reshape(*at.shape, self.n)

    def pieces_at(self, s: FloatArray) -> IntArray:
        """The index of the piece on which each s of [0, length] lies; at a break that of the later one."""
        return np.minimum(self.breaks.searchsorted(s, side="right") - 1, len(self._lines) - 1)

    def on_pieces(self, piece: IntArray, at: FloatArray, order: int) -> FloatArray:
        """q or a derivative at s = ``at`` (k,) on the given pieces (k,), continued beyond their ends; (k, n)."""
        rows = self._rows.take(piece)
        (on,) = (rows >= 0).nonzero()
        if 0 < len(on) == len(rows):
            return self._on_blends(rows, at, order)
        if order == 0:
            out = self._between(self._lines.take(piece), at)
        elif order == 1:
            out = self._polyline.tangents.take(self._lines.take(piece), axis=0)
        else:
            out = np.zeros((len(at), self.n))
        if len(on):
            out[on] = self._on_blends(rows.take(on), at.take(on), order)
        return out

    def _on_blends(self, row: IntArray, at: FloatArray, order: int) -> FloatArray:
        return self._curves.position(row, at) if order == 0 else self._curves.derivative(row, at, order)

    def _between(self, line: IntArray, at: FloatArray) -> FloatArray:
        start, move, end = (table.take(line, axis=0) for table in self._polyline.lines)
        share = ((at - self.knots.take(line)) / self._polyline.lengths.take(line))[..., np.newaxis]
        # share < 1 keeps the rounded product below the move, so no joint passes its waypoint, which may be a limit
        return np.where(share < 1.0, start + move * share, end)

    def travel(self, s: ArrayLike) -> FloatArray:
        """The total distance that each joint moves from the start to s, back and forth, (..., n) for s of shape (...).

        Raises:
            InvalidRequest: ``s`` is outside [0, length] by more than 1e-9.
        """
        at = within("s", s, self.length)
        if not len(self._lines):
            return np.zeros((*at.shape, self.n))
        flat = at.reshape(-1)
        piece = self.pieces_at(flat)
        total: FloatArray = self._travelled.take(piece, axis=0) + self._moved(piece, flat)
        return total.reshape(*at.shape, self.n)

    def _moved(self, piece: IntArray, at: FloatArray) -> FloatArray:
        """The distance that each joint moves from the start of a piece (k,) to s = ``at`` (k,); (k, n)."""
        rows = self._rows.take(piece)
        out = np.abs(self._polyline.tangents.take(self._lines.take(piece), axis=0))
        out *= (at - self.breaks.take(piece))[:, np.newaxis]
        (on,) = (rows >= 0).nonzero()
        if len(on):
            out[on] = self._curves.travel(rows.take(on), at.take(on))
        return out

    @cached_property
    def walked(self) -> JointPath:
        """The curve of how far each joint has moved, if each turned back nowhere but at corners: at least ``travel``.

        On a blend from tangent u to v no joint is faster than the share of abs(u) and abs(v) that is due there.
        """
        points = np.cumsum(np.abs(np.diff(self.waypoints, axis=0, prepend=self.waypoints[:1])), axis=0)
        path = object.__new__(JointPath)
        path._lay(_Polyline.through(points, merged=False), self.blends.tolist())
        return path

    @property
    def tables(self) -> tuple[NDArray[Any], ...]:
        """The tables of ``__call__`` and ``travel``, for compiled code that computes the same bits.

        Waypoints (N, n), knots (N,), tangents of the lines between them (N - 1, n), breaks (m + 1,); the line of each
        piece (m,) and its blend or -1 (m,); and of each blend s, width, corner, and tangents before and after,
        (k, 2 + 3 n).
        """
        return (self.waypoints, self.knots, self.tangents, self.breaks, self._lines, self._rows, self._table)

    def reversed(self) -> JointPath:
        """The same curve from its end to its start."""
        return JointPath(self.waypoints[::-1], self.blends[::-1])

    def __add__(self, other: JointPath) -> JointPath:
        """This path followed by the other, which must start exactly where this one ends; they meet in a stop.

        Raises:
            InvalidRequest: It starts elsewhere.
        """
        if self.n != other.n or not np.array_equal(self.waypoints[-1], other.waypoints[0]):
            expected = f"a path from {self.waypoints[-1].tolist()}"
            raise InvalidRequest("path", other.waypoints[0].tolist(), expected)
        points = np.concatenate([self.waypoints, other.waypoints[1:]])
        return JointPath(points, np.concatenate([self.blends, other.blends[1:]]))
