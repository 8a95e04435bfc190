"""What a plan came to: its stages, what each cost, and the reason when there is none."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from planner_service.certify import Certificate, ExemptInterval
from planner_service.collision import CheckCounts, Contact
from planner_service.errors import BrokenInvariant, PlanningFailed
from planner_service.geometry import FloatArray, as_sent
from planner_service.optimize import Figures
from planner_service.path import JointPath
from planner_service.peaks import LimitPeaks
from planner_service.roadmap import Roadmap
from planner_service.trajectory import Trajectory

__all__ = ["Failure", "MotionReport", "PlanResult", "PolishReport", "Reason", "Stage", "StageReport"]


class Stage(enum.Enum):
    """The steps of a plan, in their order."""

    ENDPOINTS = "endpoints"
    STRAIGHT_LINE = "straight line"
    ROADMAP = "roadmap"
    SEARCH = "search"
    SHORTCUT = "shortcut"
    POLISH = "polish"
    CERTIFY = "certify"
    TIMING = "timing"


class Reason(enum.Enum):
    """Why there is no plan, in MoveIt's words where it has one."""

    START_IN_COLLISION = "START_IN_COLLISION"
    GOAL_IN_COLLISION = "GOAL_IN_COLLISION"
    START_OUTSIDE_LIMITS = "START_OUTSIDE_LIMITS"
    GOAL_OUTSIDE_LIMITS = "GOAL_OUTSIDE_LIMITS"
    NO_IK_SOLUTION = "NO_IK_SOLUTION"
    TIMED_OUT = "TIMED_OUT"
    CHECK_BUDGET_EXHAUSTED = "CHECK_BUDGET_EXHAUSTED"
    PREEMPTED = "PREEMPTED"
    PLANNING_FAILED = "PLANNING_FAILED"
    NOT_CERTIFIED = "NOT_CERTIFIED"
    TIMING_FAILED = "TIMING_FAILED"
    LINE_BLOCKED = "LINE_BLOCKED"
    OPTIMUM_IN_COLLISION = "OPTIMUM_IN_COLLISION"
    WORKER_LOST = "WORKER_LOST"


@dataclass(frozen=True, eq=False)
class Failure:
    """Why there is no plan.

    Attributes:
        stage: Where it ended; the first, if a worker was lost and nobody knows how far it had come.
        reason: The kind of reason.
        detail: A sentence for a person: what was wrong, the value, what would be right.
        contacts: For an end in collision, or the first place at which an optimum is, what touches there, deepest
            first.
        nearest_free: For an end in collision, the nearest free configuration found, shape (n,).
        blocked_by: For a search, (link, what it hit, share of the colliding states), most frequent first.
    """

    stage: Stage
    reason: Reason
    detail: str
    contacts: tuple[Contact, ...] = ()
    nearest_free: FloatArray | None = None
    blocked_by: tuple[tuple[str, str, float], ...] = ()
    __setstate__ = as_sent

    def __str__(self) -> str:
        return f"{self.reason.value} ({self.stage.value}): {self.detail}"


@dataclass(frozen=True)
class StageReport:
    """One stage of a plan.

    Attributes:
        counts: What the stage asked of the collision checker.
        seconds: Wall time.
        length: L2 joint length of the path after the stage, in radians (metres for prismatic joints), or None.
        note: What happened, for a person.
    """

    stage: Stage
    counts: CheckCounts
    seconds: float
    length: float | None = None
    note: str = ""


@dataclass(frozen=True)
class MotionReport:
    """How a trajectory moves, measured on it.

    Attributes:
        peaks: How close velocity, acceleration and jerk come to the limits that were to be held; the
            ratio of a jerk is infinite where acceleration jumps.
        tool_speed: Largest speed of the tool frame's origin, in m/s.
        duration: Seconds.
        stop_duration: Seconds the same polyline would take with a stop at each of its corners, infinite if the
            timing law finds none.
        settle_time: Seconds the robot rings after its stop: a gripper should wait so long.
    """

    peaks: LimitPeaks
    tool_speed: float
    duration: float
    stop_duration: float
    settle_time: float


@dataclass(frozen=True)
class PolishReport:
    """What optimising came to.

    Attributes:
        method: Its name.
        kept: Whether the plan is the optimum; if not, it is what was there before.
        before: The path that was optimised, in numbers: with its corners as they were, not yet blended.
        after: The optimum in numbers.
        iterations: Of the method.
        gradients: Of distances, worked out on the way; the distances are counted in the stage.
        note: Why the optimum was not kept, else empty.
    """

    method: str
    kept: bool
    before: Figures
    after: Figures
    iterations: int
    gradients: int
    note: str = ""


@dataclass(frozen=True, eq=False)
class PlanResult:
    """A plan, or the reason why there is none.

    Attributes:
        path: The geometry q(s), its corners blended, None without a plan.
        trajectory: The same geometry in time, None without a plan.
        failure: None with a plan.
        stages: What each stage cost, in order; a retried stage appears once, with all its tries.
        goal_index: Which of the requested goals the path reaches, counting as given.
        attempts: Searches started; 0 when a straight line was free.
        padding: Distance in metres that the search kept from everything.
        deterministic: False when the clock or the caller had a say in the result.
        certificate: The proof that the whole path is free, between samples too; of NOT_CERTIFIED its refusal.
        motion: Peaks over limits, tool speed and durations; None without a plan.
        notes: What was done beyond the request's letter (a clamped start, ends that were closer than the padding).
        roadmap: Of a planner with a roadmap, that roadmap with all that was learned; not kept in plan files.
        polish: What optimising came to; None if it was not asked for, or there was nothing to optimise.
    """

    path: JointPath | None
    trajectory: Trajectory | None
    failure: Failure | None
    stages: tuple[StageReport, ...]
    goal_index: int | None = None
    attempts: int = 0
    padding: float = 0.0
    deterministic: bool = True
    certificate: Certificate | None = None
    motion: MotionReport | None = None
    notes: tuple[str, ...] = ()
    roadmap: Roadmap | None = None
    polish: PolishReport | None = None

    @property
    def ok(self) -> bool:
        """Whether there is a plan."""
        return self.failure is None

    @property
    def exempt(self) -> tuple[ExemptInterval, ...]:
        """Stretches on which named pairs were not judged."""
        return () if self.certificate is None else self.certificate.exempt

    @property
    def counts(self) -> CheckCounts:
        """What the whole plan asked of the collision checker: the sum of its stages."""
        return sum((report.counts for report in self.stages), CheckCounts())

    @property
    def seconds(self) -> float:
        """Wall time of all stages."""
        return sum(report.seconds for report in self.stages)

    def stage(self, stage: Stage) -> StageReport:
        """The report of a stage; one that did not run cost nothing."""
        found = next((report for report in self.stages if report.stage is stage), None)
        return found or StageReport(stage, CheckCounts(), 0.0)

    def unwrap(self) -> tuple[JointPath, Trajectory]:
        """The path and the trajectory.

        Raises:
            PlanningFailed: there is no plan.
        """
        if self.failure is not None:
            raise PlanningFailed(self.failure)
        if self.path is None or self.trajectory is None:
            raise BrokenInvariant("a result without a failure has no path")
        return self.path, self.trajectory
