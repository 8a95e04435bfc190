"""Who answers whether a configuration collides: three ways to FCL's verdict, by fewer and fewer questions to it.

``PairByPair`` is the reference and asks about every pair. ``Sieved`` and ``Compiled`` leave out those that are proven
apart, by sieves in numpy and in the compiled kernel; the latter also those proven to overlap. None of them counts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Literal, Protocol, get_args

import numpy as np

from planner_service.collision import numpy_broadphase as prefilter
from planner_service.collision.edge_sampling import SampledEdge
from planner_service.collision.fcl import FclJudge
from planner_service.collision.native_kernel import Doubt, Found, Kernel, build_kernel
from planner_service.collision.numpy_broadphase import Prefilter
from planner_service.collision.pairs import Parts
from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.shapes import FloatArray
from planner_service.robot.model import Robot

__all__ = [
    "Backend",
    "Compiled",
    "FclQuestions",
    "Found",
    "Judge",
    "PairByPair",
    "Sieved",
    "judge_for",
]

Backend = Literal["auto", "native", "numpy", "fcl"]

_FEW = 8
"""Rows that are sieved before the others: an edge that collides mostly does so early in bisection order."""

_MANY = 64
"""Rows between two looks at the limits, where these take microseconds each."""


class Judge(Protocol):
    """Finds what collides; of a configuration always the first pair, in their order, that FCL says touches."""

    @property
    def at_once(self) -> int:
        """Rows to ask about between two looks at the limits: a user may cancel within 50 ms."""

    def first_of(self, Q: FloatArray, start: int, stop: int) -> Found | None:
        """The first of rows [start, stop) of Q (m, n) that collides."""

    def first_on(self, edge: SampledEdge, start: int, stop: int) -> Found | None:
        """The first of rows [start, stop) of an edge that collides."""

    def colliding(self, Q: FloatArray) -> Iterator[int]:
        """The rows of Q (m, n) that collide."""

    def touching(self, q: FloatArray) -> list[int]:
        """All pairs that touch at q (n,)."""


class FclQuestions:
    """Puts pairs to FCL; the poses it gets come from one scalar forward kinematics, whoever found the pairs."""

    def __init__(self, robot: Robot, parts: Parts) -> None:
        self._robot, self.parts = robot, parts
        self.fcl = FclJudge(parts.shapes, [part.T for part in parts.parts])
        self._local = [(part.body, _numbers(part.T)) for part in parts.parts[: parts.riding]]

    def touching(self, q: Sequence[float], pairs: Iterable[tuple[int, tuple[int, int]]]) -> Iterator[int]:
        """The numbers of those pairs, told with their two parts, that touch at q, as FCL is asked.

        Raises:
            BrokenInvariant: q is not finite: to FCL nothing would touch there.
        """
        if not all(map(math.isfinite, q)):
            raise BrokenInvariant(prefilter.NOT_FINITE)
        riding, poses = self.parts.riding, self._robot.body_poses(q)
        placed: set[int] = set()
        for number, (i, j) in pairs:
            for part in (i, j):
                if part < riding and part not in placed:
                    placed.add(part)
                    body, local = self._local[part]
                    self.fcl.place(part, *_compose(poses[body], local))
            if self.fcl.collide(i, j):
                yield number

    def numbered(self, pairs: Sequence[int]) -> Iterator[tuple[int, tuple[int, int]]]:
        """Each of those pairs with its two parts."""
        parts = self.parts.pairs[np.array(pairs, dtype=np.intp)].tolist()
        return zip(pairs, parts, strict=True)


class PairByPair:
    """The reference: every pair of every configuration is put to FCL, in the order of the pairs."""

    at_once = 1

    def __init__(self, questions: FclQuestions) -> None:
        self.questions = questions
        self._pairs = list(enumerate(questions.parts.pairs.tolist()))

    def first_of(self, Q: FloatArray, start: int, stop: int) -> Found | None:
        """See ``Judge``."""
        for row, q in enumerate(Q[start:stop].tolist(), start):
            for pair in self._touching(q):
                return row, 0.0, pair
        return None

    def first_on(self, edge: SampledEdge, start: int, stop: int) -> Found | None:
        """See ``Judge``."""
        return _on(edge, self.first_of(edge.samples, start, stop))

    def colliding(self, Q: FloatArray) -> Iterator[int]:
        """See ``Judge``."""
        return (row for row, q in enumerate(Q.tolist()) if any(True for _ in self._touching(q)))

    def touching(self, q: FloatArray) -> list[int]:
        """See ``Judge``."""
        return list(self._touching(q.tolist()))

    def _touching(self, q: Sequence[float]) -> Iterator[int]:
        return self.questions.touching(q, self._pairs)


class Sieved:
    """FCL is asked about what numpy's sieves leave: where the kernel was not built."""

    at_once = _MANY

    def __init__(self, questions: FclQuestions, sieves: Callable[[], Prefilter]) -> None:
        self.questions, self._sieves = questions, sieves

    def first_of(self, Q: FloatArray, start: int, stop: int) -> Found | None:
        """See ``Judge``."""
        for first, end in ((start, min(start + _FEW, stop)), (start + _FEW, stop)):
            for row, pair in self._hits(Q[first:end]):
                return first + row, 0.0, pair
        return None

    def first_on(self, edge: SampledEdge, start: int, stop: int) -> Found | None:
        """See ``Judge``."""
        return _on(edge, self.first_of(edge.samples, start, stop))

    def colliding(self, Q: FloatArray) -> Iterator[int]:
        """See ``Judge``."""
        return (row for row, _ in self._hits(Q))

    def touching(self, q: FloatArray) -> list[int]:
        """See ``Judge``."""
        left: list[int] = self._sieves().candidates(q[None])[1].tolist()
        return list(self.questions.touching(q.tolist(), self.questions.numbered(left)))

    def _hits(self, Q: FloatArray) -> Iterator[tuple[int, int]]:
        """The rows that collide, each with the first of its pairs that does."""
        if not len(Q):
            return
        left: dict[int, list[int]] = {}
        for row, pair in zip(*(numbers.tolist() for numbers in self._sieves().candidates(Q)), strict=True):
            left.setdefault(row, []).append(pair)
        for row, pairs in left.items():
            for pair in self.questions.touching(Q[row].tolist(), self.questions.numbered(pairs)):
                yield row, pair
                break


class Compiled:
    """FCL is asked about what the kernel leaves in doubt; whole edges are looked at in one call.

    Attributes:
        kernel: Tells the next row in doubt; thread-safe, unlike FCL's objects.
    """

    at_once = _MANY

    def __init__(self, questions: FclQuestions, kernel: Kernel) -> None:
        self.questions, self.kernel = questions, kernel

    def first_of(self, Q: FloatArray, start: int, stop: int) -> Found | None:
        """See ``Judge``."""
        rows = np.ascontiguousarray(Q)
        return self._first(lambda begin: self.kernel.first(rows, begin, stop), self.kernel.first(rows, start, stop))

    def first_on(self, edge: SampledEdge, start: int, stop: int) -> Found | None:
        """See ``Judge``."""
        a, b, ends, segments = edge.a, edge.b, edge.ends, edge.segments
        told = self.kernel.edge(a, b, ends, segments, start, stop)
        return self._first(lambda begin: self.kernel.edge(a, b, ends, segments, begin, stop), told)

    def colliding(self, Q: FloatArray) -> Iterator[int]:
        """See ``Judge``."""
        found = self.first_of(Q, 0, len(Q))
        while found is not None:
            yield found[0]
            found = self.first_of(Q, found[0] + 1, len(Q))

    def touching(self, q: FloatArray) -> list[int]:
        """See ``Judge``."""
        return list(self._asked(q.tolist(), self.kernel.candidates(q[None])[1]))

    def _first(self, ask: Callable[[int], Found | Doubt | None], told: Found | Doubt | None) -> Found | None:
        """The first row that collides of those that may, ``ask`` telling the next of them from a row on."""
        while told is not None and len(told) == 4:
            row, fraction, q, pairs = told
            pair = self._first_touching(q, pairs)
            if pair is not None:
                return row, fraction, pair
            told = ask(row + 1)
        return told

    def _first_touching(self, q: list[float], pairs: list[int]) -> int | None:
        """The first pair that touches at q, where those are in doubt and maybe more behind them."""
        found = next(self._asked(q, pairs), None)
        if found is not None:
            return found
        # the kernel stops at the first part in doubt: others may be behind it
        more = [pair for pair in self.kernel.candidates(np.array([q]))[1] if pair not in pairs]
        return next(self._asked(q, more), None) if more else None

    def _asked(self, q: Sequence[float], pairs: list[int]) -> Iterator[int]:
        return self.questions.touching(q, self.questions.numbered(pairs))


def judge_for(backend: Backend, robot: Robot, parts: Parts, sieves: Callable[[], Prefilter]) -> Judge:
    """The judge of that name; "auto" is the kernel where it was built, else numpy.

    Args:
        sieves: Makes the sieves when they are first needed.

    Raises:
        InvalidRequest: no such backend, or "native" where the kernel was not built.
    """
    if not isinstance(backend, str) or backend not in get_args(Backend):
        raise InvalidRequest("backend", backend, '"auto", "native", "numpy" or "fcl"')
    kernel = build_kernel(robot, parts, prefilter.MARGIN) if backend in ("auto", "native") else None
    if kernel is None and backend == "native":
        raise InvalidRequest("backend", backend, '"auto", "numpy" or "fcl": the compiled kernel was not built')
    questions = FclQuestions(robot, parts)
    if kernel is not None:
        return Compiled(questions, kernel)
    return PairByPair(questions) if backend == "fcl" else Sieved(questions, sieves)


def _on(edge: SampledEdge, found: Found | None) -> Found | None:
    """What was found among an edge's samples, with where on the edge it is."""
    return None if found is None else (found[0], edge.fraction(found[0]), found[2])


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
