"""Getting out of a collision: the way with which a plan begins, and the nearest free configuration, which is advice."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planner_service.certify import MAX_OVERLAP, Certifier, ExemptInterval
from planner_service.constraints import Constraint
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import JointLimits

__all__ = ["APART", "LEAVING", "NoWayOut", "WayOut", "find_way_out", "near", "nearest_free"]

APART = 1e-4
"""Metres that everything keeps where a way out ends, at least, and a configuration that is suggested."""

PARTED = 1e-5
"""Metres from which on a pair that touched is judged like all others: five times what the proof asks."""

PADDED = 2.0
"""Times the padding that everything is to keep in the end: padded boxes are nearer by up to 1.74 of it."""

NEARBY = 0.05
"""Metres: pairs that are farther apart at the start are left to the proof."""

ROOMY = 2.0
"""Times the gap that is wanted: so much room some leave for others."""

LONGEST = 0.05
"""Radians of one straight line: with ``SAMPLES`` of them, about a millimetre of motion lies between two."""

FARTHER = 1.5
"""Times the length that the slopes at its start say: gaps do not grow evenly."""

SAMPLES = 24
"""Of a straight line, at which no gap may be smaller than before."""

SHORTER = 3
"""Lengths tried, each by ``SAMPLES`` shorter."""

LOOKS = 256
"""Places on a whole way out at which no pair may be deeper than at the one before."""

MAX_TURNS = 16
"""Straight lines of a way out."""

ROWS = 24
"""Pairs that decide on a direction: those that lack most."""

DIRECTION_STEPS = 200
CLOSE_ENOUGH = 1e-3
"""Of the best rate at which gaps grow: so much is not worth another step."""

SAME = 1e-8
"""Metres by which a gap may shrink between samples: to so much bounds of gaps are worked out."""

LEAVING = "touching where the motion begins"

_SHELLS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Radii in joint space (rad) searched in turn; beyond the last a person has to find the way out."""

_DIRECTIONS = 32
_BISECTIONS = 8


@dataclass(frozen=True, eq=False)
class WayOut:
    """A motion out of a collision on which no depth grows.

    Attributes:
        path: A polyline from the colliding configuration to a free one.
        exempt: For each pair that touches at its start, how far along it the two may overlap, and by how much.
        distances: (configuration, pair) bounds asked.
    """

    path: JointPath
    exempt: tuple[ExemptInterval, ...]
    distances: int = 0

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The pairs that touch at its start."""
        return tuple(pair for stretch in self.exempt for pair in stretch.pairs)


def nearest_free(
    is_free: Callable[[FloatArray], bool], q: FloatArray, limits: JointLimits, rng: np.random.Generator
) -> FloatArray | None:
    """A free configuration near q (n,), None if none was found.

    Random directions on growing shells inside the joint limits, then bisection back towards q; ``is_free`` counts.
    """
    free = next((candidate for candidate in near(q, limits, rng) if is_free(candidate)), None)
    return None if free is None else read_only(_pulled_back(is_free, q, free))


def near(q: FloatArray, limits: JointLimits, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Configurations around q (n,) inside the limits, in random directions on growing shells."""
    for radius in _SHELLS:
        for direction in rng.standard_normal((_DIRECTIONS, len(q))).tolist():
            norm = math.sqrt(math.fsum(x * x for x in direction))
            yield np.clip(q + np.array(direction) * (radius / norm), limits.lower, limits.upper)


def _pulled_back(is_free: Callable[[FloatArray], bool], q: FloatArray, free: FloatArray) -> FloatArray:
    """A free point on the line from a colliding q to ``free``, close to where the collision ends."""
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        if is_free(q + (free - q) * middle):
            high = middle
        else:
            low = middle
    return q + (free - q) * high if high < 1.0 else free


class NoWayOut(Exception):
    """Why there is none.

    Attributes:
        too_deep: Whether a pair overlaps by more than is allowed; otherwise no motion was found.
    """

    def __init__(self, why: str, *, too_deep: bool = False) -> None:
        super().__init__(why)
        self.too_deep = too_deep


def find_way_out(
    certifier: Certifier,
    q: FloatArray,
    overlap: float,
    padding: float,
    constraints: Sequence[Constraint] = (),
    charge: Callable[[int], None] = lambda bounds: None,
) -> WayOut:
    """A proven motion from a colliding q (n,) to where everything keeps the padding, or as near to it as it comes.

    It goes straight in the direction in which all gaps that are too small grow, each in the same part of what it lacks,
    and turns where one of them would shrink. The gaps, signed ones, are those of the proof. That they never shrink is
    looked at in ``SAMPLES`` places of each straight line; that no pair is ever deeper than at q, and no other pair
    touches, is proven.

    Args:
        overlap: Metres by which pairs may overlap at q.
        padding: Metres.
        constraints: What must be proven to hold on it, too; no direction is chosen for them.
        charge: Called with numbers of bounds.

    Raises:
        NoWayOut: A pair overlaps by more, or no such motion was found.
    """
    asked = 0

    def counted(bounds: int) -> None:
        nonlocal asked
        asked += bounds
        charge(bounds)

    (depths,) = certifier.overlaps(q[None])
    deep = [(depth, *pair) for pair, depth in depths.items() if depth > overlap]
    if deep:
        depth, a, b = max(deep)
        what = f"{a} x {b} is {depth * 1e3:.4g} mm deep, and start_overlap allows {overlap * 1e3:g} mm"
        enough = math.ceil(depth * 1e4) / 1e4
        hint = f": with start_overlap={enough:g} a plan begins with a way out of it, if there is one"
        raise NoWayOut(what + hint if enough <= MAX_OVERLAP else what, too_deep=True)
    walk = _Walk(certifier, q, depths, max(PADDED * padding, APART), counted)
    points = [q]
    while len(points) <= MAX_TURNS and not walk.done:
        ahead = walk.straight_on()
        if ahead is None:
            break
        points.append(ahead)
    if not walk.apart:
        raise NoWayOut("no motion was found on which nothing gets deeper")
    way = walk.way(JointPath(np.array(points)))
    counted(LOOKS * len(way.exempt))
    if walk.gets_deeper(way):
        raise NoWayOut("no motion was found on which nothing gets deeper")
    refusal = certifier.certify(way.path, exempt=way.exempt, constraints=constraints, charge=counted).refusal
    if refusal is not None:
        raise NoWayOut(f"the motion out of it is not proven: {refusal}")
    return replace(way, distances=asked)


class _Walk:
    """A way out in the making.

    Args:
        depths: By how much pairs overlap at q.
        wanted: Metres by which all pairs are to be apart in the end.
    """

    def __init__(
        self,
        certifier: Certifier,
        q: FloatArray,
        depths: dict[tuple[str, str], float],
        wanted: float,
        charge: Callable[[int], None],
    ) -> None:
        self._certifier, self._wanted, self._charge = certifier, wanted, charge
        self._limits = certifier.robot.limits
        self._depths = depths
        self._pairs = np.sort(certifier.near(q[None], NEARBY)[1])
        owners = [certifier.listed.names(pair) for pair in self._pairs.tolist()]
        self._names = sorted(set(owners))
        self._owner = np.array([self._names.index(owner) for owner in owners], dtype=np.intp)
        self._q, self._s = q, 0.0
        self._found = self._gaps(q[None])[0]
        self._touching_at = dict.fromkeys(self._depths, 0.0)

    @property
    def done(self) -> bool:
        """Whether everything is as far apart as is wanted."""
        return bool(self._found.min(initial=math.inf) >= self._wanted)

    @property
    def apart(self) -> bool:
        """Whether everything is as far apart as a path that begins there takes."""
        return bool(self._found.min(initial=math.inf) >= APART)

    def straight_on(self) -> FloatArray | None:
        """The end of a straight line on which no gap shrinks that lacks something; None if none was found.

        Gaps that lack nothing are let grow, too, where one of them would soon be too small otherwise.
        """
        for least in (self._wanted, ROOMY * self._wanted):
            for shared in (False, True):
                direction = self._direction(least, shared=shared)
                reach = None if direction is None else self._along(*direction)
                if reach is not None:
                    return reach
        return None

    def gets_deeper(self, way: WayOut) -> bool:
        """Whether a pair that touches is deeper somewhere on a way than before, as far as ``LOOKS`` places tell."""
        end = max((stretch.s_end for stretch in way.exempt), default=0.0)
        depths = self._certifier.overlaps(way.path(np.linspace(0.0, end, LOOKS)), self._pairs)
        return any(at.get(pair, 0.0) > before.get(pair, 0.0) + SAME for before, at in pairwise(depths) for pair in at)

    def _along(self, way: FloatArray, length: float) -> FloatArray | None:
        low, high = self._limits.lower, self._limits.upper
        room = np.where(way > 0.0, high - self._q, np.where(way < 0.0, self._q - low, np.inf))
        length = min(float((room / np.where(way != 0.0, np.abs(way), 1.0)).min()), LONGEST, length)
        for _ in range(SHORTER):
            reach = self._free_part(way, length)
            if reach is not None:
                return reach
            length /= SAMPLES
        return None

    def way(self, path: JointPath) -> WayOut:
        """The path so far, with what pairs may overlap on it."""
        exempt = [
            ExemptInterval(0.0, min(self._touching_at[pair], path.length), (pair,), LEAVING, depth)
            for pair, depth in sorted(self._depths.items())
        ]
        return WayOut(path, tuple(exempt))

    def _gaps(self, Q: FloatArray) -> FloatArray:
        """The smallest signed gap of each two owners nearby at Q (m, n), (m, names); at most ``NEARBY``."""
        self._charge(len(Q) * len(self._pairs))
        out = np.full((len(Q), len(self._names)), NEARBY)
        rows, pairs, found = self._certifier.near(Q, NEARBY, self._pairs)
        np.minimum.at(out, (rows, self._owner[np.searchsorted(self._pairs, pairs)]), found.gaps)
        return out

    def _direction(self, least: float, *, shared: bool) -> tuple[FloatArray, float] | None:
        """Where to go from here, a unit vector (n,), and how far, somewhat more than until all gaps would suffice.

        Args:
            least: Metres up to which a gap is too small.
            shared: The pieces of two owners part along one direction, the best of the two that are deepest: each of its
                own would be sideways for some of the many columns of a height field.
        """
        _, pairs, found = self._certifier.near(self._q[None], least, self._pairs)
        if shared:
            owner = self._owner[np.searchsorted(self._pairs, pairs)]
            found = self._certifier.motion.along_deepest(self._q, pairs, owner, found)
        lacks = least - found.gaps
        most = np.argsort(-lacks, kind="stable")[:ROWS]
        self._charge(2 * len(self._q) * len(most))
        rates = self._certifier.motion.slopes(self._q, pairs[most], found.n[:, most]) / lacks[most, None]
        low, high = self._limits.lower, self._limits.upper
        held = np.zeros(len(self._q), dtype=bool)
        for _ in range(len(self._q)):  # joints at their limits stay there unless they turn away
            way = nearest_to_zero(np.where(held, 0.0, rates))
            length = math.sqrt(math.fsum((way * way).tolist()))
            if not length > 0.0:
                return None
            way = way / length
            beyond = ((way > 0.0) & (self._q >= high)) | ((way < 0.0) & (self._q <= low))
            if not (beyond & ~held).any():
                break
            held |= beyond
        speeds = _products(rates, way)
        if not np.all(speeds > 0.0):
            return None
        return np.where(held, 0.0, way), FARTHER / float(speeds.min())

    def _free_part(self, way: FloatArray, length: float) -> FloatArray | None:
        """Where the part of a straight line ends on which no gap shrinks that is small; None if it has no length."""
        t = length * np.arange(1, SAMPLES + 1) / SAMPLES
        Q = np.clip(self._q + t[:, None] * way, self._limits.lower, self._limits.upper)
        gaps = self._gaps(Q)
        before = np.concatenate([self._found[None], gaps[:-1]])
        good = ((gaps >= before - SAME) | (gaps >= self._wanted)).all(axis=1)
        count = int(good.argmin()) if not good.all() else SAMPLES
        enough = np.flatnonzero(gaps[:count].min(axis=1, initial=math.inf) >= self._wanted)
        count = int(enough[0]) + 1 if len(enough) else count
        if not count:
            return None
        self._note_touching(gaps[:count], t)
        self._q, self._found = read_only(Q[count - 1]), gaps[count - 1]
        return self._q

    def _note_touching(self, gaps: FloatArray, t: FloatArray) -> None:
        """Where pairs that touch at the start come apart."""
        for pair in self._depths:
            together = np.flatnonzero(gaps[:, self._names.index(pair)] < PARTED)
            if len(together):
                last = int(together[-1]) + 1
                self._touching_at[pair] = self._s + float(t[min(last, len(t) - 1)])
            elif self._touching_at[pair] >= self._s:
                self._touching_at[pair] = self._s + float(t[0])
        self._s += float(t[len(gaps) - 1])


def nearest_to_zero(rows: FloatArray) -> FloatArray:
    """The point of the hull of rows (k, n) that is nearest to zero, about: its product with each row is the largest.

    (Frank & Wolfe, Naval Research Logistics Quarterly 3, 1956; with steps away, Wolfe 1970.)
    """
    shares: FloatArray = np.full(len(rows), 1.0 / len(rows))
    for _ in range(DIRECTION_STEPS):
        point = np.array([math.fsum(column) for column in (rows * shares[:, None]).T.tolist()])
        heights = _products(rows, point)
        towards = int(heights.argmin())
        away = int(np.where(shares > 0.0, heights, -np.inf).argmax())
        square = math.fsum((point * point).tolist())
        if heights[towards] >= square * (1.0 - CLOSE_ENOUGH):
            break
        step: FloatArray = np.zeros(len(rows))
        if square - heights[towards] >= heights[away] - square:
            step[towards], step, most = 1.0, step - shares + _unit(towards, len(rows)), 1.0
        else:
            step, most = shares - _unit(away, len(rows)), shares[away] / max(1.0 - shares[away], 1e-300)
        change = np.array([math.fsum(column) for column in (rows * step[:, None]).T.tolist()])
        size = math.fsum((change * change).tolist())
        if not size > 0.0:
            break
        length = min(max(-math.fsum((point * change).tolist()) / size, 0.0), most)
        shares = np.maximum(shares + length * step, 0.0)
    return np.array([math.fsum(column) for column in (rows * shares[:, None]).T.tolist()])


def _unit(k: int, count: int) -> FloatArray:
    out = np.zeros(count)
    out[k] = 1.0
    return out


def _products(rows: FloatArray, x: FloatArray) -> FloatArray:
    """Products of rows (k, n) with x (n,), in one fixed order, (k,)."""
    return np.array([math.fsum(row) for row in (rows * x).tolist()])
