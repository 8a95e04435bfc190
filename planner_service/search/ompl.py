"""The one place that knows OMPL: a fresh planner per query, which asks our oracle and is repeatable from its seed.

OMPL seeds every random generator from one global source at construction. So each query reseeds that source and builds
everything anew, under a process-wide lock; nothing survives it.

An exception of the oracle is held back: from then on every answer is "not free" and the termination condition says
stop. OMPL ends within microseconds and hands over its best path if it has one; only then is the exception raised. So
anytime planners keep the path they found, and no exception unwinds through OMPL's own code.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import chain, pairwise
from math import isfinite
from operator import methodcaller
from typing import Any, TypeVar

import numpy as np

from planner_service.collision.budget import SearchStopped
from planner_service.collision.edge_sampling import KNOWN_ENDS, Known
from planner_service.concurrency.fair_lock import FairLock
from planner_service.concurrency.library_import import loaded
from planner_service.geometry.arrays import FloatArray
from planner_service.search.problem import (
    CoarseOracle,
    Configuration,
    SearchProblem,
    SearchResult,
    Space,
    distances,
    of_tuples,
)

__all__ = ["Setting", "grow", "solve", "solve_in_batches"]

Setting = float | int | bool
T = TypeVar("T")


def _ompl() -> tuple[Any, Any, Any]:
    import ompl.base
    import ompl.geometric
    import ompl.util

    return ompl.base, ompl.geometric, ompl.util


# Ctrl-C during the import of OMPL would abort the process: its enumerations are made by Python code, and its binding
# ends the process if that raises.
ob, og, ou = loaded(_ompl)

MAX_SAMPLES = 200_000
"""The most samples of a batch planner; with more its neighbourhoods fill the memory."""

MAX_IDLE = 20_000
"""Polls of the termination condition in a row without a new question to the oracle, after which OMPL is taken to be
going in circles (measured: BITstar 6,732 near its optimum, all others below 2,000)."""

MAX_REPEATS = 200
"""Questions about known edges in a row without a poll of the termination condition. OMPL 2.0.1's AORRTC extends a tree
for ever over known edges once its bound on the length excludes all others; one "not free" ends that."""

MAX_REFUTED = 3
"""Paths with an edge that was not free after all, after which edges are no longer checked coarsely first: in a scene
for which coarse samples are too far apart, thousands of such paths may follow each other."""

WITHOUT_GRAPH = ("BITstar", "AORRTC")
"""Planners whose graph OMPL 2.0.1 cannot hand over: reading it leaks the whole query, or gives nothing."""

# OMPL's seed source is global to the process, and so is the lock that makes queries repeatable.
_turns = FairLock()

_SEEDS = 2**32 - 1


def _renew_turns() -> None:
    """In the child of a fork, nobody would release a lock that another thread of the parent held."""
    global _turns
    _turns = FairLock()


os.register_at_fork(after_in_child=_renew_turns)


class _GoingInCircles(Exception):
    """OMPL no longer asks anything new."""


class _Oracle:
    """The oracle as OMPL calls it: it checks nothing twice and holds exceptions back.

    It holds no OMPL object: nanobind's references are invisible to Python's garbage collector, and a cycle would keep
    the whole query for ever.

    Args:
        free: Configurations known to be free.
        coarse: Check edges coarsely first, if the oracle can.
    """

    def __init__(self, space: Space, free: Iterable[Configuration] = (), *, coarse: bool = False) -> None:
        self._oracle: CoarseOracle = of_tuples(space.oracle)
        self._coarse = coarse and hasattr(space.oracle, "edge_is_free_coarse")
        self._check = self._oracle.edge_is_free_coarse if self._coarse else self._oracle.edge_is_free
        self._poll = space.poll
        self._span = slice(0, len(space.lower))
        self._free = set(free)
        self._edges: dict[tuple[Configuration, Configuration], bool] = {}
        self._idle = self._repeats = self._polls = self._refuted = 0
        self.held: BaseException | None = None

    @property
    def states(self) -> int:
        return self._oracle.states

    def state(self, state: Any) -> bool:
        try:
            q = tuple(state[self._span])
            del state  # see edge()
            if q in self._free:
                return True
            if self.held is not None:
                return False
            self._idle = self._repeats = 0
            free = bool(self._oracle.state_is_free(q))
            if free:
                self._free.add(q)
        except BaseException as error:  # Ctrl-C is not to unwind through OMPL either
            state = None  # noqa: F841 - nor may the traceback keep it
            self.hold(error)
            return False
        return free

    def edge(self, a: Configuration, b: Configuration) -> bool:
        """Whether an edge is free, as OMPL asks.

        No frame below OMPL keeps one of its states: a traceback would keep the state alive longer than OMPL uses its
        memory, and the next state at the same address would crash the process.
        """
        if self.held is not None:
            return False
        free = self._edges.get((a, b) if a <= b else (b, a))
        if free is None:
            try:
                return self.between(a, b)
            except BaseException as error:
                self.hold(error)
                return False
        self._repeats += 1
        if self._repeats > MAX_REPEATS:
            self._repeats = 0
            return False
        return free

    def between(self, a: Configuration, b: Configuration) -> bool:
        """Whether an edge is free; each is checked once, in either direction."""
        key = (a, b) if a <= b else (b, a)
        free = self._edges.get(key)
        if free is None:
            self._idle = self._repeats = 0
            known = KNOWN_ENDS[(a in self._free) + 2 * (b in self._free)]
            free = self._edges[key] = bool(self._check(a, b, known=known))
            if free:
                self._free.add(a)
                self._free.add(b)
        return free

    def confirmed(self, points: list[Configuration]) -> bool:
        """Whether every piece of a path is free, also those that were checked only coarsely so far.

        The first that is not is remembered as such.
        """
        for a, b in pairwise(points):
            if not self.between(a, b):
                return False
            if self._coarse and not self._oracle.edge_is_free(a, b, known=Known.BOTH):
                self._edges[_key(a, b)] = False
                self._idle, self._polls = -self._polls, 0  # growing again asks nothing new for as long as it took
                self._refute()
                return False
        return True

    def free_graph(self) -> tuple[FloatArray, list[tuple[int, int]]]:
        """The ends of all edges found free so far as milestones (N, n), and these edges."""
        free = [edge for edge, verdict in self._edges.items() if verdict]
        numbers: dict[Configuration, int] = {}
        edges = [(numbers.setdefault(a, len(numbers)), numbers.setdefault(b, len(numbers))) for a, b in free]
        return np.array(list(numbers)).reshape(-1, self._span.stop), edges

    def _refute(self) -> None:
        """Count a path with an edge that is not free; after too many, check no edge coarsely, nor trust such checks."""
        self._refuted += 1
        if self._refuted == MAX_REFUTED:
            self._check = self._oracle.edge_is_free
            self._edges = {key: free for key, free in self._edges.items() if not free}

    def over(self) -> bool:
        """Whether OMPL has to stop. ``poll`` is called here too, since some planners spin without checking anything."""
        self._idle += 1
        self._polls += 1
        self._repeats = 0
        if self.held is None:
            try:
                self._poll()
                if self._idle > MAX_IDLE:
                    raise _GoingInCircles("OMPL asked nothing new any more")
            except BaseException as error:
                self.hold(error)
        return self.held is not None

    def hold(self, error: BaseException) -> None:
        """Keep an exception until OMPL has ended."""
        self.held = error

    def release(self) -> BaseException | None:
        """The exception held back; no reference stays here, which would be a cycle through its traceback."""
        held, self.held = self.held, None
        return held

    def close(self) -> None:
        """Drop the oracle: OMPL's objects hold this one, and live as long as a traceback does."""
        del self._oracle, self._check, self._poll


class _Motions(ob.MotionValidator):  # type: ignore[misc, name-defined]
    """Hands whole edges to the oracle; without it OMPL would sample them itself."""

    def __init__(self, si: Any, oracle: _Oracle) -> None:
        super().__init__(si)  # and no reference of our own to si: that would be a cycle
        self._oracle = oracle
        self._span = slice(0, si.getStateDimension())

    def checkMotion(self, first: Any, second: Any) -> bool:  # noqa: N802 - OMPL's name
        try:
            a, b = tuple(first[self._span]), tuple(second[self._span])
            del first, second  # see _Oracle.edge
            return self._oracle.edge(a, b)
        except BaseException as error:
            first = second = None  # noqa: F841
            self._oracle.hold(error)
            return False


class _Run:
    """One OMPL planner with fresh objects, which live only inside ``_seeded``."""

    def __init__(self, space: Space, oracle: _Oracle, planner: str, settings: dict[str, Setting]) -> None:
        n = len(space.lower)
        self.oracle, self._n = oracle, n
        states, bounds = ob.RealVectorStateSpace(n), ob.RealVectorBounds(n)
        for joint in range(n):
            bounds.setLow(joint, float(space.lower[joint]))
            bounds.setHigh(joint, float(space.upper[joint]))
        states.setBounds(bounds)
        self._si = ob.SpaceInformation(states)
        self._si.setStateValidityChecker(oracle.state)
        self._si.setMotionValidator(_Motions(self._si, oracle))
        self._si.setup()
        self._problem = ob.ProblemDefinition(self._si)
        self._problem.setOptimizationObjective(ob.PathLengthOptimizationObjective(self._si))
        self._name, self._settings = planner, settings

    def _state(self, q: Iterable[float]) -> Any:
        state = self._si.allocState()
        for joint, value in enumerate(q):
            state[joint] = float(value)
        return state

    def between(self, start: FloatArray, goals: FloatArray) -> None:
        """Set the query and make the planner."""
        self._problem.addStartState(self._state(start))
        targets = ob.GoalStates(self._si)
        for goal in goals:
            targets.addState(self._state(goal))
        self._problem.setGoal(targets)
        self.ready()

    def ready(self) -> None:
        """Make the planner, without a step at which Ctrl-C could come: AORRTC's destructor crashes before ``setup``.

        Python raises KeyboardInterrupt between two of its own instructions, so that even one between a call and the
        assignment of what it returned would end the process. ``deque`` runs all calls of these iterators in C.
        """
        calls = [*self._settings.items(), ("setProblemDefinition", self._problem), ("setup",)]
        planner: list[Any] = []
        made = map(planner.extend, [map(getattr(og, self._name), [self._si])])
        deque(chain(made, *(map(methodcaller(*call), planner) for call in calls)), maxlen=0)
        (self.planner,) = planner

    def until(self, act: Callable[[Any], Any], enough: Callable[[Any], bool]) -> Any:
        """Call ``act`` with a condition that ends it when a limit is reached, or once ``enough(planner)``."""
        # AORRTC keeps the condition, so the condition must not keep the planner: hence the box, emptied at the end.
        oracle, box = self.oracle, [self.planner]
        condition = ob.PlannerTerminationCondition(lambda: bool(oracle.over() or (box and enough(box[0]))))
        try:
            return act(condition)
        except Exception:
            if oracle.held is None:
                raise
            return None  # the batch planners' statistics fail if no sample was drawn: a stop like any other
        finally:
            box.clear()

    def path(self) -> list[Configuration]:
        """The waypoints of an exact solution, empty without one."""
        if not self._problem.hasExactSolution():
            return []
        path = self._problem.getSolutionPath()
        return [tuple(path.getState(k)[0 : self._n]) for k in range(path.getStateCount())]

    def roadmap(self) -> tuple[FloatArray, list[tuple[int, int]]]:
        """Milestones (N, n) and edges, each once with the smaller index first; OMPL leaves isolated milestones out."""
        data = ob.PlannerData(self._si)
        self.planner.getPlannerData(data)
        count = data.numVertices()
        points = np.array([data.getVertex(k).getState()[0 : self._n] for k in range(count)]).reshape(count, self._n)
        edges = {(min(k, m), max(k, m)) for k in range(count) for m in data.getEdges(k) if k != m}
        return points, sorted(edges)


def solve(
    problem: SearchProblem, planner: str, settings: dict[str, Setting], *, checks: int | None = None
) -> SearchResult:
    """Search with the OMPL planner of that name until it has a path.

    Args:
        settings: OMPL's setters and their arguments.
        checks: For anytime planners: once there is a path and this many states were checked, end with the best path.
            None to end with the first path.
    """
    oracle = _Oracle(problem, _ends(problem), coarse=checks is None)
    first = oracle.states

    def enough(planner: Any) -> bool:
        return checks is not None and oracle.states - first >= checks and isfinite(planner.bestCost().value())

    try:
        points = _path(problem, oracle, planner, settings, problem.goals, enough)
        while checks is None and points and oracle.held is None and not oracle.confirmed(_joined(problem, points)):
            # With the same seed and answers the same tree grows again at once, up to the edge that is not free.
            points = _path(problem, oracle, planner, settings, problem.goals, enough)
        return _result(problem, oracle, points)
    finally:
        oracle.close()


def solve_in_batches(problem: SearchProblem, planner: str, samples: int) -> SearchResult:
    """Search with a batch planner; each time it fails for every goal, double its samples.

    One goal and one batch at a time: with several goals, OMPL's own way to add samples to a batch reads beyond the end
    of a vector (measured: a segmentation fault).
    """
    oracle = _Oracle(problem, _ends(problem))
    points: list[Configuration] = []
    note = f"no path among {MAX_SAMPLES} samples"
    try:
        while not points and oracle.held is None and samples <= MAX_SAMPLES:
            settings: dict[str, Setting] = {"setNumSamples": samples, "setExtendedFMT": False}
            for goal in problem.goals:
                points = _path(problem, oracle, planner, settings, goal[None], lambda _: False)
                if points or oracle.held is not None:
                    note = ""
                    break
            samples *= 2
        return _result(problem, oracle, points, note=note)
    finally:
        oracle.close()


class _RoadmapOracle(_Oracle):
    """Remembers what blocks each edge that is not free.

    Attributes:
        blocked: The obstacle of each such edge, as ``SearchOracle.blocker`` has it.
    """

    def __init__(self, space: Space) -> None:
        super().__init__(space)
        self.blocked: dict[tuple[Configuration, Configuration], str | None] = {}

    def between(self, a: Configuration, b: Configuration) -> bool:
        free = super().between(a, b)
        if not free:
            self.blocked.setdefault(_key(a, b), getattr(self._oracle, "blocker", None))
        return free


@dataclass(frozen=True)
class Survey:
    """A roadmap as it was grown.

    Attributes:
        milestones: Free configurations (N, n) that an edge joins to others.
        free: The free edges between them, each once with the smaller index first.
        blocked: The edges that are not free, with the obstacle in the way, as ``SearchOracle.blocker`` has it.
    """

    milestones: FloatArray
    free: list[tuple[int, int]]
    blocked: dict[tuple[int, int], str | None]


def grow(
    space: Space,
    planner: str,
    settings: dict[str, Setting],
    *,
    size: tuple[int, int],
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> Survey:
    """Grow a roadmap with the OMPL planner of that name.

    Args:
        size: Milestones wanted, and states after which growing ends with fewer.
        progress: Called now and then with the number of milestones so far and the number wanted.
    """
    milestones, max_checks = size
    oracle = _RoadmapOracle(space)
    first = oracle.states

    def enough(planner: Any) -> bool:
        count = planner.milestoneCount()
        if progress is not None:
            progress(count, milestones)
        return bool(count >= milestones or oracle.states - first >= max_checks)

    def grown() -> tuple[FloatArray, list[tuple[int, int]]]:
        run = _Run(space, oracle, planner, settings)
        run.ready()  # growing before a problem is set would crash OMPL
        run.until(run.planner.growRoadmapPtc, enough)
        return run.roadmap()

    try:
        points, free = _seeded(seed, space.poll, grown)
    finally:
        oracle.close()
    held = oracle.release()
    if held is not None and not isinstance(held, _GoingInCircles):
        try:
            raise held
        finally:
            del held  # see _result
    at = {tuple(q): k for k, q in enumerate(points.tolist())}
    ends = {(at.get(a, -1), at.get(b, -1)): blocker for (a, b), blocker in oracle.blocked.items()}
    blocked = {(min(a, b), max(a, b)): blocker for (a, b), blocker in ends.items() if a >= 0 and b >= 0}
    return Survey(points, free, blocked)


def _seeded(seed: int, poll: Callable[[], None], act: Callable[[], T]) -> T:
    """What ``act`` returns, called under the process-wide lock with OMPL freshly seeded and silent.

    ``poll`` can end the wait for the lock.
    """

    def silent() -> T:
        level = ou.getLogLevel()
        try:
            try:
                ou.setLogLevel(ou.LOG_NONE)  # it would say, wrongly, that reseeding has no effect
                ou.RNG.setSeed(1 + int(seed) % _SEEDS)  # OMPL ignores 0
                return act()
            finally:
                ou.setLogLevel(level)
        finally:
            ou.setLogLevel(level)  # again, for Ctrl-C may have come before

    return _turns.hold(silent, poll)


def _path(
    problem: SearchProblem,
    oracle: _Oracle,
    planner: str,
    settings: dict[str, Setting],
    goals: FloatArray,
    enough: Callable[[Any], bool],
) -> list[Configuration]:
    """The path OMPL found, empty if none."""

    def found() -> list[Configuration]:
        run = _Run(problem, oracle, planner, settings)
        run.between(problem.start, goals)
        run.until(run.planner.solve, enough)
        if problem.grown is not None:
            problem.grown(*(oracle.free_graph() if planner in WITHOUT_GRAPH else run.roadmap()))
        return run.path()

    return _seeded(problem.seed, problem.poll, found)


def _ends(problem: SearchProblem) -> Iterable[Configuration]:
    """Start and goals, which are known to be free."""
    return map(tuple, [problem.start.tolist(), *problem.goals.tolist()])


def _joined(problem: SearchProblem, points: list[Configuration]) -> list[Configuration]:
    """OMPL's path from exactly the start to exactly the goal it reaches."""
    goal = problem.goals[_nearest(problem, points[-1])]
    return _exact(points, tuple(problem.start.tolist()), tuple(goal.tolist()))


def _nearest(problem: SearchProblem, q: Configuration) -> int:
    """Which goal a path to q reaches."""
    goals = problem.goals
    return 0 if len(goals) == 1 else int(np.argmin(distances(goals, np.array(q))))


def _result(problem: SearchProblem, oracle: _Oracle, points: list[Configuration], *, note: str = "") -> SearchResult:
    held = oracle.release()
    if isinstance(held, _GoingInCircles):
        held, note = None, f"ended early: {held}"
    index = None
    if points and (held is None or isinstance(held, SearchStopped)):
        index = _nearest(problem, points[-1])
        points = _joined(problem, points)
        # OMPL promises free pieces; but an edge is free only if the oracle said so of this very edge.
        if not oracle.confirmed(points):
            index, note = None, "a piece of the path collides that OMPL had not asked about"
    if held is not None and index is None:
        try:
            raise held
        finally:
            del held  # this frame is in its traceback: a cycle, which would live until the garbage collector finds it
    return SearchResult(
        waypoints=None if index is None else np.array(points),
        goal_index=index,
        note=note if held is None else f"stopped with a path in hand: {held}",
        stopped=held.with_traceback(None) if isinstance(held, SearchStopped) else None,
    )


def _exact(points: list[Configuration], start: Configuration, goal: Configuration) -> list[Configuration]:
    """``points`` from exactly ``start`` to exactly ``goal``, without repetitions."""
    exact = [start]
    for q in [*points[1:-1], goal]:
        if q != exact[-1]:
            exact.append(q)
    return exact


def _key(a: Configuration, b: Configuration) -> tuple[Configuration, Configuration]:
    return (a, b) if a <= b else (b, a)
