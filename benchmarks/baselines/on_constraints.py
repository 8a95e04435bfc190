"""Other ways of planning under constraints: samples that do not keep them rejected, OMPL's projected space, roboplan.

All end with their first path, which is neither shortened nor proven nor timed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou
import pinocchio as pin

from benchmarks.baselines.peers.catalogue import PEERS
from benchmarks.baselines.peers.environments import Environment
from benchmarks.baselines.peers.jobs import Task
from benchmarks.baselines.peers.running import NOT_INSTALLED, Run, path_of, replies_of
from benchmarks.harness.audit import independent
from benchmarks.harness.sources import Motion
from benchmarks.worlds.constrained import ROBOTS, ConstrainedQuery
from planner_service.collision import CollisionChecker, Known
from planner_service.collision.budget import TimeBoxSpent
from planner_service.constraints import Constraint, JointRange, ToolRegion
from planner_service.constraints.projection import Projector, projector_of
from planner_service.constraints.resolved import ConstraintSet
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.planners import RRTConnect
from planner_service.robot.model import load_robot
from planner_service.search.problem import SearchProblem

__all__ = ["METHODS", "Raw", "projected", "rejecting", "roboplan"]

SEED = 1

NARROW = 0.01
"""Metres: what is bounded to a narrower width is projected; what has room is a matter of a state's validity."""

USED = 0.9
"""Part of a tolerance within which OMPL projects, so that something is left between its states."""


@dataclass(frozen=True, eq=False)
class _Rejecting:
    """An oracle for which only states and edges that keep the constraints are free."""

    checker: CollisionChecker
    projector: Projector

    @property
    def states(self) -> int:
        return self.checker.counts.states

    def state_is_free(self, q: FloatArray) -> bool:
        return self.projector.share(tuple(q.tolist())) <= 1.0 and self.checker.state_is_free(q)

    def edge_is_free(self, q1: FloatArray, q2: FloatArray, *, known: Known = Known.NEITHER) -> bool:
        kept = self.projector.keeps(tuple(q1.tolist()), tuple(q2.tolist()))
        return kept and self.checker.edge_is_free(q1, q2, known=known)


def rejecting(query: ConstrainedQuery, given: tuple[Constraint, ...], seconds: float) -> bool:
    """Whether OMPL's RRTConnect finds a path when it may only reject what does not keep constraints."""
    robot = load_robot(ROBOTS[query.set])
    checker, held = CollisionChecker(robot, query.scene), ConstraintSet(robot, given)
    end = time.process_time() + seconds

    def poll() -> None:
        if time.process_time() > end:
            raise TimeBoxSpent("the time limit passed")

    oracle = _Rejecting(checker, projector_of(held))
    problem = SearchProblem(query.start, query.goals, held.lower, held.upper, oracle, SEED, poll, reach=checker.reach)
    try:
        return RRTConnect().search(problem).waypoints is not None
    except TimeBoxSpent:
        return False


class _Equations(ob.Constraint):  # type: ignore[misc]
    """The narrow quantities of regions in shares of their tolerances, for OMPL, which differentiates numerically."""

    def __init__(self, n: int, values: Callable[[FloatArray], FloatArray], count: int) -> None:
        super().__init__(n, count, USED)
        self._values = values

    def function(self, x: FloatArray, out: FloatArray) -> None:
        """OMPL's name for it."""
        out[:] = self._values(np.asarray(x))


def projected(query: ConstrainedQuery, given: tuple[Constraint, ...], seconds: float) -> bool | None:
    """Whether OMPL's RRTConnect finds a path in a ``ProjectedStateSpace``; None where nothing is narrow."""
    robot = load_robot(ROBOTS[query.set])
    second, checker = independent(ROBOTS[query.set], query.scene), CollisionChecker(robot, query.scene)
    held, n = ConstraintSet(robot, given), robot.n
    projector = projector_of(held)
    order = [second.model.joints[second.model.getJointId(name)].idx_q for name in robot.joint_names]
    x, data = np.zeros(second.model.nq), second.model.createData()

    def values(q: FloatArray) -> FloatArray:
        x[order] = q
        pin.framesForwardKinematics(second.model, data, x)
        return np.array(_narrow(second.model, data, given, robot.tool_frame))

    count = len(values(query.start))
    if count == 0:
        return None
    wide = any(_is_wide(constraint) for constraint in given)

    def is_valid(state: Any) -> bool:
        q = np.array([state[k] for k in range(n)])
        del state
        if not ((held.lower <= q) & (q <= held.upper)).all():  # OMPL projects beyond its bounds
            return False
        return (not wide or projector.share(tuple(q.tolist())) <= 1.0) and checker.state_is_free(q)

    ambient, bounds = ob.RealVectorStateSpace(n), ob.RealVectorBounds(n)
    for k in range(n):
        bounds.setLow(k, float(held.lower[k]))
        bounds.setHigh(k, float(held.upper[k]))
    ambient.setBounds(bounds)
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(SEED)
    space = ob.ProjectedStateSpace(ambient, _Equations(n, values, count))
    information = ob.ConstrainedSpaceInformation(space)
    information.setStateValidityChecker(is_valid)
    information.setup()
    problem = ob.ProblemDefinition(information)
    problem.addStartState(_state(space, query.start))
    goals = ob.GoalStates(information)
    for goal in query.goals:
        goals.addState(_state(space, goal))
    problem.setGoal(goals)
    planner = og.RRTConnect(information)
    planner.setProblemDefinition(problem)
    planner.setup()
    end = time.process_time() + seconds
    planner.solve(ob.PlannerTerminationCondition(lambda: time.process_time() > end))
    return bool(problem.hasExactSolution())


@dataclass(frozen=True, eq=False)
class Raw:
    """What roboplan makes of a query.

    Attributes:
        ms: CPU of its search, without what prepares the scene; all it waited for where there is no answer.
        path: None if there is none.
        failure: None if there is a path from the start to a goal.
    """

    ms: float
    path: JointPath | None
    failure: str | None


def roboplan(query: ConstrainedQuery, given: tuple[Constraint, ...], seconds: float) -> Raw | None:
    """roboplan's RRT-Connect in its environment; None where no job can hold the robot and the constraints."""
    if query.set != "panda":
        return None
    (upright,), robot, peer = given, load_robot(ROBOTS[query.set]), PEERS["roboplan"]
    assert isinstance(upright, ToolRegion)
    problem = Motion(query.name, query.set, robot.name, query.scene, query.start, tuple(query.goals))
    tasks, environment = (Task(problem, SEED, upright),), Environment.of(peer)
    if not environment.ready:
        return Raw(0.0, None, NOT_INSTALLED)
    (reply,) = replies_of(Run(peer, "rrtconnect", query.set, robot, tasks, seconds), environment, tasks)
    path, failure, _ = path_of(reply, problem)
    spent = reply.waited if reply.answer is None else float(reply.answer["cpu_seconds"])
    return Raw(spent * 1e3, None if path is None or failure is not None else JointPath(path), failure)


METHODS: dict[str, Callable[[ConstrainedQuery, tuple[Constraint, ...], float], bool | None]] = {
    "rejecting": rejecting,
    "ompl projected": projected,
}


def _state(space: Any, q: FloatArray) -> Any:
    state = space.allocState()
    state.copy(np.array(q))
    return state


def _is_wide(constraint: Constraint) -> bool:
    if isinstance(constraint, JointRange):
        return True
    pairs = zip(constraint.lower, constraint.upper, strict=True)
    return any(np.isfinite(high - low) and high - low >= NARROW for low, high in pairs)


def _narrow(model: Any, data: Any, given: tuple[Constraint, ...], tool_frame: str) -> list[float]:
    """Distances from the middle over half the width, the tilt by two components and the turn, over their bounds."""
    out: list[float] = []
    for region in given:
        if isinstance(region, JointRange):
            continue
        tool = data.oMf[model.getFrameId(region.link or tool_frame)].homogeneous @ region.tool.matrix
        base = np.eye(4) if region.relative_to is None else data.oMf[model.getFrameId(region.relative_to)].homogeneous
        T = np.linalg.solve(base @ region.frame.matrix, tool)
        for value, low, high in zip(T[:3, 3].tolist(), region.lower, region.upper, strict=True):
            if high - low < NARROW:
                out.append((2.0 * value - low - high) / (high - low))
        if region.tilt is not None:
            angle = float(np.arctan2(np.hypot(T[0, 2], T[1, 2]), T[2, 2]))
            scale = angle / max(float(np.hypot(T[0, 2], T[1, 2])), 1e-12) / region.tilt
            out += [T[0, 2] * scale, T[1, 2] * scale]
        if region.turn is not None:
            out.append(float(np.arctan2(T[1, 0] - T[0, 1], T[0, 0] + T[1, 1])) / region.turn)
    return out
