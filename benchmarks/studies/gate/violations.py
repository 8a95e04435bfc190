"""Drivers that break what is assumed of them: the gate notices, and says so before anything touches."""

from __future__ import annotations

from dataclasses import replace
from itertools import count

import numpy as np

from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.gate.driver import Driver
from benchmarks.studies.gate.policies import follower
from benchmarks.studies.gate.sessions import Session, Tally
from benchmarks.studies.gate.worlds import ROBOTS, World, world
from planner_service.gate import Kind, Tracking
from planner_service.geometry.arrays import FloatArray

__all__ = ["run"]

SESSIONS = 20
"""Of each kind, where no other number is asked for."""

CHECKS, PACE = 90, 1.0
"""Single targets of a session, and how fast they follow the plan, times its own speed."""

RATE, TRACKING = 30.0, Tracking(goal_time=0.1, error=0.01, jitter=0.003)

COUNTED = ("sessions", "noticed", "touched")

LATE = 0.1
"""Seconds."""


def _kinds(driver: Driver) -> dict[str, Driver]:
    """The driver as it is, by what is wrong with it."""
    return {
        "nothing": driver,
        "three times the error": replace(driver, error=3.0 * driver.error),
        "three times the goal time": replace(driver, goal_time=3.0 * driver.goal_time),
        "targets come up to 0.1 s late": replace(driver, jitter=LATE),
        "the arm stands still": replace(driver, goal_time=1e9),
    }


def run(queries: int | None, seed: int, robot: str | None, _: Kept = NONE) -> Report:
    """Sessions that follow plans, each with one kind of driver."""
    sessions, name = SESSIONS if queries is None else max(1, queries // CHECKS), robot or ROBOTS[0]
    found: dict[str, Row] = {}
    numbers = count()
    done = 0
    while done < sessions:
        number = next(numbers)
        place = replace(world(name, seed, number), rate=RATE, tracking=TRACKING)
        if place.plan is None or not place.gate().check(place.start, place.start[None]).proven:
            continue  # nothing moves where the error alone may reach something
        done += 1
        for kind, real in _kinds(place.driver(place.start)).items():
            row = found.setdefault(
                kind, {"part": "violations", "what": kind, "sessions": 0, "noticed": 0, "touched": 0}
            )
            noticed, touched = _session(place, real, np.random.default_rng([seed, number]))
            row["sessions"] += 1
            row["noticed"] += noticed
            row["touched"] += touched
    rows = tuple(found.values())
    lines = [{"what is wrong": r["what"], **{key: r[key] for key in COUNTED}} for r in rows]
    wrong, right = [row for row in rows if row["what"] != "nothing"], found["nothing"]
    promises = (
        *(
            Promise(f"noticed: {r['what']}", f"{r['noticed']} of {r['sessions']}", r["noticed"] == r["sessions"])
            for r in wrong
        ),
        Promise("a driver with nothing wrong is believed", f"{right['noticed']} alarms", right["noticed"] == 0),
        Promise("nothing touches before it is noticed", *_none(sum(row["touched"] for row in rows))),
    )
    caption = "Touched: sessions in which the arm, as it really went, touched something before the gate said so."
    return Report("gate", rows, (table_of("Broken assumptions", lines, caption=caption),), promises)


def _none(number: int) -> tuple[str, bool]:
    return str(number), number == 0


def _session(place: World, real: Driver, rng: np.random.Generator) -> tuple[bool, bool]:
    """Whether it was noticed, and whether anything touched before, or at all if not."""
    plan, noticed, verdict = place.plan, False, None
    assert plan is not None
    session = Session(place, rng, Tally(), real)

    def line(times: FloatArray) -> FloatArray:
        return np.asarray(plan(np.minimum(PACE * times, plan.duration)))

    wanted = follower(line, rng, RATE, pace=PACE, size=0.0, longest=1)
    way = [session.measured]
    for _ in range(CHECKS):
        verdict = session.check(wanted(session, verdict), judged=False)
        way.append(session.measured)
        if verdict.refused is not None and verdict.refused.kind is Kind.TRACKING:
            noticed = True
            break
    return noticed, place.judge.walked(np.array(way)) is not None
