"""Roadmaps as lines of text and as JSON objects: what is in one, what a query learned, what a new scene changed."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from planner_service.planning.roadmap_work import RoadmapUpdate
from planner_service.roadmap import Roadmap, Terms, Verdict
from planner_service.roadmap.verdicts import Knowledge

__all__ = [
    "Learned",
    "built_by_text",
    "difference",
    "edges_text",
    "milestones_text",
    "roadmap_facts",
    "roadmap_record",
    "size_text",
    "update_record",
]

_ALWAYS = (Verdict.FREE, Verdict.BLOCKED, Verdict.UNKNOWN)
_BEFORE_CHANGE = (Verdict.FREE_BEFORE, Verdict.BLOCKED_BEFORE)


@dataclass(frozen=True)
class Learned:
    """What a roadmap knows that its earlier value did not.

    Attributes:
        free: Edges that were unknown and are free.
        blocked: Edges that were unknown and are blocked.
        again: Edges that were free before the scene changed and still are.
        fell: Edges that were free before the scene changed and are blocked.
        rose: Edges that were blocked before the scene changed and are free.
        milestones: Milestones added.
        edges: Edges added.
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
        """What ``after`` knows beyond ``before``, as far as that still holds for the scene of ``after``."""
        kept = before if after.terms is None else before.under(after.terms)
        was, now = kept.verdicts, after.verdicts[: len(kept.verdicts)]

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
        checked = self.free + self.blocked
        words = [f"{checked:,} edges checked, {self.free:,} free"] if checked else []
        if self.again or self.fell or self.rose:
            words.append(
                f"after the change {self.again:,} edges still free, {self.fell:,} now blocked, {self.rose:,} now free"
            )
        if self.milestones or self.edges:
            words.append(f"{self.milestones:,} milestones and {self.edges:,} edges added")
        return "; ".join(words) or "nothing new about its edges"


def difference(before: Terms, now: Terms) -> str:
    """What differs from the conditions a roadmap was built for, in words; empty if nothing does."""
    if before == now:
        return ""
    if not before.same_but_for_obstacles(now):
        rows = (
            ("the robot or its gripper opening", before.robot_hash, now.robot_hash),
            ("attached objects", before.attached, now.attached),
            ("pairs allowed to touch", before.allowed, now.allowed),
            (f"the padding, {before.padding * 1000:g} mm in the roadmap", before.padding, now.padding),
            ("the sampling of edges", before.step, now.step),
        )
        differs = ", ".join(words for words, one, other in rows if one != other)
        valid = (
            "free edges stay valid" if _less_padding(before, now) else "edges are checked again where a path needs them"
        )
        learned = "" if before.padding == now.padding else ", and nothing is learned for the roadmap's own padding"
        return f"not as the roadmap was built: {differs}; {valid}{learned}"
    added, removed = before.changed(now)
    changes = (("changed", added & removed), ("added", added - removed), ("removed", removed - added))
    return "; ".join(f"{', '.join(sorted(names))} {verb}" for verb, names in changes if names)


def _less_padding(before: Terms, now: Terms) -> bool:
    """Whether the only difference is less padding."""
    return now.padding < before.padding and replace(before, padding=now.padding) == now


def milestones_text(roadmap: Roadmap) -> str:
    """The milestones by verdict, and how many components they form."""
    count, largest = _components(roadmap)
    parts = "" if count < 2 else f"; {count:,} components, the largest of {largest:,}"
    return f"{len(roadmap.milestones):,}: {_verdicts_text(roadmap.milestone_knowledge)}{parts}"


def edges_text(roadmap: Roadmap) -> str:
    """The edges by verdict."""
    return f"{len(roadmap.edges):,}: {_verdicts_text(roadmap.edge_knowledge)}"


def _verdicts_text(known: Knowledge) -> str:
    counts = [(verdict, known.count(verdict)) for verdict in (*_ALWAYS, *_BEFORE_CHANGE)]
    return ", ".join(f"{n:,} {v.name.lower().replace('_', ' ')}" for v, n in counts if n or v in _ALWAYS)


def built_by_text(roadmap: Roadmap) -> str:
    """The planner that built a roadmap, with its settings."""
    if roadmap.built is None:
        return "assembled by hand"
    in_order = sorted(roadmap.built.settings.items(), key=lambda item: (item[0] == "max_checks", item[0]))
    settings = (f"{name.replace('_', ' ')} {value:,}" for name, value in in_order)
    return ", ".join([roadmap.built.planner, *settings, f"seed {roadmap.built.seed}"])


def size_text(roadmap: Roadmap, file_bytes: int) -> str:
    """Bytes in the file, in memory, and per milestone."""
    held = _array_bytes(roadmap)
    per_milestone = f", {held / len(roadmap.milestones):,.0f} bytes per milestone" if len(roadmap.milestones) else ""
    return f"{_bytes(file_bytes)} in the file; {_bytes(held)} of arrays in memory{per_milestone}"


def _array_bytes(roadmap: Roadmap) -> int:
    return sum(array.nbytes for array in roadmap.arrays.values())


def _bytes(count: int) -> str:
    return f"{count / 1e6:,.1f} MB" if count >= 1e6 else f"{count / 1e3:,.1f} kB"


def _components(roadmap: Roadmap) -> tuple[int, int]:
    """How many connected components there are without the blocked edges, and the milestones of the largest."""
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
    """Everything in a roadmap file except its arrays, as labels and texts."""
    terms, built = roadmap.terms, roadmap.built
    rows = [("hash", roadmap.hash)]
    if terms is not None:
        obstacles = ", ".join(name for name, _ in terms.obstacles) or "no obstacles"
        rows += [
            ("robot", f"{terms.robot}, {terms.robot_hash[:12]}: {', '.join(terms.joint_names)}"),
            ("scene", f"{terms.scene}, {terms.scene_hash[:12]}: {obstacles}"),
            ("may touch", ", ".join(" x ".join(pair) for pair in terms.allowed) or "only what the robot allows"),
            ("checked with", f"{terms.padding * 1000:g} mm of padding, edges sampled by {terms.step}"),
        ]
    else:
        rows.append(("built for", "unknown; everything is checked again"))
    rows += [("to update", f"{', '.join(roadmap.pending)} changed")] if roadmap.pending else []
    rows += [("built by", built_by_text(roadmap))]
    rows += [("cost", str(built.counts))] if built is not None else []
    rows += [("milestones", milestones_text(roadmap)), ("edges", edges_text(roadmap))]
    fallback = "BalancedRRTConnect searches if the roadmap has no path" if roadmap.fallback else "no fallback planner"
    remember = "paths found are added" if roadmap.remember else "paths found are not added"
    return [*rows, ("queries", f"{fallback}; {remember}"), ("size", size_text(roadmap, file_bytes))]


def roadmap_record(roadmap: Roadmap, file_bytes: int) -> dict[str, Any]:
    """A roadmap as a JSON object."""
    terms, built = roadmap.terms, roadmap.built
    parts, largest = _components(roadmap)
    held, count = _array_bytes(roadmap), len(roadmap.milestones)
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
            "counts": built.counts.named,
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
    """An update of a roadmap as a JSON object."""
    edges = {name: getattr(update, name) for name in ("kept", "judged", "fell", "rose")}
    return {"changed": list(update.changed), **edges, "counts": update.counts.named}
