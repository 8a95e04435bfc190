"""How often a gate refuses what it need not: chunks that, with all their room, are far from contact by Coal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import count

import numpy as np

from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.gate.judge import Judge
from benchmarks.studies.gate.worlds import ROBOTS, World, world
from planner_service.gate import ActionGate, Setpoint
from planner_service.geometry.arrays import FloatArray

__all__ = ["run"]

CHUNKS = 400
"""With clearance, of each robot, where no other number is asked for."""

CLEARANCE = 0.005
"""Metres beyond the tube."""

MOST = 0.01
"""Share of these that may be refused."""

LONGEST, STARTS = 50, 6
"""Targets of a chunk, and chunks that begin somewhere on a plan."""

PLACES = 4
"""On each edge, at which the worst corner of its room is searched for."""

RAMP = 0.3
"""Seconds in which a chunk reaches the plan's own speed."""


def run(queries: int | None, seed: int, robot: str | None, _: Kept = NONE) -> Report:
    """Chunks along plans, each begun at rest."""
    rows = [
        _counted(name, CHUNKS if queries is None else queries, seed) for name in (ROBOTS if robot is None else (robot,))
    ]
    clear, refused = (sum(row[key] for row in rows) for key in ("clear", "refused"))
    lines = [
        {
            "robot": row["robot"],
            "chunks along plans": f"{row['drawn']:,}",
            "5 mm clear": f"{row['clear']:,}",
            "of these refused": row["refused"],
            "for": ", ".join(f"{number} {kind}" for kind, number in row["kinds"].items()) or "-",
        }
        for row in rows
    ]
    text = f"at most {100 * MOST:g} % of the chunks with {1e3 * CLEARANCE:g} mm beyond the tube are refused"
    told = f"{refused} of {clear:,} ({100 * refused / clear:.2f} %)"
    caption = "Clear: no corner of the room is nearer to contact, of the chunk and its stop, that a search finds."
    table = table_of("Refusals", lines, caption=caption)
    return Report("gate", tuple(rows), (table,), (Promise(text, told, refused <= MOST * clear),))


def _counted(name: str, wanted: int, seed: int) -> Row:
    drawn = clear = refused = 0
    kinds, details = Counter[str](), list[str]()
    for place, chunk in _chunks(name, seed):
        if clear >= wanted:
            break
        drawn += 1
        gate = place.gate()
        gate.slow = False
        gate.reset(chunk[0])
        verdict = gate.check(chunk[0], chunk[1:])
        if verdict.refused is not None and verdict.refused.kind.value not in ("contact", "stop"):
            continue  # too fast for the limits, whatever is near
        if _gap(place, np.concatenate([chunk, _stop(place, gate, chunk)])) < CLEARANCE:
            continue
        clear += 1
        if not verdict.ok:
            refused += 1
            assert verdict.refused is not None
            kinds[verdict.refused.kind.value] += 1
            details.append(str(verdict.refused))
    row: Row = {"part": "refusals", "robot": name, "drawn": drawn, "clear": clear, "refused": refused}
    return row | {"kinds": dict(kinds), "details": details}


def _chunks(name: str, seed: int) -> Iterator[tuple[World, FloatArray]]:
    """Where the arm stands and what is wanted, (k + 1, n), along plans, without end."""
    for number in count():
        place = world(name, seed, number)
        plan, rng = place.plan, np.random.default_rng([seed, number])
        if plan is None:
            continue
        for _ in range(STARTS):
            times = np.arange(int(rng.integers(2, LONGEST + 1)) + 1) / place.rate
            gone = float(rng.uniform(0.3, 1.0)) * np.where(times < RAMP, times**2 / (2 * RAMP), times - RAMP / 2)
            begun = float(rng.uniform(0.0, plan.duration))
            yield place, np.asarray(plan(np.minimum(begun + gone, plan.duration)))


def _stop(place: World, gate: ActionGate, chunk: FloatArray) -> FloatArray:
    """The targets that brake an arm after a chunk, which are to be free as well; they are the limits' to say."""
    share = place.tracking.shares(1.0 / place.rate)[1]
    before = after = chunk[0]
    for target in chunk[1:]:
        before, after = after, after + share * (target - after)
    speed = (after - before) / share / place.tracking.goal_time
    rows = gate.limits.braking(Setpoint(after, np.zeros(place.n), speed, np.zeros(place.n), after))
    return np.empty((0, place.n)) if rows is None else rows


def _gap(place: World, chunk: FloatArray) -> float:
    """About the smallest gap anywhere in the room of a chunk, never less than it is, by Coal."""
    judge, tracking = place.judge, place.tracking
    low, high = (min(1.0, (1.0 / place.rate + side * tracking.jitter) / tracking.goal_time) for side in (-1.0, 1.0))
    middle, radius = chunk[0], np.zeros(place.n)
    places, rooms = list[FloatArray](), list[FloatArray]()
    for target in chunk[1:]:
        shares = np.linspace(0.0, 1.0, PLACES)[:, None]
        places.extend(middle + shares * (target - middle))
        rooms.extend((1.0 - shares) * radius + place.error)
        way = target - middle
        middle, radius = middle + 0.5 * (low + high) * way, (1.0 - low) * radius + 0.5 * (high - low) * np.abs(way)
    return _least(judge, np.array(places), np.array(rooms))


def _least(judge: Judge, places: FloatArray, rooms: FloatArray) -> float:
    """Every place counts whose room may reach anything; the likeliest come first, and one that does is enough."""
    gaps = np.array([judge.gap(q) for q in places])
    least = float(gaps.min())
    for k in np.argsort(gaps - rooms @ judge.reach):
        if least < CLEARANCE or gaps[k] - rooms[k] @ judge.reach >= CLEARANCE:
            break
        least = min(least, judge.lowest(places[k], rooms[k], CLEARANCE))
    return least
