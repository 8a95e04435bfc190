"""OMPL as one sets it up by hand: RRTConnect with a validator that has Coal judge each edge in one compiled call.

Nothing of ours is in it but the numbers it is given. An edge is sampled as OMPL samples it, its end first and then the
interior in bisection order, and judged up to the first sample that collides. Pinocchio offers that call for two of its
broad phases; its naive one, which is the fastest for a single configuration, has to be called for each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou
import pinocchio as pin

from benchmarks.baselines.naive_manager import NaiveManager, models_of
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["BATCHED", "ONE_BY_ONE", "BatchedEdges", "CoalEdges", "EdgesOneByOne", "Setup", "coal_edges", "fractions"]

ONE_BY_ONE = "naive, a call a state"
BATCHED = {
    "tree, a call an edge": pin.TreeBroadPhaseManagerPool_DynamicAABBTreeCollisionManager,
    "AABB tree, a call an edge": pin.BroadPhaseManagerPool_DynamicAABBTreeCollisionManager,
}
"""Pinocchio's pools of broad phases, by the names they have in tables."""

SLACK = 1e-9
"""As everywhere: a quotient that is an integer but for rounding costs no sample more."""


@cache
def fractions(segments: int) -> FloatArray:
    """Where an edge of so many equal segments is judged, its end first, then the interior by bisection, (m, 1)."""
    found, level = [1.0], [(0, segments)]
    while level:
        halves = []
        for low, high in level:
            if high - low > 1:
                middle = (low + high) // 2
                found.append(middle / segments)
                halves += [(low, middle), (middle, high)]
        level = halves
    return np.array(found)[:, None]


class CoalEdges(Protocol):
    """Judges states, and edges given as their samples in order, (m, n)."""

    def state_is_free(self, q: Sequence[float]) -> bool:
        """Whether no pair touches at q (n,)."""

    def edge_is_free(self, Q: FloatArray) -> bool:
        """Whether no pair touches at any of Q (m, n)."""


class BatchedEdges:
    """One call an edge, which ends at the first state that collides and at the first of its pairs."""

    def __init__(self, robot: Robot, scene: Scene, pool: Callable[[Any, Any, int], Any]) -> None:
        model, world, order = models_of(robot, scene)
        self._order = None if order == sorted(order) else order
        self._pool = pool(model, world, 1)

    def state_is_free(self, q: Sequence[float]) -> bool:
        """Whether no pair touches at q (n,)."""
        return self.edge_is_free(np.array([q]))

    def edge_is_free(self, Q: FloatArray) -> bool:
        """Whether no pair touches at any of Q (m, n)."""
        columns = Q.T if self._order is None else Q[:, self._order].T
        return not pin.computeCollisionsInParallel(1, self._pool, columns, True, True).any()


class EdgesOneByOne:
    """One call a state, by the naive manager."""

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self._manager = NaiveManager(robot, scene)
        order = [body.q_index for body in robot.bodies[1:]]
        self._order = None if order == sorted(order) else order
        self.state_is_free = self._manager.state_is_free

    def edge_is_free(self, Q: FloatArray) -> bool:
        """Whether no pair touches at any of Q (m, n)."""
        rows = Q if self._order is None else np.ascontiguousarray(Q[:, self._order])
        return not any(map(self._manager.collides, rows))


def coal_edges(robot: Robot, scene: Scene) -> dict[str, CoalEdges]:
    """All ways to have Coal judge an edge, by name."""
    found: dict[str, CoalEdges] = {ONE_BY_ONE: EdgesOneByOne(robot, scene)}
    return found | {name: BatchedEdges(robot, scene, pool) for name, pool in BATCHED.items()}


class _Motions(ob.MotionValidator):  # type: ignore[misc]
    """Hands the samples of an edge to Coal."""

    def __init__(self, si: Any, edges: CoalEdges, step: float) -> None:
        super().__init__(si)  # and no reference of our own to si: that would be a cycle
        self._edges, self._step = edges, step
        self._span = slice(0, si.getStateDimension())

    def checkMotion(self, first: Any, second: Any) -> bool:  # noqa: N802 - OMPL's name
        a, b = first[self._span], second[self._span]
        segments = max(1, math.ceil(math.dist(a, b) / self._step - SLACK))
        start = np.array(a)
        return self._edges.edge_is_free(start + (np.array(b) - start) * fractions(segments))


@dataclass(frozen=True, eq=False)
class Setup:
    """One query, and the settings that both sides have in common.

    Attributes:
        start, goal: Shape (n,).
        lower, upper: Joint limits, shape (n,).
        step: Radians between samples of an edge at most, L2 over all joints.
        range: Radians of an edge at most.
        seed: Of OMPL's random numbers.
        seconds: After which the search gives up.
    """

    start: FloatArray
    goal: FloatArray
    lower: FloatArray
    upper: FloatArray
    step: float
    range: float
    seed: int
    seconds: float

    def search(self, edges: CoalEdges) -> FloatArray | None:
        """RRTConnect's waypoints (N, n), from fresh objects; None when it found no path in time."""
        with _seeded(self.seed):
            n = len(self.start)
            space, bounds = ob.RealVectorStateSpace(n), ob.RealVectorBounds(n)
            for joint in range(n):
                bounds.setLow(joint, float(self.lower[joint]))
                bounds.setHigh(joint, float(self.upper[joint]))
            space.setBounds(bounds)
            si = ob.SpaceInformation(space)
            span = slice(0, n)
            si.setStateValidityChecker(lambda state: edges.state_is_free(state[span]))
            si.setMotionValidator(_Motions(si, edges, self.step))
            si.setup()
            problem = ob.ProblemDefinition(si)
            problem.setStartAndGoalStates(_state(si, self.start), _state(si, self.goal))
            planner = og.RRTConnect(si)
            planner.setRange(self.range)
            planner.setProblemDefinition(problem)
            planner.setup()
            status = planner.solve(ob.timedPlannerTerminationCondition(self.seconds))
            if not status == ob.PlannerStatus.EXACT_SOLUTION:  # noqa: SIM201 - it knows == alone
                return None
            path = problem.getSolutionPath()
            return np.array([path.getState(k)[span] for k in range(path.getStateCount())])


def _state(si: Any, q: FloatArray) -> Any:
    state = si.allocState()
    for joint, value in enumerate(q.tolist()):
        state[joint] = value
    return state


@contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """OMPL silent, and seeded as a search of ours with that seed is."""
    level = ou.getLogLevel()
    try:
        ou.setLogLevel(ou.LOG_NONE)
        ou.RNG.setSeed(1 + seed)  # OMPL ignores 0
        yield
    finally:
        ou.setLogLevel(level)
