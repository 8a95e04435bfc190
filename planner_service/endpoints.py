"""The ends of a plan: inside the limits, free, and how far from everything the search can keep.

Cheap and definitive, so it comes first: a goal inside the table is the most common "planner failure".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.collision.ledger import CheckBudgetSpent
from planner_service.geometry import FloatArray, Pose, read_only
from planner_service.kinematics import inverse_kinematics
from planner_service.outcome import Failure, Reason, Stage
from planner_service.remedies import nearest_free
from planner_service.request import PlanRequest, joint_vector
from planner_service.robot import ExemptRetreat
from planner_service.search import joint_distance
from planner_service.stagebook import NoPlan, StageBook

__all__ = ["Endpoints", "Ends", "GoalState"]

REMEDY_STATES = 1000
"""States spent at most on looking for a free configuration near an end in collision."""

_PADDING_STEPS = (1.0, 0.5, 0.25, 0.125, 0.0)
"""Parts of the asked padding tried at an end that is closer to something than that."""


@dataclass(frozen=True, eq=False)
class GoalState:
    """A free configuration to reach.

    Attributes:
        q: Shape (n,); where a retreat leads to a named pose, its free end.
        index: Which of the requested goals it belongs to.
        arrival: The fixed way from q into the requested pose, travelled backwards.
        padding: What q keeps from everything, in metres, at most what was asked.
    """

    q: FloatArray
    index: int
    arrival: ExemptRetreat | None
    padding: float


@dataclass(frozen=True, eq=False)
class Ends:
    """Between what to plan: a free start with its padding, and free goals, nearest first."""

    start: FloatArray
    departure: ExemptRetreat | None
    start_padding: float
    goals: tuple[GoalState, ...]

    @property
    def padding(self) -> float:
        """What all of the ends keep from everything, in metres."""
        return min(self.start_padding, *(goal.padding for goal in self.goals))


class Endpoints:
    """Finds the ends of one request, or the reason why it has none."""

    def __init__(self, checker: CollisionChecker, request: PlanRequest, book: StageBook) -> None:
        self._checker = checker
        self._robot = checker.robot
        self._request = request
        self._book = book
        self._start = joint_vector("start", request.start, self._robot)
        self._goals = request.goals(self._robot)

    def find(self) -> Ends:
        """Judge the ends.

        Raises:
            NoPlan: the start, or every goal, is outside the limits, unreachable or in collision.
        """
        start, departure = self._beyond_retreat(self._clamped(self._start))
        start_padding = self._padding_at(start, "start")
        goals: list[GoalState] = []
        refused: list[Failure] = []
        for index, given in enumerate(self._goals):
            try:
                for q in self._configurations(self._name(index), given):
                    goal, arrival = self._beyond_retreat(q)
                    goals.append(GoalState(goal, index, arrival, self._padding_at(goal, self._name(index))))
            except NoPlan as no_plan:
                refused.append(no_plan.failure)
        if not goals:
            raise NoPlan(refused[0])
        goals.sort(key=lambda goal: joint_distance(start, goal.q))
        return Ends(start, departure, start_padding, tuple(goals))

    def _name(self, index: int) -> str:
        return "goal" if len(self._goals) == 1 else f"goal[{index}]"

    def _outside(self, q: FloatArray) -> int | None:
        """The joint farthest outside its limits, None if none is."""
        limits = self._robot.limits
        excess = np.maximum(limits.lower - q, q - limits.upper)
        worst = int(excess.argmax())
        return worst if excess[worst] > 0.0 else None

    def _in_words(self, q: FloatArray, joint: int) -> str:
        low, high = self._robot.limits.lower[joint], self._robot.limits.upper[joint]
        return f"{self._robot.joint_names[joint]} = {q[joint]:.6g} is outside [{low:.4f}, {high:.4f}]"

    def _clamped(self, q: FloatArray) -> FloatArray:
        joint = self._outside(q)
        if joint is None:
            return q
        limits = self._robot.limits
        inside = np.minimum(np.maximum(q, limits.lower), limits.upper)
        if abs(float(inside[joint] - q[joint])) > self._request.start_tolerance:
            detail = f"start: {self._in_words(q, joint)}"
            raise NoPlan(Failure(Stage.ENDPOINTS, Reason.START_OUTSIDE_LIMITS, detail))
        self._book.notes.append(f"start: {self._in_words(q, joint)}; it was clamped to the limit")
        return read_only(inside)

    def _configurations(self, name: str, given: FloatArray | Pose) -> Iterator[FloatArray]:
        if isinstance(given, Pose):
            yield from self._reaching(name, given)
            return
        joint = self._outside(given)
        if joint is not None:
            detail = f"{name}: {self._in_words(given, joint)}"
            raise NoPlan(Failure(Stage.ENDPOINTS, Reason.GOAL_OUTSIDE_LIMITS, detail))
        yield given

    def _reaching(self, name: str, pose: Pose) -> Iterator[FloatArray]:
        """Every free solution of a pose; if all collide, the reason of the first."""
        solutions = [read_only(q) for q in inverse_kinematics(self._robot, pose)]
        if not solutions:
            x, y, z = pose.position
            detail = f"{name}: no joint values within the limits bring the tool so to ({x:.4f}, {y:.4f}, {z:.4f})"
            raise NoPlan(Failure(Stage.ENDPOINTS, Reason.NO_IK_SOLUTION, detail))
        free = [q for q in solutions if self._checker.state_is_free(q)]
        if not free:
            raise NoPlan(self._in_collision(name, solutions[0]))
        yield from free

    def _beyond_retreat(self, q: FloatArray) -> tuple[FloatArray, ExemptRetreat | None]:
        """Where planning goes on from q: the free end of the fixed way out, if q is a pose that has one."""
        tolerance = self._request.start_tolerance
        for retreat in self._robot.retreats:
            rest = self._robot.pose(retreat.pose)
            if np.abs(q - rest).max() > tolerance:
                continue
            checker = self._checker.variant(allowed=(*self._checker.allowed, *retreat.pairs))
            if not checker.edge_is_free(rest, retreat.to):
                continue
            if q.tolist() != rest.tolist():
                self._book.notes.append(f"taken for the pose {retreat.pose!r}, from which it is within {tolerance:g}")
            return retreat.to, retreat
        return q, None

    def _padding_at(self, q: FloatArray, name: str) -> float:
        """The widest padding of a short ladder with which q is free.

        Raises:
            NoPlan: q collides as it is.
        """
        widest = self._request.padding
        ladder = [widest * part for part in _PADDING_STEPS] if widest else [0.0]
        for padding in ladder:
            if self._checker.variant(padding=padding).state_is_free(q):
                return padding
        raise NoPlan(self._in_collision(name, q))

    def _in_collision(self, name: str, q: FloatArray) -> Failure:
        contacts = self._checker.contacts(q)
        try:
            with self._checker.limited(states=REMEDY_STATES):
                free = nearest_free(self._checker, q, np.random.default_rng([self._request.seed, 2]))
        except CheckBudgetSpent:
            free = None
        detail = f"{name} in collision: {', '.join(str(contact) for contact in contacts[:3])}"
        if free is not None:
            detail += f"; the nearest free configuration found is {joint_distance(q, free):.3f} rad away"
        reason = Reason.START_IN_COLLISION if name == "start" else Reason.GOAL_IN_COLLISION
        return Failure(Stage.ENDPOINTS, reason, detail, contacts, free)
