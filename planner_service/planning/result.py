"""The result of planning: the plan, its stages and their costs, or the reason why there is none."""

from __future__ import annotations

import enum
import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

from planner_service.certify import Certificate, ExemptInterval
from planner_service.certify.certifier import proof_text
from planner_service.certify.colliding_solutions import CollidingSolution
from planner_service.collision import CheckCounts, Contact
from planner_service.constraints import Constraint
from planner_service.errors import BrokenInvariant, InvalidRequest, PlanningFailed
from planner_service.geometry.arrays import FloatArray, as_sent
from planner_service.geometry.validation import copied_in
from planner_service.kinematics.reachability import Unreachable
from planner_service.memory import NOTHING, Memory
from planner_service.optimize import Figures
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import LimitPeaks, Trajectory
from planner_service.planning.request import Pace, PlanRequest, World
from planner_service.presentation.page import OpenPage, show_page
from planner_service.presentation.tables import Block, CostTable, Row, render_html, render_text
from planner_service.provided import Provided
from planner_service.roadmap import Roadmap
from planner_service.robot.model import length_unit
from planner_service.search.trace import Trace
from planner_service.timing.limit_check import ORDERS

if TYPE_CHECKING:
    from planner_service.decomposition.no_path import NoPath

__all__ = [
    "Failure",
    "ImproveReport",
    "KeptPadding",
    "MotionReport",
    "NearEnd",
    "Origin",
    "PlanResult",
    "PolishReport",
    "Reason",
    "Stage",
    "StageReport",
    "cost_row",
    "plan_lines",
    "plan_row",
    "plan_rows",
    "stage_row",
]

save_plan: Provided[..., None] = Provided()
"""Writes a plan or a task to a file."""

save_steps: Provided[..., None] = Provided()
load_steps: Provided[..., Any] = Provided()
"""Write the steps of a task to a file, and read them."""

TIMING_LAWS = {"toppra": "TOPP-RA", "trapezoidal": "trapezoid", "s-curve": "S-curve"}


class Stage(enum.Enum):
    """The steps of a plan, in their order."""

    __hash__ = object.__hash__  # members are looked up in every stage; Enum's own is Python code

    ENDPOINTS = "endpoints"
    """Start and goals: shape, limits, collisions; inverse kinematics of poses."""
    STRAIGHT_LINE = "straight line"
    """One edge from the start to each goal; if one is free, nothing is searched."""
    ROADMAP = "roadmap"
    """Growing one within the plan, on a budget of its own; only with ``PRM``, ``PRMstar`` and ``LazyPRM``."""
    SEARCH = "search"
    """The planner, or the query of a roadmap."""
    NO_PATH = "no-path proof"
    """Looking for a proof that there is none; only after searches that made no progress."""
    SHORTCUT = "shortcut"
    """Pieces replaced by straight edges that are free."""
    IMPROVE = "improve"
    """Further searches for a shorter path; only with ``PlanRequest.improve``."""
    POLISH = "polish"
    """Corners pulled in and blended, or the path optimised."""
    CERTIFY = "certify"
    """The proof of the whole curve."""
    TIMING = "timing"
    """The law along it."""


class Reason(enum.Enum):
    """Why there is no plan, in MoveIt's words where it has one."""

    START_IN_COLLISION = "START_IN_COLLISION"
    """The start touches something; ``Failure.contacts`` says what."""
    GOAL_IN_COLLISION = "GOAL_IN_COLLISION"
    """Every goal touches something."""
    START_OUTSIDE_LIMITS = "START_OUTSIDE_LIMITS"
    """By more than ``PlanRequest.start_tolerance``."""
    GOAL_OUTSIDE_LIMITS = "GOAL_OUTSIDE_LIMITS"
    """Every goal given as joint values is outside the limits."""
    START_VIOLATES_CONSTRAINT = "START_VIOLATES_CONSTRAINT"
    """The start does not keep a constraint of the request."""
    GOAL_VIOLATES_CONSTRAINT = "GOAL_VIOLATES_CONSTRAINT"
    """No goal keeps all constraints of the request."""
    START_EXCEEDS_TORQUE = "START_EXCEEDS_TORQUE"
    """A joint cannot hold the robot and its load still at the start."""
    GOAL_EXCEEDS_TORQUE = "GOAL_EXCEEDS_TORQUE"
    """At each goal, a joint cannot hold the robot and its load still."""
    NO_IK_SOLUTION = "NO_IK_SOLUTION"
    """No configuration within the limits was found for a tool pose."""
    TIMED_OUT = "TIMED_OUT"
    """``time_limit`` passed; whether a path exists is unknown."""
    CHECK_BUDGET_EXHAUSTED = "CHECK_BUDGET_EXHAUSTED"
    """``max_checks`` were spent; whether a path exists is unknown."""
    PREEMPTED = "PREEMPTED"
    """The caller cancelled."""
    PLANNING_FAILED = "PLANNING_FAILED"
    """The planner gave up before its limits were reached; whether a path exists is unknown."""
    NO_PATH = "NO_PATH"
    """It is proven that no path exists; ``PlanResult.no_path`` is the proof."""
    NOT_CERTIFIED = "NOT_CERTIFIED"
    """A path was found, but there is no proof that it is free; ``PlanResult.certificate`` says where. Or an end is
    free, but so near to something that no path there could be proven."""
    CONSTRAINT_NOT_CERTIFIED = "CONSTRAINT_NOT_CERTIFIED"
    """A path was found, but there is no proof that it keeps a constraint everywhere."""
    TIMING_FAILED = "TIMING_FAILED"
    """The timing law has no solution along the path."""
    LINE_BLOCKED = "LINE_BLOCKED"
    """A given line is not free, or the tool cannot follow it; nothing was searched instead."""
    OPTIMUM_IN_COLLISION = "OPTIMUM_IN_COLLISION"
    """``Optimise`` was the planner, and its optimum is not free."""
    WORKER_LOST = "WORKER_LOST"
    """In ``plan_many``, the worker that planned it died twice; whether a path exists is unknown."""


@dataclass(frozen=True, eq=False)
class Failure:
    """Why there is no plan.

    Attributes:
        stage: Where it ended; the first stage if a worker was lost, as it is not known how far it had come.
        reason: The kind of reason.
        detail: A sentence for a person: what was wrong, the value, what would be right.
        contacts: What touches at an end that is in collision, or at the first place where an optimum is; deepest first.
        nearest_free: For an end in collision, the nearest free configuration found, shape (n,).
        unreachable: For a pose without a configuration, how near the tool comes and what is in the way.
        blocked_by: For a search, (link, what it hit, share of the colliding states), most frequent first.
        proven: Whether it is certain that no plan exists for the request, rather than that none was found.
        colliding: Every configuration for the poses that were asked for, if all are known and proven to collide.
    """

    stage: Stage
    reason: Reason
    detail: str
    contacts: tuple[Contact, ...] = ()
    nearest_free: FloatArray | None = None
    blocked_by: tuple[tuple[str, str, float], ...] = ()
    unreachable: Unreachable | None = None
    proven: bool = False
    colliding: tuple[CollidingSolution, ...] = ()
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        copied_in(self, "contacts", "nearest_free", "blocked_by", "colliding")

    def __str__(self) -> str:
        return f"{self.reason.value} ({self.stage.value}): {self.detail}"


@dataclass(frozen=True)
class StageReport:
    """One stage of a plan.

    Attributes:
        counts: The collision checks of the stage.
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
        peaks: How close velocity, acceleration and jerk come to the limits; the ratio of a jerk is infinite where the
            acceleration jumps.
        tool_speed: Largest speed of the tool frame's origin, in m/s. A plan's is measured when it is first looked at.
        duration: Seconds.
        stop_duration: Seconds the same polyline would take with a stop at each of its corners; infinite if the timing
            law has no solution for that.
        settle_time: Seconds for which the robot rings after its stop: a gripper should wait for as long.
    """

    peaks: LimitPeaks
    tool_speed: float
    duration: float
    stop_duration: float
    settle_time: float

    @classmethod
    def measuring(
        cls,
        tool_speed: Callable[[], float],
        peaks: LimitPeaks,
        duration: float,
        stop_duration: float,
        settle_time: float,
    ) -> MotionReport:
        """A report whose ``tool_speed`` is what a function returns, called when somebody wants to know."""
        report = object.__new__(cls)
        known = {"peaks": peaks, "duration": duration, "stop_duration": stop_duration, "settle_time": settle_time}
        report.__dict__.update(known, _measure=tool_speed)
        return report

    def __getattr__(self, name: str) -> float:
        """The tool's speed, if it has not been measured yet."""
        measure = self.__dict__.get("_measure") if name == "tool_speed" else None
        if measure is None:
            raise AttributeError(name, name=name, obj=self)
        speed = self.__dict__["tool_speed"] = measure()
        return float(speed)

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __str__(self) -> str:
        ratios = {name: getattr(self.peaks, name).ratio for name in ORDERS}
        torques = [peak.ratio for peak in self.peaks.torques]
        ratios |= {"torque": max(torques)} if torques else {}
        used = ", ".join(f"{name} {ratio:.0%}" for name, ratio in ratios.items() if math.isfinite(ratio))
        faster = self.duration < self.stop_duration < math.inf
        stops = f" ({self.stop_duration:.2f} s with a stop at each corner)" if faster else ""
        return f"{self.duration:.2f} s{stops}; {used} of the limits; tool up to {self.tool_speed:.2f} m/s"


@dataclass(frozen=True)
class PolishReport:
    """The outcome of optimising.

    Attributes:
        method: Its name.
        kept: Whether the plan is the optimum; if not, it is the path as it was.
        before: Figures of the path that was optimised, its corners not yet blended.
        after: Figures of the optimum.
        iterations: Of the method.
        gradients: Gradients of distances that were computed; the distances are counted in the stage.
        note: Why the optimum was not kept; empty if it was.
    """

    method: str
    kept: bool
    before: Figures
    after: Figures
    iterations: int
    gradients: int
    note: str = ""

    def __str__(self) -> str:
        before, after = self.before, self.after
        change = (
            f"length {before.length:.2f} -> {after.length:.2f}, cost {before.cost:.3f} -> {after.cost:.3f}, "
            f"clearance at waypoints {before.clearance * 1000:.1f} -> {after.clearance * 1000:.1f} mm"
        )
        end = "" if self.kept else f"; not kept: {self.note}"
        return f"{change}; {self.method}, {self.iterations} iterations, {self.gradients:,} gradients{end}"


@dataclass(frozen=True)
class ImproveReport:
    """What further searches made of a path.

    Attributes:
        rounds: Made of those that were asked for: no more once less than 2 % could be gained.
        before: L2 joint length of the first path, shortened, its corners not yet blended.
        after: The same of the shortest that was found.
        bound: No path is shorter: the distance from the start to the nearest goal.
    """

    rounds: int
    before: float
    after: float
    bound: float

    @property
    def gain(self) -> float:
        """The share of the length that further rounds could gain at most, 0 to 1."""
        return max(0.0, 1.0 - self.bound / self.after) if self.after > 0.0 else 0.0

    @property
    def words(self) -> str:
        """How many rounds, for a person."""
        return "1 round" if self.rounds == 1 else f"{self.rounds} rounds"

    def __str__(self) -> str:
        return f"length {self.before:.2f} -> {self.after:.2f} in {self.words}; none is below {self.bound:.2f}"


@dataclass(frozen=True)
class NearEnd:
    """A stretch at an end of a path on which named pairs are closer than the padding, as they are at that end.

    Attributes:
        s_start: Where in path length s it begins.
        s_end: Where it ends.
        pairs: The names of each two.
    """

    s_start: float
    s_end: float
    pairs: tuple[tuple[str, str], ...]

    def __post_init__(self) -> None:
        ExemptInterval(self.s_start, self.s_end, self.pairs, "")  # refuses the same

    def __str__(self) -> str:
        pairs = ", ".join(f"{a} x {b}" for a, b in self.pairs)
        return f"from s = {self.s_start:.3f} to {self.s_end:.3f}: {pairs}"


@dataclass(frozen=True)
class KeptPadding:
    """What padding a motion is proven to keep.

    Attributes:
        padding: Metres, on all of it but ``near_ends``.
        near_ends: Where named pairs are closer.
        note: What a person should know of it; empty if all that was asked for is kept everywhere.
        proof: That it is kept everywhere, if the certificate of the motion was too rough to show it.
    """

    padding: float
    near_ends: tuple[NearEnd, ...] = ()
    note: str = ""
    proof: Certificate | None = None


@dataclass(frozen=True, eq=False)
class Origin:
    """Where a result comes from.

    Attributes:
        world: What it was planned in.
        request: What was asked; None for a given polyline.
        pace: How fast a given polyline was to be travelled; None for a request.
        elsewhere: Whether a server planned it: before an arm moves it is proven again, as a plan from a file is.
    """

    world: World
    request: PlanRequest | None
    pace: Pace | None = None
    elsewhere: bool = False


@dataclass(frozen=True, eq=False)
class PlanResult:
    """A plan, or the reason why there is none.

    Attributes:
        path: The geometry q(s), its corners blended, None without a plan.
        trajectory: The same geometry in time, None without a plan.
        failure: None with a plan.
        stages: What each stage cost, in order; a retried stage appears once, with all its tries.
        goal_index: Which of the requested goals the path reaches.
        attempts: Searches started; 0 when a straight line was free.
        padding: Metres that everything keeps, except on ``near_ends`` and on exempt stretches at the ends. For a given
            line, and wherever an end is closer, it is what is proven of the requested padding; else what the search
            kept at its samples.
        deterministic: False if the clock or the caller had a say in the result.
        certificate: The proof that the whole path is free, between samples too; with NOT_CERTIFIED, its refusal.
        motion: Peaks over limits, tool speed and durations; None without a plan.
        notes: What a person should know beside it: a clamped start, ends closer than the padding, a second search.
        roadmap: The roadmap of a planner that has one, with all that it learned; not kept in plan files.
        polish: The outcome of optimising; None if it was not asked for, or there was nothing to optimise.
        improvement: What further searches made of the path; None if they were not asked for, or nothing was searched.
        trace: How the search went; None if it was not asked for. Not kept in plan files.
        origin: What it was planned in, and what was asked; None for a result from a file or another process.
        fraction: For a motion of the tool along a path, the share of its length, 0 to 1, that is possible; None for
            other plans. Not kept in plan files.
        constraints: What the motion keeps all along, those of what the robot carries among them; ``certificate.kept``
            is the proof of each, in the same order.
        near_ends: Where named pairs are closer than ``padding``, because they are so at an end.
        no_path: With NO_PATH, the proof; ``save_no_path`` writes it. Not kept in plan files.
        known: The memory that it was planned with; not kept in plan files, nor is the next.
        learned: What its motion adds to that, (k, n), with the names of the joints; None if nothing.
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
    improvement: ImproveReport | None = None
    trace: Trace | None = None
    origin: Origin | None = field(default=None, repr=False)
    fraction: float | None = None
    constraints: tuple[Constraint, ...] = ()
    near_ends: tuple[NearEnd, ...] = ()
    no_path: NoPath | None = None
    known: Memory = field(default=NOTHING, repr=False)
    learned: tuple[FloatArray, tuple[str, ...]] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        copied_in(self, "stages", "notes", "constraints", "near_ends")

    def __getstate__(self) -> dict[str, Any]:
        """Sent to another process it goes without its origin: robot and scene are larger than a plan."""
        return {**self.__dict__, "origin": None}

    def __repr__(self) -> str:
        if self.failure is not None:
            return f"<PlanResult: no plan, {self.failure.reason.value}>"
        seconds = math.nan if self.trajectory is None else self.trajectory.duration
        return f"<PlanResult: {seconds:.2f} s of motion, {self.counts}>"

    def __str__(self) -> str:
        return render_text(self._blocks())

    def _repr_html_(self) -> str:
        return render_html(self._blocks())

    def _blocks(self) -> list[Block]:
        where, unit = "", ""
        if self.origin is not None:
            robot, scene = self.origin.world.robot, self.origin.world.scene
            where, unit = f": {robot.name} in {scene.name or 'unnamed scene'}", length_unit(robot)
        table = CostTable(f"{'planned' if self.ok else 'no plan'}{where}", plan_rows(self), unit)
        return [table, *plan_lines(self), *([] if self.ok else [f"no plan: {self.failure}"])]

    def show(self, *, port: int = 8080, block: bool | None = None) -> OpenPage:
        """Show the robot, the scene and this plan on a page in the browser; see ``PlannerService.view``.

        Raises:
            InvalidRequest: the result comes from a file or another process: ``service.view(result)`` shows it.
            MissingDependency: the extra ``view`` is not installed.
        """
        if self.origin is None:
            raise InvalidRequest(
                "result",
                "a result from a file or another process",
                "one that a service in this process planned; show it with service.view(result)",
            )
        return show_page(self.origin.world, self, port=port, block=block)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plan, or the failure in its place, to a JSON file with its robot, scene and request.

        Raises:
            InvalidRequest: the result comes from a file or another process, or has no place in a file.
            InvalidFile: it cannot be written.
        """
        save_plan(self, path)

    @property
    def ok(self) -> bool:
        """Whether there is a plan."""
        return self.failure is None

    @cached_property
    def memory(self) -> Memory:
        """What was remembered, with this motion; pass it to the next plan."""
        return self.known if self.learned is None else self.known.with_motion(*self.learned)

    @property
    def exempt(self) -> tuple[ExemptInterval, ...]:
        """Stretches on which named pairs were not checked."""
        return () if self.certificate is None else self.certificate.exempt

    @property
    def allowed(self) -> tuple[tuple[str, str], ...]:
        """Pairs that were checked nowhere, as the service allows them to touch."""
        if self.certificate is not None:
            return self.certificate.allowed
        return () if self.origin is None else self.origin.world.allowed

    @property
    def counts(self) -> CheckCounts:
        """The collision checks of the whole plan: the sum of its stages."""
        return sum((report.counts for report in self.stages), CheckCounts())

    @property
    def seconds(self) -> float:
        """Wall time of all stages."""
        return sum(report.seconds for report in self.stages)

    def stage(self, stage: Stage) -> StageReport:
        """The report of a stage; one that did not run cost nothing."""
        reports = (report for report in self.stages if report.stage is stage)
        return next(reports, StageReport(stage, CheckCounts(), 0.0))

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


def plan_rows(plan: PlanResult) -> list[Row]:
    """A row per stage, and the total."""
    return [*(stage_row(plan, report) for report in plan.stages), plan_row("total", [plan])]


def plan_row(name: str, plans: Sequence[PlanResult]) -> Row:
    """One row for all stages of one or more plans; its length and duration only if all of them succeeded."""
    counts = sum((plan.counts for plan in plans), CheckCounts())
    seconds = sum(report.seconds for plan in plans for report in plan.stages)
    return cost_row(name, "", counts, seconds, plans if all(plan.ok for plan in plans) else [])


def cost_row(name: str, note: str, counts: CheckCounts, seconds: float | None, plans: Sequence[PlanResult] = ()) -> Row:
    """A row with the length and the duration of some plans."""
    lengths = [plan.path.length for plan in plans if plan.path is not None]
    durations = [plan.trajectory.duration for plan in plans if plan.trajectory is not None]
    cost = counts.states, counts.edges, counts.distances, seconds
    sums = sum(lengths) if lengths else None, sum(durations) if durations else None
    return Row(name, note, *cost, *sums, projections=counts.projections)


def stage_row(plan: PlanResult, report: StageReport, depth: int = 1) -> Row:
    """The row of one stage; the timing stage has the law and the duration of the motion."""
    note, length, duration = report.note, report.length, None
    if report.stage is Stage.TIMING and plan.trajectory is not None:
        law = note.partition(",")[0]
        note, length, duration = TIMING_LAWS.get(law, law), None, plan.trajectory.duration
    elif report.stage is Stage.CERTIFY:
        length = None
    counts = report.counts
    cost = counts.states, counts.edges, counts.distances, report.seconds
    return Row(report.stage.value, note, *cost, length, duration, depth, counts.projections)


def plan_lines(plan: PlanResult) -> list[str]:
    """How a plan moves, what is proven of it, and what was done beyond the request, a sentence each."""
    lines = [] if plan.motion is None else [f"motion: {plan.motion}"]
    if plan.certificate is not None and plan.ok:
        free = f"proof: {proof_text(plan.certificate.clearance, plan.certificate.distances)}"
        lines.append("; ".join([free, *map(str, plan.certificate.kept)]))
    lines += [] if plan.improvement is None else [f"improved: {plan.improvement}"]
    lines += [] if plan.polish is None else [f"optimised: {plan.polish}"]
    if plan.failure is not None and plan.failure.proven:
        lines.append("proven: no plan exists for this request")
    notes = [
        *plan.notes,
        *(() if plan.certificate is None else plan.certificate.unjudged),
        *allowed_lines(plan.allowed),
    ]
    return [*lines, *(f"note: {note}" for note in notes)]


def allowed_lines(pairs: Iterable[tuple[str, str]]) -> list[str]:
    """Says of each pair that the service allows to touch that it was not judged."""
    return [f"not judged: {a} x {b} (allowed by the service)" for a, b in pairs]
