"""Chunks of all kinds, each verdict followed by simulated drivers: nothing that passes touches anything, by Coal.

The same judge must catch a gate that proves too little, or its silence means nothing.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.episode_audit import Stored
from benchmarks.studies.gate.policies import Policy, attacker, follower
from benchmarks.studies.gate.sessions import Session, Tally, Touched
from benchmarks.studies.gate.worlds import ROBOTS, World, recorded, world
from planner_service.certify.certifier import TubeProof
from planner_service.datasets import EpisodeWork, episode_task, write_episodes
from planner_service.gate import ActionGate
from planner_service.geometry.arrays import FloatArray
from planner_service.parallel import Lost, Processes

__all__ = ["ChunkWork", "planted", "run"]

CHUNKS = 4000
"""Where no other number is asked for."""

CHECKS = 50
"""Of a session, each of a chunk."""

SOURCES = ("plan", "attack", "changing scene", "episode")
"""What the chunks of a session are; episodes are the first robot's."""

CHANGES = 0.25
"""Share of the checks before which the scene changes, where it does."""

EPISODES = 12

FAULTS = 30
"""Sessions with a planted fault, which each must show."""


@dataclass(frozen=True)
class ChunkWork:
    """Sessions by their number.

    Args:
        folder: Of a data set of episodes.
        episodes: How many it has.
        robots: Their names.
        fault: What the gate does not prove, by its name in ``FAULTY``; empty for the gate as it is.
    """

    folder: str
    episodes: int
    robots: tuple[str, ...]
    seed: int
    fault: str = ""

    def prepare(self) -> None:
        """Nothing: each session has a world of its own."""

    def __call__(self, item: int) -> tuple[str, str, Tally]:
        """The source, the robot, and what came of the checks."""
        rng = np.random.default_rng([self.seed, item])
        number, k = divmod(item, len(SOURCES))
        source = "attack" if self.fault else SOURCES[k]
        robot = self.robots[number % len(self.robots)] if source != "episode" else ROBOTS[0]
        tally = Tally()
        if source == "episode":
            stored = Stored(Path(self.folder), number % self.episodes)
            place, policy = _replayed(stored, rng)
        else:
            place = world(robot, self.seed, item)
            policy = attacker(rng)
            if source == "attack":
                place = place.near_contact(rng)
            plan = place.plan if source == "plan" else None
            if plan is not None:
                policy = follower(lambda times: plan(np.minimum(times, plan.duration)), rng, place.rate)
        session = Session(place, rng, tally)
        if self.fault:
            _spoil(session.gate, self.fault)
        try:
            verdict = session.check(policy(session, None))
        except ps.InvalidRequest as refused:
            if refused.field != "error":  # the arm may be too fast from where it is held to where it is measured
                raise
            tally.unbegun += 1
            return source, robot, tally
        for _ in range(CHECKS - 1):
            if source == "changing scene" and rng.random() < CHANGES:
                session.moved(session.world.changed(rng))
            verdict = session.check(policy(session, verdict))
        return source, robot, tally


def _replayed(stored: Stored, rng: np.random.Generator) -> tuple[World, Policy]:
    """The world of an episode, and a policy that does what was recorded."""
    recording = stored.frames
    states, times = recording["observation.state"][:, :-1], recording["timestamp"]

    def line(at: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(at, times, column) for column in states.T])

    place = recorded(ROBOTS[0], stored.scene, states[0], states[-1], rng)
    return place, follower(line, rng, place.rate)


class _Faulty:
    """A certifier of a gate that gives wrong proofs."""

    def __init__(self, right: Any, fault: str) -> None:
        self._right, self._fault = right, fault

    def __getattr__(self, name: str) -> Any:
        return getattr(self._right, name)

    def certify_tubes(self, starts: Any, ends: Any, room: Any, **options: Any) -> TubeProof:
        """As the certifier's, but for the fault."""
        if self._fault == "nothing proven":
            return TubeProof(len(starts), 0)
        share = {"no room": 0.0, "half the room": 0.5}.get(self._fault, 1.0)
        proof: TubeProof = self._right.certify_tubes(starts, ends, share * np.asarray(room), **options)
        return proof


FAULTY = ("nothing proven", "no room", "half the room")
"""What a gate may not do."""


def _spoil(gate: ActionGate, fault: str) -> None:
    gate.certifier = _Faulty(gate.certifier, fault)  # type: ignore[assignment]


def run(queries: int | None, seed: int, robot: str | None, kept: Kept = NONE) -> Report:
    """So many chunks, a quarter of them from each source."""
    sessions = max(len(SOURCES), round((CHUNKS if queries is None else queries) / CHECKS))
    robots = ROBOTS if robot is None else (robot,)
    found = dict[tuple[str, str], Tally]()
    keys = [f"chunks {seed} {robot} {CHECKS} {item}" for item in range(sessions)]
    left = [item for item, key in enumerate(keys) if kept.get(key) is None]
    done = [(row["source"], row["robot"], Tally.of(row)) for key in keys if (row := kept.get(key)) is not None]
    with tempfile.TemporaryDirectory() as folder:
        work = EpisodeWork(ps.load_robot(ROBOTS[0]), episode_task("pick-place"), seed=seed)
        summary = write_episodes(folder, work, EPISODES)
        for item, answer in Processes().run(ChunkWork(folder, summary.episodes, robots, seed), left):
            if isinstance(answer, Lost):
                raise ps.BrokenInvariant(f"a session was lost: {answer.detail}")
            kept.put(keys[item], _row(*answer))
            done.append(answer)
    for source, name, tally in done:
        found.setdefault((source, name), Tally()).join(tally)
    rows = [_row(source, name, tally) for (source, name), tally in sorted(found.items())]
    total = Tally()
    for tally in found.values():
        total.join(tally)
    lines = [_line(row) for row in (*rows, _row("all", "", total))]
    promises = (
        Promise(
            f"{total.chunks:,} chunks: 0 of those that pass touch, by Coal every 0.2 mm",
            f"{len(total.touched)} of {total.ways:,} ways of {total.passed:,} targets and their stops {_first(total)}",
            not total.touched and total.passed > 0,
        ),
        Promise(
            "nothing that passes is outside a limit", str(total.outside + total.fast), not total.outside + total.fast
        ),
        Promise("no driver within what is assumed is said to be astray", *_none(total.refused.get("tracking", 0))),
        Promise("at most 1 % of the sessions are refused at their start", *_few(total.unbegun, sessions)),
    )
    caption = "Nearest: the smallest distance that Coal measured, at all places where a way might touch."
    return Report("gate", tuple(rows), (table_of("Chunks", lines, caption=caption),), promises)


def planted(queries: int | None, seed: int, robot: str | None, _: Kept = NONE) -> Report:
    """What the judge finds where the gate is made to prove less."""
    sessions = FAULTS if queries is None else max(1, queries // CHECKS)
    rows = list[Row]()
    for fault in FAULTY:
        total = Tally()
        work = ChunkWork("", 0, ROBOTS[:1] if robot is None else (robot,), seed, fault)
        for item in range(sessions):
            total.join(work(item)[2])
        rows.append({"part": "planted", "fault": fault, "chunks": total.chunks, "touched": len(total.touched)})
    lines = [{"fault of the gate": r["fault"], "chunks": r["chunks"], "that touch": r["touched"]} for r in rows]
    promises = [Promise(f"Coal finds: {r['fault']}", f"{r['touched']} touch", bool(r["touched"])) for r in rows]
    return Report("gate", tuple(rows), (table_of("Planted faults", lines),), tuple(promises))


def _few(count: int, sessions: int) -> tuple[str, bool]:
    return f"{count} of {sessions:,}", 100 * count <= sessions


def _none(count: int) -> tuple[str, bool]:
    return str(count), count == 0


def _first(tally: Tally) -> str:
    return "" if not tally.touched else f"({_words(tally.touched[0])})"


def _words(touched: Touched) -> str:
    return f"{touched.what}, {touched.how}, at {[round(value, 6) for value in touched.at]}"


def _row(source: str, robot: str, tally: Tally) -> Row:
    return {
        "part": "chunks",
        "source": source,
        "robot": robot,
        "chunks": tally.chunks,
        "targets": tally.targets,
        "passed": tally.passed,
        "slowed": tally.slowed,
        "unproven": tally.unproven,
        "unbegun": tally.unbegun,
        "refused": tally.refused,
        "ways": tally.ways,
        "outside": tally.outside,
        "fast": tally.fast,
        "least_gap": tally.least,
        "touched": [vars(each) for each in tally.touched],
    }


def _line(row: Row) -> dict[str, object]:
    refused = ", ".join(f"{count:,} {kind}" for kind, count in sorted(row["refused"].items()))
    return {
        "chunks of": f"{row['source']} {row['robot']}".strip(),
        "chunks": f"{row['chunks']:,}",
        "targets": f"{row['targets']:,}",
        "that pass": f"{row['passed']:,}",
        "slowed": f"{row['slowed']:,}",
        "refused": refused or "none",
        "ways judged": f"{row['ways']:,}",
        "nearest, mm": f"{row['least_gap'] * 1e3:.2f}",
        "touch": len(row["touched"]),
    }
