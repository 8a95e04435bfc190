"""Is each query of a SCARA arm in a drawn cell planned, or is it proven that there is no path?

The cell holds low walls, over which the hand passes or not, and at most one post. The hand starts and ends low. Proofs
cut up to four joints: all that the arm has.
"""

from __future__ import annotations

import math
import random
import time

from rich.table import Table

import planner_service as ps
from benchmarks.harness.report import Promise, Report, Row, grouped, spread, table_of
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.infeasibility import prove_no_path

__all__ = ["run"]

CELLS, SHARE = 100, 0.95
"""Promised: this part is decided."""

CHECKS, BOXES = 20_000, 1_000_000
LOW = (0.1, 0.3)
"""Of the slide, in metres."""


def run(queries: int | None, seed: int) -> Report:
    """Measure so many cells."""
    rows = [_row(seed, number) for number in range(queries or CELLS)]
    both = [row for row in rows if row["planned"] and row["proven"]]
    decided = sum(row["planned"] or row["proven"] for row in rows)
    promises = (
        Promise(f"no query of {len(rows)} SCARA cells is planned and proven impossible", f"{len(both)} are", not both),
        Promise(f"at least {SHARE:.0%} are one of both", f"{decided}", decided >= SHARE * len(rows)),
    )
    return Report("evidence", tuple(rows), (_table(rows),), promises)


def _row(seed: int, number: int) -> Row:
    chance = random.Random(f"scara {seed} {number}")
    service = ps.PlannerService("scara", ps.Scene((*_walls(chance), *_posts(chance))))
    start, goal = _free(service, chance), _free(service, chance)
    planned = service.plan(ps.PlanRequest(start, goal, seed=number, time_limit=None, max_checks=CHECKS)).ok
    clock = time.process_time()
    proof = prove_no_path(service.robot, service.scene, start, [goal], max_boxes=BOXES)
    row: Row = {"cell": number, "planned": planned, "proven": proof is not None}
    row |= {"ms": (time.process_time() - clock) * 1e3, "boxes": None if proof is None else proof.boxes}
    return row | {"joints": "-" if proof is None else ", ".join(proof.joints)}


def _walls(chance: random.Random) -> list[ps.Obstacle]:
    walls = []
    for k in range(chance.randrange(4, 10)):
        x, y = _place(chance)
        height, yaw = chance.uniform(0.15, 0.42), chance.uniform(0.0, math.pi)
        box = ps.Box((chance.uniform(0.2, 0.7), chance.uniform(0.04, 0.1), height))
        turn = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
        walls.append(ps.Obstacle(f"wall_{k}", box, ps.Pose((x, y, height / 2), turn)))
    return walls


def _posts(chance: random.Random) -> list[ps.Obstacle]:
    places = [_place(chance) for _ in range(chance.randrange(2))]
    return [ps.Obstacle("post", ps.Cylinder(chance.uniform(0.03, 0.08), 1.0), ps.Pose((x, y, 0.5))) for x, y in places]


def _place(chance: random.Random) -> tuple[float, float]:
    """A place within reach, and not on the arm's base."""
    azimuth, distance = chance.uniform(-2.8, 2.8), chance.uniform(0.3, 0.65)
    return distance * math.cos(azimuth), distance * math.sin(azimuth)


def _free(service: ps.PlannerService, chance: random.Random) -> FloatArray:
    limits = list(zip(service.robot.limits.lower.tolist(), service.robot.limits.upper.tolist(), strict=True))
    limits[2] = LOW
    while True:
        q = read_only([chance.uniform(*limit) for limit in limits])
        if service.checker.state_is_free(q):
            return q


def _table(rows: list[Row]) -> Table:
    lines = [
        {
            "proven by": joints,
            "cells": str(len(group)),
            "planned": str(sum(row["planned"] for row in group)),
            "ms": spread([row["ms"] for row in group]),
            "boxes": "-" if joints == "-" else f"{max(row['boxes'] for row in group):,}",
        }
        for joints, group in grouped(rows, "joints").items()
    ]
    caption = f"at most {BOXES:,} boxes; ms: p50 / p95 of CPU time, with a proof or without; boxes: most"
    return table_of("SCARA cells", lines, caption=caption)
