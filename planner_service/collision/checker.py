"""The collision checker: it alone decides whether a configuration or an edge is free, and it alone counts."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from planner_service.collision.backends import (
    BackendName,
    Collision,
    CollisionBackend,
    FirstHit,
    NativeBackend,
    NearPairs,
    make_backend,
    measuring_kernel,
    require_backend,
)
from planner_service.collision.budget import CancelToken, CheckBudgetSpent, CheckCounts, Ledger, SearchStopped
from planner_service.collision.clearance import Clearances
from planner_service.collision.contact import Contact, EdgeHit, deepest, rounded_down
from planner_service.collision.edge_sampling import (
    MAX_SEGMENTS,
    EdgeStep,
    FinestStep,
    Known,
    MotionStep,
    SampledEdge,
    Samples,
    bisection_order,
    coarse_samples,
    coarse_segments_of,
    judged_ends,
)
from planner_service.collision.native_kernel import FCL, build_kernel, configure_edges
from planner_service.collision.pairs import Parts, require_padding, sorted_pairs
from planner_service.concurrency.polling import Prepared, asked
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray, read_only
from planner_service.geometry.validation import instance, number, numbers, whole
from planner_service.native.loading import load_core
from planner_service.path.joint_path import JointPath
from planner_service.presentation.measures import range_text
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["BackendName", "CollisionChecker", "Contact", "EdgeHit"]

MAX_VARIANTS = 32
"""Variants kept, the oldest forgotten first: a plan needs a handful, and building one again changes no answer."""

FEW_PAIRS = 5_000
"""Pairs up to which a call with a time limit need not be able to leave halfway what is prepared for them."""

LIMIT_SLACK = 1e-9
"""Radians or metres by which rounding may carry a configuration over a joint limit."""

T = TypeVar("T")

_ALL, _COARSE, _REST = Samples
"""Looked up once: before Python 3.12 this takes as long for a member of an enum as some of the checks below."""


_Key = tuple[float, tuple[tuple[str, str], ...], float | None]
"""Padding, allowed pairs and motion step of a variant."""


class _Shared:
    """What checkers of the same robot and scene have in common that count apart, by variant: pieces, and what judges.

    The oldest are forgotten first, as of variants.
    """

    def __init__(self) -> None:
        self._made: dict[tuple[str, _Key], Any] = {}

    def made(self, kind: str, key: _Key, make: Callable[[], T]) -> T:
        """What was made of a kind for a variant; made now if it was not."""
        found: T | None = self._made.get((kind, key))
        if found is None:
            found = make()
            for old in list(self._made)[: len(self._made) + 1 - 2 * MAX_VARIANTS]:
                self._made.pop(old, None)
            self._made[kind, key] = found
        return found


class _Last(threading.local):
    """The collision that each thread found last."""

    hit: FirstHit | None = None


class CollisionChecker:
    """Answers whether a robot's configurations and the edges between them are free in a scene; from any thread.

    FCL's boolean ``collide`` decides every doubtful pair; a pair is not asked only where it is proven apart, or to
    overlap, by more than the margin in which FCL could say otherwise. Joint limits are part of the question: a
    configuration outside them raises rather than being called free.

    Args:
        edge_step: How finely edges are sampled; ``MotionStep(0.010)`` if not given.
        padding: Distance in metres that every pair must keep; verdicts of a plan use 0.
        allowed: Pairs of link or object names that may touch, beside those the robot allows.
        backend: "native", the compiled kernel, which asks FCL where it has no proof; "fcl", the judge of that, which
            asks FCL about every pair in their order. Verdicts, counts and names are the same.

    Raises:
        UnknownName: ``allowed`` names nothing that is there.
        InvalidRequest: no such backend.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        *,
        edge_step: EdgeStep | None = None,
        padding: float = 0.0,
        allowed: Iterable[tuple[str, str]] = (),
        backend: BackendName = "native",
    ) -> None:
        require_padding(padding)
        if edge_step is not None and not callable(getattr(edge_step, "segments", None)):
            raise InvalidRequest("edge_step", edge_step, "a rule such as MotionStep(0.010)")
        self.robot = instance("robot", robot, Robot, "a Robot")
        self.scene = instance("scene", scene, Scene, "a Scene")
        self.backend = require_backend(backend)
        self.ledger = Ledger()
        self._variants: dict[_Key, CollisionChecker] = {}
        self._preparing: dict[_Key, Prepared[CollisionChecker]] = {}
        self._asked_step: EdgeStep = MotionStep() if edge_step is None else edge_step
        self._shared = _Shared()
        pairs = sorted_pairs(allowed)
        parts = Parts(robot, scene, padding=float(padding), allowed=pairs)
        self._reach: list[float] = robot.reach(parts.carried).tolist()
        self._judge(parts, float(padding), pairs, None)

    def _judge(self, parts: Parts, padding: float, allowed: tuple[tuple[str, str], ...], finest: float | None) -> None:
        """Prepare for these pieces, which have the padding, and for edges sampled at least this finely."""
        self._parts, self.padding, self.allowed, self._motion_step = parts, padding, allowed, finest
        step = self._asked_step
        self.edge_step: EdgeStep = step if finest is None else FinestStep((step, MotionStep(finest)))
        self._last = _Last()
        self._coarse_segments = coarse_segments_of(self.edge_step)
        self._lower = [value - LIMIT_SLACK for value in self.robot.bounds[0].tolist()]
        self._upper = [value + LIMIT_SLACK for value in self.robot.bounds[1].tolist()]
        if not self.quick:
            _ = self._compiled  # now, as a call with a time limit cannot leave it halfway

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
        if type(padding) is not float:
            require_padding(padding)
        finest = self._motion_step
        if motion_step is not None:
            motion_step = MotionStep(motion_step).distance
            finest = motion_step if finest is None else min(motion_step, finest)
        pairs = self.allowed if allowed is None else sorted_pairs(allowed)
        key = (padding, pairs, finest)
        if key == (self.padding, self.allowed, self._motion_step):
            return self
        known = self._variants.get(key)
        if known is None:
            require_padding(padding)

            def keep() -> CollisionChecker:
                other = self._varied(padding, pairs, finest)
                for old in list(self._variants)[: len(self._variants) + 1 - MAX_VARIANTS]:
                    self._variants.pop(old, None)
                self._variants[key] = other
                self._preparing.pop(key, None)
                return other

            if self.quick or not asked():
                return keep()
            return self._preparing.setdefault(key, Prepared(keep)).get()  # which a call that was ended may have begun
        return known

    def counting_anew(self) -> CollisionChecker:
        """The same checker, and what is compiled for it and its variants, with counts of its own."""
        other = object.__new__(CollisionChecker)
        other.__dict__.update(self.__dict__)
        other.ledger, other._last, other._variants, other._preparing = Ledger(), _Last(), {}, {}
        return other

    def _varied(self, padding: float, allowed: tuple[tuple[str, str], ...], finest: float | None) -> CollisionChecker:
        other = object.__new__(CollisionChecker)
        other.robot, other.scene, other.backend, other.ledger = self.robot, self.scene, self.backend, self.ledger
        other._variants, other._preparing, other._asked_step = self._variants, self._preparing, self._asked_step
        other._reach, other._shared = self._reach, self._shared

        def parts() -> Parts:
            if allowed == self.allowed:
                return self._parts.padded(padding)
            if set(self.allowed).issubset(allowed):
                return self._parts.padded(padding).allowing(self.robot, self.scene, allowed)
            return Parts(self.robot, self.scene, padding=padding, allowed=allowed)

        other._judge(self._shared.made("parts", (padding, allowed, None), parts), padding, allowed, finest)
        return other

    @cached_property
    def _compiled(self) -> tuple[CollisionBackend, _core.CollisionKernel | None]:
        """What judges, made when a first state is: a service often judges only with a padding, by a variant.

        And the kernel if it checks states and edges itself; None if FCL judges all pairs, or with a user's own step.
        """

        def compiled() -> tuple[CollisionBackend, _core.CollisionKernel | None]:
            backend = make_backend(self.backend, self.robot, self._parts)
            splits = isinstance(backend, NativeBackend) and self._configure(backend.kernel)
            return backend, backend.kernel if splits and isinstance(backend, NativeBackend) else None

        return self._shared.made("compiled", (self.padding, self.allowed, self._motion_step), compiled)

    @cached_property
    def _backend(self) -> CollisionBackend:
        return self._compiled[0]

    @cached_property
    def _kernel(self) -> _core.CollisionKernel | None:
        return self._compiled[1]

    def _configure(self, kernel: _core.CollisionKernel) -> bool:
        """Have a kernel check states and edges; False if it cannot split edges."""
        limits = self.robot.limits  # outside them there is no table of what is proven apart, and pairs are looked at
        tables = (limits.lower - LIMIT_SLACK).tolist(), (limits.upper + LIMIT_SLACK).tolist()
        return configure_edges(kernel, (self._lower, self._upper), tables, self._reach, self.edge_step)

    @cached_property
    def _asked_kernel(self) -> tuple[_core.CollisionKernel, bool]:
        """What compiled searches ask, and whether it splits edges: one that proves nothing where FCL is the judge."""
        if isinstance(self._backend, NativeBackend):
            return self._backend.kernel, self._kernel is not None
        kernel = build_kernel(self.robot, self._parts, FCL)
        return kernel, self._configure(kernel)

    @cached_property
    def _clearances(self) -> Clearances:
        return Clearances(self.robot, self._parts)

    @property
    def instruction_set(self) -> str | None:
        """What the compiled kernel uses; None where FCL judges every pair."""
        return self._backend.kernel.variant if isinstance(self._backend, NativeBackend) else None

    @property
    def counts(self) -> CheckCounts:
        """The checks so far, by this checker and its variants, in all threads."""
        return self.ledger.counts

    @cached_property
    def reach(self) -> FloatArray:
        """Metres that any point of the robot, and of what it carries, moves per unit of each joint at most, (n,)."""
        return read_only(self._reach)

    @property
    def parts(self) -> Parts:
        """The numbered pieces of robot and scene: ``parts.parts`` as they are, ``parts.shapes`` with the padding."""
        return self._parts

    @property
    def pair_count(self) -> int:
        """Pairs of pieces judged in each state, robot against itself and against the scene."""
        return len(self._parts.pairs)

    @property
    def quick(self) -> bool:
        """Whether there are so few pairs that a variant, or a proof's tables, take a few milliseconds."""
        return self.pair_count <= FEW_PAIRS

    def limited(
        self, *, states: int | None = None, deadline: float | None = None, token: CancelToken | None = None
    ) -> AbstractContextManager[None]:
        """Within the block, a check of this thread that would pass one of these limits raises a ``SearchStopped``.

        Args:
            states: How many more may be judged.
            deadline: When ``time.monotonic()`` is later than this.
            token: When it is cancelled.

        Raises:
            InvalidRequest: no whole number, no time or no token.
        """
        return self.ledger.limited(states=states, deadline=deadline, token=token)

    def state_is_free(self, q: ArrayLike) -> bool:
        """Whether the robot at q (n,) touches neither itself nor the scene; counts one state.

        Raises:
            InvalidRequest: q has the wrong shape, is not finite, or lies outside the joint limits.
        """
        if self._kernel is not None:
            self.ledger.require_room()
            check = self._kernel.check_state(q)
            if check.free:
                self.ledger.record_states(1)
                return True
            if check.colliding:
                self.ledger.record_states(1)
                self._note(check)
                return False
        return self._first_collision(self._configuration("q", q)[None]) is None

    def states_are_free(self, Q: ArrayLike) -> BoolArray:
        """Which configurations of Q (m, n) are free, (m,): as ``state_is_free`` says, several times as fast; counts m.

        Raises:
            InvalidRequest: a row has the wrong shape, is not finite, or lies outside the joint limits.
        """
        array = numbers("Q", Q, f"rows of {self.robot.n} joint values")
        if array.ndim != 2:
            raise InvalidRequest("Q", array.shape, f"rows of {self.robot.n} joint values, shape (m, {self.robot.n})")
        rows = [self._configuration(f"Q[{k}]", q) for k, q in enumerate(array)]
        free = np.ones(len(rows), dtype=bool)
        start = 0
        while start < len(rows):
            self.ledger.require_room()
            stop = self._stop(start, len(rows))
            free[[start + row for row in self._backend.colliding(np.array(rows[start:stop]))]] = False
            self.ledger.record_states(stop - start)
            start = stop
        return free

    def edge_is_free(self, q1: ArrayLike, q2: ArrayLike, *, known: Known = Known.NEITHER) -> bool:
        """Whether every sample of the straight line from q1 to q2 is free; counts as ``edge_hit`` does."""
        return self._edge(q1, q2, known, _ALL) is None

    def edge_hit(self, q1: ArrayLike, q2: ArrayLike, *, known: Known = Known.NEITHER) -> EdgeHit | None:
        """Where the straight line from q1 to q2 collides, None when every sample is free.

        Counts one edge and its states. Judges q1, q2, then the interior in bisection order, up to the
        first sample that collides.

        Args:
            known: Ends that are known to be free and are neither judged nor counted.

        Raises:
            InvalidRequest: an end has the wrong shape, is not finite, or lies outside the joint limits.
        """
        return self._named(self._edge(q1, q2, known, _ALL))

    def edge_is_free_coarse(self, q1: ArrayLike, q2: ArrayLike, *, known: Known = Known.NEITHER) -> bool:
        """As ``edge_is_free``, but judges only some of the interior samples, which are far apart.

        An edge that collides mostly does so at one of these; ``finish_edge`` judges the others.
        """
        return self._edge(q1, q2, known, _COARSE) is None

    def finish_edge(self, q1: ArrayLike, q2: ArrayLike) -> EdgeHit | None:
        """Where an edge collides at a sample that ``edge_is_free_coarse`` left out, None when all of these are free.

        Counts their states, and no edge: the coarse check counted that.
        """
        return self._named(self._edge(q1, q2, Known.BOTH, _REST))

    def _edge(self, q1: ArrayLike, q2: ArrayLike, known: Known, samples: Samples) -> FirstHit | None:
        if not isinstance(known, Known):
            raise InvalidRequest("known", known, "Known.NEITHER, START, END or BOTH")
        if self._kernel is not None and self._has_room():
            check = self._kernel.check_edge(q1, q2, known._value_, samples._value_, self._stop(0, MAX_SEGMENTS))
            if not check.refused:
                self.ledger.own.edges += samples is not _REST
                self.ledger.record_states(check.judged)
                return None if check.free else self._decided(q1, q2, check)
        a, b = self._configuration("q1", q1).tolist(), self._configuration("q2", q2).tolist()
        edge = SampledEdge(a, b, judged_ends(a, b, known), self._segments(a, b))
        coarse = edge.end_rows + coarse_samples(edge.segments, self._coarse_segments)
        start = coarse if samples is _REST else 0
        self.ledger.own.edges += samples is not _REST
        rows = coarse if samples is _COARSE else edge.rows
        return self._counted(partial(self._backend.first_collision_on, edge), rows, start)

    def oracle(self, starts: Sequence[tuple[float, ...]], goals: Sequence[tuple[float, ...]]) -> _core.EdgeOracle:
        """What compiled searches ask (``SearchOracle.core``).

        Args:
            starts: Configurations at which motions are counted apart.
            goals: The same, counted on their own.
        """
        narrow_phase, (kernel, splits) = self._backend.narrow_phase, self._asked_kernel

        def decide(q: list[float], pairs: list[int]) -> int:
            return next(narrow_phase.touching(q, pairs), -1)

        oracle: _core.EdgeOracle = load_core().EdgeOracle(
            kernel, starts, goals, decide, self.ledger.poll, None if splits else self._parts_of
        )
        return oracle

    def counted(self, oracle: _core.EdgeOracle, ask: Callable[[], T]) -> T:
        """What ``ask`` returns, which asks a compiled oracle of this checker: its checks are counted, and limits hold.

        Raises:
            InvalidRequest: An edge leaves the joint limits, or has too many samples.
        """
        oracle.allow(*self.ledger.allowance())
        try:
            try:
                return ask()
            finally:
                self._record(oracle)
        except RuntimeError:
            if oracle.spent:
                raise CheckBudgetSpent("the check budget is spent") from None
            if oracle.refused is not None:
                self.segments(*oracle.refused)  # says what is wrong with that edge
            raise

    def _record(self, oracle: _core.EdgeOracle) -> None:
        states, edges, hits = oracle.take()
        self.ledger.record(states, edges, hits, self._parts.names)
        if hits:
            self._last.hit = Collision(0, oracle.last_fraction, oracle.last_pair)

    def _has_room(self) -> bool:
        """Whether a state may be judged; if not, what forbids it is raised once there is a state to judge."""
        try:
            self.ledger.require_room()
        except SearchStopped:
            return False
        return True

    def _decided(self, q1: ArrayLike, q2: ArrayLike, check: _core.EdgeCheck) -> FirstHit | None:
        """Where an edge collides that the kernel did not find free, once the rows it left undecided are judged."""
        if check.colliding:
            self._note(check)
            return check
        a, b = (np.asarray(q, dtype=np.float64).tolist() for q in (q1, q2))
        edge = SampledEdge(a, b, check.ends, check.segments)
        return self._counted(partial(self._backend.first_collision_on, edge), check.rows, check.next)

    def segments(self, q1: ArrayLike, q2: ArrayLike) -> int:
        """The number of equal parts into which the edge from q1 to q2 is split; counts nothing."""
        return self._segments(self._configuration("q1", q1).tolist(), self._configuration("q2", q2).tolist())

    def _segments(self, a: Sequence[float], b: Sequence[float]) -> int:
        return self._parts_of([y - x for x, y in zip(a, b, strict=True)])

    def _parts_of(self, dq: Sequence[float]) -> int:
        """Equal parts of an edge with joint differences ``dq``: fewer than one would leave its samples unjudged."""
        return whole("edge_step.segments", self.edge_step.segments(dq, self._reach), 1, MAX_SEGMENTS)

    def path_is_free(self, path: JointPath, *, known: Known = Known.NEITHER) -> bool:
        """Whether every piece of a path is free: straight ones as edges, blends at samples; points between them once.

        Args:
            known: Ends of the path that are known to be free.
        """
        instance("path", path, JointPath, "a JointPath")
        instance("known", known, Known, "Known.NEITHER, START, END or BOTH")
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
        instance("path", path, JointPath, "a JointPath")
        k = whole("k", k, 0, len(path.waypoints) - 1)
        if not path.blends[k] > 0.0:
            raise InvalidRequest("k", k, "the index of a waypoint with a blend")
        start, length = float(path.knots[k] - path.blends[k]), float(2.0 * path.blends[k])
        ends = np.array([start, start + length])
        fastest = np.abs(path(ends, 1)).max(axis=0)
        segments = self._parts_of((fastest * length).tolist())
        s = start + length * bisection_order(segments)[:, 0]
        points = path(np.concatenate([ends, np.minimum(s, path.length)]))
        for q in points[:2]:
            self._configuration("path", q)
        return segments == 1 or self._first_collision(points[2:]) is None

    def clearance(self, q: ArrayLike) -> float:
        """A proven lower bound in metres of the smallest gap at q (n,); negative when something overlaps.

        The bound is the separation of the original shapes along the best direction found, by
        support functions. Counts one distance per pair.

        Returns:
            ``math.inf`` when no pair is judged at all.

        Raises:
            InvalidRequest: q has the wrong shape, is not finite, or lies outside the joint limits.
        """
        gap = self._clearances.smallest_gap(self._configuration("q", q))
        self.ledger.charge_distances(self.pair_count)
        return rounded_down(gap)

    def near(self, Q: ArrayLike, within: float) -> NearPairs:
        """All judged pairs that are nearer than ``within`` metres at configurations Q (m, n), and how to part them.

        Counts one distance for each pair whose boxes are so near that it has to be measured.

        Raises:
            InvalidRequest: a row has the wrong shape, is not finite, or lies outside the joint limits.
        """
        within = number("within", within, "metres in [0, 1]", 0.0, 1.0)
        rows = np.ascontiguousarray(numbers("Q", Q, f"rows of {self.robot.n} joint values"))
        if rows.ndim != 2 or rows.shape[1] != self.robot.n:
            raise InvalidRequest("Q", rows.shape, f"rows of {self.robot.n} joint values, shape (m, {self.robot.n})")
        outside = np.flatnonzero(~((rows >= self._lower) & (rows <= self._upper)).all(axis=1))  # NaN is outside
        if len(outside):
            self._configuration(f"Q[{outside[0]}]", rows[outside[0]])
        self.ledger.poll()
        near = self._measuring_kernel.near(rows, within)
        self.ledger.charge_distances(near.measured)
        return NearPairs(near.rows, near.pairs, near.distances, near.points, near.gradients)

    def are_own(self, pairs: IntArray) -> BoolArray:
        """Which judged pairs, given by their numbers (k,), are of two pieces that both ride on the robot, (k,)."""
        own: BoolArray = self._parts.pairs.of(pairs)[:, 1] < self._parts.riding
        return own

    def pair_names(self, pair: int) -> tuple[str, str]:
        """The owners of a pair by its number: the link or carried object, then what it meets."""
        whole("pair", pair, 0, self.pair_count - 1)
        return self._parts.names[pair]

    @cached_property
    def _measuring_kernel(self) -> _core.CollisionKernel:
        return measuring_kernel(self._backend, self.robot, self._parts)

    def contacts(self, q: ArrayLike) -> tuple[Contact, ...]:
        """The pairs that touch at q (n,), deepest first; empty when q is free. Counts one state.

        Raises:
            InvalidRequest: q has the wrong shape, is not finite, or lies outside the joint limits.
        """
        q = self._configuration("q", q)
        pairs = np.array(self._touching(q), dtype=np.intp)
        overlaps = self._clearances.overlaps(q, pairs).tolist()
        return deepest(zip(map(self._parts.names.__getitem__, pairs.tolist()), overlaps, strict=True))

    def touching(self, q: ArrayLike) -> frozenset[tuple[str, str]]:
        """The pairs of names of ``contacts``, without their depths, which take longer. Counts one state."""
        return frozenset(map(self._parts.names.__getitem__, self._touching(self._configuration("q", q))))

    def deepest_touching(self, q: ArrayLike) -> tuple[str, str] | None:
        """The names of the deepest of ``contacts``; None when q is free. Counts one state.

        Depths, which take longer than all else, are measured only if several pairs of names touch.
        """
        q = self._configuration("q", q)
        pairs = self._touching(q)
        names = [self._parts.names[pair] for pair in pairs]
        if len(set(names)) <= 1:
            return names[0] if names else None
        overlaps = self._clearances.overlaps(q, np.array(pairs, dtype=np.intp)).tolist()
        first, *_ = deepest(zip(names, overlaps, strict=True))
        return first.a, first.b

    def _touching(self, q: FloatArray) -> list[int]:
        self.ledger.require_room()
        pairs = self._backend.touching(q)
        self.ledger.record_states(1)
        return pairs

    def _configuration(self, field: str, q: ArrayLike) -> FloatArray:
        if type(q) is np.ndarray and q.dtype == np.float64:  # as planners ask: no time for a closer look
            array = q
        else:
            array = numbers(field, q, f"{self.robot.n} joint values")
        if array.shape != (self.robot.n,):
            raise InvalidRequest(field, np.shape(q), f"{self.robot.n} joint values, shape ({self.robot.n},)")
        for k, value in enumerate(array.tolist()):
            if not self._lower[k] <= value <= self._upper[k]:
                low, high = (bound[k] for bound in self.robot.bounds)
                raise InvalidRequest(field, value, f"{self.robot.joint_names[k]} in {range_text(low, high, value)}")
        return array

    def _first_collision(self, Q: FloatArray) -> Collision | None:
        """Judge configurations (m, n) in order, up to the first that collides, and count them."""
        return self._counted(partial(self._backend.first_collision, Q), len(Q))

    def _stop(self, start: int, rows: int) -> int:
        """Up to which row to judge in one go, from ``start``: none more than there is room for."""
        room, stop = self.ledger.room(), start + self._backend.rows_at_once
        if room is not None and start + room < stop:
            stop = start + room
        return stop if stop < rows else rows

    def _counted(
        self, first_collision: Callable[[int, int], Collision | None], rows: int, start: int = 0
    ) -> Collision | None:
        """The first of rows ``start`` to ``rows`` that collides; every row that is judged is counted."""
        while start < rows:
            self.ledger.require_room()
            stop = self._stop(start, rows)
            collision = first_collision(start, stop)
            self.ledger.record_states((stop if collision is None else collision.row + 1) - start)
            if collision is not None:
                self._note(collision)
                return collision
            start = stop
        return None

    def _note(self, hit: FirstHit) -> None:
        """Remember a collision as the last, and count which pair it is of."""
        self._last.hit = hit
        self.ledger.record_hit(self._parts.names[hit.pair])

    @property
    def last_hit(self) -> EdgeHit | None:
        """The collision that this thread found last; of a single configuration its place on an edge means nothing."""
        return self._named(self._last.hit)

    def _named(self, hit: FirstHit | None) -> EdgeHit | None:
        return None if hit is None else EdgeHit(hit.fraction, *self._parts.names[hit.pair])
