"""Roadmaps as JSON objects and as lines: what is in one, what a query learned, what a scene changed."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from planner_service.cli.tables import UNATTENDED_WIDTH, console
from planner_service.collision import CheckCounts
from planner_service.planning.roadmap_work import RoadmapUpdate
from planner_service.records.result import counts_record
from planner_service.roadmap import Roadmap, Terms, Verdict
from planner_service.roadmap.verdicts import Knowledge

__all__ = [
    "Learned",
    "cost_words",
    "difference",
    "edge_words",
    "facts",
    "grower_words",
    "milestone_words",
    "roadmap_facts",
    "roadmap_record",
    "size_words",
    "update_record",
]

NAME_WIDTH = 14

_ALWAYS = (Verdict.FREE, Verdict.BLOCKED, Verdict.UNKNOWN)
_REDONE = (Verdict.FREE_BEFORE, Verdict.BLOCKED_BEFORE)


@dataclass(frozen=True)
class Learned:
    """What one value of a roadmap knows that another, from which it came, did not.

    Attributes:
        free: Edges that were not known, and are free.
        blocked: Edges that were not known, and are blocked.
        again: Edges that were free before the scene changed, and were found free again.
        fell: Edges that were free before the scene changed, and are blocked.
        rose: Edges that were blocked before the scene changed, and are free.
        milestones: How many were added.
        edges: How many were added.
    """

    free: int
    blocked: int
    again: int
    fell: int
    rose: int
    milestones: int
    edges: int

    @classmethod
    def of(cls, before: Roadmap, after: Roadmap) -> Learned:
        """What ``after`` knows beyond what is left of ``before`` where it was learned."""
        here = before if after.terms is None else before.under(after.terms)
        was, now = here.verdicts, after.verdicts[: len(here.verdicts)]

        def both(one: Verdict, other: Verdict) -> int:
            return int(np.count_nonzero((was == one) & (now == other)))

        return cls(
            both(Verdict.UNKNOWN, Verdict.FREE),
            both(Verdict.UNKNOWN, Verdict.BLOCKED),
            both(Verdict.FREE_BEFORE, Verdict.FREE),
            both(Verdict.FREE_BEFORE, Verdict.BLOCKED),
            both(Verdict.BLOCKED_BEFORE, Verdict.FREE),
            len(after.milestones) - len(before.milestones),
            len(after.edges) - len(before.edges),
        )

    def __str__(self) -> str:
        judged = self.free + self.blocked
        words = [f"{judged:,} edges judged, {self.free:,} free"] if judged else []
        if self.again or self.fell or self.rose:
            words.append(f"after the change {self.again:,} edges free again, {self.fell:,} fell, {self.rose:,} rose")
        if self.milestones or self.edges:
            words.append(f"{self.milestones:,} milestones and {self.edges:,} edges added")
        return "; ".join(words) or "nothing about its edges"


def difference(before: Terms, now: Terms) -> str:
    """What decides verdicts and is not as it was, in words; empty if nothing is."""
    if before == now:
        return ""
    if not before.same_but_for_obstacles(now):
        rows = (
            ("the robot or its gripper's width", before.robot_hash, now.robot_hash),
            ("what is attached", before.attached, now.attached),
            ("what may touch", before.allowed, now.allowed),
            (f"the padding, there {before.padding * 1000:g} mm", before.padding, now.padding),
            ("the spacing of samples", before.step, now.step),
        )
        differs = ", ".join(words for words, one, other in rows if one != other)
        left = "what was free stays known" if _nearer(before, now) else "all of it is judged anew where a path needs it"
        kept = "" if before.padding == now.padding else ", and nothing is learned for the roadmap's own padding"
        return f"not as it was judged: {differs}; {left}{kept}"
    come, gone = before.changed(now)
    rows_of = (("changed", come & gone), ("came", come - gone), ("went", gone - come))
    return "; ".join(f"{', '.join(sorted(names))} {verb}" for verb, names in rows_of if names)


def _nearer(before: Terms, now: Terms) -> bool:
    """Whether nothing differs but that less padding is kept."""
    return now.padding < before.padding and replace(before, padding=now.padding) == now


def facts(rows: Iterable[tuple[str, str]]) -> list[str]:
    """Names and what is to be said of each, as wide as the terminal."""
    width = max(min(console().width, UNATTENDED_WIDTH), NAME_WIDTH + 10)
    wrapper = textwrap.TextWrapper(width, subsequent_indent=" " * (NAME_WIDTH + 2), break_on_hyphens=False)
    lines = []
    for name, text in rows:
        wrapper.initial_indent = f"  {name:<{NAME_WIDTH}}"
        lines.append(wrapper.fill(text))
    return lines


def milestone_words(roadmap: Roadmap) -> str:
    """How many milestones there are, what is known of them, and in how many parts they are."""
    count, largest = _components(roadmap)
    parts = "" if count < 2 else f"; {count:,} parts not joined to each other, the largest of {largest:,}"
    return f"{len(roadmap.milestones):,}: {_verdict_words(roadmap.milestone_knowledge)}{parts}"


def edge_words(roadmap: Roadmap) -> str:
    """How many edges there are, and what is known of them."""
    return f"{len(roadmap.edges):,}: {_verdict_words(roadmap.edge_knowledge)}"


def _verdict_words(known: Knowledge) -> str:
    told = [(verdict, known.count(verdict)) for verdict in Verdict]
    return ", ".join(f"{n:,} {v.name.lower().replace('_', ' ')}" for v, n in _in_order(told) if n or v in _ALWAYS)


def _in_order(told: list[tuple[Verdict, int]]) -> list[tuple[Verdict, int]]:
    return sorted(told, key=lambda row: (*_ALWAYS, *_REDONE).index(row[0]))


def cost_words(counts: CheckCounts) -> str:
    """What something asked of the checker."""
    bounds = f", {counts.distances:,} distances" if counts.distances else ""
    return f"{counts.states:,} states, {counts.edges:,} edges{bounds}"


def grower_words(roadmap: Roadmap) -> str:
    """Who grew it, with what settings."""
    if roadmap.built is None:
        return "put together, not grown"
    given = sorted(roadmap.built.settings.items(), key=lambda item: (item[0] == "max_checks", item[0]))
    settings = (f"{name.replace('_', ' ')} {value:,}" for name, value in given)
    return ", ".join([roadmap.built.planner, *settings, f"seed {roadmap.built.seed}"])


def size_words(roadmap: Roadmap, file_bytes: int) -> str:
    """Bytes in the file, in memory, and for each milestone."""
    held = _held(roadmap)
    each = f", {held / len(roadmap.milestones):,.0f} bytes per milestone" if len(roadmap.milestones) else ""
    return f"{_bytes(file_bytes)} in the file; {_bytes(held)} of arrays in memory{each}"


def _held(roadmap: Roadmap) -> int:
    return sum(array.nbytes for array in roadmap.arrays.values())


def _bytes(count: int) -> str:
    return f"{count / 1e6:,.1f} MB" if count >= 1e6 else f"{count / 1e3:,.1f} kB"


def _components(roadmap: Roadmap) -> tuple[int, int]:
    """How many parts have no way between them but over blocked edges, and milestones of the largest."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(roadmap.milestones)
    if count == 0:
        return 0, 0
    a, b = roadmap.edges[roadmap.verdicts != Verdict.BLOCKED].T
    graph = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(count, count))
    parts, labels = connected_components(graph, directed=False)
    return int(parts), int(np.bincount(labels).max())


def roadmap_facts(roadmap: Roadmap, file_bytes: int) -> list[tuple[str, str]]:
    """All that a file holds, but for its arrays."""
    terms, built = roadmap.terms, roadmap.built
    rows = [("hash", roadmap.hash)]
    if terms is not None:
        obstacles = ", ".join(name for name, _ in terms.obstacles) or "no obstacles"
        rows += [
            ("robot", f"{terms.robot}, {terms.robot_hash[:12]}: {', '.join(terms.joint_names)}"),
            ("scene", f"{terms.scene}, {terms.scene_hash[:12]}: {obstacles}"),
            ("may touch", ", ".join(" x ".join(pair) for pair in terms.allowed) or "only what the robot allows"),
            ("judged with", f"{terms.padding * 1000:g} mm of padding, edges sampled by {terms.step}"),
        ]
    else:
        rows.append(("judged for", "not said: nothing of it is taken for known"))
    rows += [("not yet told", f"{', '.join(roadmap.pending)} changed")] if roadmap.pending else []
    rows += [("grown by", grower_words(roadmap))]
    rows += [("cost", cost_words(built.counts))] if built is not None else []
    rows += [("milestones", milestone_words(roadmap)), ("edges", edge_words(roadmap))]
    asks = "asks RRTConnect where it has no path" if roadmap.fallback else "no other search where it has no path"
    keeps = "paths found are added to it" if roadmap.remember else "paths found are not added to it"
    return [*rows, ("a query", f"{asks}; {keeps}"), ("size", size_words(roadmap, file_bytes))]


def roadmap_record(roadmap: Roadmap, file_bytes: int) -> dict[str, Any]:
    """The same for machines."""
    terms, built = roadmap.terms, roadmap.built
    parts, largest = _components(roadmap)
    held, count = _held(roadmap), len(roadmap.milestones)
    return {
        "hash": roadmap.hash,
        "terms": None if terms is None else asdict(terms),
        "pending": list(roadmap.pending),
        "built": None
        if built is None
        else {
            "planner": built.planner,
            "settings": dict(built.settings),
            "seed": built.seed,
            "counts": counts_record(built.counts),
        },
        "fallback": roadmap.fallback,
        "remember": roadmap.remember,
        "milestones": _verdict_record(roadmap.milestone_knowledge),
        "edges": _verdict_record(roadmap.edge_knowledge),
        "components": {"count": parts, "largest": largest},
        "bytes": {"file": file_bytes, "memory": held, "per_milestone": held / count if count else None},
    }


def _verdict_record(known: Knowledge) -> dict[str, int]:
    return {"count": len(known.verdicts), **{verdict.name.lower(): known.count(verdict) for verdict in Verdict}}


def update_record(update: RoadmapUpdate) -> dict[str, Any]:
    """What revalidating a roadmap came to."""
    told = {name: getattr(update, name) for name in ("kept", "judged", "fell", "rose")}
    return {"changed": list(update.changed), **told, "counts": counts_record(update.counts)}
