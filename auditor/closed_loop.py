"""The closed loop of an arm in interval arithmetic: its lines at q = 0, equations between few joints, the tool's own.

With M_1 ... M_m the motions of the joints about their lines at q = 0, H the tool there, T the goal and G = T H^-1, a
point or direction x of the tool at q = 0 obeys ``M_k^-1 ... M_1^-1 G x = M_{k+1} ... M_m x``, and one of the base
``M_k^-1 ... M_1^-1 b = M_{k+1} ... M_m G^-1 b``. Both sides are sums of products of at most one number of each joint:
1, its cosine or its sine; or 1 and its position, if it slides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from auditor.intervals import Interval, cosine_and_sine, cross, dot, exactly, stacked, upper_norm
from auditor.schema import require

__all__ = ["Equation", "Loop", "Wanted", "at_boxes", "equation_of", "own_equations", "parts_of"]

Array = Any
Json = Any

LITTLE = 1e-14  # a coefficient below goes into the slack
MODEL = 2e-13  # metres for each metre, and radians: frames that are not quite rotations
POINTWISE = 4e-13  # metres for each metre, and radians: 16 turns, each off by 100 units in the last place
MOST_JOINTS = 4  # on each side of an equation


@dataclass
class Wanted:
    """The goal: "pose", "axis" or "position", the pose (4, 4), by how much it may be missed, and the free axis."""

    kind: str
    pose: Array
    shift: float
    turn: float
    axis: Array | None


class Loop:
    """An arm: of each joint from the base out whether it slides, its entry of q, multiplier, axis and a point."""

    def __init__(self, robot: Json, columns: list[int], chain: list[int], near: Array, domain: Array) -> None:
        T = exactly(np.eye(4))
        self.slides, self.entry, self.by = [], [], []
        self.axis: list[Interval] = []
        self.point: list[Interval] = []
        for body in (robot["bodies"][index] for index in chain):
            placement = np.array(body["placement"], float)
            R = placement[:3, :3]
            require(np.array_equal(placement[3], [0.0, 0.0, 0.0, 1.0]), "a frame with another last row")
            require(np.abs(R @ R.T - np.eye(3)).max() < 1e-14 and np.linalg.det(R) > 0, "a frame that is no rotation")
            T = _moved(T, placement)
            given = np.array(body["axis"], float)
            size = dot(given, given).root()
            require(abs(float(size.high) - 1.0) < 1e-9, "an axis that is no unit vector")
            axis = _turned(T, given) * size.inverse()
            at = exactly(near[len(self.axis)])
            self.axis.append(axis)
            self.point.append(T[:3, 3] + axis * dot(axis, at - T[:3, 3]))
            self.slides.append(bool(body["prismatic"]))
            self.entry.append(columns.index(body["q_index"]))
            self.by.append(float(body.get("multiplier", 1.0)))
        placement = np.array(robot["tool_placement"], float)
        R = placement[:3, :3]
        require(np.array_equal(placement[3], [0.0, 0.0, 0.0, 1.0]), "a tool with another last row")
        require(np.abs(R @ R.T - np.eye(3)).max() < 1e-14 and np.linalg.det(R) > 0, "a tool that is turned oddly")
        self.tool = _moved(T, placement)
        self.n, self.m = len(columns), len(chain)
        largest = np.abs(domain).max(axis=0)
        self.strokes = [
            abs(by) * (float(largest[e]) + 0.1) if slides else 0.0
            for slides, e, by in zip(self.slides, self.entry, self.by, strict=True)
        ]
        corners = [exactly(np.zeros(3)), *self.point, self.tool[:3, 3]]
        offsets = [float(upper_norm(b - a)) for a, b in pairwise(corners)]
        self.longest = sum(offsets) + sum(self.strokes)

    def end(self, wanted: Wanted) -> Interval:
        """Where at q = 0 the point is that has to be at the goal."""
        own = wanted.kind == "pose" and not self.slides[-1]
        return self.point[-1] if own else self.tool[:3, 3]

    def bends(self, wanted: Wanted) -> tuple[Array, Array]:
        """Bounds of second derivatives of the end's place and of the orientation, (n, n) each.

        For joints i and j, j the further out, the second derivative of a point p is ``a_i x (a_j x (p - o_j))``, no
        longer than p's distance from o_j; half of a rotation's skew part changes by no more than 1.
        """
        reach, beyond = [0.0] * self.m, self.end(wanted)
        for k in reversed(range(self.m)):
            own = float(upper_norm(beyond - self.point[k]))
            reach[k] = own + (reach[k + 1] + self.strokes[k + 1] if k + 1 < self.m else 0.0)
            beyond = self.point[k]
        shift, turn = np.zeros((self.n, self.n)), np.zeros((self.n, self.n))
        for i in range(self.m):
            for j in range(i, self.m):
                scale = abs(self.by[i] * self.by[j]) * (1.0 + 1e-12)
                a, b = self.entry[i], self.entry[j]
                moves = 0.0 if self.slides[i] else scale * (1.0 if self.slides[j] else reach[j] * (1.0 + 1e-12))
                turns = 0.0 if self.slides[i] or self.slides[j] else scale
                for table, value in ((shift, moves), (turn, turns)):
                    table[a, b] += value
                    if i != j:
                        table[b, a] += value
        return shift, turn

    def turns(self) -> Array:
        """By how much each entry of q turns bodies, all in all, (n,)."""
        out = np.zeros(self.n)
        for slides, entry, by in zip(self.slides, self.entry, self.by, strict=True):
            out[entry] += 0.0 if slides else abs(by)
        return out


def _moved(T: Interval, by: Array) -> Interval:
    """T times a frame (4, 4)."""
    rows = [[dot(T[i, :3], by[:3, j]) + (T[i, 3] if j == 3 else 0.0) for j in range(4)] for i in range(3)]
    whole = [stacked(row) for row in rows] + [exactly(np.array([0.0, 0.0, 0.0, 1.0]))]
    return stacked(whole, 0)


def _turned(T: Interval, v: Any) -> Interval:
    return stacked([dot(T[i, :3], v) for i in range(3)])


def own_equations(loop: Loop, wanted: Wanted, q: Array) -> tuple[Interval, Interval, Interval, Array]:
    """Six numbers, five or three that are 0 at the goal, at points q (k, n): (k, rows); derivatives (k, rows, n).

    Then ``1 + 2 cos`` of how far the tool is turned away, (k,), and by how much each number may be off, (rows,).

    Intervals of vectors that are turned again and again grow fast, so these are the middles of intervals, with a bound
    of all rounding: each of at most 16 turns, of vectors no longer than 1 or the arm, is off by less than 100 units in
    the last place, and so is what is made of them.
    """
    k, T = len(q), wanted.pose
    H = _middle(loop.tool)
    axes, points = [_middle(a) for a in loop.axis], [_middle(o) for o in loop.point]
    columns = [exactly(np.tile(np.eye(3)[c], (k, 1))) for c in range(3)]
    p, joints = exactly(np.zeros((k, 3))), []
    for index in range(loop.m):
        a = _middle(_of_columns(columns, axes[index]))
        o = _middle(p + _of_columns(columns, points[index]))
        joints.append((a, o))
        angle = exactly(q[:, loop.entry[index]]) * loop.by[index]
        if loop.slides[index]:
            p = _middle(p + a * angle[:, None])
            continue
        c, s = cosine_and_sine(angle)
        c, s = _middle(c), _middle(s)
        columns = [_middle(_about(a, c[:, None], s[:, None], v)) for v in columns]
        p = _middle(o + _about(a, c[:, None], s[:, None], p - o))
    end = _middle(loop.end(wanted))
    X = [_middle(_of_columns(columns, H[:3, c])) for c in range(3)]
    at = p + _of_columns(columns, end)
    local = stacked([dot(H[:3, c], end - H[:3, 3]) for c in range(3)])
    there = stacked([dot(exactly(T[i, :3]), local) + T[i, 3] for i in range(3)])
    values, slopes = [(at - there)[:, i] for i in range(3)], [[exactly(np.zeros(k))] * loop.n for _ in range(3)]
    goal = [exactly(T[:3, c]) for c in range(3)]
    pairs = [((i + 1) % 3, (i + 2) % 3) for i in range(3)]
    sides: list[Any] = []
    agreement = exactly(np.full(k, 3.0))
    if wanted.kind == "pose":
        values += [(dot(X[u], goal[w]) - dot(X[w], goal[u])) * 0.5 for u, w in pairs]
        agreement = dot(X[0], goal[0]) + dot(X[1], goal[1]) + dot(X[2], goal[2])
    elif wanted.kind == "axis":
        assert wanted.axis is not None
        towards = T[:3, :3] @ wanted.axis
        side = np.cross(towards, [1.0, 0.0, 0.0] if abs(towards[0]) < 0.6 else [0.0, 1.0, 0.0])
        side /= math.sqrt(side @ side)
        sides = [side, np.cross(towards, side)]
        d = X[0] * wanted.axis[0] + X[1] * wanted.axis[1] + X[2] * wanted.axis[2]
        values += [dot(d, one_side) for one_side in sides]
        agreement = dot(d, towards) * 2.0 + 1.0
    slopes += [[exactly(np.zeros(k))] * loop.n for _ in values[3:]]
    for index, (a, o) in enumerate(joints):
        by, entry = loop.by[index], loop.entry[index]
        moves = a if loop.slides[index] else cross(a, at - o)
        changes = [moves[:, i] for i in range(3)]
        if not loop.slides[index] and wanted.kind == "pose":
            turned = [cross(a, x) for x in X]
            changes += [(dot(turned[u], goal[w]) - dot(turned[w], goal[u])) * 0.5 for u, w in pairs]
        elif not loop.slides[index] and wanted.kind == "axis":
            changes += [dot(cross(a, d), one_side) for one_side in sides]
        for row, change in enumerate(changes):
            slopes[row] = [x + change * by if j == entry else x for j, x in enumerate(slopes[row])]
    far = float(upper_norm(end - H[:3, 3])) if wanted.kind == "pose" else 0.0
    errors = np.array([wanted.shift + far * wanted.turn] * 3 + [wanted.turn] * (len(values) - 3))
    errors = errors * (1.0 + 1e-12) + MODEL * (1.0 + loop.longest)
    rounding = POINTWISE * (1.0 + loop.longest) * max(1.0, *map(abs, loop.by))
    value, slope = stacked(values).widened(rounding), stacked([stacked(row) for row in slopes], 1).widened(rounding)
    return value, slope, agreement.widened(rounding), errors


def _middle(x: Interval) -> Interval:
    return exactly((x.low + x.high) / 2.0)


def _of_columns(columns: list[Interval], v: Interval) -> Interval:
    return columns[0] * v[0] + columns[1] * v[1] + columns[2] * v[2]


def _about(a: Interval, c: Interval, s: Interval, v: Interval) -> Interval:
    return v * c + cross(a, v) * s + a * (dot(a, v)[:, None] * (1.0 - c))


@dataclass
class Side:
    """A sum: the joints in it, and coefficients, an axis of three for each."""

    joints: list[int]
    coefficients: Interval


@dataclass
class Equation:
    """``left + right = 0``, off by at most ``slack``."""

    sides: tuple[Side, Side]
    slack: float


class _Seen:
    """A point or a direction as seen from a cut: vectors times one number of each joint, by keys with base 3 digits."""

    def __init__(self, v: Interval, point: bool) -> None:
        self.keys, self.v, self.point, self.lost = [0], v[None], point, 0.0

    def move(self, loop: Loop, index: int, sign: float) -> None:
        a, o, digit = loop.axis[index], loop.point[index], 3**index
        if loop.slides[index]:
            if self.point:
                self.keys.append(digit)
                self.v = _joined(self.v, (a * sign)[None])
            return
        v = self.v
        if self.point:
            v = _joined((v[0] - o)[None], v[1:])
        along = a * dot(a, v)[:, None]
        keys = [*self.keys, *(key + digit for key in self.keys), *(key + 2 * digit for key in self.keys)]
        parts = _joined(along, v - along, cross(a, v) * sign)
        big = upper_norm(parts)
        weights = np.array([_scale(key, loop) for key in keys])
        keep = (big > LITTLE) | (np.array(keys) == 0)
        self.lost += float((big * weights)[~keep].sum()) * (1.0 + 1e-12)
        rows = np.flatnonzero(keep)
        self.keys, self.v = [keys[row] for row in rows], parts[rows]
        if self.point:
            first = self.keys.index(0)
            order = [first, *(k for k in range(len(self.keys)) if k != first)]
            self.keys, self.v = [self.keys[k] for k in order], self.v[np.array(order)]
            self.v = _joined((self.v[0] + o)[None], self.v[1:])
        require(len(self.keys) <= 3**6, "an equation between too many joints")

    def along(self, w: Any, factor: float = 1.0) -> list[tuple[int, Interval]]:
        products = dot(self.v, w) * factor
        return [(key, products[k]) for k, key in enumerate(self.keys)]


def _joined(*parts: Interval) -> Interval:
    return Interval(np.concatenate([p.low for p in parts]), np.concatenate([p.high for p in parts]))


def _scale(key: int, loop: Loop) -> float:
    """The largest value of what a term is multiplied with."""
    out = 1.0
    for index in range(loop.m):
        if key // 3**index % 3 and loop.slides[index]:
            out *= max(1.0, loop.strokes[index])
    return out


def equation_of(loop: Loop, wanted: Wanted, followed: Array, row: Array) -> Equation:
    """The equation of a row of pair, cut, kind and direction; pairs are rows of still, point and where at q = 0."""
    pair, cut, kind = (int(x) for x in row[:3])
    require(0 <= pair < len(followed) and 0 <= cut <= loop.m and kind in (0, 1, 2), "no such equation")
    at = _both_ends(loop, wanted, followed[pair])
    if kind == 0:
        left, right = _seen(loop, at, 0, cut), _seen(loop, at, 1, cut)
        size = float(upper_norm(row[3:]))
        require(size < 2.0, "a long direction")
        terms = left.along(row[3:]), right.along(row[3:])
        return _written(loop, *terms, (at.error + left.lost + right.lost) * size)
    require(not any(loop.slides) and cut < loop.m, "distances from axes of an arm that slides")
    return _of_distances(loop, wanted, followed, pair, cut, kind)


@dataclass
class _Ends:
    given: Interval
    own: Interval
    point: bool
    error: float


def _both_ends(loop: Loop, wanted: Wanted, row: Array) -> _Ends:
    """A point or a direction where the base ends and where the tool ends, and how far they may be off."""
    still, point, where = bool(row[0]), bool(row[1]), exactly(row[2:])
    T, H = exactly(wanted.pose), loop.tool
    model = MODEL * (1.0 + loop.longest)
    if wanted.kind != "pose":
        require(not still, "what stands still says nothing of a goal that leaves the tool free")
        require(not point or upper_norm(where - H[:3, 3]) < 1e-9, "another point than the tool's")
        where = H[:3, 3] if point else _turned(H, wanted.axis)
        require(point or wanted.kind == "axis", "a direction of a goal that is a place")
    size = float(upper_norm(where - (T if still else H)[:3, 3])) if point else float(upper_norm(where))
    error = (wanted.shift if point else 0.0) + size * wanted.turn + model * (1.0 + size)
    if wanted.kind == "position" or (wanted.kind == "axis" and point):
        error = wanted.shift + model
    A, B = (T, H) if still else (H, T)  # from the frame A to the frame B
    offset = where - A[:3, 3] if point else where
    local = stacked([dot(A[:3, c], offset) for c in range(3)])
    moved = _turned(B, local)
    if point:
        moved = moved + B[:3, 3]
    return _Ends(where, moved, point, error) if still else _Ends(moved, where, point, error)


def _seen(loop: Loop, at: _Ends, side: int, cut: int) -> _Seen:
    """From a cut: the base's end through the joints before it, or the tool's end through those after it."""
    out = _Seen(at.own if side else at.given, at.point)
    for index in reversed(range(cut, loop.m)) if side else range(cut):
        out.move(loop, index, 1.0 if side else -1.0)
    return out


def _of_distances(loop: Loop, wanted: Wanted, followed: Array, pair: int, cut: int, kind: int) -> Equation:
    """The squared distance of a point from the point of the axis at a cut, or its offset along a direction."""
    at = _both_ends(loop, wanted, followed[pair])
    require(at.point, "the distance of a direction")
    o = loop.point
    towards = None
    if kind == 2:
        require(pair + 1 < len(followed), "no direction")
        towards = _both_ends(loop, wanted, followed[pair + 1])
        require(not towards.point and bool(followed[pair][0]) == bool(followed[pair + 1][0]), "a direction of another")
    far = float(upper_norm(at.given - o[0])) + sum(float(upper_norm(o[k + 1] - o[k])) for k in range(cut))
    lost, sides = 0.0, []
    for side in (0, 1):
        first = loop.m - 1 if side else 0
        begin = (at.own if side else at.given) - o[first]
        if towards is None:
            terms = [(0, dot(begin, begin))]
        else:
            terms = [(0, dot(begin, towards.own if side else towards.given))]
        for k in reversed(range(cut, loop.m - 1)) if side else range(cut):
            # from the point o[k + 1] to o[k] at the cut k + 1, or back
            here, step = k + 1, (o[k + 1] - o[k]) if side else (o[k] - o[k + 1])
            from_point = o[k + 1] if side else o[k]
            seen = _seen(loop, at if towards is None else towards, side, here)
            lost += seen.lost * float(upper_norm(step)) * 2.0
            if towards is None:
                terms += seen.along(step, 2.0)
                terms.append((0, dot(step, step) - dot(step, from_point) * 2.0))
            else:
                terms += seen.along(step)
        sides.append(terms)
    model = at.error
    if towards is None:
        slack = (2.0 * far + model) * model + lost
    else:
        slack = model * (1.0 + towards.error) + (far + model) * towards.error + lost
    return _written(loop, sides[0], sides[1], slack * (1.0 + 1e-9))


def _written(loop: Loop, left: list[tuple[int, Interval]], right: list[tuple[int, Interval]], slack: float) -> Equation:
    """``left - right = 0``."""
    sides, constant = [], exactly(0.0)
    for sign, terms in ((1.0, left), (-1.0, right)):
        sums: dict[int, Interval] = {}
        for key, value in terms:
            sums[key] = sums[key] + value * sign if key in sums else value * sign
        constant = constant + sums.pop(0, exactly(0.0))
        kept = {key: value for key, value in sums.items() if value.size > 100.0 * LITTLE}
        slack += sum(float(value.size) * _scale(key, loop) for key, value in sums.items() if key not in kept)
        joints = [index for index in range(loop.m) if any(key // 3**index % 3 for key in kept)]
        require(len(joints) <= MOST_JOINTS, "an equation between too many joints")
        low, high = np.zeros((2, *[3] * len(joints)))
        for key, value in kept.items():
            place = tuple(key // 3**index % 3 for index in joints)
            low[place], high[place] = value.low, value.high
        sides.append(Side(joints, Interval(low, high)))
    first = sides[0].coefficients
    zero = (0,) * len(sides[0].joints)
    total = first[zero] + constant
    first.low[zero], first.high[zero] = total.low, total.high
    return Equation((sides[0], sides[1]), slack * (1.0 + 1e-9))


Numbers = list[tuple[Interval, Interval]]


def at_boxes(loop: Loop, low: Array, high: Array) -> Numbers:
    """Of each joint its cosines and sines in boxes (k, n), (k,) each; its positions and nothing, if it slides."""
    out = []
    for slides, entry, by in zip(loop.slides, loop.entry, loop.by, strict=True):
        moved = Interval(low[:, entry], high[:, entry]) * by
        out.append((moved, exactly(np.zeros(len(low)))) if slides else cosine_and_sine(moved))
    return out


def parts_of(side: Side, numbers: Numbers, count: int) -> tuple[Interval, list[Interval]]:
    """The value of a side, (k,), and of each of its joints what 1, cosine and sine are multiplied with, (k, 3)."""
    if not side.joints:
        whole = side.coefficients
        return Interval(np.full(count, whole.low), np.full(count, whole.high)), []

    def folded(table: Interval, joints: list[int], keep: int | None) -> Interval:
        """Without the axes of all joints but one."""
        for index in reversed(joints):
            if index == keep:
                last = table.low.ndim - 1
                order = (0, last, *range(1, last))  # kept for the end
                table = Interval(table.low.transpose(order), table.high.transpose(order))
                continue
            c, s = numbers[index]
            shape = (count, *[1] * (table.low.ndim - 2))
            c, s = (Interval(x.low.reshape(shape), x.high.reshape(shape)) for x in (c, s))
            table = table[..., 0] + table[..., 1] * c + table[..., 2] * s
        return table

    whole = Interval(side.coefficients.low[None].repeat(count, 0), side.coefficients.high[None].repeat(count, 0))
    parts = [folded(whole, side.joints, index) for index in side.joints]
    return folded(whole, side.joints, None), parts
