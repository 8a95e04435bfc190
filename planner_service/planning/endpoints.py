"""The ends of a plan: inside the limits, free, and how far from everything the search can keep.

Cheap and definitive, so it comes first: a goal inside the table is the most common "planner failure".
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from planner_service.collision import CollisionChecker, Contact
from planner_service.collision.budget import CheckBudgetSpent, TimeBoxSpent
from planner_service.geometry.shapes import FloatArray, Pose, read_only
from planner_service.kinematics.inverse import inverse_kinematics
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.planning.accounting import NoPlan, StageBook
from planner_service.planning.collision_recovery import nearest_free
from planner_service.planning.request import PlanRequest, joint_vector
from planner_service.planning.result import Failure, Reason, Stage
from planner_service.robot.model import ExemptRetreat
from planner_service.search.problem import joint_distance

__all__ = ["Endpoints", "Ends", "GoalState"]

REMEDY_STATES = 1000
"""States spent at most on looking for a free configuration near an end in collision."""

SAME_POSE = 1e-4
"""Joint difference (rad) up to which a configuration is a named pose: an encoder step, 0.1 mm at the tip. A larger
box around the folded pose of the WidowX AI is unsound: its meshes touch 0.01 rad beside it."""

NEAR_POSE = 0.1
"""Joint difference (rad) up to which a user is told of a pose's way out."""

MOST_GOALS = 16
"""Free configurations of a pose with room that a search is given: the nearest."""

_LESS_PADDING = (0.5, 0.25, 0.125)
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
    """Between what to plan: a free start with its padding, and free goals, nearest first.

    ``begin`` is the requested start inside the limits, beyond which ``departure`` leads to ``start``;
    ``arrived_at`` is the index of a goal that is ``begin`` itself, None if there is no such.
    """

    begin: FloatArray
    start: FloatArray
    departure: ExemptRetreat | None
    start_padding: float
    goals: tuple[GoalState, ...]
    arrived_at: int | None = None

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
        begin = self._clamped(self._start)
        start, departure = self._beyond_retreat(begin)
        try:
            start_padding = self._padding_at(start, "start")
        except NoPlan as no_plan:
            raise NoPlan(self._remedied(no_plan.failure, start)) from no_plan
        goals: list[GoalState] = []
        refused: list[Failure] = []
        refused_at: FloatArray | None = None
        arrived_at: int | None = None
        for index, given in enumerate(self._goals):
            name = self._name(index)
            self._checker.ledger.poll()
            try:
                candidates = self._configurations(name, given, begin)
            except NoPlan as no_plan:
                refused.append(no_plan.failure)
                continue
            before = len(goals)
            for q in candidates:
                if isinstance(given, PoseGoal) and len(goals) - before == MOST_GOALS:
                    break
                if arrived_at is None and q.tolist() == begin.tolist():
                    arrived_at = index
                goal, arrival = self._beyond_retreat(q)
                try:
                    goals.append(GoalState(goal, index, arrival, self._padding_at(goal, name)))
                except NoPlan as no_plan:
                    refused_at = goal if not refused else refused_at
                    refused.append(no_plan.failure)
        if not goals:
            raise NoPlan(refused[0] if refused_at is None else self._remedied(refused[0], refused_at))
        goals.sort(key=lambda goal: joint_distance(start, goal.q))
        return Ends(begin, start, departure, start_padding, tuple(goals), arrived_at)

    def padded(self, ends: Ends, padding: float) -> Ends:
        """The same ends with what they keep of another padding."""

        def kept(q: FloatArray, before: float) -> float:
            return padding if self._checker.variant(padding=padding).state_is_free(q) else min(before, padding)

        goals = tuple(replace(goal, padding=kept(goal.q, goal.padding)) for goal in ends.goals)
        return replace(ends, start_padding=kept(ends.start, ends.start_padding), goals=goals)

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

    def _configurations(self, name: str, given: FloatArray | Pose | PoseGoal, begin: FloatArray) -> list[FloatArray]:
        """A joint goal itself, or every inverse kinematics solution of a pose, other arms staying as in ``begin``.

        Where a pose has room, the nearest come first.

        Raises:
            NoPlan: the goal is outside the limits, or the pose has no solution.
        """
        if isinstance(given, PoseGoal):
            return self._within(name, given, begin)
        if isinstance(given, Pose):
            solutions = inverse_kinematics(self._robot, given, still=begin)
            if len(solutions) == 0:
                x, y, z = given.position
                detail = f"{name}: no joint values within the limits bring the tool so to ({x:.4f}, {y:.4f}, {z:.4f})"
                raise NoPlan(Failure(Stage.ENDPOINTS, Reason.NO_IK_SOLUTION, detail))
            return [read_only(q) for q in solutions]
        joint = self._outside(given)
        if joint is not None:
            detail = f"{name}: {self._in_words(given, joint)}"
            raise NoPlan(Failure(Stage.ENDPOINTS, Reason.GOAL_OUTSIDE_LIMITS, detail))
        return [given]

    def _within(self, name: str, goal: PoseGoal, begin: FloatArray) -> list[FloatArray]:
        poses = goal.poses()
        solutions = list[FloatArray]()
        for pose in poses:
            self._checker.ledger.poll()
            solutions += [read_only(q) for q in inverse_kinematics(self._robot, pose, still=begin)]
        if not solutions:
            x, y, z = goal.pose.position
            tried = f"any of {len(poses)} poses around ({x:.4f}, {y:.4f}, {z:.4f})"
            detail = f"{name}: no joint values within the limits bring the tool to {tried}"
            raise NoPlan(Failure(Stage.ENDPOINTS, Reason.NO_IK_SOLUTION, detail))
        return sorted(solutions, key=lambda q: joint_distance(begin, q))

    def _beyond_retreat(self, q: FloatArray) -> tuple[FloatArray, ExemptRetreat | None]:
        """Where planning goes on from q: the free end of the fixed way out, if q is a colliding pose that has one."""
        for retreat in self._robot.retreats:
            rest = self._robot.pose(retreat.pose)
            if np.abs(q - rest).max() > SAME_POSE or self._checker.state_is_free(q):
                continue
            pairs = self._checker.parts.labels.links(retreat.pairs)
            checker = self._checker.variant(allowed=(*self._checker.allowed, *pairs))
            if checker.edge_is_free(rest, retreat.to):
                if q.tolist() != rest.tolist():
                    self._book.notes.append(
                        f"taken for the pose {retreat.pose!r}, {np.abs(q - rest).max():.1e} rad away"
                    )
                return retreat.to, retreat
        return q, None

    def _padding_at(self, q: FloatArray, name: str) -> float:
        """The widest padding of a short ladder with which q is free.

        Raises:
            NoPlan: q collides as it is.
        """
        widest = self._request.padding
        if self._checker.variant(padding=widest).state_is_free(q):
            return widest
        if widest == 0.0 or not self._checker.state_is_free(q):
            raise NoPlan(self._in_collision(name, q))
        ladder = (widest * part for part in _LESS_PADDING)
        return next((p for p in ladder if self._checker.variant(padding=p).state_is_free(q)), 0.0)

    def _in_collision(self, name: str, q: FloatArray) -> Failure:
        contacts: tuple[Contact, ...] = ()
        with suppress(CheckBudgetSpent, TimeBoxSpent):  # that it collides is known all the same
            contacts = self._checker.contacts(q)
        what = ", ".join(str(contact) for contact in contacts[:3]) or "no check left to say with what"
        detail = f"{name} in collision: {what}"
        for retreat in self._robot.retreats:
            if np.abs(q - self._robot.pose(retreat.pose)).max() <= NEAR_POSE:
                detail += f"; the pose {retreat.pose!r} itself has a way out, to within {SAME_POSE:g} of it"
        reason = Reason.START_IN_COLLISION if name == "start" else Reason.GOAL_IN_COLLISION
        return Failure(Stage.ENDPOINTS, reason, detail, contacts)

    def _remedied(self, failure: Failure, q: FloatArray) -> Failure:
        """The same failure with the nearest free configuration found, if the limits leave room to look for one."""
        try:
            with self._checker.limited(states=REMEDY_STATES):
                free = nearest_free(self._checker, q, np.random.default_rng([self._request.seed, 2]))
        except (CheckBudgetSpent, TimeBoxSpent) as stopped:
            self._book.deterministic &= isinstance(stopped, CheckBudgetSpent)
            free = None
        if free is None:
            return failure
        away = joint_distance(q, free)
        detail = f"{failure.detail}; the nearest free configuration found is {away:.3f} rad away"
        return replace(failure, detail=detail, nearest_free=free)
