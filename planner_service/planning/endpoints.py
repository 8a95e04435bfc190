"""The ends of a plan: whether they are within the limits and free, and how much padding the search can keep there.

This comes first because it is cheap and its answer is final: a goal inside the table is the most common reason why
there is no plan.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from planner_service.certify import MARGIN, ExemptInterval
from planner_service.certify.colliding_solutions import CollidingSolution, all_in_words, colliding_solutions
from planner_service.collision import Contact
from planner_service.collision.budget import CheckBudgetSpent, TimeBoxSpent
from planner_service.geometry.arrays import FloatArray, joint_distance, read_only
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.inverse import (
    configurations_at,
    inverse_is_complete,
    inverse_kinematics,
    solutions_known,
)
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.kinematics.reachability import why_unreachable
from planner_service.path.joint_path import JointPath
from planner_service.planning.accounting import NoPlan, PlanContext
from planner_service.planning.collision_recovery import APART, NoWayOut, WayOut, find_way_out, nearest_free
from planner_service.planning.hull_contacts import filled_hulls, how_to_cut, touching_by_hulls
from planner_service.planning.request import Goals, PlanRequest, clamp_note
from planner_service.planning.result import Failure, Reason, Stage
from planner_service.presentation.measures import outside_text
from planner_service.robot.model import TURN, ExemptRetreat, Robot, joint_vector

__all__ = ["Ends", "GoalState", "find_ends", "padded_ends", "require_ends"]

DEGREES = 1.0
"""Radians beyond a limit from which on a joint's value may be one in degrees."""

RECOVERY_STATES = 1000
"""States checked at most when looking for a free configuration near an end in collision."""

SAME_POSE = 1e-4
"""Joint difference (rad) up to which a configuration is a named pose: an encoder step, 0.1 mm at the tip. A larger
box around the folded pose of the WidowX AI is unsound: its meshes touch 0.01 rad beside it."""

SAME_TURN = 1e-9
"""Joint difference (rad) up to which two configurations, one of them turned by whole turns, are the same: rounding."""

SAME_SOLUTION = 1e-5
"""Joint difference (rad) up to which two solutions for a pose are the same: the starts end when the tool is there."""

NEAR_POSE = 0.1
"""Joint difference (rad) up to which a message mentions that a pose has a way out."""

MAX_GOALS = 16
"""Free configurations of a pose with tolerances that a search is given: the nearest."""

LESS_PADDING = (0.5, 0.25, 0.125)
"""Parts of the requested padding tried, in this order, at an end that is closer to something; then ``MARGIN``, without
which no path that begins or ends there can be proven."""


@dataclass(frozen=True, eq=False)
class GoalState:
    """A free configuration to reach.

    Attributes:
        q: Shape (n,); for a named pose with a fixed way in, where that way begins.
        index: Which of the requested goals it belongs to.
        arrival: The fixed way from q into the requested pose, a retreat driven backwards; None if q is the goal.
        padding: Metres that q keeps from everything, at most what was requested.
    """

    q: FloatArray
    index: int
    arrival: ExemptRetreat | None
    padding: float


@dataclass(frozen=True, eq=False)
class Ends:
    """Where a plan starts, and where it may end.

    Attributes:
        begin: The requested start, clamped to the limits, shape (n,).
        start: Where the search starts, shape (n,): ``begin``, or where the way out of it ends.
        departure: The way out of that pose, or of a collision; None if there is none.
        start_padding: Metres that ``start`` keeps from everything, at most what was requested.
        goals: Free goals, nearest first.
        arrived_at: The index of a requested goal that is ``begin`` itself; None if there is none.
        padding: Metres that all of the ends keep from everything.
    """

    begin: FloatArray
    start: FloatArray
    departure: WayOut | None
    start_padding: float
    goals: tuple[GoalState, ...]
    arrived_at: int | None = None
    padding: float = field(init=False)

    def __post_init__(self) -> None:
        self.__dict__["padding"] = min(self.start_padding, *(goal.padding for goal in self.goals))

    def all_of(self, asked: Goals, robot: Robot) -> tuple[FloatArray, ...] | None:
        """Every configuration that would do as an end of a motion to these goals; None if others may do, too."""
        stated = list[FloatArray]()
        for goal in asked:
            if not isinstance(goal, Pose | PoseGoal):
                stated.append(goal)
            elif not _all_known(robot, goal):
                return None
        return (*(goal.q for goal in self.goals), *stated)


def require_ends(request: PlanRequest, robot: Robot) -> Goals:
    """Refuse a request whose start or goal is not one of a robot; its goals, as ``PlanRequest.goals`` says.

    Raises:
        InvalidRequest: It is neither n finite joint values nor, for a goal, a pose.
    """
    joint_vector("start", request.start, robot)
    return request.goals(robot)


def find_ends(context: PlanContext) -> Ends:
    """Check start and goals, as the ENDPOINTS stage.

    Raises:
        NoPlan: The start, or every goal, is outside the limits, out of reach or in collision.
    """
    with context.accounting.during(Stage.ENDPOINTS) as entry:
        ends = _ends(context)
        left = [stretch for stretch in (ends.departure.exempt if ends.departure else ()) if stretch.depth is not None]
        if left:
            deep = max(stretch.depth or 0.0 for stretch in left)
            pairs = ", ".join(f"{a} x {b}" for stretch in left for a, b in stretch.pairs)
            entry.note = f"a way out of {pairs} ({deep * 1e3:.2g} mm deep)"
        return ends


def padded_ends(context: PlanContext, ends: Ends, padding: float) -> Ends:
    """The same ends with what they keep of another padding, as the ENDPOINTS stage."""
    checker = context.checker.variant(padding=padding)

    def kept(q: FloatArray, before: float) -> float:
        return padding if checker.state_is_free(q) else min(before, padding)

    with context.accounting.during(Stage.ENDPOINTS):
        goals = tuple(replace(goal, padding=kept(goal.q, goal.padding)) for goal in ends.goals)
        return replace(ends, start_padding=kept(ends.start, ends.start_padding), goals=goals)


def _ends(context: PlanContext) -> Ends:
    request, robot = context.request, context.checker.robot
    begin = _clamped(context, np.asarray(request.start))
    start, retreat = _beyond_retreat(context, begin)
    departure = None if retreat is None else _fixed_way(context, retreat)
    context.accounting.require_end("start", begin, start)
    try:
        start_padding = _padding_at(context, start, "start")
    except NoPlan as no_plan:
        if departure is not None:
            raise NoPlan(_with_nearest_free(context, no_plan.failure, start)) from no_plan
        departure = _way_out(context, start, no_plan.failure)
        start = departure.path.waypoints[-1]
        start_padding = _padding_at(context, start, "start")
    goals: list[GoalState] = []
    failures: list[Failure] = []
    every = True  # end that was asked for is known
    colliding: FloatArray | None = None
    arrived_at: int | None = None
    judged: dict[int, list[FloatArray]] = {}
    for index, ((name, stated), given) in enumerate(zip(request.named_goals(), context.goals, strict=True)):
        if not isinstance(given, Pose | PoseGoal):
            _note_clamped(context, name, np.asarray(stated), given)
            context.checker.ledger.poll()
        try:
            candidates = _configurations(context, name, given, begin)
        except NoPlan as no_plan:
            failures.append(no_plan.failure)
            continue
        every = every and (not isinstance(given, Pose | PoseGoal) or _all_known(robot, given))
        if isinstance(given, Pose | PoseGoal):
            judged[index] = candidates
        before = len(goals)
        for q in candidates:
            if isinstance(given, PoseGoal) and len(goals) - before == MAX_GOALS:
                break
            if arrived_at is None and q.tolist() == begin.tolist():
                arrived_at = index
            try:
                goals.append(_goal_state(context, name, q, index))
            except NoPlan as no_plan:
                if not failures and no_plan.failure.reason is Reason.GOAL_IN_COLLISION:
                    colliding = q
                failures.append(no_plan.failure)
    shown: tuple[CollidingSolution, ...] | None = None
    if not goals and judged:
        missed, more, shown = _all_solutions(context, judged, begin)
        goals += missed
        failures += more
    if not goals:
        certain = every or shown is not None
        first = replace(failures[0], proven=certain and all(failure.proven for failure in failures))
        if first.proven and shown:
            first = replace(first, detail=f"{first.detail}; {all_in_words(shown)}", colliding=shown)
        elif first.proven and len(failures) > 1:
            pairs = {f"{failure.contacts[0].a} x {failure.contacts[0].b}" for failure in failures if failure.contacts}
            words = f"all {len(failures)} ends that would do are refused ({', '.join(sorted(pairs))})"
            first = replace(first, detail=f"{first.detail}; {words}")
        raise NoPlan(_explained(context, first, context.goals[0], colliding, begin))
    if len(goals) > 1:
        goals.sort(key=lambda goal: joint_distance(start.tolist(), goal.q.tolist()))
    return Ends(begin, start, departure, start_padding, tuple(goals), arrived_at)


def _goal_state(context: PlanContext, name: str, q: FloatArray, index: int) -> GoalState:
    """A configuration as a goal.

    Raises:
        NoPlan: It is in collision, nearer to something than can be proven, or does not keep what an end has to.
    """
    goal, arrival = _beyond_retreat(context, q)
    context.accounting.require_end(name, q, goal)
    return GoalState(goal, index, arrival, _padding_at(context, goal, name))


def _all_solutions(
    context: PlanContext, judged: dict[int, list[FloatArray]], begin: FloatArray
) -> tuple[list[GoalState], list[Failure], tuple[CollidingSolution, ...] | None]:
    """What a complete search adds for poses of which no configuration found so far will do.

    Args:
        judged: By the number of the goal, the configurations that were found and refused.

    Returns:
        Goals that the starts have missed; why others are refused; and if there is no goal, all configurations for
        these poses, each proven to collide: None if that is not known of one of them.
    """
    goals, failures = list[GoalState](), list[Failure]()
    certain, shown = True, list[CollidingSolution]()
    robot, names = context.checker.robot, [name for name, _ in context.request.named_goals()]
    try:
        for index, known in judged.items():
            given = context.goals[index]
            assert isinstance(given, Pose | PoseGoal)
            context.checker.ledger.poll()
            found = solutions_known(robot, given, still=begin)
            certain = certain and found is not None and found.complete
            if found is None:
                continue
            for q in _nearest_turns(robot, found.q, begin) if any(robot.continuous) else list(found.q):
                if all(_farthest(q, other) > SAME_SOLUTION for other in known):
                    try:
                        goals.append(_goal_state(context, names[index], q, index))
                    except NoPlan as no_plan:
                        failures.append(no_plan.failure)
            if certain and not goals:
                collide = colliding_solutions(context.certifier.get(), found.q, found.lower, found.upper)
                certain = collide is not None
                shown += collide or ()
    except (CheckBudgetSpent, TimeBoxSpent) as stopped:
        context.accounting.stopped_by(stopped)
        certain = False
    return goals, failures, tuple(shown) if certain and not goals else None


def _all_known(robot: Robot, given: Pose | PoseGoal) -> bool:
    """Whether no configuration for a goal was left out."""
    return isinstance(given, Pose) and inverse_is_complete(robot, given)


def _outside(q: FloatArray, robot: Robot) -> int | None:
    """The joint farthest outside its limits, None if none is."""
    rows = zip(robot.limits.lower.tolist(), q.tolist(), robot.limits.upper.tolist(), strict=True)
    excess = [max(low - value, value - high) for low, value, high in rows]
    worst = max(excess)
    return excess.index(worst) if worst > 0.0 else None


def _farthest(q: FloatArray, other: FloatArray) -> float:
    """The largest difference of any joint."""
    return float(max([abs(a - b) for a, b in zip(q.tolist(), other.tolist(), strict=True)]))


def _outside_in_words(q: FloatArray, joint: int, robot: Robot) -> str:
    low, high = robot.limits.lower[joint], robot.limits.upper[joint]
    least, most = (bound[joint] for bound in robot.bounds)
    if not least <= q[joint] <= most:  # of a continuous joint these are wider than the window that is planned in
        low, high = least, most
    words = f"{robot.joint_names[joint]} = {outside_text(q[joint], low, high)}{_in_degrees(q, joint, robot)}"
    return words if _out_of_bounds(q, robot) else f"{words}, which is all that a roadmap covers"


def _in_degrees(q: FloatArray, joint: int, robot: Robot) -> str:
    """What to write instead if the values of turning joints are degrees: all of them are within the limits then."""
    lower, upper = robot.bounds
    slides = {body.q_index for body in robot.bodies[1:] if body.prismatic}
    meant = np.array([value if k in slides else np.radians(value) for k, value in enumerate(q.tolist())])
    beyond = max(lower[joint] - q[joint], q[joint] - upper[joint])
    if joint in slides or beyond < DEGREES or not np.all((meant >= lower) & (meant <= upper)):
        return ""
    return f"; if these are degrees, write [{', '.join(f'{value:.4f}' for value in meant.tolist())}]"


def _out_of_bounds(q: FloatArray, robot: Robot) -> bool:
    """Whether the robot can never be at q, however its continuous joints are turned."""
    lower, upper = robot.bounds
    return not np.all((q >= lower) & (q <= upper))


def _clamped(context: PlanContext, q: FloatArray) -> FloatArray:
    robot = context.checker.robot
    joint = _outside(q, robot)
    if joint is None:
        return q
    words = f"start: {_outside_in_words(q, joint, robot)}"
    inside = np.minimum(np.maximum(q, robot.limits.lower), robot.limits.upper)
    if abs(float(inside[joint] - q[joint])) > context.request.start_tolerance:
        proven = _out_of_bounds(q, robot)
        raise NoPlan(Failure(Stage.ENDPOINTS, Reason.START_OUTSIDE_LIMITS, words, proven=proven))
    context.accounting.notes.append(f"{words}; it was clamped to the limit")
    return read_only(inside)


def _note_clamped(context: PlanContext, name: str, stated: FloatArray, goal: FloatArray) -> None:
    """Add a note if a goal is not exactly the requested one."""
    note = clamp_note(name, stated, goal, context.checker.robot)
    if note and not _out_of_bounds(goal, context.checker.robot):
        context.accounting.notes.append(note)


def _configurations(
    context: PlanContext, name: str, given: FloatArray | Pose | PoseGoal, begin: FloatArray
) -> list[FloatArray]:
    """A joint goal itself, or every inverse kinematics solution of a pose, other arms staying as in ``begin``.

    For a pose with tolerances the nearest come first.

    Raises:
        NoPlan: The goal is outside the limits, or the pose has no solution.
    """
    robot = context.checker.robot
    if not isinstance(given, Pose | PoseGoal):
        ways = _ways_round(robot, given, begin)
        if ways:
            return ways
        joint = _outside(given, robot)
        if joint is not None:
            detail = f"{name}: {_outside_in_words(given, joint, robot)}"
            raise NoPlan(
                Failure(Stage.ENDPOINTS, Reason.GOAL_OUTSIDE_LIMITS, detail, proven=_out_of_bounds(given, robot))
            )
        return [given]
    poses = (given,) if isinstance(given, Pose) else given.poses()
    solutions = list[FloatArray]()
    for pose in poses:
        context.checker.ledger.poll()
        found = configurations_at(robot, pose, still=begin)
        solutions += _nearest_turns(robot, found, begin) if any(robot.continuous) else list(found)
    known = None if solutions else solutions_known(robot, given, still=begin)
    if known is not None and len(known):  # the starts have missed them
        solutions += _nearest_turns(robot, known.q, begin) if any(robot.continuous) else list(known.q)
    if not solutions:
        x, y, z = (given if isinstance(given, Pose) else given.pose).position
        tried = "this pose at" if isinstance(given, Pose) else f"any of {len(poses)} poses around"
        detail = f"{name}: the arm cannot reach {tried} ({x:.4f}, {y:.4f}, {z:.4f}) within its joint limits"
        proven = known is not None and known.complete
        raise NoPlan(Failure(Stage.ENDPOINTS, Reason.NO_IK_SOLUTION, detail, proven=proven))
    if isinstance(given, PoseGoal):
        solutions.sort(key=lambda q: joint_distance(begin, q))
    return solutions


def _nearest_turns(robot: Robot, Q: FloatArray, begin: FloatArray) -> list[FloatArray]:
    """Configurations (m, n), each once, continuous joints moved by whole turns to the nearest places to ``begin``."""
    out: list[FloatArray] = []
    for q in Q:
        turns = robot.nearest_turns(q[None], begin)
        near = q + turns
        near = np.where((turns != 0.0) & (np.abs(near - begin) <= SAME_TURN), begin, near)
        if all(_farthest(near, other) > SAME_TURN for other in out):
            out.append(read_only(near))
    return out


def _ways_round(robot: Robot, goal: FloatArray, begin: FloatArray) -> list[FloatArray]:
    """A joint goal the shortest way round, then with each continuous joint the other way, as far as there are limits.

    Nothing for a robot without continuous joints.
    """
    if not any(robot.continuous) or not np.all((goal >= robot.bounds[0]) & (goal <= robot.bounds[1])):
        return []
    (nearest,) = _nearest_turns(robot, goal[None], begin)
    out = [nearest]
    for joint in np.flatnonzero(robot.continuous).tolist():
        if nearest[joint] != begin[joint]:
            other = nearest.copy()
            other[joint] -= math.copysign(TURN, nearest[joint] - begin[joint])
            out.append(read_only(other))
    lower, upper = robot.bounds
    return [q for q in out if _outside(q, robot) is None and np.all((q >= lower) & (q <= upper))]


def _beyond_retreat(context: PlanContext, q: FloatArray) -> tuple[FloatArray, ExemptRetreat | None]:
    """Where planning goes on from q: the end of the fixed way out, if q is a colliding pose that has one."""
    checker = context.checker
    poses = dict(checker.robot.named_poses)
    for retreat in checker.robot.retreats:
        rest = poses[retreat.pose]
        if _farthest(q, rest) > SAME_POSE or checker.state_is_free(q):
            continue
        pairs = checker.parts.labels.links(retreat.pairs)
        if checker.variant(allowed=(*checker.allowed, *pairs)).edge_is_free(rest, retreat.to):
            if q.tolist() != rest.tolist():
                away = f"{_farthest(q, rest):.1e} rad away"
                context.accounting.notes.append(f"taken for the pose {retreat.pose!r}, {away}")
            return retreat.to, retreat
    return q, None


def _fixed_way(context: PlanContext, retreat: ExemptRetreat) -> WayOut:
    """The fixed way out of a named pose."""
    path = JointPath(np.array([context.checker.robot.pose(retreat.pose), retreat.to]))
    pairs = context.checker.parts.labels.links(retreat.pairs)
    return WayOut(path, (ExemptInterval(0.0, path.length, pairs, retreat.reason),))


def _way_out(context: PlanContext, start: FloatArray, failure: Failure) -> WayOut:
    """The proven way out of a start that overlaps by no more than the request allows.

    Raises:
        NoPlan: There is none; the failure says what would help.
    """
    request, accounting = context.request, context.accounting
    kept = () if context.accounting.constraints is None else context.accounting.constraints.constraints
    certifier, overlap = context.certifier.get(), request.start_overlap
    try:
        way = find_way_out(certifier, start, overlap, request.padding, kept, accounting.ledger.charge)
        accounting.require_held("start", way.path.waypoints[-1])
    except NoWayOut as none:
        proven = failure.proven and none.too_deep
        failure = replace(failure, detail=f"{failure.detail}; {none}", proven=proven)
        raise NoPlan(_with_nearest_free(context, failure, start)) from none
    return way


def _padding_at(context: PlanContext, q: FloatArray, name: str) -> float:
    """The widest of a few paddings with which q is free.

    Raises:
        NoPlan: q is in collision without any padding, or nearer to something than can be proven.
    """
    checker, widest = context.checker, context.request.padding
    if checker.variant(padding=widest).state_is_free(q):
        return widest
    if widest == 0.0 or not checker.state_is_free(q):
        raise NoPlan(_in_collision(context, name, q))
    for padding in (*(widest * part for part in LESS_PADDING), MARGIN):
        if checker.variant(padding=padding).state_is_free(q):
            return padding
    gap = float(context.certifier.get().clearances(q[None])[0])  # padding is farther at the corners of a box
    if gap <= MARGIN:
        near = checker.variant(padding=MARGIN)
        what = ", ".join(f"{contact.a} x {contact.b}" for contact in near.contacts(q)[:3])
        detail = f"{name}: {what}: no gap of more than {MARGIN * 1000:g} mm is proven, and a path has to keep one"
        raise NoPlan(Failure(Stage.ENDPOINTS, Reason.NOT_CERTIFIED, detail))
    return 0.0


def _in_collision(context: PlanContext, name: str, q: FloatArray) -> Failure:
    robot, contacts, by_hulls = context.checker.robot, tuple[Contact, ...](), tuple[tuple[str, str], ...]()
    with suppress(CheckBudgetSpent, TimeBoxSpent):  # that it collides is known all the same
        contacts = context.checker.contacts(q)
        by_hulls = touching_by_hulls(context.checker, q, contacts)
    what = ", ".join(str(contact) for contact in contacts[:3]) or "the limits leave no check to say with what"
    detail = f"{name} in collision: {what}"
    for retreat in robot.retreats:
        if _farthest(q, robot.pose(retreat.pose)) <= NEAR_POSE:
            detail += f"; the pose {retreat.pose!r} itself has a way out, to within {SAME_POSE:g} of it"
    if by_hulls:
        hulls = filled_hulls(robot, context.checker.scene, by_hulls)
        detail += f"; only the hulls of {', '.join(f'{a} and {b}' for a, b in by_hulls[:3])} touch"
        detail += f": {how_to_cut(robot, hulls)}"
    reason = Reason.START_IN_COLLISION if name == "start" else Reason.GOAL_IN_COLLISION
    return Failure(Stage.ENDPOINTS, reason, detail, contacts, proven=len(by_hulls) < max(1, len(contacts)))


def _explained(
    context: PlanContext,
    failure: Failure,
    given: FloatArray | Pose | PoseGoal,
    colliding: FloatArray | None,
    begin: FloatArray,
) -> Failure:
    """The failure at the first goal with what would help: the nearest free configuration, or why it is unreachable."""
    if colliding is not None:
        return _with_nearest_free(context, failure, colliding)
    if failure.reason is not Reason.NO_IK_SOLUTION or not isinstance(given, Pose | PoseGoal):
        return failure
    pose, which = (given, "") if isinstance(given, Pose) else (given.pose, "for the one in the middle, ")
    why = why_unreachable(context.checker.robot, pose, seed=context.request.seed, still=begin)
    if why.suggestion is not None and not _can_be_reached(context, why.suggestion.pose, begin):
        why = replace(why, suggestion=None)
    return replace(failure, detail=f"{failure.detail}: {which}{why}", unreachable=why)


def _can_be_reached(context: PlanContext, pose: Pose, begin: FloatArray) -> bool:
    """Whether a configuration for a pose is known to be free."""
    try:
        solutions = inverse_kinematics(context.checker.robot, pose, seed=context.request.seed, still=begin)
        return any(context.checker.state_is_free(q) for q in solutions)
    except (CheckBudgetSpent, TimeBoxSpent) as stopped:
        context.accounting.stopped_by(stopped)
        return False


def _with_nearest_free(context: PlanContext, failure: Failure, q: FloatArray) -> Failure:
    """The same failure with the nearest free configuration found, if the limits leave room to look for one.

    A plan may begin or end there: it keeps ``APART`` from everything, and what else the request asks of an end.
    """
    checker = context.checker.variant(padding=APART)

    def would_do(q: FloatArray) -> bool:
        if not checker.state_is_free(q):
            return False
        with suppress(NoPlan):
            context.accounting.require_end("start", q)
            return True
        return False

    rng = np.random.default_rng([context.request.seed, 2])
    try:
        with context.checker.limited(states=RECOVERY_STATES):
            free = nearest_free(would_do, q, checker.robot.limits, rng)
    except (CheckBudgetSpent, TimeBoxSpent) as stopped:
        context.accounting.stopped_by(stopped)
        free = None
    if free is None:
        return failure
    away = joint_distance(q, free)
    detail = f"{failure.detail}; the nearest free configuration found is {away:.3f} rad away"
    return replace(failure, detail=detail, nearest_free=free)
