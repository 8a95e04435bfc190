"""In which order: visits and picks of a cell, with the gap that is proven, next to RoboTSP's order on the same cell."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from rich.table import Table

import planner_service as ps
from benchmarks.baselines.robotsp import robotsp_seconds
from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, table_of
from planner_service.geometry.arrays import FloatArray
from planner_service.grasping.grasps import tool_rotation
from planner_service.tasks import Handling
from planner_service.tasks.ordering import Branch, Move, OrderResult, Visit, order, order_moves

__all__ = ["run"]

ROBOTS = ("wxai", "panda", "ur5_vacuum")

BRANCHES = 8

FEW, MANY = 30, 200
"""Visits."""

MOVES = 12

GAP = 0.10

CPU = {FEW: 60.0, MANY: 300.0}
"""Seconds of CPU that are promised."""

REACH = {"wxai": (0.24, 0.42), "panda": (0.38, 0.62), "ur5_vacuum": (0.40, 0.70)}
"""Metres from the base at which tools work."""

TILT = 0.5
"""Radians by which a target is tilted at most, about each horizontal axis."""

SIZE, TOP = 0.03, 0.011
"""Edge of a block that is moved, and where its underside stands, in metres."""


def run(queries: int | None, seed: int, robot: str | None, kept: Kept = NONE) -> Report:
    """Orders of each robot.

    Args:
        queries: Visits of the only cell, and no moves; 30 and 200 visits, and 12 moves, if None.
    """
    rows = [row for name in ROBOTS for row in _rows(name, queries, seed, robot in (None, name), kept)]
    return Report("cells order", tuple(rows), (_table(rows),), tuple(_promises(rows)))


def _rows(name: str, queries: int | None, seed: int, asked: bool, kept: Kept) -> Iterator[Row]:
    for count in (FEW, MANY) if queries is None else (queries,):
        visited = partial(_visited, name, count, seed)
        yield from kept.rows(f"order {name} {count} visits {seed}", visited if asked else None)
    if queries is None:
        yield from kept.rows(f"order {name} moves", partial(_moved, name) if asked else None)


def _visited(name: str, count: int, seed: int) -> Iterator[Row]:
    service, visits = visiting(name, count, seed)
    request = _request(service)
    clock = time.process_time()
    found = order(service, visits, request, gap=GAP)
    cpu = time.process_time() - clock
    jobs = [(tuple(branch for branch in visit.ways if isinstance(branch, Branch)),) for visit in visits]
    base, plans = robotsp_seconds(service, jobs, request)
    yield {"robot": name, "what": f"{count} visits", "count": count, **_row(found, cpu, base, plans)}


def _moved(name: str) -> Iterator[Row]:
    service, moves = moving(name)
    request = _request(service)
    clock = time.process_time()
    found = order_moves(service, moves, request, gap=GAP)
    cpu = time.process_time() - clock
    given = [replace(move, after=(moves[k - 1].name,) if k else ()) for k, move in enumerate(moves)]
    base = order_moves(service, given, request, gap=GAP)  # the rows one after another, as a person would
    yield {"robot": name, "what": f"{len(moves)} moves", "count": 0, **_row(found, cpu, base.duration, base.plans)}


def _row(found: OrderResult, cpu: float, base: float, plans: int) -> Row:
    results = [segment.result for segment in found.task.segments]
    return {
        "seconds": found.duration,
        "baseline": base,
        "gap": found.gap,
        "floor gap": found.floor_gap,
        "plans": found.plans,
        "baseline plans": plans,
        "failed": len(found.failed),
        "cpu": cpu,
        "proven": found.ok and all(one.certificate is not None and one.certificate.certified for one in results),
    }


def _request(service: ps.PlannerService) -> ps.PlanRequest:
    home = service.robot.home
    return ps.PlanRequest(home, home, time_limit=None, max_checks=200_000)


def visiting(name: str, count: int, seed: int) -> tuple[ps.PlannerService, list[Visit]]:
    """A robot among three posts, and targets around them, each with up to eight free branches: turns of the tool
    count."""
    robot, rng = ps.load_robot(name), np.random.default_rng([seed, count])
    near, far = REACH[name]
    post = ps.Cylinder(0.02, 0.3)
    posts = [
        ps.Obstacle(f"post_{k}", post, ps.Pose((near * 1.25 * math.cos(a), near * 1.25 * math.sin(a), 0.15)))
        for k, a in enumerate((-0.7, 0.1, 0.8))
    ]
    service = ps.PlannerService(robot, ps.Scene(tuple(posts)))
    visits = list[Visit]()
    while len(visits) < count:
        radius, angle, height = rng.uniform(near, far), rng.uniform(-1.2, 1.2), rng.uniform(0.08, 0.3)
        at = np.array([radius * math.cos(angle), radius * math.sin(angle), height])
        branches = _branches(service, at, rng.uniform(-TILT, TILT, 2), rng.uniform(0.0, math.tau))
        if len(branches) > 1:
            visits.append(Visit(f"target {len(visits) + 1}", branches))
    return service, visits


def _branches(service: ps.PlannerService, at: FloatArray, tilt: FloatArray, turn: float) -> list[FloatArray]:
    """Up to eight free configurations with the tool at a place, tilted from straight down, its turn about itself
    free."""
    gripper, found = service.robot.gripper, list[FloatArray]()
    assert gripper is not None
    down = np.array([math.sin(tilt[0]), math.sin(tilt[1]), -1.0])
    down /= np.linalg.norm(down)
    roomy = service.checker.variant(padding=0.005)
    for k in range(BRANCHES):
        side = np.array([math.cos(turn + k * math.tau / BRANCHES), math.sin(turn + k * math.tau / BRANCHES), 0.0])
        side -= (side @ down) * down
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = tool_rotation(gripper, down, side / np.linalg.norm(side)), at
        for q in ps.inverse_kinematics(service.robot, ps.Pose.from_matrix(T), seed=k)[:2]:
            if roomy.state_is_free(q) and len(found) < BRANCHES:
                found.append(q)
    return found


def moving(name: str) -> tuple[ps.PlannerService, list[Move]]:
    """A table with twelve blocks on one side of a robot that go to the other side, each to a place of its own."""
    robot = ps.load_robot(name)
    k = 1.0 if name == "wxai" else 1.6
    table = ps.Obstacle("table", ps.Box((0.5 * k, 0.9 * k, 0.02)), ps.Pose((0.3 * k + 0.05, 0.0, 0.0)))
    height, pitch = TOP + SIZE / 2, 0.06 * k

    def spot(number: int, side: int) -> ps.Pose:
        row, column = divmod(number, 6)
        return ps.Pose((0.2 * k + pitch * column * 0.8, side * (0.12 * k + pitch * row), height))

    shape = ps.Box((SIZE, SIZE, SIZE))
    blocks = [ps.Obstacle(f"block_{n}", shape, spot(n, 1)) for n in range(MOVES)]
    how = Handling(support="table")
    moves = [Move(block.name, [spot(n * 7 % MOVES, -1)], handling=how, onto="table") for n, block in enumerate(blocks)]
    return ps.PlannerService(robot, ps.Scene((table, *blocks))), moves


def _table(rows: Sequence[Row]) -> Table:
    lines = [
        {
            "cell": f"{row['robot']}, {row['what']}",
            "seconds": f"{row['seconds']:.2f}",
            "baseline": f"{row['baseline']:.2f}",
            "saved": f"{1.0 - row['seconds'] / row['baseline']:.1%}",
            "gap": f"{row['gap']:.1%}",
            "gap to any motion": f"{row['floor gap']:.1%}",
            "legs planned": row["plans"],
            "without a plan": row["failed"],
            "CPU s": f"{row['cpu']:.1f}",
        }
        for row in rows
    ]
    caption = "Motion time. Baseline: RoboTSP's order of visits on the same cell; of moves, one row after another."
    return table_of("Orders", lines, caption=caption)


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    for row in rows:
        cell = f"{row['robot']}, {row['what']}"
        yield Promise(f"{cell}: every motion is proven", str(row["proven"]), bool(row["proven"]))
        better = row["seconds"] <= row["baseline"]
        yield Promise(
            f"{cell}: no slower than the baseline", f"{row['seconds']:.2f} s, {row['baseline']:.2f} s", better
        )
        if row["count"] <= FEW:
            yield Promise(f"{cell}: a gap of at most {GAP:.0%}", f"{row['gap']:.1%}", row["gap"] <= GAP)
        if row["count"] in CPU:
            most = CPU[row["count"]]
            yield Promise(f"{cell}: at most {most:g} s of CPU", f"{row['cpu']:.1f} s", row["cpu"] <= most)
