"""The one oracle: is it free? It alone judges, and it alone counts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal, TypeGuard, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner_service.collision import prefilter
from planner_service.collision.edges import (
    GLANCE,
    MAX_SEGMENTS,
    EdgeStep,
    FinestStep,
    Known,
    MotionStep,
    bisection_order,
    first_samples,
    interior,
)
from planner_service.collision.fcl import FclJudge
from planner_service.collision.kernel import Asked, Doubt, Kernel, build_kernel, rules_of
from planner_service.collision.ledger import CancelToken, CheckCounts, Ledger
from planner_service.collision.parts import Parts
from planner_service.collision.prefilter import Prefilter
from planner_service.errors import InvalidRequest
from planner_service.geometry import FloatArray, numbers
from planner_service.path import JointPath
from planner_service.robot import Robot
from planner_service.scene import Scene

__all__ = ["Backend", "CollisionChecker", "Contact", "EdgeHit"]

Backend = Literal["auto", "native", "numpy", "fcl"]

MAX_PADDING = 0.1
"""Metres; more padding than this is a unit mistake."""

NANO = 1e9
"""Bounds are given in whole nanometres, rounded to the safe side: their last bits depend on the CPU."""

MAX_VARIANTS = 32
"""Variants kept, the oldest forgotten first: a plan needs a handful, and building one again changes no answer."""

LIMIT_SLACK = 1e-9
"""Radians or metres by which rounding may carry a configuration over a joint limit."""

_FIRST_CHUNK, _CHUNK = 8, 64
"""Samples judged at once: few first, because an edge that collides mostly does so early in bisection order.
The kernel sees to that by itself; between two calls of it a user can cancel."""

FLOAT64 = np.dtype(np.float64)

_END = Known.END.value
_JUDGED_ENDS = (3, 2, 1, 0)
"""As the kernel has it, 1 for the start and 2 for the end, by the value of ``Known``: arithmetic of flags is slow."""

Hit = tuple[int, float, tuple[str, str]]
"""The row that collides, where on the edge it is, and the owners of the first pair that touches there."""


@dataclass(frozen=True)
class Contact:
    """Two things that touch.

    Attributes:
        a: A link of the robot, or an object it carries.
        b: What it touches: a link, a carried object or an obstacle.
        depth: Overlap in metres of their deepest pieces along a separating direction: an upper
            bound of how far they penetrate.
    """

    a: str
    b: str
    depth: float

    def __str__(self) -> str:
        return f"{self.a} x {self.b} (at most {self.depth * 1000:.1f} mm deep)"


@dataclass(frozen=True)
class EdgeHit:
    """The first sample of an edge, in the order of judging, that collides.

    Attributes:
        fraction: Where it is on the edge: 0 at q1, 1 at q2.
        a: A link of the robot, or an object it carries.
        b: What it touches.
    """

    fraction: float
    a: str
    b: str


class CollisionChecker:
    """Answers whether a robot's configurations and the edges between them are free in a scene; from any thread.

    FCL's boolean ``collide`` decides every doubtful pair; a pair is not asked only where it is proven apart, or to
    overlap, by more than the margin in which FCL could say otherwise. Joint limits are part of the question: a
    configuration outside them raises rather than being called free.

    Args:
        edge_step: How finely edges are sampled.
        padding: Distance in metres that every pair must keep; verdicts of a plan use 0.
        allowed: Pairs of link or object names that may touch, beside those the robot allows.
        backend: What finds the pairs that FCL is asked about: "native", the compiled kernel; "numpy", sieves in
            numpy; "auto", the kernel where it was built, else numpy; "fcl", nothing: the reference, which puts every
            pair to FCL, one by one in their order. Verdicts, counts and names are the same.

    Raises:
        UnknownName: ``allowed`` names nothing that is there.
        InvalidRequest: no such backend, or "native" where the kernel was not built.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        *,
        edge_step: EdgeStep | None = None,
        padding: float = 0.0,
        allowed: Iterable[tuple[str, str]] = (),
        backend: Backend = "auto",
    ) -> None:
        _require_padding(padding)
        if edge_step is not None and not callable(getattr(edge_step, "segments", None)):
            raise InvalidRequest("edge_step", edge_step, "a rule such as MotionStep(0.010)")
        self.robot = robot
        self.scene = scene
        self.edge_step: EdgeStep = MotionStep() if edge_step is None else edge_step
        self.padding = float(padding)
        self.allowed = _sorted_pairs(allowed)
        self.ledger = Ledger()
        self._parts = Parts(robot, scene, padding=self.padding, allowed=self.allowed)
        self.backend = backend
        self._kernel = _kernel_of(backend, robot, self._parts)
        self._judge = FclJudge(self._parts.shapes, [part.T for part in self._parts.parts])
        n = self._parts.riding
        self._local = [_numbers(part.T) for part in self._parts.parts[:n]]
        self._reach: list[float] = robot.reach(self._parts.carried).tolist()
        self._lower = [value - LIMIT_SLACK for value in robot.limits.lower.tolist()]
        self._upper = [value + LIMIT_SLACK for value in robot.limits.upper.tolist()]
        self._quick = self._agreed()
        self._variants: dict[tuple[float, tuple[tuple[str, str], ...], float | None], CollisionChecker] = {}
        self._motion_step: float | None = None

    def variant(
        self,
        *,
        padding: float | None = None,
        allowed: Iterable[tuple[str, str]] | None = None,
        motion_step: float | None = None,
    ) -> CollisionChecker:
        """A checker of the same robot and scene with other padding or allowed pairs; both count in one ledger.

        Args:
            motion_step: Metres of a ``MotionStep`` that edges keep beside the step there is.
        """
        padding = self.padding if padding is None else padding
        pairs = self.allowed if allowed is None else _sorted_pairs(allowed)
        key = (padding, pairs, self._motion_step if motion_step is None else motion_step)
        if key == (self.padding, self.allowed, self._motion_step):
            return self
        _require_padding(padding)
        if key not in self._variants:
            step = self.edge_step
            if motion_step is not None:
                step = FinestStep((step, MotionStep(motion_step)))
            other = CollisionChecker(
                self.robot, self.scene, edge_step=step, padding=padding, allowed=pairs, backend=self.backend
            )
            other.ledger, other._variants, other._motion_step = self.ledger, self._variants, key[2]
            while len(self._variants) >= MAX_VARIANTS:
                del self._variants[next(iter(self._variants))]
            self._variants[key] = other
        return self._variants[key]

    def _agreed(self) -> Kernel | None:
        """The kernel, told the limits and the edge step; None if there is none, or the step is a user's own."""
        rules = rules_of(self.edge_step)
        if self._kernel is None or rules is None:
            return None
        self._kernel.agree(self._lower, self._upper, self._reach, rules)
        return self._kernel

    @cached_property
    def _prefilter(self) -> Prefilter:
        return Prefilter(self.robot, self._parts)

    @property
    def instruction_set(self) -> str | None:
        """What the compiled kernel uses; None where it is not asked."""
        return None if self._kernel is None else self._kernel.variant

    @property
    def counts(self) -> CheckCounts:
        """What was asked so far, of this checker and its variants."""
        return self.ledger.counts

    @property
    def pair_count(self) -> int:
        """Pairs of pieces judged in each state, robot against itself and against the scene."""
        return len(self._parts.pairs)

    @contextmanager
    def limited(
        self, *, states: int | None = None, deadline: float | None = None, token: CancelToken | None = None
    ) -> Iterator[None]:
        """Within the block, a check that would pass one of these limits raises a ``SearchStopped`` instead."""
        with self.ledger.limited(states=states, deadline=deadline, token=token):
            yield

    def state_is_free(self, q: ArrayLike) -> bool:
        """Whether the robot at q (n,) touches neither itself nor the scene; counts one state.

        Raises:
            InvalidRequest: q has the wrong shape, is not finite, or lies outside the joint limits.
        """
        if self._quick is not None and _are_floats(q):
            with self.ledger.lock:
                if self._quick.surely_free(q):
                    self.ledger.poll()
                    self.ledger.charge_states(1)
                    return True
        return self._first_collision(self._configuration("q", q)[None]) is None

    def states_are_free(self, Q: ArrayLike) -> NDArray[np.bool_]:
        """Which configurations of Q (m, n) are free, (m,): as ``state_is_free`` says, several times as fast; counts m.

        Raises:
            InvalidRequest: a row has the wrong shape, is not finite, or lies outside the joint limits.
        """
        array = numbers("Q", Q, f"rows of {self.robot.n} joint values")
        if array.ndim != 2:
            raise InvalidRequest("Q", array.shape, f"rows of {self.robot.n} joint values, shape (m, {self.robot.n})")
        rows = [self._configuration(f"Q[{k}]", q) for k, q in enumerate(array)]
        free = np.ones(len(rows), dtype=bool)
        for start in range(0, len(rows), _CHUNK):
            chunk = np.array(rows[start : start + _CHUNK])
            with self.ledger.lock:
                self.ledger.poll()
                self.ledger.charge_states(len(chunk))
                for row, _ in self._hits(chunk):
                    free[start + row] = False
        return free

    def edge_is_free(self, q1: ArrayLike, q2: ArrayLike, *, known: Known = Known.NEITHER) -> bool:
        """Whether every sample of the straight line from q1 to q2 is free; counts as ``edge_hit`` does."""
        return self.edge_hit(q1, q2, known=known) is None

    def edge_hit(self, q1: ArrayLike, q2: ArrayLike, *, known: Known = Known.NEITHER) -> EdgeHit | None:
        """Where the straight line from q1 to q2 collides, None when every sample is free.

        Counts one edge and its states. Judges q1, q2, then the interior in bisection order, up to the
        first sample that collides.

        Args:
            known: Ends that are known to be free and are neither judged nor counted.

        Raises:
            InvalidRequest: an end has the wrong shape, is not finite, or lies outside the joint limits.
        """
        return self._edge(q1, q2, known, 0)

    def edge_glance(self, q1: ArrayLike, q2: ArrayLike, *, known: Known = Known.NEITHER) -> EdgeHit | None:
        """As ``edge_hit``, but of the interior only the first samples are judged, which are far apart.

        An edge that collides mostly does so at one of these; ``edge_rest`` judges the others.
        """
        return self._edge(q1, q2, known, GLANCE)

    def edge_rest(self, q1: ArrayLike, q2: ArrayLike) -> EdgeHit | None:
        """Where an edge collides at a sample that ``edge_glance`` left out, None when all of these are free.

        Counts their states, and no edge: that was counted at the glance.
        """
        a, b = self._configuration("q1", q1).tolist(), self._configuration("q2", q2).tolist()
        segments = self._segments(a, b)
        first = first_samples(segments)
        with self.ledger.lock:
            if self._kernel is None:
                hit = self._interior_hit(a, b, segments, slice(first, None))
            else:
                ask = partial(self._kernel.edge, a, b, 0, segments)
                hit = self._first_doubtful(segments - 1, ask, start=first)
        return None if hit is None else EdgeHit(hit[1], *hit[2])

    def _edge(self, q1: ArrayLike, q2: ArrayLike, known: Known, glance: int) -> EdgeHit | None:
        """Judge an edge, of its interior only what a glance sees unless ``glance`` is 0."""
        if self._quick is not None and _are_floats(q1) and _are_floats(q2):
            with self.ledger.lock:  # FCL objects are moved from question to question
                stop = self._stop(0, MAX_SEGMENTS)
                told = self._quick.ask(q1, q2, known._value_, glance, stop)
                if told is not None:
                    return self._told(self._quick, q1, q2, told, stop)
        a, b = self._configuration("q1", q1).tolist(), self._configuration("q2", q2).tolist()
        segments = self._segments(a, b)
        inner = first_samples(segments) if glance else segments - 1
        with self.ledger.lock:
            self.ledger.edges += 1
            if self._kernel is None:
                hit = self._edge_hit((a, b), segments, inner, known if a != b else known | Known.END)
            else:
                ends = _JUDGED_ENDS[known._value_ if a != b else known._value_ | _END]
                ask = partial(self._kernel.edge, a, b, ends, segments)
                hit = self._first_doubtful((ends + 1) // 2 + inner, ask)
        return None if hit is None else EdgeHit(hit[1], *hit[2])

    def _told(self, kernel: Kernel, q1: FloatArray, q2: FloatArray, told: int | Asked, stop: int) -> EdgeHit | None:
        """Count and finish an edge of which the kernel told the rows below ``stop``."""
        self.ledger.edges += 1
        if isinstance(told, int):
            if told:
                self.ledger.poll()
                self.ledger.charge_states(told)
            return None
        ends, segments, rows, doubt = told
        ask = partial(kernel.edge, q1.tolist(), q2.tolist(), ends, segments)
        hit = self._first_doubtful(rows, ask, told=(min(stop, rows), doubt))
        return None if hit is None else EdgeHit(hit[1], *hit[2])

    def _edge_hit(self, edge: tuple[list[float], list[float]], segments: int, inner: int, known: Known) -> Hit | None:
        """The first collision among the ends that are not known and the first ``inner`` interior samples."""
        ends = [
            (k, q) for k, (q, end) in enumerate(zip(edge, (Known.START, Known.END), strict=True)) if end not in known
        ]
        hit = self._first_of_all(np.array([q for _, q in ends])) if ends else None
        if hit is not None:
            return hit[0], float(ends[hit[0]][0]), hit[2]
        return self._interior_hit(*edge, segments, slice(inner))

    def _interior_hit(self, a: list[float], b: list[float], segments: int, part: slice) -> Hit | None:
        """The first collision among a part of an edge's interior samples."""
        if segments == 1:
            return None
        hit = self._first_of_all(interior(a, b, segments)[part])
        if hit is None:
            return None
        fraction = float(bisection_order(segments)[part][hit[0], 0])
        return hit[0], fraction if a <= b else 1.0 - fraction, hit[2]

    def segments(self, q1: ArrayLike, q2: ArrayLike) -> int:
        """The number of equal parts into which the edge from q1 to q2 is split; counts nothing."""
        return self._segments(self._configuration("q1", q1).tolist(), self._configuration("q2", q2).tolist())

    def _segments(self, a: Sequence[float], b: Sequence[float]) -> int:
        return self.edge_step.segments([y - x for x, y in zip(a, b, strict=True)], self._reach)

    def path_is_free(self, path: JointPath, *, known: Known = Known.NEITHER) -> bool:
        """Whether every piece of a path is free: straight ones as edges, blends at samples; points between them once.

        Args:
            known: Ends of the path that are known to be free.
        """
        points = path(path.breaks)
        if len(points) == 1:
            return bool(known) or self.state_is_free(points[0])
        blends = iter(np.flatnonzero(path.blends > 0.0).tolist())
        for k, blended in enumerate(path.blended.tolist()):
            ends = Known.START if k or Known.START in known else Known.NEITHER
            if k == len(points) - 2:
                ends |= known & Known.END
            if blended:
                unknown = [q for q, end in ((points[k], Known.START), (points[k + 1], Known.END)) if end not in ends]
                free = all(map(self.state_is_free, unknown)) and self.blend_is_free(path, next(blends))
            else:
                free = self.edge_is_free(points[k], points[k + 1], known=ends)
            if not free:
                return False
        return True

    def blend_is_free(self, path: JointPath, k: int) -> bool:
        """Whether the blend at waypoint k of a path is free between its ends, which are not judged; counts its states.

        Its samples are spaced as on an edge over which each joint moves as fast as anywhere on the blend, and judged
        in bisection order.

        Raises:
            InvalidRequest: there is no blend at waypoint k, or its end lies outside the joint limits.
        """
        inside = 0 < k < len(path.waypoints) - 1
        if not inside or not path.blends[k] > 0.0:
            raise InvalidRequest("k", k, "the index of a waypoint with a blend")
        start, length = float(path.knots[k] - path.blends[k]), float(2.0 * path.blends[k])
        for q in path([start, start + length]):
            self._configuration("path", q)
        fastest = np.abs(path([start, start + length], 1)).max(axis=0)
        segments = self.edge_step.segments((fastest * length).tolist(), self._reach)
        if segments == 1:
            return True
        s = start + length * bisection_order(segments)[:, 0]
        return self._first_collision(path(np.minimum(s, path.length))) is None

    def clearance(self, q: ArrayLike) -> float:
        """A proven lower bound in metres of the smallest gap at q (n,); negative when something overlaps.

        The bound is the separation of the original shapes along the best direction found, by
        support functions. Counts one distance per pair.

        Returns:
            ``math.inf`` when no pair is judged at all.

        Raises:
            InvalidRequest: q has the wrong shape, is not finite, or lies outside the joint limits.
        """
        gap = self._prefilter.smallest_gap(self._configuration("q", q))
        self.ledger.charge_distances(self.pair_count)
        return math.floor(gap * NANO) / NANO if math.isfinite(gap) else gap

    def contacts(self, q: ArrayLike) -> tuple[Contact, ...]:
        """The pairs that touch at q (n,), deepest first; empty when q is free. Counts one state.

        Raises:
            InvalidRequest: q has the wrong shape, is not finite, or lies outside the joint limits.
        """
        q = self._configuration("q", q)
        numbers = self._candidates(q)
        with self.ledger.lock:
            self.ledger.charge_states(1)
            hits = np.array(list(self._colliding_pairs(q.tolist(), numbers)), dtype=np.intp)
        depth: dict[tuple[str, str], float] = {}
        for pair, overlap in zip(hits.tolist(), self._prefilter.overlaps(q, hits).tolist(), strict=True):
            names = self._parts.names(pair)  # of a pair that only touches the bound may be below 0
            depth[names] = max(depth.get(names, 0.0), math.ceil(overlap * NANO) / NANO)
        found = [Contact(a, b, value) for (a, b), value in depth.items()]
        return tuple(sorted(found, key=lambda c: (-c.depth, c.a, c.b)))

    def _configuration(self, field: str, q: ArrayLike) -> FloatArray:
        if type(q) is np.ndarray and q.dtype == np.float64:  # as planners ask: no time for a closer look
            array = q
        else:
            array = numbers(field, q, f"{self.robot.n} joint values")
        if array.shape != (self.robot.n,):
            raise InvalidRequest(field, np.shape(q), f"{self.robot.n} joint values, shape ({self.robot.n},)")
        for k, value in enumerate(array.tolist()):
            if not self._lower[k] <= value <= self._upper[k]:
                low, high = self.robot.limits.lower[k], self.robot.limits.upper[k]
                raise InvalidRequest(field, value, f"{self.robot.joint_names[k]} in [{low:.4f}, {high:.4f}]")
        return array

    def _candidates(self, q: FloatArray) -> Sequence[int]:
        """The pairs at q (n,) that are not proven apart; for the reference all there are."""
        if self.backend == "fcl":
            return range(self.pair_count)
        if self._kernel is not None:
            return self._kernel.candidates(q[None])[1]
        numbers: list[int] = self._prefilter.candidates(q[None])[1].tolist()
        return numbers

    def _first_collision(self, Q: FloatArray) -> Hit | None:
        """Judge configurations (m, n) in order, up to the first that collides, and count them."""
        with self.ledger.lock:  # FCL objects are moved from question to question
            if self._kernel is None:
                return self._first_of_all(Q)
            return self._first_doubtful(len(Q), partial(self._kernel.first, np.ascontiguousarray(Q)))

    def _stop(self, start: int, rows: int) -> int:
        """Up to which row to judge in one go, from ``start``: one more than there is room for passes the limit."""
        room = self.ledger.room()
        return min(rows, start + (_CHUNK if room is None else min(_CHUNK, room + 1)))

    def _first_doubtful(
        self,
        rows: int,
        ask: Callable[[int, int], Doubt | None],
        *,
        start: int = 0,
        told: tuple[int, Doubt | None] | None = None,
    ) -> Hit | None:
        """The same for configurations ``start`` to ``rows`` of which the kernel, asked, tells the next in doubt.

        Args:
            told: Up to which row it was asked before, and what it told.
        """
        while start < rows:
            self.ledger.poll()
            if told is None:
                stop = self._stop(start, rows)
                doubt = ask(start, stop)
            else:
                (stop, doubt), told = told, None
            pair = None
            while doubt is not None:
                pair = self._first_touching(doubt)
                if pair is not None:
                    break
                doubt = ask(doubt[0] + 1, stop)
            self.ledger.charge_states((stop if doubt is None else doubt[0] + 1) - start)
            if doubt is not None and pair is not None:
                names = self._parts.names(pair)
                self.ledger.hit(names)
                return doubt[0], doubt[1], names
            start = stop
        return None

    def _first_touching(self, doubt: Doubt) -> int | None:
        """The first pair that touches where the kernel is in doubt."""
        _, _, q, asked, deep = doubt
        if deep:
            return asked[0]
        for pair in self._colliding_pairs(q, asked):
            return pair
        rest = [pair for pair in self._candidates(np.array(q)) if pair not in asked]
        return next(self._colliding_pairs(q, rest), None)

    def _first_of_all(self, Q: FloatArray) -> Hit | None:
        start, size = 0, _FIRST_CHUNK
        while start < len(Q):
            self.ledger.poll()
            room = self.ledger.room()
            chunk = Q[start : start + (size if room is None else min(size, room + 1))]
            hit = next(self._hits(chunk), None)
            self.ledger.charge_states(len(chunk) if hit is None else hit[0] + 1)
            if hit is not None:
                names = self._parts.names(hit[1])
                self.ledger.hit(names)
                return start + hit[0], 0.0, names
            start, size = start + len(chunk), _CHUNK
        return None

    def _hits(self, Q: FloatArray) -> Iterator[tuple[int, int]]:
        """The rows of Q that collide, in order, each with the first of its pairs that does."""
        if self._kernel is not None:
            start = 0
            while (doubt := self._kernel.first(Q, start, len(Q))) is not None:
                touching = self._first_touching(doubt)
                if touching is not None:
                    yield doubt[0], touching
                start = doubt[0] + 1
            return
        if self.backend == "fcl":
            for row, q in enumerate(Q.tolist()):
                pair = next(self._colliding_pairs(q, range(self.pair_count)), None)
                if pair is not None:
                    yield row, pair
            return
        rows, pairs = self._prefilter.candidates(Q)
        doubtful: dict[int, list[int]] = {}
        for row, pair in zip(rows.tolist(), pairs.tolist(), strict=True):
            doubtful.setdefault(row, []).append(pair)
        for row, asked in doubtful.items():
            pair = next(self._colliding_pairs(Q[row].tolist(), asked), None)
            if pair is not None:
                yield row, pair

    def _colliding_pairs(self, q: Sequence[float], asked: Sequence[int]) -> Iterator[int]:
        """The pairs among ``asked`` that FCL finds touching at q, as it is asked.

        The poses FCL gets come from one scalar forward kinematics, whatever placed the prefilter.
        """
        placed: set[int] = set()
        poses = None
        numbers_of_parts = self._parts.pairs[np.array(asked, dtype=np.intp)].tolist()
        for number, (i, j) in zip(asked, numbers_of_parts, strict=True):
            for part in (i, j):
                if part < self._parts.riding and part not in placed:
                    poses = self.robot.body_poses(q) if poses is None else poses
                    placed.add(part)
                    R, t = _compose(poses[self._parts.parts[part].body], self._local[part])
                    self._judge.place(part, R, t)
            if self._judge.collide(i, j):
                yield number


def _require_padding(padding: object) -> None:
    kind = isinstance(padding, int | float | np.number) and not isinstance(padding, bool)
    if not kind or not 0.0 <= padding <= MAX_PADDING:  # type: ignore[operator]
        raise InvalidRequest("padding", padding, f"metres in [0, {MAX_PADDING}]")


def _are_floats(q: ArrayLike) -> TypeGuard[FloatArray]:
    """Whether q is what planners ask with, without a closer look."""
    return type(q) is np.ndarray and q.dtype is FLOAT64


def _kernel_of(backend: object, robot: Robot, parts: Parts) -> Kernel | None:
    if backend not in get_args(Backend):
        raise InvalidRequest("backend", backend, '"auto", "native", "numpy" or "fcl"')
    kernel = build_kernel(robot, parts, prefilter.MARGIN) if backend in ("auto", "native") else None
    if kernel is None and backend == "native":
        raise InvalidRequest("backend", backend, '"auto", "numpy" or "fcl": the compiled kernel was not built')
    return kernel


def _sorted_pairs(allowed: Iterable[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """Pairs of names, each once and in order."""
    pairs = set()
    for pair in allowed:
        if not isinstance(pair, tuple | list) or len(pair) != 2 or not all(isinstance(name, str) for name in pair):
            raise InvalidRequest("allowed", pair, "pairs of link or object names")
        pairs.add((min(pair), max(pair)))
    return tuple(sorted(pairs))


def _numbers(T: FloatArray) -> tuple[float, ...]:
    """A 4 x 4 matrix as nine row-major rotation numbers and three translation numbers."""
    return (*T[:3, :3].ravel().tolist(), *T[:3, 3].tolist())


def _compose(a: Sequence[float], b: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and translation (3,) of the product of two poses given as twelve numbers each."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8, x, y, z = a
    b0, b1, b2, b3, b4, b5, b6, b7, b8, u, v, w = b
    R = np.array(
        [
            [a0 * b0 + a1 * b3 + a2 * b6, a0 * b1 + a1 * b4 + a2 * b7, a0 * b2 + a1 * b5 + a2 * b8],
            [a3 * b0 + a4 * b3 + a5 * b6, a3 * b1 + a4 * b4 + a5 * b7, a3 * b2 + a4 * b5 + a5 * b8],
            [a6 * b0 + a7 * b3 + a8 * b6, a6 * b1 + a7 * b4 + a8 * b7, a6 * b2 + a7 * b5 + a8 * b8],
        ]
    )
    t = np.array([a0 * u + a1 * v + a2 * w + x, a3 * u + a4 * v + a5 * w + y, a6 * u + a7 * v + a8 * w + z])
    return R, t
