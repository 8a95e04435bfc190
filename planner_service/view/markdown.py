"""The texts of the page, as Markdown; every name is escaped, as names come from files."""

from __future__ import annotations

import math

from planner_service.certify.certifier import clearance_text
from planner_service.collision import Contact
from planner_service.planning.result import PlanResult, plan_row, plan_rows
from planner_service.presentation.tables import CostTable, markdown_escaped
from planner_service.view.collision_report import CollisionReport
from planner_service.view.state import ViewState

__all__ = ["report_markdown", "result_markdown", "state_markdown"]

MAX_CONTACTS = 5

MAX_STEPS = 20
"""Steps that failed once or more, of which is said why."""


def report_markdown(report: CollisionReport) -> str:
    """Contacts and clearance of a configuration."""
    if report.contacts:
        return "**in collision**\n\n" + _contact_lines(report.contacts)
    room = "nothing to touch" if report.clearance == math.inf else f"at least {_millimetres(report.clearance)} clear"
    verdict = "touching" if report.clearance <= 0.0 else f"**free**: {room}"
    return verdict + ("\n\nexpected contacts:\n\n" + _contact_lines(report.expected) if report.expected else "")


def _millimetres(metres: float) -> str:
    return f"{math.floor(metres * 1e4) / 10:.1f} mm"


def _contact_lines(contacts: tuple[Contact, ...]) -> str:
    lines = [
        f"- {markdown_escaped(contact.a)} × {markdown_escaped(contact.b)}, at most {contact.depth * 1000:.1f} mm deep"
        for contact in contacts[:MAX_CONTACTS]
    ]
    more = len(contacts) - len(lines)
    return "\n".join([*lines, *([f"- and {more} more"] if more else [])])


def state_markdown(state: ViewState) -> str:
    """Which motion is shown, at what time, and what the robot carries."""
    if state.playback is None or state.seconds is None:
        return "moved by hand" if state.playback is not None else ""
    clip = state.playback.at(state.seconds).clip
    name = "" if len(state.playback.clips) == 1 else f"{markdown_escaped(clip.name)}, "
    carried = "".join(f", carrying {markdown_escaped(held.name)}" for held in state.service.scene.attached)
    return f"{name}{state.seconds:.2f} of {state.playback.duration:.2f} s{carried}"


def result_markdown(state: ViewState) -> str:
    """What was planned and what it cost, by stage, or by motion of a task; or why there is no plan."""
    if not state.results and state.failure is None:
        return "nothing planned yet"
    results = [segment.result for segment in state.results]
    if len(results) == 1:
        rows = plan_rows(results[0])
    else:
        rows = [plan_row(segment.name, [segment.result]) for segment in state.results]
        rows.append(plan_row("total", results))
    lines = [f"**no plan**: {markdown_escaped(str(state.failure))}"] if state.failure is not None else []
    lines += ["**proven**: no plan exists"] if state.failure is not None and state.failure.proven else []
    side_by_side = state.playback is not None and bool(state.playback.rows)
    motion = [] if side_by_side else _motion(results)
    lines += [*_steps(state), *_proof(results), *motion, CostTable("", rows).markdown()]
    lines += [f"- {markdown_escaped(note)}" for result in results for note in result.notes]
    return "\n\n".join(lines)


def _steps(state: ViewState) -> list[str]:
    """What was in the way of steps of a task."""
    failed = [step for step in state.steps if step.failed][:MAX_STEPS]
    rows = [f"| {_cell(step.step)} | {step.failed} of {step.tried} | {_cell(step.why)} |" for step in failed]
    return ["\n".join(["| step | failed | most frequent reasons |", "|---|---|---|", *rows])] if rows else []


def _cell(text: str) -> str:
    """A text in a cell of a table, on one line."""
    return markdown_escaped(" ".join(text.split()))


def _proof(results: list[PlanResult]) -> list[str]:
    clearances = [result.certificate.clearance for result in results if result.certificate is not None and result.ok]
    return [f"**certified**: {clearance_text(min(clearances))}, between samples too"] if clearances else []


def _motion(results: list[PlanResult]) -> list[str]:
    planned = [result for result in results if result.path is not None and result.motion is not None]
    if not planned:
        return []
    seconds = math.fsum(result.motion.duration for result in planned if result.motion is not None)
    length = math.fsum(result.path.length for result in planned if result.path is not None)
    return [f"{seconds:.2f} s, {length:.2f} of path"]
