"""Another motion while one is under way: what ``PlannerService.replan`` runs.

What is left of the old motion is proven in the new scene, and goes on if nothing is in the way and nothing better is
found. Else a new way leaves it, at a place that the robot passes at speed. If there is none, the robot stops along the
old curve; if that cannot be proven either, nothing is safe, which is said.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, product

import numpy as np

from planner_service.certify import Certificate, Certifier, ExemptInterval
from planner_service.collision import CancelToken, CollisionChecker
from planner_service.collision.budget import CheckBudgetSpent, SearchStopped, TimeBoxSpent
from planner_service.concurrency.fair_lock import Turns
from planner_service.concurrency.polling import Prepared
from planner_service.errors import BrokenInvariant
from planner_service.geometry.shapes import FloatArray, Pose
from planner_service.grasping.guards import reach_objection
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.planning.accounting import Limits, NoPlan, StageBook, narrower, not_certified
from planner_service.planning.endpoints import Endpoints, GoalState
from planner_service.planning.pipeline import Run
from planner_service.planning.request import Goal, Pace, PlanRequest
from planner_service.planning.result import Failure, MotionReport, PlanResult, Reason, Stage
from planner_service.planning.timing_stage import peak_tool_speed, tool_speed_limit
from planner_service.replanning.detour import Detours, Way
from planner_service.replanning.result import Old, Outcome, Replanned, request_for, underway
from planner_service.replanning.splice import Handover
from planner_service.scene.names import Names
from planner_service.scene.scene import KIND_SUFFIXES
from planner_service.search.problem import joint_distance
from planner_service.timing.laws import TimingFailed, ToppRa
from planner_service.timing.limit_check import TOLERANCE, LimitPeaks, peaks

__all__ = ["replan"]

SHORTER, SOONER = 0.98, 0.97
"""A free old motion is left for a way that is shorter, and a motion that ends sooner, by that much."""

FEW, ENOUGH, MOST_TRIES, TURNS = 4, 3, 10, 2
"""Ways tried beside a free old motion; without one, when one is found and at most; searches at each place."""

BESIDE = 0.2
"""Part of the states that looking for something better than a free old motion may use."""

GOOD = 1.3
"""Of the time left to the old motion: a new one that takes no longer is taken without looking for a better one."""

SLIGHT = 1e-6
"""Share by which a tool may seem too fast, its peak being known to six digits; metres at which it is at a pose."""


def replan(
    checker: CollisionChecker,
    certifier: Prepared[Certifier],
    motion: tuple[PlanResult | Replanned, float, float],
    asked: tuple[PlanRequest | None, Goal | None],
    caller: tuple[Turns, CancelToken | None],
) -> Replanned:
    """What to do from the splice on; ``motion`` is the old one, the time on it and the latency.

    Raises:
        InvalidRequest: as ``underway`` and ``request_for`` say, or a goal is neither a pose nor n finite joint values.
    """
    old = underway(motion[0], checker.robot, *motion[1:])
    request = request_for(motion[0], old, *asked)
    run = _Run((checker, certifier), old, request, caller[1])
    law = _law_of(motion[0])
    if asked[0] is None and law != request.timing.name:
        run.note([f"a new motion is timed by {request.timing.name}, which can begin at speed, not by {law}"])
    return run.result(caller[0])


def _law_of(previous: PlanResult | Replanned) -> str:
    """The name of the law of the motion before, as far as it is known."""
    origin = previous.origin if isinstance(previous, PlanResult) else None
    asked = None if origin is None else origin.request or origin.pace
    return ToppRa.name if asked is None else asked.timing.name


def _as_it_was(old: Old, certifier: Prepared[Certifier]) -> set[str]:
    """The owners that are as they were: contact was meant with an object where it stood, nowhere else."""
    before = old.made_in
    if before is None or not old.exempt:
        return set()
    here = certifier.get()
    now = here.scene
    held = {*before.attached} ^ {*now.attached}
    changed = {item.name for item in {*before.obstacles} ^ {*now.obstacles}} | {item.name for item in held}
    of_objects = KIND_SUFFIXES[1]
    return {owner for owner in here.listed.owners if owner.removesuffix(of_objects) not in changed}


class _Run:
    """One call."""

    def __init__(
        self,
        judges: tuple[CollisionChecker, Prepared[Certifier]],
        old: Old,
        request: PlanRequest,
        cancel: CancelToken | None,
    ) -> None:
        self._checker, self._certifier = judges
        same = _as_it_was(old, self._certifier)
        self._meant = [(e, tuple(pair for pair in e.pairs if not same.issuperset(pair))) for e in old.exempt]
        sure = [replace(e, pairs=tuple(p for p in e.pairs if p not in unsure)) for e, unsure in self._meant]
        self._old = replace(old, exempt=tuple(e for e in sure if e.pairs))
        self._motion, self._request, self._cancel = old.underway, request, cancel
        self._pace = Pace.of(request)
        self._limits = self._pace.limits(self._checker.robot)
        self._book = StageBook(
            self._checker, Limits(request.max_checks, request.max_checks, request.time_limit, cancel)
        )
        self._endpoints = Endpoints(self._checker, request, self._book)
        self._detours = Detours(self._checker, request, self._book, (self._motion.path, old.ahead))

    def note(self, notes: Iterable[str]) -> None:
        """Say it in the result."""
        self._book.notes.extend(notes)

    def result(self, turns: Turns) -> Replanned:
        """Look for a motion within the limits of the request; a stop, which is cheap, whatever they are."""
        try:
            going_on = self._book.within_limits(turns, self._under_way)
            return self._from_rest(turns) if going_on is None else going_on
        except NoPlan as no_plan:
            failure = no_plan.failure
        with self._book.apart():  # a robot under way waits for nobody
            return self._stopping(failure)

    def _under_way(self) -> Replanned | None:
        """What to do before the old motion rests; None if it does, its last stretch being proven.

        Raises:
            NoPlan: there is nothing to do, or what is left cannot be proven.
        """
        self._ask_again()
        if not self._motion.rests:
            return self._going_on()
        self._prove_last_stretch()
        return None

    def _ask_again(self) -> None:
        """Have contact with what is not as it was stay meant where ``pick`` would still mean it; else it lapses."""
        for stretch, unsure in self._meant:
            if not unsure:
                continue
            with self._book.during(Stage.ENDPOINTS):
                objection = self._objection(stretch, unsure)
            if objection:
                self.note(f"{a} x {b} may no longer touch: {objection}" for a, b in sorted(unsure))
            else:
                self.note(f"{a} x {b} may still touch: the grasp is sound where it stands now" for a, b in unsure)
                self._old = replace(self._old, exempt=(*self._old.exempt, replace(stretch, pairs=unsure)))

    def _objection(self, stretch: ExemptInterval, pairs: tuple[tuple[str, str], ...]) -> str:
        """Why pairs may not touch any more; empty if they are fingers and what they still take at the path's end."""
        robot, now, before, path = self._checker.robot, self._checker.scene, self._old.made_in, self._motion.path
        names = Names(robot, now)
        fingers = {names.link(link) for link in (() if robot.gripper is None else robot.gripper.links)}
        stood = {} if before is None else {item.name: item for item in before.obstacles}
        others = {name for pair in pairs for name in pair} - fingers
        targets = [item for item in now.obstacles if names.object(item.name) in others]
        was = stood.get(targets[0].name) if len(others) == len(targets) == 1 else None
        taken = self._old.arrives and stretch.s_end >= path.length
        if was is None or was.shape != targets[0].shape or not taken:
            return "one of them is not as it was"
        begin = max(stretch.s_start, self._motion.s(self._motion.now))
        return reach_objection(self._checker, path, begin, (was, targets[0]), pairs)

    def _prove_last_stretch(self) -> None:
        """What is left until the old motion rests.

        Raises:
            NoPlan: it cannot be proven.
        """
        part = self._motion.s(self._motion.now), self._motion.end
        if part[0] < part[1]:
            certificate = self._book.certificate(self._certifier.get(), self._motion.path, self._old.exempt, part)
            if not certificate.certified:
                raise NoPlan(not_certified(certificate), certificate)

    def _from_rest(self, turns: Turns) -> Replanned:
        """A plan from where the old motion has ended when the new one begins.

        Raises:
            NoPlan: there is none.
        """
        plan = Run(self._checker, self._certifier, self._request, self._cancel).result(turns)
        result = self._book.with_plan(plan)
        if plan.failure is not None:
            raise NoPlan(plan.failure)
        outcome = Outcome.NEW if plan.path is not None and plan.path.length > 0.0 else Outcome.KEPT
        return Replanned(outcome, result, self._old.splice, self._request, None, self._old.ahead[:0])

    def _going_on(self) -> Replanned:
        """The old motion, or a new one.

        Raises:
            NoPlan: there is none.
        """
        kept = self._kept()
        try:
            with self._book.during(Stage.ENDPOINTS):
                goals = self._goals()
        except (NoPlan, CheckBudgetSpent, TimeBoxSpent) as stopped:
            if kept is None or not self._is_asked(self._old.end):
                raise
            return self._still(kept, stopped)
        end = self._old.end.tolist()
        same = next((goal for goal in goals if goal.q.tolist() == end), None)
        if kept is None or same is None:
            return self._new(goals[0] if same is None else same)
        try:
            with self._checker.limited(states=max(1, int(self._request.max_checks * BESIDE))):
                better = self._improved(kept, same)
        except (NoPlan, CheckBudgetSpent, TimeBoxSpent) as stopped:
            return self._still(kept, stopped)
        return better or self._told(Outcome.KEPT, kept, same.index)

    def _still(self, kept: _Motion, stopped: NoPlan | SearchStopped) -> Replanned:
        """The old motion, since nothing better was found."""
        self._book.deterministic &= not isinstance(stopped, TimeBoxSpent)
        self._book.notes.append(f"the old motion goes on: {stopped}")
        return self._told(Outcome.KEPT, kept, None)

    def _is_asked(self, q: FloatArray) -> bool:
        """Whether a configuration is one of the goals, or brings the tool to one."""
        goals = self._request.goals(self._checker.robot)
        there = self._checker.robot.tool_pose(q)
        return any(
            np.abs(there - goal.matrix).max() <= SLIGHT
            if isinstance(goal, Pose)
            else not isinstance(goal, PoseGoal) and goal.tolist() == q.tolist()
            for goal in goals
        )

    def _goals(self) -> tuple[GoalState, ...]:
        """Free goals, the nearest to the old one first.

        Raises:
            NoPlan: there is none, or the robot touches something at the splice.
        """
        ends = self._endpoints.find()
        goals = [goal for goal in ends.goals if goal.arrival is None]
        if ends.departure is not None or not goals:
            detail = "a fixed way out of a pose, or into one, cannot be entered at speed: plan it from a stop"
            raise NoPlan(Failure(Stage.ENDPOINTS, Reason.PLANNING_FAILED, detail))
        return tuple(sorted(goals, key=lambda goal: joint_distance(self._old.end.tolist(), goal.q.tolist())))

    def _kept(self) -> _Motion | None:
        """What is left of the old motion, if it goes to its end, is proven, and as slow as is asked now."""
        if not self._old.arrives:
            return None
        path, part = self._motion.path, (self._motion.s(self._motion.now), self._motion.end)
        certificate = self._book.certificate(self._certifier.get(), path, self._old.exempt, part)
        if not certificate.certified:
            return None
        trajectory = self._motion.rest()
        try:
            with self._book.during(Stage.TIMING):
                return _Motion(path, trajectory, certificate, self._slow_enough(self._report(trajectory)))
        except NoPlan as too_fast:
            self._book.notes.append(f"the old motion is left: {too_fast}")
            return None

    def _improved(self, kept: _Motion, goal: GoalState) -> Replanned | None:
        """A motion that keeps more from things than the old one, or ends sooner; None if there is none."""
        handover = next(self._motion.handovers(), None)
        if handover is None:
            return None
        failures: list[NoPlan] = []
        for place in islice(self._detours.places(handover, self._stop_from(handover), goal.q, beyond=False), FEW):
            if not place.s < self._motion.end:
                break
            way = self._detours.way(handover, place, goal)
            if way is None:
                continue
            shorter = way.path.length - way.s <= SHORTER * (self._motion.end - way.s)
            if not way.searched and not shorter:
                if way.roomy:
                    break
                continue
            try:
                found = self._moving(way)
            except NoPlan as no_plan:
                failures.append(no_plan)
                continue
            if found.stops <= kept.stops and (
                way.searched or found.trajectory.duration <= SOONER * kept.trajectory.duration
            ):
                return self._told(Outcome.NEW, found, goal.index)
        if failures:
            self._book.notes.append(f"no better motion: {failures[0]}")
        return None

    def _new(self, goal: GoalState) -> Replanned:
        """Of the first few ways that can be driven and proven that with the fewest stops, and then the quickest.

        Raises:
            NoPlan: there is none; why not is said of the first.
        """
        failures: list[NoPlan] = []
        found: list[_Motion] = []
        try:
            self._collect(self._ways(goal, failures), found, failures)
        except CheckBudgetSpent:
            if not found:
                raise
        if found:
            best = min(found, key=lambda motion: (motion.stops, motion.trajectory.duration))
            return self._told(Outcome.NEW, best, goal.index)
        if failures:
            raise failures[0]
        detail = "the robot cannot turn off before what is in the way"
        raise NoPlan(Failure(Stage.STRAIGHT_LINE, Reason.LINE_BLOCKED, detail))

    def _collect(self, ways: Iterator[Way], found: list[_Motion], failures: list[NoPlan]) -> None:
        """Motions along ways, until there are enough of them, or a good one."""
        left = self._motion.trajectory.duration - self._motion.splice
        for tries, way in enumerate(ways, start=1):
            try:
                found.append(self._moving(way))
            except NoPlan as no_plan:
                failures.append(no_plan)
            good = bool(found) and not found[-1].stops and found[-1].trajectory.duration <= GOOD * left
            if good or tries >= (ENOUGH if found else MOST_TRIES):
                break

    def _ways(self, goal: GoalState, failures: list[NoPlan]) -> Iterator[Way]:
        """Ways to try, one after the other, as far as what comes before them can be proven."""
        handovers: list[Handover] = []
        for handover in self._motion.handovers():
            part = self._motion.s(self._motion.now), handover.s
            certificate = self._book.certificate(self._certifier.get(), self._motion.path, self._old.exempt, part)
            if not certificate.certified:
                failures.append(NoPlan(not_certified(certificate), certificate))
                break
            handovers.append(handover)
        for turn, handover in product(range(TURNS), handovers):
            for place in self._detours.places(handover, self._stop_from(handover), goal.q):
                try:
                    way = self._detours.way(handover, place, goal, turn)
                except NoPlan as no_plan:
                    failures.append(no_plan)
                else:
                    if way is not None and (way.searched or turn == 0):
                        yield way

    def _moving(self, way: Way) -> _Motion:
        """A way proven, and in time from the splice on.

        Raises:
            NoPlan: it cannot be proven, or entered as fast as the robot comes along.
        """
        path, since = way.path, self._motion.s(self._motion.now)
        exempt = tuple(e for e in self._old.exempt if e.s_end <= way.s)
        while True:
            certificate = self._book.certificate(self._certifier.get(), path, exempt, (since, path.length))
            if certificate.refusal is None:
                break
            less = narrower(path, certificate.refusal, way.leaves)
            if less is None:
                raise NoPlan(not_certified(certificate), certificate)
            path = less
        speed_limit = tool_speed_limit(path, self._pace, self._checker.robot)
        with self._book.during(Stage.TIMING) as entry:
            try:
                trajectory, found = self._motion.onward(
                    path, way.handover, (self._timing, self._limits), speed_limit=speed_limit
                )
            except TimingFailed as failed:
                raise NoPlan(Failure(Stage.TIMING, Reason.TIMING_FAILED, str(failed))) from failed
            entry.note, entry.length = f"{self._timing.name}, {trajectory.duration:.2f} s", path.length
            return _Motion(path, trajectory, certificate, self._slow_enough(self._report(trajectory, found)))

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
            with self._book.during(Stage.TIMING):
                stop = self._motion.braked(limits)
            if pace == whole or peaks(stop, limits).highest <= 1.0 + TOLERANCE:
                yield stop

    def _stop_from(self, handover: Handover) -> float:
        return self._motion.stop_from(handover, self._limits)

    def _report(self, trajectory: Trajectory, found: LimitPeaks | None = None) -> MotionReport:
        """How a motion moves, its peaks next to the limits asked."""
        robot, ratios = self._checker.robot, found or peaks(trajectory, self._limits)
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
        if most is not None and speed > most * (1.0 + SLIGHT):
            detail = f"the tool would move at {speed:.6g} m/s, faster than {most:.6g}"
            raise NoPlan(Failure(Stage.TIMING, Reason.TIMING_FAILED, detail))
        return report

    def _stopping(self, failure: Failure) -> Replanned:
        """The quickest stop along the old curve, if it can be proven."""
        motion = self._motion
        for stop in self._stops():
            exempt = tuple(e for e in self._old.exempt if e.s_start <= stop.path.length)
            exempt = tuple(replace(e, s_end=min(e.s_end, stop.path.length)) for e in exempt)
            part = motion.s(motion.now), stop.end
            certificate = self._book.certificate(self._certifier.get(), stop.path, exempt, part)
            if certificate.certified:
                self._book.notes.append(f"a stop along the old curve: {failure}")
                found = _Motion(stop.path, stop, certificate, self._report(stop))
                return self._told(Outcome.STOP, found, None, failure)
        detail = (
            f"nothing is safe: the earliest stop along the old curve ends {stop.duration:.3f} s after the splice at "
            f"s = {stop.end:.4g}, and {certificate.refusal}; no new motion: {failure}"
        )
        unsafe = Failure(Stage.CERTIFY, Reason.NOT_CERTIFIED, detail)
        result = self._book.result(failure=unsafe, certificate=certificate)
        return Replanned(Outcome.UNSAFE, result, self._old.splice, self._request, failure, self._ahead(stop), stop)

    def _told(
        self, outcome: Outcome, found: _Motion, goal_index: int | None, failure: Failure | None = None
    ) -> Replanned:
        if found.report.peaks.highest > 1.0 + 2.0 * TOLERANCE:
            velocity, acceleration = found.report.peaks.velocity, found.report.peaks.acceleration
            parts = f"velocity {velocity.ratio:.0%}, acceleration {acceleration.ratio:.0%}"
            self._book.notes.append(f"beyond the limits asked: {parts} of them")
        result = self._book.result(
            found.path, (found.trajectory, found.report), goal_index=goal_index, certificate=found.certificate
        )
        ahead = self._ahead(found.trajectory) if outcome is Outcome.STOP else self._old.ahead[:0]
        return Replanned(outcome, result, self._old.splice, self._request, failure, ahead)

    def _ahead(self, stop: Trajectory) -> FloatArray:
        """The old waypoints beyond the path of a stop."""
        return np.concatenate([self._motion.path.waypoints[len(stop.path.waypoints) :], self._old.ahead])


@dataclass(frozen=True, eq=False)
class _Motion:
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
