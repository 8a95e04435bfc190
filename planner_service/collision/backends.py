"""Which pairs touch: the compiled kernel asks FCL where it has no proof; the judge asks it about every pair.

Both have FCL's verdicts, and neither counts. How far apart near pairs are, the kernel says whichever of them judges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from planner_service.collision.clearance import NOT_FINITE
from planner_service.collision.edge_sampling import SampledEdge
from planner_service.collision.native_kernel import build_kernel
from planner_service.collision.pairs import Parts
from planner_service.concurrency.library_import import loaded
from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot

if TYPE_CHECKING:
    from planner_service.collision.fcl import FclObjects
    from planner_service.native import _core

__all__ = [
    "BackendName",
    "Collision",
    "CollisionBackend",
    "FclBackend",
    "FirstHit",
    "NarrowPhase",
    "NativeBackend",
    "NearPairs",
    "make_backend",
    "measuring_kernel",
    "require_backend",
]


BackendName = Literal["native", "fcl"]

_ROWS_AT_ONCE = 256
"""Rows between two looks at the limits; most edges have fewer. 8 ms in a cloud of 50,000 points, a tenth elsewhere."""


class FirstHit(Protocol):
    """Where an edge collides first: a ``Collision``, or what the kernel says of an edge or a state."""

    @property
    def fraction(self) -> float:
        """Where it is on the edge, 0 to 1; 0 for a configuration of no edge."""

    @property
    def pair(self) -> int:
        """Number of the first pair that touches there."""


class Collision(NamedTuple):
    """The first row of several that collides, and its ``FirstHit``."""

    row: int
    fraction: float
    pair: int


class CollisionBackend(Protocol):
    """Finds what collides; of a configuration always the first pair, in their order, that FCL says touches."""

    narrow_phase: NarrowPhase

    @property
    def rows_at_once(self) -> int:
        """Rows to ask about between two looks at the limits: a user may cancel within 50 ms."""

    def first_collision(self, Q: FloatArray, start: int, stop: int) -> Collision | None:
        """The first of rows [start, stop) of Q (m, n) that collides."""

    def first_collision_on(self, edge: SampledEdge, start: int, stop: int) -> Collision | None:
        """The first of rows [start, stop) of an edge that collides."""

    def colliding(self, Q: FloatArray) -> Iterator[int]:
        """The rows of Q (m, n) that collide."""

    def touching(self, q: FloatArray) -> list[int]:
        """All pairs that touch at q (n,)."""


class NarrowPhase:
    """Asks FCL about pairs; the poses it gets come from one scalar forward kinematics, whichever backend asks."""

    def __init__(self, robot: Robot, parts: Parts) -> None:
        self._robot, self.parts = robot, parts

    @cached_property
    def fcl(self) -> FclObjects:
        """What FCL is asked with: the library is loaded with the first question, as many plans ask none."""
        parts = self.parts
        return loaded(_fcl_objects)(parts.shapes, lambda number: parts.parts[number].T, {})

    @cached_property
    def _local(self) -> list[tuple[int, tuple[float, ...]]]:
        """Of each part that rides its body, and its pose there: rows of the rotation, then the position."""
        riding = self.parts.parts[: self.parts.riding]
        return [(p.body, (*p.T[:3, :3].ravel().tolist(), *p.T[:3, 3].tolist())) for p in riding]

    def touching(self, q: Sequence[float], pairs: Sequence[int]) -> Iterator[int]:
        """Those of some pairs, given by their numbers, that touch at q (n,), in the order given."""
        parts = self.parts.pairs.of(np.array(pairs, dtype=np.intp)).tolist()
        return self.touching_parts(q, zip(pairs, parts, strict=True))

    def touching_parts(self, q: Sequence[float], pairs: Iterable[tuple[int, Sequence[int]]]) -> Iterator[int]:
        """As ``touching``, of pairs that come with their two parts.

        Raises:
            BrokenInvariant: q is not finite: to FCL nothing would touch there.
        """
        if not all(map(math.isfinite, q)):
            raise BrokenInvariant(NOT_FINITE)
        riding, poses = self.parts.riding, self._robot.body_poses(q)
        placed: set[int] = set()
        for pair, (i, j) in pairs:
            for part in (i, j):
                if part < riding and part not in placed:
                    placed.add(part)
                    body, local = self._local[part]
                    self.fcl.place(part, *_compose(poses[body], local))
            if self.fcl.collide(i, j):
                yield pair


def _fcl_objects() -> type[FclObjects]:
    from planner_service.collision.fcl import FclObjects

    return FclObjects


class FclBackend:
    """The judge: FCL decides every pair of every configuration, in the order of the pairs."""

    rows_at_once = 1

    def __init__(self, narrow_phase: NarrowPhase) -> None:
        self.narrow_phase = narrow_phase
        self._pairs = narrow_phase.parts.pairs

    def first_collision(self, Q: FloatArray, start: int, stop: int) -> Collision | None:
        """See ``CollisionBackend``."""
        for row, q in enumerate(Q[start:stop].tolist(), start):
            for pair in self._touching(q):
                return Collision(row, 0.0, pair)
        return None

    def first_collision_on(self, edge: SampledEdge, start: int, stop: int) -> Collision | None:
        """See ``CollisionBackend``."""
        return _on(edge, self.first_collision(edge.samples, start, stop))

    def colliding(self, Q: FloatArray) -> Iterator[int]:
        """See ``CollisionBackend``."""
        return (row for row, q in enumerate(Q.tolist()) if any(True for _ in self._touching(q)))

    def touching(self, q: FloatArray) -> list[int]:
        """See ``CollisionBackend``."""
        return list(self._touching(q.tolist()))

    def _touching(self, q: Sequence[float]) -> Iterator[int]:
        return self.narrow_phase.touching_parts(q, enumerate(self._pairs))


class NativeBackend:
    """FCL decides what the kernel leaves undecided; whole edges are checked in one call.

    Attributes:
        kernel: Finds the next row that is not free; thread-safe.
    """

    rows_at_once = _ROWS_AT_ONCE

    def __init__(self, narrow_phase: NarrowPhase, kernel: _core.CollisionKernel) -> None:
        self.narrow_phase, self.kernel = narrow_phase, kernel

    def first_collision(self, Q: FloatArray, start: int, stop: int) -> Collision | None:
        """See ``CollisionBackend``."""
        rows = np.ascontiguousarray(Q)
        return self._first(lambda row: self.kernel.check_rows(rows, row, stop), start)

    def first_collision_on(self, edge: SampledEdge, start: int, stop: int) -> Collision | None:
        """See ``CollisionBackend``."""
        a, b, ends, segments = edge.a, edge.b, edge.ends, edge.segments
        return self._first(lambda row: self.kernel.check_edge_rows(a, b, ends, segments, row, stop), start)

    def colliding(self, Q: FloatArray) -> Iterator[int]:
        """See ``CollisionBackend``."""
        collision = self.first_collision(Q, 0, len(Q))
        while collision is not None:
            yield collision.row
            collision = self.first_collision(Q, collision.row + 1, len(Q))

    def touching(self, q: FloatArray) -> list[int]:
        """See ``CollisionBackend``."""
        return list(self.narrow_phase.touching(q.tolist(), self.kernel.candidates(q[None])[1]))

    def _first(self, check_from: Callable[[int], _core.RowCheck], start: int) -> Collision | None:
        """The first row that collides, where ``check_from`` has the kernel check the rows from one on."""
        check = check_from(start)
        while check.undecided:
            pair = self.first_touching(check.q, check.pairs)
            if pair is not None:
                return Collision(check.row, check.fraction, pair)
            check = check_from(check.row + 1)
        return None if check.free else Collision(check.row, check.fraction, check.pair)

    def first_touching(self, q: list[float], pairs: list[int]) -> int | None:
        """The first of the pairs left undecided at q (n,) that touches."""
        return next(self.narrow_phase.touching(q, pairs), None)


def require_backend(name: BackendName) -> BackendName:
    """The name of a backend.

    Raises:
        InvalidRequest: there is none of that name.
    """
    if not isinstance(name, str) or name not in get_args(BackendName):
        raise InvalidRequest("backend", name, '"native" or "fcl"')
    return name


def make_backend(name: BackendName, robot: Robot, parts: Parts) -> CollisionBackend:
    """The backend of that name."""
    narrow_phase = NarrowPhase(robot, parts)
    if name == "fcl":
        return FclBackend(narrow_phase)
    return NativeBackend(narrow_phase, build_kernel(robot, parts))


def _on(edge: SampledEdge, collision: Collision | None) -> Collision | None:
    """A collision among an edge's samples, with where on the edge it is."""
    return None if collision is None else collision._replace(fraction=edge.fraction(collision.row))


def _compose(a: Sequence[float], b: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and translation (3,) of the product of two poses, given as nine row-major numbers and three."""
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


@dataclass(frozen=True, eq=False)
class NearPairs:
    """Pairs that are near at some configurations Q (m, n), by row, k of them.

    Attributes:
        rows: Of Q, (k,).
        pairs: Their numbers, (k,).
        distances: Signed metres, (k,): of an overlap the least way out of it. The separation of both pieces along the
            direction that was found: never above the true distance but for rounding, and below it by a few nanometres
            where pieces are apart.
        points: Where it is measured, on the first piece and on the second, world frame, (k, 2, 3).
        gradients: Of the distances, metres per radian (or per metre of a prismatic joint), (k, n): the direction from
            piece to piece times the difference of both points' Jacobians. Where nearest points are not unique the
            distance has a kink, and this is the derivative to one side, or between both.
    """

    rows: NDArray[np.int64]
    pairs: NDArray[np.int64]
    distances: FloatArray
    points: FloatArray
    gradients: FloatArray


def measuring_kernel(backend: CollisionBackend, robot: Robot, parts: Parts) -> _core.CollisionKernel:
    """The compiled kernel, whichever backend judges."""
    return backend.kernel if isinstance(backend, NativeBackend) else build_kernel(robot, parts)
