"""Plans and tasks as text and HTML: what each stage or motion did and cost, and what was proven.

Results are described here by the few attributes that are shown, so that they can print themselves.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Sequence
from typing import Protocol

from planner_service.presentation.tables import Block, CostTable, Row

__all__ = [
    "clearance_text",
    "counts_text",
    "plan_blocks",
    "plan_lines",
    "plan_row",
    "plan_rows",
    "proof_text",
    "task_blocks",
    "task_lines",
    "task_rows",
]

SEARCH_STAGES = ("roadmap", "search", "shortcut", "polish", "certify", "timing")
"""Stages that get a row of their own below a motion of a task that was searched for."""

TIMING_LAWS = {"toppra": "TOPP-RA", "trapezoidal": "trapezoid", "s-curve": "S-curve"}


class Counts(Protocol):
    """See ``CheckCounts``."""

    @property
    def states(self) -> int: ...
    @property
    def edges(self) -> int: ...
    @property
    def distances(self) -> int: ...


class Path(Protocol):
    """See ``JointPath``."""

    @property
    def length(self) -> float: ...


class Motion(Protocol):
    """See ``Trajectory``."""

    @property
    def duration(self) -> float: ...


class Proof(Protocol):
    """See ``Certificate``."""

    @property
    def certified(self) -> bool: ...
    @property
    def clearance(self) -> float: ...
    @property
    def distances(self) -> int: ...


class StageCost(Protocol):
    """See ``StageReport``."""

    @property
    def stage(self) -> enum.Enum: ...
    @property
    def counts(self) -> Counts: ...
    @property
    def seconds(self) -> float: ...
    @property
    def length(self) -> float | None: ...
    @property
    def note(self) -> str: ...


class Plan(Protocol):
    """See ``PlanResult``."""

    @property
    def path(self) -> Path | None: ...
    @property
    def trajectory(self) -> Motion | None: ...
    @property
    def failure(self) -> object | None: ...
    @property
    def stages(self) -> Sequence[StageCost]: ...
    @property
    def attempts(self) -> int: ...
    @property
    def certificate(self) -> Proof | None: ...
    @property
    def motion(self) -> object | None: ...
    @property
    def polish(self) -> object | None: ...
    @property
    def notes(self) -> Sequence[str]: ...
    @property
    def exempt(self) -> Sequence[object]: ...


class GripperStep(Protocol):
    """See ``GripperMotion``."""

    @property
    def name(self) -> str: ...
    @property
    def start(self) -> float: ...
    @property
    def end(self) -> float: ...
    @property
    def certificate(self) -> Proof: ...
    @property
    def refused(self) -> str: ...
    @property
    def seconds(self) -> float: ...


class TaskMotion(Protocol):
    """See ``Segment``."""

    @property
    def name(self) -> str: ...
    @property
    def result(self) -> Plan: ...
    @property
    def gripper(self) -> GripperStep | None: ...


class Task(Protocol):
    """See ``TaskResult`` and ``SavedTask``."""

    @property
    def segments(self) -> Sequence[TaskMotion]: ...
    @property
    def choosing(self) -> Counts: ...
    @property
    def counts(self) -> Counts: ...
    @property
    def failure(self) -> object | None: ...
    @property
    def notes(self) -> Sequence[str]: ...
    @property
    def task(self) -> str: ...
    @property
    def seconds(self) -> float: ...


def clearance_text(metres: float) -> str:
    """A proven clearance in words, rounded down."""
    if metres == math.inf:
        return "nothing to touch"
    return f"{math.floor(metres * 1e5) / 100:.2f} mm clear" if metres < 0.1 else f"{metres:.3f} m clear"


def counts_text(counts: Counts) -> str:
    """Check counts in words."""
    parts = [(counts.states, "state"), (counts.edges, "edge")]
    parts += [(counts.distances, "distance")] if counts.distances else []
    return ", ".join(f"{number:,} {noun}{'' if number == 1 else 's'}" for number, noun in parts)


def proof_text(proofs: Sequence[Proof]) -> str:
    """What is proven of one or more motions."""
    bounds = sum(proof.distances for proof in proofs)
    clearance = clearance_text(min(proof.clearance for proof in proofs))
    return f"{clearance}, between samples too ({bounds:,} bounds)"


def _row(
    name: str,
    note: str,
    counts: Iterable[Counts],
    seconds: float | None,
    plans: Iterable[Plan] = (),
    *,
    depth: int = 1,
) -> Row:
    """A row with the sum of some counts, and with the length and duration of some plans."""
    spent = list(counts)
    paths = [plan.path.length for plan in plans if plan.path is not None]
    motions = [plan.trajectory.duration for plan in plans if plan.trajectory is not None]
    return Row(
        name,
        note,
        sum(each.states for each in spent),
        sum(each.edges for each in spent),
        sum(each.distances for each in spent),
        seconds,
        sum(paths) if paths else None,
        sum(motions) if motions else None,
        depth,
    )


def _stage_row(plan: Plan, report: StageCost, depth: int = 1) -> Row:
    note, length, duration, stage = report.note, report.length, None, report.stage.value
    if stage == "timing" and plan.trajectory is not None:
        law = note.partition(",")[0]
        note, length, duration = TIMING_LAWS.get(law, law), None, plan.trajectory.duration
    elif stage == "certify":
        length = None
    counts = report.counts
    return Row(stage, note, counts.states, counts.edges, counts.distances, report.seconds, length, duration, depth)


def plan_rows(plan: Plan) -> list[Row]:
    """A row per stage, and the total."""
    return [*(_stage_row(plan, report) for report in plan.stages), plan_row("total", [plan])]


def plan_row(name: str, plans: Sequence[Plan]) -> Row:
    """One row for all stages of one or more plans; its length and duration only if all of them succeeded."""
    stages = [report for plan in plans for report in plan.stages]
    seconds = sum(report.seconds for report in stages)
    done = plans if all(plan.failure is None for plan in plans) else []
    return _row(name, "", [report.counts for report in stages], seconds, done)


def task_rows(task: Task) -> list[Row]:
    """A row per motion, with its stages below if it was searched for, then the choice of grasps, and the total."""
    rows: list[Row] = []
    for motion in task.segments:
        rows += [] if motion.gripper is None else [_gripper_row(motion.gripper)]
        rows += _motion_rows(motion.name, motion.result)
    motions = sum(row.seconds or 0.0 for row in rows)
    choosing = task.seconds - motions if task.seconds else None
    rows.append(_row("choosing", "grasp, placement and their straight lines", [task.choosing], choosing))
    plans = [motion.result for motion in task.segments] if task.failure is None else []
    return [*rows, _row("total", "", [task.counts], task.seconds or motions, plans)]


def _gripper_row(step: GripperStep) -> Row:
    proof = step.certificate
    verdict = f"proven: {clearance_text(proof.clearance)}" if proof.certified else step.refused
    note = f"{step.start * 1e3:.1f} -> {step.end * 1e3:.1f} mm, {verdict}"
    return Row(step.name, note, 0, 0, proof.distances, step.seconds)


def _motion_rows(name: str, plan: Plan) -> list[Row]:
    straight = plan.failure is None and not plan.attempts
    below = [] if straight else [report for report in plan.stages if report.stage.value in SEARCH_STAGES]
    merged = [report for report in plan.stages if report not in below]
    counts, seconds = [report.counts for report in merged], sum(report.seconds for report in merged)
    row = _row(name, _straight_line_note(plan), counts, seconds, [plan] if straight else [])
    return [row, *(_stage_row(plan, report, 2) for report in below)]


def _straight_line_note(plan: Plan) -> str:
    for report in plan.stages:
        if report.stage.value == "straight line":
            separator = " " if report.note.startswith("blocked") else ", "
            return separator.join(filter(None, ("straight line", report.note)))
    return ""


def plan_lines(plan: Plan) -> list[str]:
    """How a plan moves, what is proven of it, and what was done beyond the request, a sentence each."""
    lines = [] if plan.motion is None else [f"motion: {plan.motion}"]
    if plan.certificate is not None and plan.failure is None:
        lines.append(f"proof: {proof_text([plan.certificate])}")
    lines += [] if plan.polish is None else [f"optimised: {plan.polish}"]
    return [*lines, *(f"note: {note}" for note in (*plan.notes, *map(str, plan.exempt)))]


def task_lines(task: Task) -> list[str]:
    """What is proven of a task, and what was done beyond the request, a sentence each."""
    results = [motion.result for motion in task.segments]
    proofs = [plan.certificate for plan in results if plan.certificate is not None and plan.failure is None]
    proofs += [motion.gripper.certificate for motion in task.segments if motion.gripper is not None]
    notes = [*task.notes, *(f"{motion.name}: {note}" for motion in task.segments for note in motion.result.notes)]
    proof = [f"proof: {proof_text(proofs)}"] if proofs else []
    return [*proof, *(f"note: {note}" for note in notes)]


def plan_blocks(plan: Plan, where: str = "", *, unit: str = "") -> list[Block]:
    """A plan as ``planner-service plan`` prints it.

    Args:
        where: Robot and scene, for the title.
        unit: Unit of path lengths.
    """
    title = ": ".join(filter(None, ("planned" if plan.failure is None else "no plan", where)))
    return [CostTable(title, plan_rows(plan), unit), *plan_lines(plan), *_ending(plan.failure)]


def task_blocks(task: Task, *, unit: str = "") -> list[Block]:
    """A task as ``planner-service pick-place`` prints it.

    Args:
        unit: Unit of path lengths.
    """
    verdict = "planned" if task.failure is None else "no plan"
    title = ": ".join(filter(None, (verdict, task.task)))
    return [CostTable(title, task_rows(task), unit), *task_lines(task), *_ending(task.failure)]


def _ending(failure: object | None) -> list[str]:
    return [] if failure is None else [f"no plan: {failure}"]
