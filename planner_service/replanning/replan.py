"""Another motion while one is under way: what ``PlannerService.replan`` runs.

What is left of the old motion is proven in the new scene, and goes on if nothing is in the way and nothing better is
found. Otherwise a new path leaves it, at a place that the robot passes at speed. If there is none, the robot stops
along the old curve; if that cannot be proven either, the result says that nothing is safe.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, product

import numpy as np

from planner_service.certify import Certificate, Certifier, ExemptInterval
from planner_service.collision import CancelToken, CollisionChecker
from planner_service.collision.budget import CheckBudgetSpent, SearchStopped, TimeBoxSpent
from planner_service.concurrency.polling import Prepared
from planner_service.constraints.values import constraint_names
from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.arrays import FloatArray, joint_distance
from planner_service.geometry.shapes import Pose
from planner_service.grasping.guards import reach_objection
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import LimitPeaks, Trajectory
from planner_service.planning.accounting import (
    NoPlan,
    PlanAccounting,
    PlanContext,
    certify,
    motion_report,
    narrower,
    require_proven,
    tool_speed_limit,
    unproven,
)
from planner_service.planning.endpoints import GoalState, find_ends, require_ends
from planner_service.planning.pipeline import plan
from planner_service.planning.request import Goal, Pace, PlanRequest
from planner_service.planning.result import Failure, MotionReport, PlanResult, Reason, Stage
from planner_service.replanning.detour import CandidatePath, Detours
from planner_service.replanning.result import OldMotion, Outcome, Replanned, request_for, underway
from planner_service.replanning.splice import SwitchPoint
from planner_service.scene.names import Names
from planner_service.scene.scene import KIND_SUFFIXES
from planner_service.timing.laws import TimingFailed, ToppRa
from planner_service.timing.limit_check import TOLERANCE, peaks

__all__ = ["replan"]

SHORTER, SOONER = 0.98, 0.97
"""A free old motion is left only for a path that is shorter, and a motion that ends sooner, by these factors."""

MAX_BETTER_PLACES = 4
"""Places to turn off that are tried to improve on a free old motion."""

ENOUGH_MOTIONS, MAX_MOTIONS = 3, 10
"""When the old motion is not free: candidate paths tried when one of them can be driven, and at most."""

SEARCHES = 2
"""Searches from each place."""

BETTER_SHARE = 0.2
"""Part of the states that looking for something better than a free old motion may use."""

GOOD = 1.3
"""A new motion that takes no longer than this many times what is left of the old one is taken at once."""

ROUNDING = 1e-6
"""Share by which a tool may seem too fast, as its peak is known to six digits; metres at which it is at a pose."""


def replan(
    previous: PlanResult | Replanned,
    checker: CollisionChecker,
    certifier: Prepared[Certifier],
    *,
    at_time: float,
    latency: float,
    request: PlanRequest | None = None,
    goal: Goal | None = None,
    cancel: CancelToken | None = None,
) -> Replanned:
    """What to do from the splice on; see ``PlannerService.replan``.

    Raises:
        InvalidRequest: As ``underway`` and ``request_for`` say, a goal is neither a pose nor n finite joint values, or
            what the robot carries has constraints.
    """
    if checker.scene.constraints:
        names = constraint_names(checker.scene.constraints)
        raise InvalidRequest("scene", f"something carried with constraints ({names})", "none: replan keeps none")
    old = underway(previous, checker.robot, at_time, latency)
    new = request_for(previous, old, request, goal)
    goals = require_ends(new, checker.robot)
    most = new.max_checks
    accounting = PlanAccounting(checker, states=most, search_states=most, seconds=new.time_limit, cancel=cancel)
    context = PlanContext(new, goals, checker, certifier, accounting)
    law = _law_of(previous)
    if request is None and law != new.timing.name:
        note = f"a new motion is timed by {new.timing.name}, which can begin at speed, not by {law}"
        context.accounting.notes.append(note)
    call = _Call(context, old, cancel)
    try:
        motion = context.accounting.within_limits(lambda: _before_rest(call))
        return _from_rest(call) if motion is None else motion
    except NoPlan as no_plan:
        failure = no_plan.failure
    return _stopping(call, failure)  # without limits: a robot under way waits for nobody, and a stop is cheap


def _law_of(previous: PlanResult | Replanned) -> str:
    """The name of the timing law of the motion before, as far as it is known."""
    origin = previous.origin if isinstance(previous, PlanResult) else None
    source = None if origin is None else origin.request or origin.pace
    return ToppRa.name if source is None else source.timing.name


def _unchanged_owners(old: OldMotion, certifier: Prepared[Certifier]) -> set[str]:
    """Names of what is as it was when the old motion was planned: contact was meant with an object in its place."""
    before = old.made_in
    if before is None or not old.exempt:
        return set()
    proving = certifier.get()
    now = proving.scene
    held = {*before.attached} ^ {*now.attached}
    changed = {item.name for item in {*before.obstacles} ^ {*now.obstacles}} | {item.name for item in held}
    of_objects = KIND_SUFFIXES[1]
    return {owner for owner in proving.listed.owners if owner.removesuffix(of_objects) not in changed}


@dataclass(frozen=True, eq=False)
class _DoubtfulContact:
    """Pairs that were meant to touch on a stretch of the old motion, and have since changed."""

    stretch: ExemptInterval
    pairs: tuple[tuple[str, str], ...]


class _Call:
    """What the stages of one call share. ``exempt`` grows by contacts in doubt that are meant still; all else stays."""

    def __init__(self, context: PlanContext, old: OldMotion, cancel: CancelToken | None) -> None:
        self.context, self.old, self.motion, self.cancel = context, old, old.underway, cancel
        self.checker, self.certifier, self.request = context.checker, context.certifier, context.request
        self.accounting = context.accounting
        unchanged = _unchanged_owners(old, self.certifier)
        self.exempt = list[ExemptInterval]()
        self.doubtful = list[_DoubtfulContact]()
        for stretch in old.exempt:
            doubtful = tuple(pair for pair in stretch.pairs if not unchanged.issuperset(pair))
            sure = tuple(pair for pair in stretch.pairs if pair not in doubtful)
            self.exempt += [replace(stretch, pairs=sure)] if sure else []
            self.doubtful += [_DoubtfulContact(stretch, doubtful)] if doubtful else []
        self.pace = Pace.of(self.request)
        self.limits = self.pace.limits(self.checker.robot)
        self.detours = Detours(context, self.motion.path, old.ahead)

    @property
    def s_now(self) -> float:
        """Where the robot is, on what is left of the old path."""
        return self.motion.s(self.motion.now)

    @cached_property
    def timing(self) -> ToppRa:
        """The law of a new motion."""
        timing = self.request.timing
        if not isinstance(timing, ToppRa):
            raise BrokenInvariant("a timing law that was refused is used")
        return timing


@dataclass(frozen=True, eq=False)
class _ProvenMotion:
    """A proven motion from the splice on."""

    path: JointPath
    trajectory: Trajectory
    certificate: Certificate
    report: MotionReport
    padding: float = 0.0

    @property
    def stops(self) -> int:
        """How many corners it stops at before its end."""
        s = self.path.knots[list(self.path.corners)]
        return int(((s > self.trajectory.begin) & (s < self.trajectory.end)).sum())


def _before_rest(call: _Call) -> Replanned | None:
    """What to do before the old motion rests; None if it does, its last stretch being proven.

    Raises:
        NoPlan: there is nothing to do, or what is left cannot be proven.
    """
    _confirm_contacts(call)
    if not call.motion.rests:
        return _going_on(call)
    if call.s_now < call.motion.end:
        require_proven(_certify(call, call.motion.path, call.motion.end, call.exempt))
    return None


# Contacts: which of them are still meant.


def _confirm_contacts(call: _Call) -> None:
    """Contact in doubt stays meant where ``pick`` would mean it now; else it lapses."""
    for contact in call.doubtful:
        with call.accounting.during(Stage.ENDPOINTS):
            objection = _objection(call, contact)
        if objection:
            pairs = sorted(contact.pairs)
            notes = [f"{a} x {b} may no longer touch: {objection}" for a, b in pairs]
        else:
            notes = [f"{a} x {b} may still touch: the grasp is sound where it stands now" for a, b in contact.pairs]
            call.exempt.append(replace(contact.stretch, pairs=contact.pairs))
        call.accounting.notes.extend(notes)


def _objection(call: _Call, contact: _DoubtfulContact) -> str:
    """Why pairs may not touch any more; empty if they are fingers and what they still take at the path's end."""
    robot, now, before, path = call.checker.robot, call.checker.scene, call.old.made_in, call.motion.path
    names = Names(robot, now)
    fingers = {names.link(link) for link in (() if robot.gripper is None else robot.gripper.links)}
    objects_before = {} if before is None else {item.name: item for item in before.obstacles}
    others = {name for pair in contact.pairs for name in pair} - fingers
    targets = [item for item in now.obstacles if names.object(item.name) in others]
    was = objects_before.get(targets[0].name) if len(others) == len(targets) == 1 else None
    taken = call.old.arrives and contact.stretch.s_end >= path.length
    if was is None or was.shape != targets[0].shape or not taken:
        return "one of them is not as it was"
    begin = max(contact.stretch.s_start, call.s_now)
    return reach_objection(call.checker, path, begin, targets[0], contact.pairs, before=was)


# What to do: a plan from rest, the old motion, or a new one.


def _from_rest(call: _Call) -> Replanned:
    """A plan from where the old motion has ended when the new one begins.

    Raises:
        NoPlan: there is none.
    """
    from_rest = plan(call.request, call.checker, call.certifier, cancel=call.cancel)
    result = call.accounting.with_plan(from_rest)
    if from_rest.failure is not None:
        raise NoPlan(from_rest.failure)
    outcome = Outcome.NEW if from_rest.path is not None and from_rest.path.length > 0.0 else Outcome.KEPT
    return Replanned(outcome, result, call.old.splice, call.request, None, call.old.ahead[:0])


def _going_on(call: _Call) -> Replanned:
    """The old motion, or a new one.

    Raises:
        NoPlan: there is none.
    """
    kept = _kept(call)
    try:
        goals = _goals(call)
    except (NoPlan, CheckBudgetSpent, TimeBoxSpent) as stopped:
        if kept is None or not _is_goal(call, call.old.end):
            raise
        return _keep(call, kept, stopped)
    end = call.old.end.tolist()
    same = next((goal for goal in goals if goal.q.tolist() == end), None)
    if kept is None or same is None:
        return _new(call, goals[0] if same is None else same)
    try:
        with call.checker.limited(states=max(1, int(call.request.max_checks * BETTER_SHARE))):
            better = _improved(call, kept, same)
    except (NoPlan, CheckBudgetSpent, TimeBoxSpent) as stopped:
        return _keep(call, kept, stopped)
    return better or _replanned(call, Outcome.KEPT, kept, same.index)


def _keep(call: _Call, kept: _ProvenMotion, stopped: NoPlan | SearchStopped) -> Replanned:
    """The old motion, since nothing better was found."""
    call.accounting.deterministic &= not isinstance(stopped, TimeBoxSpent)
    call.accounting.notes.append(f"the old motion goes on: {stopped}")
    return _replanned(call, Outcome.KEPT, kept, None)


def _is_goal(call: _Call, q: FloatArray) -> bool:
    """Whether a configuration is one of the goals, or has the tool at one."""
    goals = call.request.goals(call.checker.robot)
    tool = call.checker.robot.tool_pose(q)
    return any(
        np.abs(tool - goal.matrix).max() <= ROUNDING
        if isinstance(goal, Pose)
        else not isinstance(goal, PoseGoal) and goal.tolist() == q.tolist()
        for goal in goals
    )


def _goals(call: _Call) -> tuple[GoalState, ...]:
    """Free goals, the nearest to the old one first.

    Raises:
        NoPlan: there is none, or the robot touches something at the splice.
    """
    ends = find_ends(replace(call.context, request=replace(call.request, start_overlap=0.0)))  # it is moving there
    goals = [goal for goal in ends.goals if goal.arrival is None]
    if ends.departure is not None or not goals:
        detail = "a fixed way out of a pose, or into one, cannot be entered at speed: plan it from a stop"
        raise NoPlan(Failure(Stage.ENDPOINTS, Reason.PLANNING_FAILED, detail))
    return tuple(sorted(goals, key=lambda goal: joint_distance(call.old.end.tolist(), goal.q.tolist())))


def _kept(call: _Call) -> _ProvenMotion | None:
    """The rest of the old motion, if it goes to its end, is proven, and keeps the pace now requested."""
    if not call.old.arrives:
        return None
    path = call.motion.path
    certificate = _certify(call, path, call.motion.end, call.exempt)
    if not certificate.certified:
        return None
    trajectory = call.motion.rest()
    try:
        with call.accounting.during(Stage.TIMING):
            return _ProvenMotion(path, trajectory, certificate, _slow_enough(call, _report(call, trajectory)))
    except NoPlan as too_fast:
        call.accounting.notes.append(f"the old motion is left: {too_fast}")
        return None


def _improved(call: _Call, kept: _ProvenMotion, goal: GoalState) -> Replanned | None:
    """A motion that keeps more from things than the old one, or ends sooner; None if there is none."""
    switch = next(call.motion.switch_points(), None)
    if switch is None:
        return None
    failures: list[NoPlan] = []
    places = call.detours.places(switch, call.motion.stop_from(switch, call.limits), goal.q, beyond=False)
    for place in islice(places, MAX_BETTER_PLACES):
        if not place.s < call.motion.end:
            break
        candidate = call.detours.candidate(switch, place, goal)
        if candidate is None:
            continue
        shorter = candidate.path.length - candidate.s <= SHORTER * (call.motion.end - candidate.s)
        if not candidate.searched and not shorter:
            if candidate.roomy:
                break
            continue
        try:
            motion = _proven(call, candidate)
        except NoPlan as no_plan:
            failures.append(no_plan)
            continue
        sooner = motion.trajectory.duration <= SOONER * kept.trajectory.duration
        if motion.stops <= kept.stops and (candidate.searched or sooner):
            return _replanned(call, Outcome.NEW, motion, goal.index)
    if failures:
        call.accounting.notes.append(f"no better motion: {failures[0]}")
    return None


def _new(call: _Call, goal: GoalState) -> Replanned:
    """Of the first few candidates that can be driven and proven the one with the fewest stops, then the quickest.

    Raises:
        NoPlan: There is none; the reason is that of the first.
    """
    failures: list[NoPlan] = []
    motions: list[_ProvenMotion] = []
    left = call.motion.trajectory.duration - call.motion.splice
    try:
        for tries, candidate in enumerate(_candidates(call, goal, failures), start=1):
            try:
                motions.append(_proven(call, candidate))
            except NoPlan as no_plan:
                failures.append(no_plan)
            good = bool(motions) and not motions[-1].stops and motions[-1].trajectory.duration <= GOOD * left
            if good or tries >= (ENOUGH_MOTIONS if motions else MAX_MOTIONS):
                break
    except CheckBudgetSpent:
        if not motions:
            raise
    if motions:
        best = min(motions, key=lambda motion: (motion.stops, motion.trajectory.duration))
        return _replanned(call, Outcome.NEW, best, goal.index)
    if failures:
        raise failures[0]
    detail = "the robot cannot turn off before what is in the way"
    raise NoPlan(Failure(Stage.STRAIGHT_LINE, Reason.LINE_BLOCKED, detail))


# New motions: proven, and in time.


def _candidates(call: _Call, goal: GoalState, failures: list[NoPlan]) -> Iterator[CandidatePath]:
    """Paths to try, one after the other, as far as the old path can be proven up to where they leave its law."""
    switches: list[SwitchPoint] = []
    for switch in call.motion.switch_points():
        certificate = _certify(call, call.motion.path, switch.s, call.exempt)
        if not certificate.certified:
            failures.append(unproven(certificate))
            break
        switches.append(switch)
    for turn, switch in product(range(SEARCHES), switches):
        for place in call.detours.places(switch, call.motion.stop_from(switch, call.limits), goal.q):
            try:
                candidate = call.detours.candidate(switch, place, goal, turn)
            except NoPlan as no_plan:
                failures.append(no_plan)
            else:
                if candidate is not None and (candidate.searched or turn == 0):
                    yield candidate


def _proven(call: _Call, candidate: CandidatePath) -> _ProvenMotion:
    """A candidate proven, and in time from the splice on.

    Raises:
        NoPlan: It cannot be proven, or not be entered as fast as the robot comes along.
    """
    path = candidate.path
    exempt = tuple(e for e in call.exempt if e.s_end <= candidate.s)
    while True:
        certificate = _certify(call, path, path.length, exempt)
        if certificate.refusal is None:
            break
        less = narrower(path, certificate.refusal, candidate.leaves)
        if less is None:
            raise unproven(certificate)
        path = less
    speed_limit = tool_speed_limit(path, call.pace, call.checker.robot)
    with call.accounting.during(Stage.TIMING) as entry:
        try:
            trajectory, ratios = call.motion.onward(
                path, candidate.switch, call.timing, call.limits, speed_limit=speed_limit
            )
        except TimingFailed as failed:
            raise NoPlan(Failure(Stage.TIMING, Reason.TIMING_FAILED, str(failed))) from failed
        entry.note, entry.length = f"{call.timing.name}, {trajectory.duration:.2f} s", path.length
        report = _slow_enough(call, _report(call, trajectory, ratios))
        return _ProvenMotion(path, trajectory, certificate, report, candidate.padding)


def _certify(call: _Call, path: JointPath, s_end: float, exempt: Sequence[ExemptInterval]) -> Certificate:
    """What can be proven of a path from where the robot is to ``s_end``."""
    part = call.s_now, s_end
    return certify(path, call.certifier.get(), call.accounting, exempt, part=part)


def _report(call: _Call, trajectory: Trajectory, ratios: LimitPeaks | None = None) -> MotionReport:
    """How a motion moves, its peaks compared with the requested limits."""
    return motion_report(call.checker.robot, trajectory, ratios or peaks(trajectory, call.limits), math.inf)


def _slow_enough(call: _Call, report: MotionReport) -> MotionReport:
    """The report of a motion within the requested limits, whose tool is no faster than it may be.

    Raises:
        NoPlan: it exceeds them, or its tool is faster.
    """
    if report.peaks.highest > 1.0 + 2.0 * TOLERANCE:  # one for that with which it was made
        detail = f"it would exceed limits by {report.peaks.highest - 1.0:.2%}"
        raise NoPlan(Failure(Stage.TIMING, Reason.TIMING_FAILED, detail))
    most = call.pace.max_tool_speed
    if most is not None and report.tool_speed > most * (1.0 + ROUNDING):
        detail = f"the tool would move at {report.tool_speed:.6g} m/s, faster than {most:.6g}"
        raise NoPlan(Failure(Stage.TIMING, Reason.TIMING_FAILED, detail))
    return report


# A stop, and the result.


def _stopping(call: _Call, failure: Failure) -> Replanned:
    """The quickest stop along the old curve, if it can be proven."""
    for stop in _stops(call):
        exempt = tuple(e for e in call.exempt if e.s_start <= stop.path.length)
        exempt = tuple(replace(e, s_end=min(e.s_end, stop.path.length)) for e in exempt)
        certificate = _certify(call, stop.path, stop.end, exempt)
        if certificate.certified:
            call.accounting.notes.append(f"a stop along the old curve: {failure}")
            motion = _ProvenMotion(stop.path, stop, certificate, _report(call, stop))
            return _replanned(call, Outcome.STOP, motion, None, failure)
    detail = (
        f"nothing is safe: the earliest stop along the old curve ends {stop.duration:.3f} s after the splice at "
        f"s = {stop.end:.4g}, and {certificate.refusal}; no new motion: {failure}"
    )
    unsafe = Failure(Stage.CERTIFY, Reason.NOT_CERTIFIED, detail)
    result = call.accounting.result(failure=unsafe, certificate=certificate)
    return Replanned(Outcome.UNSAFE, result, call.old.splice, call.request, failure, _ahead(call, stop), stop)


def _stops(call: _Call) -> Iterator[Trajectory]:
    """Stops along the old curve: the quickest within the requested limits; then, where these are parts of the robot's,
    within the robot's own, since a robot that is faster than requested cannot stop within the requested limits.
    """
    whole = replace(call.pace, velocity_scale=1.0, acceleration_scale=1.0)
    for pace in dict.fromkeys((call.pace, whole)):
        limits = pace.limits(call.checker.robot)
        with call.accounting.during(Stage.TIMING):
            stop = call.motion.braked(limits)
        if pace == whole or peaks(stop, limits).highest <= 1.0 + TOLERANCE:
            yield stop


def _replanned(
    call: _Call, outcome: Outcome, motion: _ProvenMotion, goal_index: int | None, failure: Failure | None = None
) -> Replanned:
    if motion.report.peaks.highest > 1.0 + 2.0 * TOLERANCE:
        velocity, acceleration = motion.report.peaks.velocity, motion.report.peaks.acceleration
        parts = f"velocity {velocity.ratio:.0%}, acceleration {acceleration.ratio:.0%}"
        call.accounting.notes.append(f"beyond the limits asked: {parts} of them")
    asked = call.request.padding
    kept = call.accounting.padding = max(motion.padding, min(asked, motion.certificate.clearance))
    if outcome is Outcome.NEW and kept < asked:
        call.accounting.notes.append(
            f"{1e3 * kept:.2f} mm are kept all along, less than the padding of {1e3 * asked:g} mm"
        )
    result = call.accounting.result(
        motion.path, motion.trajectory, motion.report, goal_index=goal_index, certificate=motion.certificate
    )
    ahead = _ahead(call, motion.trajectory) if outcome is Outcome.STOP else call.old.ahead[:0]
    return Replanned(outcome, result, call.old.splice, call.request, failure, ahead)


def _ahead(call: _Call, stop: Trajectory) -> FloatArray:
    """The old waypoints beyond the path of a stop."""
    return np.concatenate([call.motion.path.waypoints[len(stop.path.waypoints) :], call.old.ahead])
