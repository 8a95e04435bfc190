"""What one call costs, stage by stage, within what limits, and what its result will say; and the stages that end each.

The tool's speed is not a polynomial in time, so its peak is found by sampling, ever denser around the highest samples.
"""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from planner_service.certify import Certificate, Certifier, ExemptInterval, KeptRefusal, Refusal
from planner_service.collision import CancelToken, CheckCounts, CollisionChecker
from planner_service.collision.budget import Cancelled, CheckBudgetSpent, SearchStopped, TimeBoxSpent
from planner_service.concurrency.polling import Prepared, waited
from planner_service.constraints import Constraint
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics.constraint_set import ConstraintSet, constraint_set, projector_of
from planner_service.memory import NOTHING, Memory
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import LimitPeaks, Trajectory
from planner_service.planning.request import Goals, Pace, PlanRequest
from planner_service.planning.result import (
    Failure,
    ImproveReport,
    KeptPadding,
    MotionReport,
    NearEnd,
    Origin,
    PlanResult,
    PolishReport,
    Reason,
    Stage,
    StageReport,
)
from planner_service.roadmap import Roadmap
from planner_service.robot.model import JointLimits, Robot
from planner_service.search.trace import Tracer
from planner_service.smoothing.smoothing import MIN_BLEND
from planner_service.timing.laws import TimingFailed, peak_tool_speed, stop_duration, time_with_peaks, tool_speeds
from planner_service.timing.segments import SpeedLimit
from planner_service.timing.torque_limits import TorqueLimits

if TYPE_CHECKING:
    from planner_service.decomposition.no_path import NoPath
    from planner_service.native import _core

T = TypeVar("T")

__all__ = [
    "NoPlan",
    "PlanAccounting",
    "PlanContext",
    "StageEntry",
    "certified_path",
    "certify",
    "motion_report",
    "narrower",
    "require_proven",
    "timed",
    "told_of_stages",
    "tool_speed_limit",
    "unproven",
]

logger = logging.getLogger(__name__)

STAGES = tuple(Stage)

LONG = 200
"""Waypoints beyond which a path may take long to time: then the time limit is watched meanwhile."""

_told: ContextVar[Callable[[StageReport], object] | None] = ContextVar("_told", default=None)


@contextmanager
def told_of_stages(tell: Callable[[StageReport], object]) -> Iterator[None]:
    """Have ``tell`` called, in this thread, whenever a stage of a plan ends in the block; one may end repeatedly."""
    before = _told.set(tell)
    try:
        yield
    finally:
        _told.reset(before)


class NoPlan(Exception):
    """Ends the call from within any stage, with the reason."""

    def __init__(self, failure: Failure, certificate: Certificate | None = None, no_path: NoPath | None = None) -> None:
        super().__init__(str(failure))
        self.failure = failure
        self.certificate = certificate
        self.no_path = no_path


class StageEntry:
    """A running stage: what it will report is a note for a person, and the length of the path after it."""

    def __init__(self, accounting: PlanAccounting, stage: Stage, improving: str) -> None:
        self._accounting, self._stage, self._improving = accounting, stage, improving
        self.note = ""
        self.length: float | None = None

    def __enter__(self) -> StageEntry:
        tally = self._accounting.tally
        self._before = tally.states, tally.edges, tally.distances, tally.projections
        self._clock = time.perf_counter()
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> bool | None:
        accounting, tally = self._accounting, self._accounting.tally
        forgiven = bool(self._improving) and isinstance(error, CheckBudgetSpent | TimeBoxSpent)
        if forgiven and isinstance(error, SearchStopped):
            accounting.stopped_by(error)
            self.note = f"not {self._improving}: {error}"
        if accounting.projector is not None:
            tally.projections += accounting.projector.take()
        states, edges, distances, projections = self._before
        judged = tally.states - states, tally.edges - edges
        spent = CheckCounts(*judged, tally.distances - distances, tally.projections - projections)
        seconds = time.perf_counter() - self._clock
        accounting.add(StageReport(self._stage, spent, seconds, self.length, self.note))
        return forgiven


@dataclass(eq=False)
class PlanAccounting:
    """The stages of one call as they happen, and its result at the end; of the thread that it is made in.

    Stages write into it what the result will say; what they need of each other they hand on as values.

    Attributes:
        states: How many the call may check; None for no limit.
        search_states: How many of them searching may use.
        seconds: Wall time.
        cancel: Ends it when cancelled.
        roadmap: That of the request.
        tracer: Told how the search goes; None if nobody asked.
        origin: What the result says that it comes from.
        notes: As in the result; so are ``deterministic``, ``padding``, ``near_ends``, ``attempts``, ``roadmap`` and
            ``polish`` and ``improvement``.
        end_trouble: Which end the search could not leave, as the end of a sentence.
        tried_in_vain: What else was tried after a search without progress; the same.
        memory: That of the call.
        learned: What its motion adds, as in the result.
    """

    checker: CollisionChecker
    states: int | None = None
    search_states: int | None = None
    seconds: float | None = None
    cancel: CancelToken | None = None
    roadmap: Roadmap | None = None
    tracer: Tracer | None = None
    origin: Origin | None = None
    notes: list[str] = field(default_factory=list)
    deterministic: bool = True
    padding: float = 0.0
    near_ends: tuple[NearEnd, ...] = ()
    attempts: int = 0
    end_trouble: str = ""
    tried_in_vain: str = ""
    polish: PolishReport | None = None
    improvement: ImproveReport | None = None
    constraints: ConstraintSet | None = None
    projector: _core.Projector | None = None
    torque_limits: TorqueLimits | None = None
    memory: Memory = NOTHING
    learned: tuple[FloatArray, tuple[str, ...]] | None = None

    def __post_init__(self) -> None:
        self.ledger, self.tally = self.checker.ledger, self.checker.ledger.own
        self._reports: dict[Stage, StageReport] = {}
        self._stage = Stage.ENDPOINTS
        self._hits = dict(self.tally.hits)

    def keep(self, constraints: Sequence[Constraint]) -> None:
        """Hold the call to constraints.

        Raises:
            UnknownName: A link or a joint is not one of the robot's.
            InvalidRequest: As ``ConstraintSet``.
        """
        if constraints:
            self.constraints = constraint_set(self.checker.robot, tuple(constraints))
            self.projector = projector_of(self.constraints)

    def require_end(self, end: str, *Q: FloatArray) -> None:
        """Refuse configurations (n,) of an end as ``require_kept`` and ``require_held`` do."""
        for q in Q:
            self.require_kept(end, q)
            self.require_held(end, q)

    def require_kept(self, end: str, q: FloatArray) -> None:
        """Refuse an end that does not keep the constraints.

        Args:
            end: What it is called: "start", or a goal.

        Raises:
            NoPlan: It violates one.
        """
        if self.constraints is None or self.projector is None:
            return
        within = bool(np.all((self.constraints.lower <= q) & (q <= self.constraints.upper)))
        if within and self.projector.share(tuple(q.tolist())) <= 1.0:
            return
        violated = self.constraints.violation(q)
        if violated is not None:
            reason = Reason.START_VIOLATES_CONSTRAINT if end == "start" else Reason.GOAL_VIOLATES_CONSTRAINT
            raise NoPlan(Failure(Stage.ENDPOINTS, reason, f"{end} does not keep {violated}"))

    def require_held(self, end: str, q: FloatArray) -> None:
        """Refuse an end at which the robot cannot hold itself and what it carries, if torque limits are to be kept.

        Raises:
            NoPlan: A joint would need more than its torque.
        """
        objection = "" if self.torque_limits is None else self.torque_limits.objection(q)
        if objection:
            reason = Reason.START_EXCEEDS_TORQUE if end == "start" else Reason.GOAL_EXCEEDS_TORQUE
            raise NoPlan(Failure(Stage.ENDPOINTS, reason, f"{end}: {objection}"))

    def during(self, stage: Stage, *, improving: str = "") -> StageEntry:
        """Charge what the block costs to ``stage``, however it ends; a stage entered again adds up.

        Args:
            improving: What the block does to a path which is a plan without it, such as "shortened": a limit then ends
                the block alone, and the entry says so.
        """
        self._stage = stage
        return StageEntry(self, stage, improving)

    def add(self, report: StageReport) -> None:
        """Add what a stage has cost to what it has cost before, and tell those who want to know."""
        self._add(report)
        tell = _told.get()
        if tell is not None:
            tell(report)
        if logger.isEnabledFor(logging.DEBUG):
            stage, spent, milliseconds = report.stage.value, report.counts, report.seconds * 1e3
            logger.debug("%s: %s, %.1f ms; %s", stage, spent, milliseconds, report.note or "no note")

    def _add(self, report: StageReport) -> None:
        before = self._reports.get(report.stage)
        if before is not None:
            counts, seconds = before.counts + report.counts, before.seconds + report.seconds
            report = StageReport(report.stage, counts, seconds, report.length, report.note)
        self._reports[report.stage] = report

    def back_to(self, stage: Stage, padding: float, end_trouble: str) -> None:
        """Take it that ``stage`` goes on, as it was before others in between."""
        self._stage, self.padding, self.end_trouble = stage, padding, end_trouble

    def stopped_by(self, stopped: SearchStopped) -> None:
        """Note that a limit had a say in the result: only a number of checks is the same every time."""
        self.deterministic &= isinstance(stopped, CheckBudgetSpent)

    def attempt(self, what: str) -> None:
        """Count a search that begins."""
        self.attempts += 1
        if self.attempts > 1:
            logger.info("attempt %d: %s", self.attempts, what)

    def retry(self, note: str) -> None:
        """Note why the search begins anew."""
        self.notes.append(note)
        logger.info("%s", note)

    def within_limits(self, act: Callable[[], T]) -> T:
        """What ``act`` returns, held to the limits.

        Raises:
            NoPlan: A limit was reached.
        """
        try:
            return self.ledger.held(act, states=self.states, seconds=self.seconds, cancel=self.cancel)
        except SearchStopped as stopped:
            raise NoPlan(self._stopped(stopped)) from stopped

    def outcome(self, act: Callable[[], PlanResult]) -> PlanResult:
        """What ``act`` returns, held to the limits; if it finds no plan, or a limit was reached, the reason."""
        try:
            return self.within_limits(act)
        except NoPlan as no_plan:
            return self.result(failure=no_plan.failure, certificate=no_plan.certificate, no_path=no_plan.no_path)

    def take(self, kept: KeptPadding) -> None:
        """Say in the result what padding is kept, first of all that a person should know."""
        self.padding, self.near_ends = kept.padding, kept.near_ends
        if kept.note:
            self.notes.insert(0, kept.note)

    def result(
        self,
        path: JointPath | None = None,
        trajectory: Trajectory | None = None,
        motion: MotionReport | None = None,
        *,
        failure: Failure | None = None,
        goal_index: int | None = None,
        certificate: Certificate | None = None,
        no_path: NoPath | None = None,
    ) -> PlanResult:
        """The result of the call."""
        return PlanResult(
            path=path,
            trajectory=trajectory,
            failure=failure,
            stages=self._stages,
            goal_index=goal_index,
            attempts=self.attempts,
            padding=self.padding,
            deterministic=self.deterministic,
            certificate=certificate,
            motion=motion,
            notes=tuple(self.notes),
            roadmap=self.roadmap,
            polish=self.polish,
            improvement=self.improvement,
            constraints=() if self.constraints is None else self.constraints.constraints,
            near_ends=() if path is None else self.near_ends,
            no_path=no_path,
            trace=None if self.tracer is None else self.tracer.trace,
            origin=self.origin,
            known=self.memory,
            learned=self.learned,
        )

    def with_plan(self, plan: PlanResult) -> PlanResult:
        """The result of a call that made another plan: that plan, with what both cost and noted."""
        for report in plan.stages:
            self._add(report)
        self.attempts += plan.attempts
        self.deterministic &= plan.deterministic
        return replace(
            plan,
            stages=self._stages,
            attempts=self.attempts,
            deterministic=self.deterministic,
            notes=(*self.notes, *plan.notes),
        )

    @property
    def _stages(self) -> tuple[StageReport, ...]:
        reports = self._reports
        return tuple([reports[stage] for stage in STAGES if stage in reports])

    def gave_up(self) -> Failure:
        """The failure of a search that ended by itself without a path."""
        return self._unknown(Reason.PLANNING_FAILED, "the search gave up")

    def _stopped(self, stopped: SearchStopped) -> Failure:
        if isinstance(stopped, Cancelled):
            self.deterministic = False
            return Failure(self._stage, Reason.PREEMPTED, str(stopped))
        if isinstance(stopped, TimeBoxSpent):
            self.deterministic = False
            return self._unknown(Reason.TIMED_OUT, f"the time limit of {self.seconds:g} s passed")
        return self._unknown(
            Reason.CHECK_BUDGET_EXHAUSTED,
            f"no path within the {self.states:,} checks that may be made"
            + (f", {self.search_states:,} of them by a search" if self._stage is Stage.SEARCH else ""),
        )

    def impossible(self, proof: NoPath, hulls: str) -> NoPlan:
        """That it is proven that no path exists; ``hulls`` says if only for hulls of meshes, and what to do then."""
        detail = f"{proof}{hulls and '; '}{hulls}"
        failure = Failure(Stage.NO_PATH, Reason.NO_PATH, detail, blocked_by=self._blocked, proven=not hulls)
        return NoPlan(failure, no_path=proof)

    def _unknown(self, reason: Reason, what: str) -> Failure:
        """A failure that proves nothing, with what the search kept running into."""
        blocked = self._blocked
        if self.constraints is not None:
            what += f" while keeping {self.constraints.names}"
        detail = f"{what}; whether a path exists is unknown{self.tried_in_vain}"
        detail += f"{_blocked_in_words(blocked)}{self.end_trouble}"
        return Failure(self._stage, reason, detail, blocked_by=blocked)

    @property
    def _blocked(self) -> tuple[tuple[str, str, float], ...]:
        """What the search ran into, most frequent first, with shares."""
        hits = self.tally.hits - Counter(self._hits)
        total = sum(hits.values())
        worst = sorted(hits.items(), key=lambda item: (-item[1], item[0]))[:5]
        return tuple((a, b, count / total) for (a, b), count in worst)


@dataclass(frozen=True, eq=False)
class PlanContext:
    """What every stage of a plan is handed.

    Attributes:
        request: What was asked.
        goals: Those of the request, joint values clamped.
        checker: Judges and counts, without padding; its limits are those of the call.
        certifier: Proves the path in the end.
        accounting: Told by each stage what the result will say.
    """

    request: PlanRequest
    goals: Goals
    checker: CollisionChecker
    certifier: Prepared[Certifier]
    accounting: PlanAccounting


def certify(
    path: JointPath,
    certifier: Certifier,
    accounting: PlanAccounting,
    exempt: Sequence[ExemptInterval],
    *,
    part: tuple[float, float] | None = None,
    padding: float = 0.0,
) -> Certificate:
    """What can be proven of a path, as the CERTIFY stage; its bounds are counted, and the limits hold."""
    with accounting.during(Stage.CERTIFY) as entry:
        constraints = () if accounting.constraints is None else accounting.constraints.constraints
        proof = certifier.proven(path, padding, tuple(exempt), constraints, part, accounting.ledger.charge)
        entry.note = proof.verdict
        return proof


def certified_path(
    path: JointPath,
    certifier: Certifier,
    accounting: PlanAccounting,
    exempt: Sequence[ExemptInterval],
    *,
    padding: float = 0.0,
) -> tuple[JointPath, Certificate]:
    """The path and what can be proven of it; blends that cannot be proven are halved, and become stops in the end."""
    while True:
        certificate = certify(path, certifier, accounting, exempt, padding=padding)
        less = None if certificate.refusal is None else narrower(path, certificate.refusal)
        if less is None:
            return path, certificate
        path = less
        accounting.notes.append(f"blends made narrower: {certificate.refusal}")


def unproven(certificate: Certificate) -> NoPlan:
    """That a path could not be proven."""
    reason, what = Reason.NOT_CERTIFIED, f"not proven free: {certificate.refusal}"
    if isinstance(certificate.refusal, KeptRefusal):
        reason, what = Reason.CONSTRAINT_NOT_CERTIFIED, str(certificate.refusal)
    return NoPlan(Failure(Stage.CERTIFY, reason, what), certificate)


def require_proven(certificate: Certificate) -> Certificate:
    """The certificate of a path that is proven.

    Raises:
        NoPlan: It is not.
    """
    if certificate.refusal is not None:
        raise unproven(certificate)
    return certificate


def narrower(path: JointPath, refusal: Refusal | KeptRefusal, first: int = 0) -> JointPath | None:
    """The path with those blends halved, from waypoint ``first`` on, at which it was refused; None if there is none."""
    if refusal.spent:
        return None
    before, after = path.knots - path.blends, path.knots + path.blends
    spans = refusal.broken if isinstance(refusal, KeptRefusal) else ((refusal.s, refusal.s),)
    meant = np.any([(before <= end) & (after >= start) for start, end in spans], axis=0)
    meant &= (path.blends > 0.0) & (np.arange(len(before)) >= first)
    if not np.any(meant):
        return None
    widths = np.where(meant, path.blends / 2.0, path.blends)
    return path.with_blends(np.where(widths < MIN_BLEND, 0.0, widths))


def timed(path: JointPath, pace: Pace, robot: Robot, accounting: PlanAccounting) -> tuple[Trajectory, MotionReport]:
    """The path in time, and how the robot then moves, as the TIMING stage.

    Raises:
        NoPlan: The timing law has no solution.
    """
    limits, torque_limits = pace.limits(robot), accounting.torque_limits

    def away(work: Callable[[], T]) -> T:
        return waited(work) if len(path.knots) > LONG else work()

    with accounting.during(Stage.TIMING) as entry:
        try:
            limit = tool_speed_limit(path, pace, robot)
            trajectory, ratios = away(lambda: time_with_peaks(pace.timing, path, limits, limit, torque_limits))
            speed = None if pace.max_tool_speed is None else away(lambda: peak_tool_speed(robot, trajectory))
            if speed is not None and pace.max_tool_speed is not None and speed > pace.max_tool_speed:
                factor, speed = speed / pace.max_tool_speed, pace.max_tool_speed
                trajectory, ratios = trajectory.dilated(factor), ratios.dilated(factor)
                if torque_limits is not None:
                    ratios = replace(ratios, torques=torque_limits.samples(trajectory).peaks())
            stops = away(lambda: _stop_duration(trajectory, pace, robot, limits, torque_limits))
        except TimingFailed as failed:
            raise NoPlan(Failure(Stage.TIMING, Reason.TIMING_FAILED, str(failed))) from failed
        entry.note, entry.length = f"{pace.timing.name}, {trajectory.duration:.2f} s", path.length
        return trajectory, motion_report(robot, trajectory, ratios, stops, speed)


def motion_report(
    robot: Robot, trajectory: Trajectory, ratios: LimitPeaks, stops: float, speed: float | None = None
) -> MotionReport:
    """How a robot moves.

    Args:
        stops: Seconds with a stop at each corner.
        speed: The tool's peak speed; measured when it is looked at if None.
    """
    settle = robot.settle_time if trajectory.duration > 0.0 else 0.0
    if speed is not None:
        return MotionReport(ratios, speed, trajectory.duration, stops, settle)
    measure = partial(peak_tool_speed, robot, trajectory)
    return MotionReport.measuring(measure, ratios, trajectory.duration, stops, settle)


def tool_speed_limit(path: JointPath, pace: Pace, robot: Robot) -> SpeedLimit | None:
    """The largest ds/dt at which the tool is no faster than allowed; None without a limit."""
    speed = pace.max_tool_speed
    if speed is None:
        return None

    def limit(s: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            return np.asarray(speed / tool_speeds(robot, path(s), path(s, 1)))

    return limit


def _stop_duration(
    trajectory: Trajectory, pace: Pace, robot: Robot, limits: JointLimits, torque_limits: TorqueLimits | None
) -> float:
    """Seconds that the path would take with a stop at each of its corners; infinite if the law then fails."""
    path = trajectory.path
    if not path.turns or not path.blended.any():
        return trajectory.duration
    try:
        return _stopping(path, pace, robot, limits, torque_limits)
    except TimingFailed:
        return math.inf


def _stopping(
    path: JointPath, pace: Pace, robot: Robot, limits: JointLimits, torque_limits: TorqueLimits | None
) -> float:
    if pace.max_tool_speed is None:
        return stop_duration(path, pace.timing, limits, torque_limits)
    sharp = path.with_blends(None)
    speed_limit = tool_speed_limit(sharp, pace, robot)
    stopping, _ = time_with_peaks(pace.timing, sharp, limits, speed_limit, torque_limits)
    return stopping.duration * max(1.0, peak_tool_speed(robot, stopping) / pace.max_tool_speed)


def _blocked_in_words(blocked: tuple[tuple[str, str, float], ...]) -> str:
    """The pairs most in the way, as the end of a sentence."""
    if not blocked:
        return ""
    return "; most in the way: " + ", ".join(f"{a} x {b} ({share:.0%})" for a, b, share in blocked[:3])
