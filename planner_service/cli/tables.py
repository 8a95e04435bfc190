"""Plans as tables for people: a row per stage or motion, whose numbers add up to the last row."""

from __future__ import annotations

import math
import os
import sys
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rich.console import Console, RenderableType
from rich.text import Text

from planner_service.certify import GripperMotion
from planner_service.collision import CheckCounts
from planner_service.planning.accounting import in_words
from planner_service.planning.result import MotionReport, PlanResult, PolishReport, Stage, StageReport
from planner_service.records.plan_file import SavedTask
from planner_service.robot_setup.kernel_check import Health

__all__ = [
    "UNATTENDED_WIDTH",
    "Row",
    "console",
    "emit",
    "health_words",
    "motion_words",
    "plan_rows",
    "plan_words",
    "polish_words",
    "proof_words",
    "render",
    "table",
    "task_rows",
]

UNATTENDED_WIDTH = 100
"""Columns of output that goes to no terminal."""

NARROW = 88
"""With fewer columns, a row takes a line for its words and one for its numbers."""

NAME_WIDTH = 19
_NUMBERS = ("states", "edges", "distances", "ms")
_NUMBER_WIDTHS = (7, 7, 11, 8)
_LENGTH_WIDTH, _DURATION_WIDTH = 10, 9

_SHOWN_APART = (Stage.ROADMAP, Stage.SEARCH, Stage.SHORTCUT, Stage.POLISH, Stage.CERTIFY, Stage.TIMING)
_TIMING_WORDS = {"toppra": "TOPP-RA", "trapezoidal": "trapezoid", "s-curve": "S-curve"}


@dataclass(frozen=True)
class Row:
    """A line of a table; ``depth`` indents it, 0 is for totals."""

    name: str
    note: str
    counts: CheckCounts
    seconds: float
    length: float | None = None
    duration: float | None = None
    depth: int = 1


def plan_rows(result: PlanResult) -> list[Row]:
    """A row per stage of a plan, and the total."""
    rows = [_stage_row(result, report, 1) for report in result.stages]
    return [*rows, _total(result.counts, result.seconds, [result], ok=result.ok)]


def task_rows(task: SavedTask) -> list[Row]:
    """A row per motion of a task, those of its stages under one that had to search, and the total."""
    rows: list[Row] = []
    for segment in task.segments:
        rows += [] if segment.gripper is None else [_gripper_row(segment.gripper)]
        rows += _segment_rows(segment.name, segment.result)
    results = [segment.result for segment in task.segments]
    rest = task.seconds - sum(row.seconds for row in rows)
    rows.append(Row("choosing", "grasp, placement and their straight lines", task.choosing, rest))
    return [*rows, _total(task.counts, task.seconds, results, ok=task.failure is None)]


def _gripper_row(motion: GripperMotion) -> Row:
    proof = motion.certificate
    found = f"proven: {in_words(proof.clearance)}" if proof.certified else motion.refused
    note = f"{motion.start * 1e3:.1f} -> {motion.end * 1e3:.1f} mm, {found}"
    return Row(motion.name, note, CheckCounts(distances=proof.distances), motion.seconds)


def _segment_rows(name: str, result: PlanResult) -> list[Row]:
    """One row for a motion that is a straight line; for one that searched also a row for each stage from there on."""
    if result.ok and not result.attempts:
        return [_merged(name, _line_words(result), result.stages, result)]
    later = [report for report in result.stages if report.stage in _SHOWN_APART]
    rest = [report for report in result.stages if report not in later]
    return [_merged(name, _line_words(result), rest, None), *(_stage_row(result, report, 2) for report in later)]


def _line_words(result: PlanResult) -> str:
    report = next((report for report in result.stages if report.stage is Stage.STRAIGHT_LINE), None)
    if report is None:
        return ""
    join = " " if report.note.startswith("blocked") else ", "
    return join.join(filter(None, ("straight line", report.note)))


def _merged(name: str, note: str, reports: Sequence[StageReport], result: PlanResult | None) -> Row:
    counts = sum((report.counts for report in reports), CheckCounts())
    length = duration = None
    if result is not None and result.path is not None and result.trajectory is not None:
        length, duration = result.path.length, result.trajectory.duration
    return Row(name, note, counts, sum(report.seconds for report in reports), length, duration)


def _stage_row(result: PlanResult, report: StageReport, depth: int) -> Row:
    note, length, duration = report.note, report.length, None
    if report.stage is Stage.TIMING and result.trajectory is not None:
        law = note.partition(",")[0]
        note, length, duration = _TIMING_WORDS.get(law, law), None, result.trajectory.duration
    if report.stage is Stage.CERTIFY:
        length = None
    return Row(report.stage.value, note, report.counts, report.seconds, length, duration, depth)


def proof_words(results: Sequence[PlanResult], grips: Sequence[GripperMotion] = ()) -> str:
    """What is proven of motions that have plans, and of the gripper's, in a sentence; empty if there are none."""
    proofs = [result.certificate for result in results if result.certificate is not None and result.ok]
    proofs += [motion.certificate for motion in grips]
    if not proofs:
        return ""
    bounds = sum(proof.distances for proof in proofs)
    return f"proof: {in_words(min(proof.clearance for proof in proofs))}, between samples too ({bounds:,} bounds)"


def plan_words(result: PlanResult) -> list[str]:
    """How a plan moves, what is proven of it, and what was done beyond what was asked, a line each."""
    told = [] if result.motion is None else [motion_words(result.motion), proof_words([result])]
    told += [] if result.polish is None else [polish_words(result.polish)]
    return [*told, *(f"note: {note}" for note in (*result.notes, *map(str, result.exempt)))]


def motion_words(motion: MotionReport) -> str:
    """How a motion moves, in a sentence."""
    kinds = (
        ("velocity", motion.peaks.velocity),
        ("acceleration", motion.peaks.acceleration),
        ("jerk", motion.peaks.jerk),
    )
    peaks = ", ".join(f"{name} {peak.ratio:.0%}" for name, peak in kinds if math.isfinite(peak.ratio))
    faster = motion.duration < motion.stop_duration < math.inf
    stops = f" ({motion.stop_duration:.2f} s with a stop at each corner)" if faster else ""
    return (
        f"motion: {motion.duration:.2f} s{stops}; used of the limits: {peaks}; tool up to {motion.tool_speed:.2f} m/s"
    )


def polish_words(report: PolishReport) -> str:
    """What optimising came to, in a sentence."""
    before, after = report.before, report.after
    told = (
        f"length {before.length:.2f} -> {after.length:.2f}, cost {before.cost:.3f} -> {after.cost:.3f}, "
        f"smallest clearance at waypoints {before.clearance * 1000:.1f} -> {after.clearance * 1000:.1f} mm"
    )
    end = "" if report.kept else f"; not kept: {report.note}"
    return f"optimised: {told}; {report.method}, {report.iterations} iterations, {report.gradients:,} gradients{end}"


def health_words(health: Health, where: str) -> list[str]:
    """What is compiled, how it compares, and how fast it is."""
    asked = (
        ("checks", health.checks, f"random states of {where}", "collide", "a state"),
        ("proofs", health.proofs, "short edges between them", "are refused", "an edge"),
    )
    lines = []
    for name, told, questions, refused, one in asked:
        lines += [
            f"{name}: not compiled, numpy stands in; plans are the same and take longer"
            if told.instruction_set is None
            else f"{name}: {told.instruction_set}; this processor can run {', '.join(told.available)}",
            f"  compared on {told.asked:,} {questions} ({told.refused:,} {refused}): {told.differences:,} differences",
            f"  {one} takes {told.us:.1f} us, {told.reference_us:.1f} us by the reference",
        ]
    return lines


def _total(counts: CheckCounts, seconds: float, results: Sequence[PlanResult], *, ok: bool) -> Row:
    length = duration = None
    if ok:
        length = sum(result.path.length for result in results if result.path is not None)
        duration = sum(result.trajectory.duration for result in results if result.trajectory is not None)
    return Row("total", "", counts, seconds, length, duration)


def table(title: str, rows: Iterable[Row], width: int, unit: str = "rad") -> Text:
    """Rows in columns; where the terminal is narrow, each in two lines.

    Args:
        unit: Of path lengths.
    """
    lines = _wide(title, rows, width, unit) if width >= NARROW else _stacked(title, rows, width, unit)
    text = Text("\n").join(lines)
    text.no_wrap, text.overflow = True, "ignore"
    return text


def _wide(title: str, rows: Iterable[Row], width: int, unit: str) -> list[Text]:
    room = min(width, UNATTENDED_WIDTH) - sum(_NUMBER_WIDTHS)
    heads = "".join(f"{name:>{size}}" for name, size in zip(_NUMBERS, _NUMBER_WIDTHS, strict=True))
    first, *more = textwrap.wrap(title, room - 1) or [""]
    lines = [
        Text(f"{first:<{room}}", style="bold").append(heads, style="dim"),
        *(Text(f"  {line}", "bold") for line in more),
    ]
    for row in rows:
        length, duration = _amounts(row, unit)
        amounts = f"{length:>{_LENGTH_WIDTH}}{duration:>{_DURATION_WIDTH}}" if length else duration
        name = f"{'  ' * row.depth}{row.name}"
        notes = textwrap.wrap(row.note, room - NAME_WIDTH - len(amounts)) or [""]
        left = f"{name:<{NAME_WIDTH - 1}} {notes[0]}"
        lines.append(
            Text(left + amounts.rjust(room - len(left)) + _numbers(row), "bold" if row.name == "total" else "")
        )
        lines += [Text(" " * NAME_WIDTH + note) for note in notes[1:]]
    return lines


def _stacked(title: str, rows: Iterable[Row], width: int, unit: str) -> list[Text]:
    lines = [Text(line, "bold") for line in textwrap.wrap(title, width)]
    for row in rows:
        indent = "  " * row.depth
        words = f"{row.name}: {row.note}" if row.note else row.name
        lines += [Text(line) for line in textwrap.wrap(words, width, initial_indent=indent, subsequent_indent=indent)]
        counts = row.counts
        told = [f"{value:,} {name}" for value, name in zip(_counted(counts), _NUMBERS, strict=False)]
        numbers = ", ".join([*filter(None, _amounts(row, unit)), *told, f"{row.seconds * 1000:.1f} ms"])
        indent += "    "
        lines += [
            Text(line, "dim") for line in textwrap.wrap(numbers, width, initial_indent=indent, subsequent_indent=indent)
        ]
    return lines


def _amounts(row: Row, unit: str) -> tuple[str, str]:
    length = "" if row.length is None else f"{row.length:.2f} {unit}"
    return length, "" if row.duration is None else f"{row.duration:.2f} s"


def _numbers(row: Row) -> str:
    values = [*(f"{value:,}" for value in _counted(row.counts)), f"{row.seconds * 1000:,.1f}"]
    return "".join(f"{value:>{size}}" for value, size in zip(values, _NUMBER_WIDTHS, strict=True))


def _counted(counts: CheckCounts) -> tuple[int, int, int]:
    return counts.states, counts.edges, counts.distances


def console() -> Console:
    """Standard output as it is now: as wide as the terminal, 100 columns where there is none and nobody said."""
    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else UNATTENDED_WIDTH
    return Console(file=sys.stdout, width=width, highlight=False, markup=False, emoji=False)


def render(*parts: RenderableType) -> str:
    """What to write to standard output for these parts: with colours only if it is a terminal."""
    screen = console()
    with screen.capture() as capture:
        for part in parts:
            screen.print(part, soft_wrap=isinstance(part, str))
    return capture.get()


def emit(text: str) -> None:
    """Write to standard output; once its reader is gone, to nowhere, so that the command still ends as it should."""
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
