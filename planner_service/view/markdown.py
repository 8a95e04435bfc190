"""What a page says, as Markdown."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from planner_service.collision import CheckCounts, Contact
from planner_service.planning.accounting import in_words
from planner_service.planning.result import PlanResult
from planner_service.view.collision_report import Look
from planner_service.view.state import ViewState

__all__ = ["look_words", "plain", "result_words", "state_words"]

HEAD = "| | states | edges | distances | ms |\n|:--|--:|--:|--:|--:|"
MOST_CONTACTS = 5

SIGNS = re.compile(r"[!-/:-@\[-`{-~]")
"""What Markdown may read as a sign, and as itself after a backslash: ASCII's punctuation."""


def look_words(look: Look) -> str:
    """What is to be said of a configuration."""
    if look.contacts:
        return "**collides**\n\n" + _contact_lines(look.contacts)
    room = "nothing to touch" if look.clearance == math.inf else f"at least {_millimetres(look.clearance)} of room"
    words = "touches" if look.clearance <= 0.0 else f"**free**: {room}"
    return words + ("\n\nmeant to touch:\n\n" + _contact_lines(look.meant) if look.meant else "")


def _millimetres(metres: float) -> str:
    return f"{math.floor(metres * 1e4) / 10:.1f} mm"


def _contact_lines(contacts: tuple[Contact, ...]) -> str:
    lines = [f"- {plain(c.a)} × {plain(c.b)}, at most {c.depth * 1000:.1f} mm deep" for c in contacts[:MOST_CONTACTS]]
    more = len(contacts) - len(lines)
    return "\n".join([*lines, *([f"- and {more} more"] if more else [])])


def state_words(state: ViewState) -> str:
    """Which motion is to be seen, and what is carried."""
    if state.reel is None or state.seconds is None:
        return "moved by hand" if state.reel is not None else ""
    take = state.reel.at(state.seconds).take
    name = "" if len(state.reel.takes) == 1 else f"{plain(take.name)}, "
    carried = "".join(f", carrying {plain(held.name)}" for held in state.service.scene.attached)
    return f"{name}{state.seconds:.2f} of {state.reel.duration:.2f} s{carried}"


def result_words(state: ViewState) -> str:
    """What was planned and what it cost, by stage, or by motion of a task; or why there is no plan."""
    if not state.results and state.failure is None:
        return "nothing planned yet"
    results = [segment.result for segment in state.results]
    if len(results) == 1:
        rows = [(report.stage.value, report.counts, report.seconds) for report in results[0].stages]
    else:
        rows = [(plain(segment.name), segment.result.counts, segment.result.seconds) for segment in state.results]
    total = sum((counts for _, counts, _ in rows), CheckCounts()), sum(seconds for *_, seconds in rows)
    table = "\n".join([HEAD, *(_row(*row) for row in rows), _row("**total**", *total)])
    lines = [f"**no plan**: {plain(str(state.failure))}"] if state.failure is not None else []
    lines += [*_proof(results), *_motion(results), table]
    lines += [f"- {plain(note)}" for result in results for note in result.notes]
    return "\n\n".join(lines)


def _row(name: str, counts: CheckCounts, seconds: float) -> str:
    return f"| {name} | {counts.states:,} | {counts.edges:,} | {counts.distances:,} | {seconds * 1000:,.1f} |"


def _proof(results: Iterable[PlanResult]) -> list[str]:
    proofs = [result.certificate for result in results if result.certificate is not None and result.ok]
    if not proofs:
        return []
    return [f"**certified**: {in_words(min(proof.clearance for proof in proofs))}, between samples too"]


def _motion(results: Iterable[PlanResult]) -> list[str]:
    paths = [(r.path.length, r.motion.duration) for r in results if r.path is not None and r.motion is not None]
    if not paths:
        return []
    return [f"{math.fsum(s for _, s in paths):.2f} s, {math.fsum(length for length, _ in paths):.2f} of path"]


def plain(text: str) -> str:
    """A text in which neither Markdown nor HTML finds anything to do: names come from files."""
    return SIGNS.sub(r"\\\g<0>", text)
