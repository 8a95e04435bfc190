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
from planner_service.concurrency.fair_lock import FairLock
from planner_service.concurrency.polling import Prepared
from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.grasping.guards import reach_objection
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.planning.accounting import (
    Limits,
    NoPlan,
    PlanAccounting,
    PlanContext,
    certify,
    narrower,
    not_certified,
)
from planner_service.planning.endpoints import GoalState, find_ends, require_ends
from planner_service.planning.pipeline import plan
from planner_service.planning.request import Goal, Pace, PlanRequest
from planner_service.planning.result import Failure, MotionReport, PlanResult, Reason, Stage
from planner_service.planning.timing_stage import peak_tool_speed, tool_speed_limit
from planner_service.replanning.detour import CandidatePath, Detours
from planner_service.replanning.result import OldMotion, Outcome, Replanned, request_for, underway
from planner_service.replanning.splice import SwitchPoint
from planner_service.scene.names import Names
from planner_service.scene.scene import KIND_SUFFIXES
from planner_service.search.problem import joint_distance
from planner_service.timing.laws import TimingFailed, ToppRa
from planner_service.timing.limit_check import TOLERANCE, LimitPeaks, peaks

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
    turns: FairLock,
    *,
    at_time: float,
    latency: float,
    request: PlanRequest | None = None,
    goal: Goal | None = None,
    cancel: CancelToken | None = None,
) -> Replanned:
    """What to do from the splice on; see ``PlannerService.replan``.

    Raises:
        InvalidRequest: As ``underway`` and ``request_for`` say, or a goal is neither a pose nor n finite joint values.
    """
    old = underway(previous, checker.robot, at_time, latency)
    asked = request_for(previous, old, request, goal)
    require_ends(asked, checker.robot)
    limits = Limits(asked.max_checks, asked.max_checks, asked.time_limit, cancel)
    context = PlanContext(asked, checker, certifier, PlanAccounting(checker, limits))
    law = _law_of(previous)
    if request is None and law != asked.timing.name:
        note = f"a new motion is timed by {asked.timing.name}, which can begin at speed, not by {law}"
        context.accounting.notes.append(note)
    return _Replanning(context, old, cancel).result(turns)


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
    """Pairs that were meant to touch on a stretch of the old motion, and of which something has changed."""

    stretch: ExemptInterval
    pairs: tuple[tuple[str, str], ...]


class _Replanning:
    """One call. ``_exempt`` grows when contacts that were in doubt turn out to be meant still; all else stays."""

    def __init__(self, context: PlanContext, old: OldMotion, cancel: CancelToken | None) -> None:
        self._context, self._old, self._motion, self._cancel = context, old, old.underway, cancel
        self._checker, self._certifier, self._request = context.checker, context.certifier, context.request
        self._accounting = context.accounting
        unchanged = _unchanged_owners(old, self._certifier)
        self._exempt = list[ExemptInterval]()
        self._doubtful = list[_DoubtfulContact]()
        for stretch in old.exempt:
            doubtful = tuple(pair for pair in stretch.pairs if not unchanged.issuperset(pair))
            sure = tuple(pair for pair in stretch.pairs if pair not in doubtful)
            self._exempt += [replace(stretch, pairs=sure)] if sure else []
            self._doubtful += [_DoubtfulContact(stretch, doubtful)] if doubtful else []
        self._pace = Pace.of(self._request)
        self._limits = self._pace.limits(self._checker.robot)
        self._detours = Detours(context, self._motion.path, old.ahead)

    def result(self, turns: FairLock) -> Replanned:
        """Look for a motion within the limits of the request; a stop, which is cheap, whatever they are."""
        try:
            going_on = self._accounting.within_limits(turns, self._under_way)
            return self._from_rest(turns) if going_on is None else going_on
        except NoPlan as no_plan:
            failure = no_plan.failure
        with self._accounting.apart():  # a robot under way waits for nobody
            return self._stopping(failure)

    def _under_way(self) -> Replanned | None:
        """What to do before the old motion rests; None if it does, its last stretch being proven.

        Raises:
            NoPlan: there is nothing to do, or what is left cannot be proven.
        """
        self._confirm_contacts()
        if not self._motion.rests:
            return self._going_on()
        self._prove_last_stretch()
        return None

    def _confirm_contacts(self) -> None:
        """Contact in doubt stays meant where ``pick`` would mean it now; else it lapses."""
        for contact in self._doubtful:
            with self._accounting.during(Stage.ENDPOINTS):
                objection = self._objection(contact)
            if objection:
                pairs = sorted(contact.pairs)
                notes = [f"{a} x {b} may no longer touch: {objection}" for a, b in pairs]
            else:
                notes = [f"{a} x {b} may still touch: the grasp is sound where it stands now" for a, b in contact.pairs]
                self._exempt.append(replace(contact.stretch, pairs=contact.pairs))
            self._accounting.notes.extend(notes)

    def _objection(self, contact: _DoubtfulContact) -> str:
        """Why pairs may not touch any more; empty if they are fingers and what they still take at the path's end."""
        robot, now, before, path = self._checker.robot, self._checker.scene, self._old.made_in, self._motion.path
        names = Names(robot, now)
        fingers = {names.link(link) for link in (() if robot.gripper is None else robot.gripper.links)}
        objects_before = {} if before is None else {item.name: item for item in before.obstacles}
        others = {name for pair in contact.pairs for name in pair} - fingers
        targets = [item for item in now.obstacles if names.object(item.name) in others]
        was = objects_before.get(targets[0].name) if len(others) == len(targets) == 1 else None
        taken = self._old.arrives and contact.stretch.s_end >= path.length
        if was is None or was.shape != targets[0].shape or not taken:
            return "one of them is not as it was"
        begin = max(contact.stretch.s_start, self._s_now)
        return reach_objection(self._checker, path, begin, targets[0], contact.pairs, before=was)

    @property
    def _s_now(self) -> float:
        """Where the robot is, on what is left of the old path."""
        return self._motion.s(self._motion.now)

    def _certify(self, path: JointPath, s_end: float, exempt: Sequence[ExemptInterval]) -> Certificate:
        """What can be proven of a path from where the robot is to ``s_end``."""
        part = self._s_now, s_end
        return certify(path, self._certifier.get(), self._accounting, exempt, part=part)

    def _prove_last_stretch(self) -> None:
        """What is left until the old motion rests.

        Raises:
            NoPlan: it cannot be proven.
        """
        if self._s_now < self._motion.end:
            certificate = self._certify(self._motion.path, self._motion.end, self._exempt)
            if not certificate.certified:
                raise NoPlan(not_certified(certificate), certificate)

    def _from_rest(self, turns: FairLock) -> Replanned:
        """A plan from where the old motion has ended when the new one begins.

        Raises:
            NoPlan: there is none.
        """
        from_rest = plan(self._request, self._checker, self._certifier, turns, cancel=self._cancel)
        result = self._accounting.with_plan(from_rest)
        if from_rest.failure is not None:
            raise NoPlan(from_rest.failure)
        outcome = Outcome.NEW if from_rest.path is not None and from_rest.path.length > 0.0 else Outcome.KEPT
        return Replanned(outcome, result, self._old.splice, self._request, None, self._old.ahead[:0])

    def _going_on(self) -> Replanned:
        """The old motion, or a new one.

        Raises:
            NoPlan: there is none.
        """
        kept = self._kept()
        try:
            goals = self._goals()
        except (NoPlan, CheckBudgetSpent, TimeBoxSpent) as stopped:
            if kept is None or not self._is_goal(self._old.end):
                raise
            return self._keep(kept, stopped)
        end = self._old.end.tolist()
        same = next((goal for goal in goals if goal.q.tolist() == end), None)
        if kept is None or same is None:
            return self._new(goals[0] if same is None else same)
        try:
            with self._checker.limited(states=max(1, int(self._request.max_checks * BETTER_SHARE))):
                better = self._improved(kept, same)
        except (NoPlan, CheckBudgetSpent, TimeBoxSpent) as stopped:
            return self._keep(kept, stopped)
        return better or self._replanned(Outcome.KEPT, kept, same.index)

    def _keep(self, kept: _ProvenMotion, stopped: NoPlan | SearchStopped) -> Replanned:
        """The old motion, since nothing better was found."""
        self._accounting.deterministic &= not isinstance(stopped, TimeBoxSpent)
        self._accounting.notes.append(f"the old motion goes on: {stopped}")
        return self._replanned(Outcome.KEPT, kept, None)

    def _is_goal(self, q: FloatArray) -> bool:
        """Whether a configuration is one of the goals, or has the tool at one."""
        goals = self._request.goals(self._checker.robot)
        tool = self._checker.robot.tool_pose(q)
        return any(
            np.abs(tool - goal.matrix).max() <= ROUNDING
            if isinstance(goal, Pose)
            else not isinstance(goal, PoseGoal) and goal.tolist() == q.tolist()
            for goal in goals
        )

    def _goals(self) -> tuple[GoalState, ...]:
        """Free goals, the nearest to the old one first.

        Raises:
            NoPlan: there is none, or the robot touches something at the splice.
        """
        ends = find_ends(self._context)
        goals = [goal for goal in ends.goals if goal.arrival is None]
        if ends.departure is not None or not goals:
            detail = "a fixed way out of a pose, or into one, cannot be entered at speed: plan it from a stop"
            raise NoPlan(Failure(Stage.ENDPOINTS, Reason.PLANNING_FAILED, detail))
        return tuple(sorted(goals, key=lambda goal: joint_distance(self._old.end.tolist(), goal.q.tolist())))

    def _kept(self) -> _ProvenMotion | None:
        """What is left of the old motion, if it goes to its end, is proven, and as slow as is asked now."""
        if not self._old.arrives:
            return None
        path = self._motion.path
        certificate = self._certify(path, self._motion.end, self._exempt)
        if not certificate.certified:
            return None
        trajectory = self._motion.rest()
        try:
            with self._accounting.during(Stage.TIMING):
                return _ProvenMotion(path, trajectory, certificate, self._slow_enough(self._report(trajectory)))
        except NoPlan as too_fast:
            self._accounting.notes.append(f"the old motion is left: {too_fast}")
            return None

    def _improved(self, kept: _ProvenMotion, goal: GoalState) -> Replanned | None:
        """A motion that keeps more from things than the old one, or ends sooner; None if there is none."""
        switch = next(self._motion.switch_points(), None)
        if switch is None:
            return None
        failures: list[NoPlan] = []
        places = self._detours.places(switch, self._stop_from(switch), goal.q, beyond=False)
        for place in islice(places, MAX_BETTER_PLACES):
            if not place.s < self._motion.end:
                break
            candidate = self._detours.candidate(switch, place, goal)
            if candidate is None:
                continue
            shorter = candidate.path.length - candidate.s <= SHORTER * (self._motion.end - candidate.s)
            if not candidate.searched and not shorter:
                if candidate.roomy:
                    break
                continue
            try:
                motion = self._proven(candidate)
            except NoPlan as no_plan:
                failures.append(no_plan)
                continue
            sooner = motion.trajectory.duration <= SOONER * kept.trajectory.duration
            if motion.stops <= kept.stops and (candidate.searched or sooner):
                return self._replanned(Outcome.NEW, motion, goal.index)
        if failures:
            self._accounting.notes.append(f"no better motion: {failures[0]}")
        return None

    def _new(self, goal: GoalState) -> Replanned:
        """Of the first few candidates that can be driven and proven the one with the fewest stops, then the quickest.

        Raises:
            NoPlan: There is none; the reason is that of the first.
        """
        failures: list[NoPlan] = []
        motions: list[_ProvenMotion] = []
        try:
            self._collect(self._candidates(goal, failures), motions, failures)
        except CheckBudgetSpent:
            if not motions:
                raise
        if motions:
            best = min(motions, key=lambda motion: (motion.stops, motion.trajectory.duration))
            return self._replanned(Outcome.NEW, best, goal.index)
        if failures:
            raise failures[0]
        detail = "the robot cannot turn off before what is in the way"
        raise NoPlan(Failure(Stage.STRAIGHT_LINE, Reason.LINE_BLOCKED, detail))

    def _collect(
        self, candidates: Iterator[CandidatePath], motions: list[_ProvenMotion], failures: list[NoPlan]
    ) -> None:
        """Add motions along candidates until there are enough, or a good one; a limit leaves those that were added."""
        left = self._motion.trajectory.duration - self._motion.splice
        for tries, candidate in enumerate(candidates, start=1):
            try:
                motions.append(self._proven(candidate))
            except NoPlan as no_plan:
                failures.append(no_plan)
            good = bool(motions) and not motions[-1].stops and motions[-1].trajectory.duration <= GOOD * left
            if good or tries >= (ENOUGH_MOTIONS if motions else MAX_MOTIONS):
                break

    def _candidates(self, goal: GoalState, failures: list[NoPlan]) -> Iterator[CandidatePath]:
        """Paths to try, one after the other, as far as the old path can be proven up to where they leave its law."""
        switches: list[SwitchPoint] = []
        for switch in self._motion.switch_points():
            certificate = self._certify(self._motion.path, switch.s, self._exempt)
            if not certificate.certified:
                failures.append(NoPlan(not_certified(certificate), certificate))
                break
            switches.append(switch)
        for turn, switch in product(range(SEARCHES), switches):
            for place in self._detours.places(switch, self._stop_from(switch), goal.q):
                try:
                    candidate = self._detours.candidate(switch, place, goal, turn)
                except NoPlan as no_plan:
                    failures.append(no_plan)
                else:
                    if candidate is not None and (candidate.searched or turn == 0):
                        yield candidate

    def _proven(self, candidate: CandidatePath) -> _ProvenMotion:
        """A candidate proven, and in time from the splice on.

        Raises:
            NoPlan: It cannot be proven, or not be entered as fast as the robot comes along.
        """
        path = candidate.path
        exempt = tuple(e for e in self._exempt if e.s_end <= candidate.s)
        while True:
            certificate = self._certify(path, path.length, exempt)
            if certificate.refusal is None:
                break
            less = narrower(path, certificate.refusal, candidate.leaves)
            if less is None:
                raise NoPlan(not_certified(certificate), certificate)
            path = less
        speed_limit = tool_speed_limit(path, self._pace, self._checker.robot)
        with self._accounting.during(Stage.TIMING) as entry:
            try:
                trajectory, ratios = self._motion.onward(
                    path, candidate.switch, self._timing, self._limits, speed_limit=speed_limit
                )
            except TimingFailed as failed:
                raise NoPlan(Failure(Stage.TIMING, Reason.TIMING_FAILED, str(failed))) from failed
            entry.note, entry.length = f"{self._timing.name}, {trajectory.duration:.2f} s", path.length
            report = self._slow_enough(self._report(trajectory, ratios))
            return _ProvenMotion(path, trajectory, certificate, report)

    @cached_property
    def _timing(self) -> ToppRa:
        timing = self._request.timing
        if not isinstance(timing, ToppRa):
            raise BrokenInvariant("a timing law that was refused is used")
        return timing

    def _stops(self) -> Iterator[Trajectory]:
        """Stops along the old curve: the quickest within the limits asked; then, where these are parts of the robot's,
        within the robot's own, for a robot that is faster than asked cannot stop within what is asked.
        """
        whole = replace(self._pace, velocity_scale=1.0, acceleration_scale=1.0)
        for pace in dict.fromkeys((self._pace, whole)):
            limits = pace.limits(self._checker.robot)
            with self._accounting.during(Stage.TIMING):
                stop = self._motion.braked(limits)
            if pace == whole or peaks(stop, limits).highest <= 1.0 + TOLERANCE:
                yield stop

    def _stop_from(self, switch: SwitchPoint) -> float:
        return self._motion.stop_from(switch, self._limits)

    def _report(self, trajectory: Trajectory, ratios: LimitPeaks | None = None) -> MotionReport:
        """How a motion moves, its peaks compared with the limits asked for."""
        robot, ratios = self._checker.robot, ratios or peaks(trajectory, self._limits)
        settle = robot.settle_time if trajectory.duration > 0.0 else 0.0
        return MotionReport(ratios, peak_tool_speed(robot, trajectory), trajectory.duration, math.inf, settle)

    def _slow_enough(self, report: MotionReport) -> MotionReport:
        """The report of a motion within the limits asked, whose tool is no faster than it may be.

        Raises:
            NoPlan: it exceeds them, or its tool is faster.
        """
        if report.peaks.highest > 1.0 + 2.0 * TOLERANCE:  # one for that with which it was made
            detail = f"it would exceed limits by {report.peaks.highest - 1.0:.2%}"
            raise NoPlan(Failure(Stage.TIMING, Reason.TIMING_FAILED, detail))
        speed, most = report.tool_speed, self._pace.max_tool_speed
        if most is not None and speed > most * (1.0 + ROUNDING):
            detail = f"the tool would move at {speed:.6g} m/s, faster than {most:.6g}"
            raise NoPlan(Failure(Stage.TIMING, Reason.TIMING_FAILED, detail))
        return report

    def _stopping(self, failure: Failure) -> Replanned:
        """The quickest stop along the old curve, if it can be proven."""
        for stop in self._stops():
            exempt = tuple(e for e in self._exempt if e.s_start <= stop.path.length)
            exempt = tuple(replace(e, s_end=min(e.s_end, stop.path.length)) for e in exempt)
            certificate = self._certify(stop.path, stop.end, exempt)
            if certificate.certified:
                self._accounting.notes.append(f"a stop along the old curve: {failure}")
                motion = _ProvenMotion(stop.path, stop, certificate, self._report(stop))
                return self._replanned(Outcome.STOP, motion, None, failure)
        detail = (
            f"nothing is safe: the earliest stop along the old curve ends {stop.duration:.3f} s after the splice at "
            f"s = {stop.end:.4g}, and {certificate.refusal}; no new motion: {failure}"
        )
        unsafe = Failure(Stage.CERTIFY, Reason.NOT_CERTIFIED, detail)
        result = self._accounting.result(failure=unsafe, certificate=certificate)
        return Replanned(Outcome.UNSAFE, result, self._old.splice, self._request, failure, self._ahead(stop), stop)

    def _replanned(
        self, outcome: Outcome, motion: _ProvenMotion, goal_index: int | None, failure: Failure | None = None
    ) -> Replanned:
        if motion.report.peaks.highest > 1.0 + 2.0 * TOLERANCE:
            velocity, acceleration = motion.report.peaks.velocity, motion.report.peaks.acceleration
            parts = f"velocity {velocity.ratio:.0%}, acceleration {acceleration.ratio:.0%}"
            self._accounting.notes.append(f"beyond the limits asked: {parts} of them")
        result = self._accounting.result(
            motion.path, motion.trajectory, motion.report, goal_index=goal_index, certificate=motion.certificate
        )
        ahead = self._ahead(motion.trajectory) if outcome is Outcome.STOP else self._old.ahead[:0]
        return Replanned(outcome, result, self._old.splice, self._request, failure, ahead)

    def _ahead(self, stop: Trajectory) -> FloatArray:
        """The old waypoints beyond the path of a stop."""
        return np.concatenate([self._motion.path.waypoints[len(stop.path.waypoints) :], self._old.ahead])


@dataclass(frozen=True, eq=False)
class _ProvenMotion:
    """A proven motion from the splice on."""

    path: JointPath
    trajectory: Trajectory
    certificate: Certificate
    report: MotionReport

    @property
    def stops(self) -> int:
        """How many corners it stops at before its end."""
        s = self.path.knots[list(self.path.corners)]
        return int(((s > self.trajectory.begin) & (s < self.trajectory.end)).sum())
