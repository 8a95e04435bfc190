"""How to handle an object when picking and placing, and the motions that result."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from types import NoneType
from typing import Protocol

import numpy as np

from planner_service.certify import GripperMotion
from planner_service.certify.certifier import clearance_text, proof_text
from planner_service.collision import CancelToken, CheckCounts
from planner_service.constraints.values import MIN_ANGLE, KeepUpright
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import copied_in, instance, items, number
from planner_service.memory import NOTHING, Memory
from planner_service.planning.request import PlanRequest, World, keeps_torques, require_timing
from planner_service.planning.result import Failure, PlanResult, Stage, allowed_lines, cost_row, save_plan, stage_row
from planner_service.presentation.measures import numbers_text
from planner_service.presentation.page import OpenPage, show_page
from planner_service.presentation.tables import Block, CostTable, Row, Table, render_html, render_text
from planner_service.robot.model import length_unit
from planner_service.scene.scene import Scene
from planner_service.timing.laws import Timing

__all__ = [
    "JOIN",
    "MAX_SUPPORT_GAP",
    "SAME_WIDTH",
    "Handling",
    "Segment",
    "StepReport",
    "TaskReport",
    "TaskResult",
    "require_joined",
    "step_table",
    "task_blocks",
    "task_lines",
    "task_rows",
]

MAX_SUPPORT_GAP = 0.05
"""Metres of a lift or of a lowering, at most, within which an object and its support may touch."""

SAME_WIDTH = 1e-6
"""Metres: two openings of a gripper that differ by less are the same."""

JOIN = 1e-6
"""Radians (or metres) between the end of one motion and the start of the next: less than the margin of a proof."""

SHOWN_REASONS = 3
"""Of a step, in print."""

SEARCH_STAGES = (
    Stage.ROADMAP,
    Stage.SEARCH,
    Stage.NO_PATH,
    Stage.SHORTCUT,
    Stage.IMPROVE,
    Stage.POLISH,
    Stage.CERTIFY,
    Stage.TIMING,
)
"""Stages that get a row of their own below a motion that was searched for."""


@dataclass(frozen=True)
class Handling:
    """How an object is taken or set down.

    Attributes:
        support: The obstacle that the object stands on before a pick, or after a place.
        support_gap: Metres of the lift, or of the lowering, within which object and support may touch.
        open_width: The gripper's opening around the object; None for 12 mm of room on either side, and for a cup.
        request: Planner, timing, seed, scales, padding, constraints and limits; its start and goal are not used. Its
            ``time_limit`` is for the whole pick or place, its ``max_checks`` for each motion. All motions keep its
            constraints.
        line_timing: The timing law along the straight tool lines; the request's if None.
        cancel: Ends the task before its next check when cancelled from another thread.
        upright: For a pick, the radians by which what is taken may lean while it is carried from how it stood; None
            for any. The attached object has the constraint, so that every later motion with it keeps it.

    Raises:
        InvalidRequest: A value is of the wrong kind or out of its range, or the request's planner does not keep what is
            taken upright.
    """

    support: str | None = None
    support_gap: float = 0.005
    open_width: float | None = None
    request: PlanRequest | None = None
    line_timing: Timing | None = None
    cancel: CancelToken | None = None
    upright: float | None = None

    def __post_init__(self) -> None:
        instance("support", self.support, (str, NoneType), "the name of an obstacle, or None")
        number("support_gap", self.support_gap, f"metres in [0, {MAX_SUPPORT_GAP:g}]", 0.0, MAX_SUPPORT_GAP)
        if self.open_width is not None:
            number("open_width", self.open_width, "metres in [0, 1], or None", 0.0, 1.0)
        instance("request", self.request, (PlanRequest, NoneType), "a PlanRequest, or None")
        if self.upright is not None:
            number("upright", self.upright, f"radians in [{MIN_ANGLE:g}, pi], or None", MIN_ANGLE, math.pi)
            if self.request is not None:
                self.request.require_keeping([KeepUpright((0.0, 0.0, 1.0), self.upright)])
        if self.line_timing is not None:
            require_timing(self.line_timing)
            if self.request is not None and keeps_torques(self.request.timing) and not keeps_torques(self.line_timing):
                expected = "None, or ToppRa(torque=True): the request keeps torque limits"
                raise InvalidRequest("line_timing", self.line_timing, expected)
        instance("cancel", self.cancel, (CancelToken, NoneType), "a CancelToken, or None")


@dataclass(frozen=True, eq=False)
class Segment:
    """One motion of a task, by name.

    Attributes:
        width: The gripper's opening in metres during it; NaN or 0 without a gripper.
        scene: What stands around the robot, and what it carries, during it. If None, the scene it was planned in or,
            where that is unknown, the scene of the motion before.
        gripper: How it comes to that opening, while the arm stands at the motion's start; None if it has it already.
        timing: Its timing law, if that is not the one of the task's request.
        wait: Seconds that the arm stands still before it, once the gripper is at that opening.
    """

    name: str
    result: PlanResult
    width: float
    scene: Scene | None = None
    gripper: GripperMotion | None = None
    timing: Timing | None = None
    wait: float = 0.0

    @property
    def counts(self) -> CheckCounts:
        """The collision checks of the motion, including the proof of its gripper."""
        if self.gripper is None:
            return self.result.counts
        return self.result.counts + CheckCounts(distances=self.gripper.certificate.distances)

    def world_before(self, before: World) -> World:
        """The same as ``world_after``, with the gripper as it stands before it opens or closes for the motion."""
        world = self.world_after(before)
        return world if self.gripper is None else replace(world, robot=world.robot.with_gripper(self.gripper.start))

    def world_after(self, before: World) -> World:
        """The robot and the scene as they are during this motion.

        Args:
            before: The same of the motion before it, or of the beginning of the task.

        Raises:
            InvalidRequest: the width is outside the gripper's range.
        """
        if self.result.origin is not None:
            return self.result.origin.world
        scene = before.scene if self.scene is None else self.scene
        moves = before.robot.gripper is not None and before.robot.gripper_width != self.width
        if not moves and scene == before.scene:
            return before
        return replace(before, robot=before.robot.with_gripper(self.width) if moves else before.robot, scene=scene)


def require_joined(segments: Sequence[Segment]) -> None:
    """Refuse motions that do not each begin where the one before ends.

    Raises:
        InvalidRequest: it does not, or there is no motion.
        PlanningFailed: a motion without a plan.
    """
    if not items("segments", segments, Segment, "a list of Segment"):
        raise InvalidRequest("segments", segments, "at least one motion")
    paths = [segment.result.unwrap()[0] for segment in segments]
    for before, after, path, then in zip(segments, segments[1:], paths, paths[1:], strict=False):
        end, begin = path.waypoints[-1], then.waypoints[0]
        if not np.array_equal(end.shape, begin.shape) or not np.all(np.abs(end - begin) <= JOIN):
            given = f"{after.name}, which begins at {numbers_text(begin.tolist())}"
            expected = f"one that begins at {numbers_text(end.tolist())}, where {before.name} ends"
            raise InvalidRequest("segments", given, expected)


@dataclass(frozen=True, eq=False)
class StepReport:
    """How often one step of a task was tried, and what was in its way.

    Attributes:
        step: Which, by its number in the task, its kind and its name.
        tried: Ways of it that were looked at, in whatever depth.
        failed: How many of them are not possible.
        reasons: Why, each with how often, the most frequent first; at most 20.
        refused: The last motion that was planned for it in vain; its ``origin`` has the world and the request. None if
            there was none.
    """

    step: str
    tried: int = 0
    failed: int = 0
    reasons: tuple[tuple[str, int], ...] = ()
    refused: PlanResult | None = None

    @property
    def why(self) -> str:
        """The most frequent reasons in one line."""
        shown = self.reasons[:SHOWN_REASONS]
        return "; ".join(f"{reason} ({times})" if times > 1 else reason for reason, times in shown)

    def __str__(self) -> str:
        return f"{self.step}: {self.failed} of {self.tried} failed{': ' if self.reasons else ''}{self.why}"


@dataclass(frozen=True, eq=False)
class TaskResult:
    """What a task came to.

    Attributes:
        segments: The motions, in order.
        world: The robot with its gripper as it stands afterwards, and the scene as it is then; what follows is planned
            by ``PlannerService.of(task.world)``.
        q: Where the robot ends, shape (n,).
        failure: None if every segment has a plan.
        choosing: What it cost to find a grasp or placement that works, beyond the segments.
        notes: Which was chosen, and why others were not.
        request: The planner, timing law, scales and limits of all motions; its goal has no meaning.
        task: What was to be done, in words.
        seconds: Wall time of all of it.
        steps: How each step of the task fared, in their order.
        memory: What was remembered, with these motions; pass it to the next task. Not kept in files.
    """

    segments: tuple[Segment, ...]
    world: World
    q: FloatArray
    failure: Failure | None = None
    choosing: CheckCounts = field(default_factory=CheckCounts)
    notes: tuple[str, ...] = ()
    request: PlanRequest | None = None
    task: str = ""
    seconds: float = 0.0
    steps: tuple[StepReport, ...] = ()
    memory: Memory = field(default=NOTHING, repr=False)

    def __post_init__(self) -> None:
        copied_in(self, "segments", "q", "notes", "steps")

    def __repr__(self) -> str:
        what = f"{self.duration:.2f} s of motion" if self.failure is None else f"no plan, {self.failure.reason.value}"
        return f"<TaskResult: {len(self.segments)} motions, {what}, {self.counts}>"

    def __str__(self) -> str:
        return render_text(self._blocks())

    def _repr_html_(self) -> str:
        return render_html(self._blocks())

    def _blocks(self) -> list[Block]:
        return task_blocks(self, length_unit(self.world.robot))

    @property
    def begin(self) -> World:
        """The robot and the scene before the first motion."""
        return self.segments[0].world_before(self.world) if self.segments else self.world

    @property
    def ok(self) -> bool:
        """Whether every segment has a plan."""
        return self.failure is None

    @property
    def counts(self) -> CheckCounts:
        """The collision checks of the whole task."""
        return sum((segment.counts for segment in self.segments), self.choosing)

    def show(self, *, port: int = 8080, block: bool | None = None) -> OpenPage:
        """Show the motions one after another on a page in the browser; see ``PlannerService.view``.

        Raises:
            MissingDependency: the extra ``view`` is not installed.
        """
        return show_page(self.begin, self, port=port, block=block)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the motions, as far as there are plans, to a JSON file with the robot and the scene of each.

        Raises:
            InvalidRequest: Something in it has no place in a file.
            InvalidFile: It cannot be written.
        """
        save_plan(self, path)

    @property
    def duration(self) -> float:
        """Seconds of motion and of waiting, without what the gripper takes to open and close."""
        moving = [s.result.trajectory.duration for s in self.segments if s.result.trajectory is not None]
        return math.fsum((*moving, *(s.wait for s in self.segments)))


class TaskReport(Protocol):
    """What is printed of a ``TaskResult`` or a ``SavedTask``."""

    @property
    def segments(self) -> tuple[Segment, ...]: ...
    @property
    def choosing(self) -> CheckCounts: ...
    @property
    def counts(self) -> CheckCounts: ...
    @property
    def failure(self) -> Failure | None: ...
    @property
    def notes(self) -> tuple[str, ...]: ...
    @property
    def task(self) -> str: ...
    @property
    def seconds(self) -> float: ...
    @property
    def steps(self) -> tuple[StepReport, ...]: ...


def task_blocks(task: TaskReport, unit: str) -> list[Block]:
    """A task as ``planner-service solve`` prints it: one without a plan also with how its steps fared.

    Args:
        unit: Unit of path lengths.
    """
    title = ": ".join(filter(None, ("planned" if task.failure is None else "no plan", task.task)))
    ending = [] if task.failure is None else [f"no plan: {task.failure}"]
    fared: list[Block] = [] if task.failure is None or not task.steps else ["", step_table(task.steps)]
    return [CostTable(title, task_rows(task), unit), *task_lines(task), *ending, *fared]


def step_table(steps: Sequence[StepReport]) -> Table:
    """How often each step of a task was tried, how often it failed, and why."""
    rows = [(step.step, f"{step.tried:,}", f"{step.failed:,}", step.why if step.failed else "") for step in steps]
    return Table(["step", "tried", "failed", "most frequent reasons"], rows)


def task_rows(task: TaskReport) -> list[Row]:
    """A row per motion, with its stages below if it was searched for, then the choice of grasps, and the total."""
    rows: list[Row] = []
    for motion in task.segments:
        rows += [] if motion.gripper is None else [_gripper_row(motion.gripper)]
        rows += _motion_rows(motion.name, motion.result)
    seconds = sum(row.seconds or 0.0 for row in rows)
    choosing = task.seconds - seconds if task.seconds else None
    rows.append(cost_row("choosing", "grasp, placement and their straight lines", task.choosing, choosing))
    plans = [motion.result for motion in task.segments] if task.failure is None else []
    return [*rows, cost_row("total", "", task.counts, task.seconds or seconds, plans)]


def _gripper_row(motion: GripperMotion) -> Row:
    proof = motion.certificate
    verdict = f"proven: {clearance_text(proof.clearance)}" if proof.certified else motion.refused
    note = f"{motion.start * 1e3:.1f} -> {motion.end * 1e3:.1f} mm, {verdict}"
    return cost_row(motion.name, note, CheckCounts(distances=proof.distances), motion.seconds)


def _motion_rows(name: str, plan: PlanResult) -> list[Row]:
    straight = plan.ok and not plan.attempts
    below = [] if straight else [report for report in plan.stages if report.stage in SEARCH_STAGES]
    merged = [report for report in plan.stages if report not in below]
    counts, seconds = sum((each.counts for each in merged), CheckCounts()), sum(each.seconds for each in merged)
    row = cost_row(name, _straight_line_note(plan), counts, seconds, [plan] if straight else [])
    return [row, *(stage_row(plan, report, 2) for report in below)]


def _straight_line_note(plan: PlanResult) -> str:
    for report in plan.stages:
        if report.stage is Stage.STRAIGHT_LINE:
            separator = " " if report.note.startswith("blocked") else ", "
            return separator.join(filter(None, ("straight line", report.note)))
    return ""


def task_lines(task: TaskReport) -> list[str]:
    """What is proven of a task, and what was done beyond the request, a sentence each."""
    results = [motion.result for motion in task.segments]
    proofs = [plan.certificate for plan in results if plan.certificate is not None and plan.ok]
    proofs += [motion.gripper.certificate for motion in task.segments if motion.gripper is not None]
    lines = []
    if proofs:
        clearance, bounds = min(proof.clearance for proof in proofs), sum(proof.distances for proof in proofs)
        lines.append(f"proof: {proof_text(clearance, bounds)}")
    notes = [*task.notes, *(f"{motion.name}: {note}" for motion in task.segments for note in motion.result.notes)]
    notes += allowed_lines(dict.fromkeys(pair for result in results for pair in result.allowed))
    return [*lines, *(f"note: {note}" for note in notes)]
