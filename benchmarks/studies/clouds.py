"""What clouds of 10,000 to 1,000,000 points cost: one room, measured ever finer, around an arm."""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any, TypeVar

import numpy as np

import planner_service as ps
from auditor.verify import verify
from benchmarks.harness.report import Promise, Report, table
from planner_service.records import SavedPlan
from planner_service.records.evidence import with_evidence

__all__ = ["run", "scan"]

POINTS = (10_000, 100_000, 1_000_000)
"""A room of 25 m2 at 50, 16 and 5 mm."""

PER_POINTS = 0.3
"""CPU seconds that 100,000 points may take until there are boxes."""

SLOWER = 1.5
"""The most CPU time of a plan among the largest cloud, relative to that among the smallest."""

NEW, FEW = 10_000, 1_000
"""Points that are measured anew, on 1 m2, and so many on a tenth of that."""

STATES = 20_000

CHECKED = 10.0
"""CPU seconds that the auditor may take for a plan among any of these."""

Result = TypeVar("Result")


def scan(count: int, seed: int) -> tuple[np.ndarray[Any, Any], float]:
    """So many points (n, 3) of a floor, three walls, shelves and crates, a few millimetres off, and their distance."""
    rng = np.random.default_rng([seed, count])
    sides = [  # a corner and two sides of each rectangle
        ((-1.5, -1.5, -0.3), (3.0, 0.0, 0.0), (0.0, 3.0, 0.0)),
        ((1.5, -1.5, -0.3), (0.0, 3.0, 0.0), (0.0, 0.0, 2.0)),
        ((-1.5, 1.5, -0.3), (3.0, 0.0, 0.0), (0.0, 0.0, 2.0)),
        ((0.65, -0.6, 0.35), (0.4, 0.0, 0.0), (0.0, 1.2, 0.0)),
        ((0.65, -0.6, 0.75), (0.4, 0.0, 0.0), (0.0, 1.2, 0.0)),
        ((1.05, -0.6, 0.0), (0.0, 1.2, 0.0), (0.0, 0.0, 0.75)),
        ((-0.9, 0.55, 0.1), (1.2, 0.0, 0.0), (0.0, 0.0, 0.6)),
        ((-0.9, 0.55, 0.1), (1.2, 0.0, 0.0), (0.0, 0.6, 0.0)),
    ]
    corners, first, second = (np.array(each) for each in zip(*sides, strict=True))
    areas = np.linalg.norm(np.cross(first, second), axis=1)
    side = rng.choice(len(sides), count, p=areas / areas.sum())
    u, v = rng.random((2, count, 1))
    points = corners[side] + u * first[side] + v * second[side]
    return points + rng.normal(0.0, 0.002, (count, 3)), float(np.sqrt(areas.sum() / count))


def _timed(what: Callable[[], Result]) -> tuple[Result, float]:
    start = time.process_time()
    result = what()
    return result, time.process_time() - start


def _megabytes() -> float:
    """The most memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)


def _built(points: np.ndarray[Any, Any], resolution: float) -> ps.PointCloud:
    """A cloud, with the boxes that its cells are joined to."""
    cloud = ps.PointCloud(points, resolution)
    len(cloud.pieces)
    return cloud


def run(robot: str | None = None, queries: int = 20, seed: int = 5) -> Report:
    """Later plans of one service for each cloud, between states that are free among all of them."""
    arm = ps.load_robot(robot or "panda_mbm")
    rows, services = list[dict[str, Any]](), list[ps.PlannerService]()
    for count in POINTS:
        points, resolution = scan(count, seed)
        cloud, build = _timed(lambda p=points, r=resolution: _built(p, r))  # type: ignore[misc]
        new = scan(25 * NEW, seed + 1)[0]
        new = new[(new[:, :2] >= 0.5).all(axis=1)][:NEW]
        corners = np.array([0.5, 0.5, -1.0]), np.array([1.6, 1.6, 2.0])
        fresh, update = _timed(lambda c=cloud, n=new, box=corners: c.with_points(n, instead_of=box))  # type: ignore[misc]
        _, joined = _timed(lambda f=fresh: len(f.pieces))  # type: ignore[misc]
        few = new[(new[:, :2] <= 0.8).all(axis=1)][:FEW]
        _, glance = _timed(lambda c=cloud, n=few: len(c.with_points(n).pieces))  # type: ignore[misc]
        scene = ps.Scene((ps.Obstacle("room", cloud),))
        service, ready = _timed(lambda s=scene: ps.PlannerService(arm, s))  # type: ignore[misc]
        Q = np.random.default_rng(seed).uniform(*arm.bounds, (STATES, arm.n))
        free, checks = _timed(lambda s=service, q=Q: s.checker.states_are_free(q))  # type: ignore[misc]
        same = ps.PointCloud(np.concatenate([cloud.points, new]), resolution) == cloud.with_points(new)
        services.append(service)
        rows.append(
            {"points": count, "cells": len(cloud.cells), "boxes": len(cloud.pieces), "build": build, "ready": ready}
            | {"update": update + joined, "few": glance, "state_us": 1e6 * checks / STATES, "free": float(free.mean())}
            | {"memory": _megabytes(), "same": same}
        )
    rng, pairs = np.random.default_rng(seed), list[tuple[Any, Any]]()
    while len(pairs) < queries + 1:
        start, goal = rng.uniform(*arm.bounds, (2, arm.n))
        if all(service.checker.state_is_free(q) for service in services for q in (start, goal)):
            pairs.append((start, goal))
    times: list[list[float]] = [[] for _ in services]
    found = [0] * len(services)
    saved: list[ps.PlanResult | None] = [None] * len(services)
    for start, goal in pairs:  # in turn
        for k, service in enumerate(services):
            request = ps.PlanRequest(start, goal, seed=seed, time_limit=60.0)
            plan, seconds = _timed(partial(service.plan, request))
            found[k] += plan.certificate is not None and plan.certificate.certified
            saved[k] = plan if plan.ok else saved[k]
            times[k].append(seconds)
    for k, row in enumerate(rows):
        row |= {"first": times[k][0], "plan_ms": 1e3 * median(times[k][1:]), "proven": found[k], "of": len(pairs)}
        if (last := saved[k]) is not None:
            text = with_evidence(SavedPlan.of(last)).file_text()
            _, checked = _timed(lambda t=text: list(verify(json.loads(t))))  # type: ignore[misc]
            row |= {"megabytes": len(text) / 1e6, "checked": checked}
        row["memory"] = max(row["memory"], _megabytes() if k == len(rows) - 1 else 0.0)
    return _report(tuple(rows))


def _report(rows: tuple[dict[str, Any], ...]) -> Report:
    least = rows[0]["plan_ms"]
    shown = [
        (
            f"{row['points']:,}",
            f"{row['cells']:,}",
            f"{row['boxes']:,}",
            f"{row['build']:.3f}",
            f"{row['update']:.3f}",
            f"{row['few']:.3f}",
            f"{row['ready']:.3f}",
            f"{row['first']:.3f}",
            f"{row['plan_ms']:.2f}",
            f"{row['plan_ms'] / least:.2f}",
            f"{row['state_us']:.2f}",
            f"{row['memory']:.0f}",
            f"{row.get('megabytes', 0.0):.1f}",
            f"{row.get('checked', 0.0):.2f}",
            f"{row['proven']} of {row['of']}",
        )
        for row in rows
    ]
    names = (
        "points",
        "cells",
        "boxes",
        "build s",
        "update s",
        "few s",
        "service s",
        "first plan s",
        "plan ms",
        "ratio",
    )
    heads = (*names, "us a state", "MB", "file MB", "checked s", "proven")
    most = max(row["build"] / row["points"] * 1e5 for row in rows[1:])
    ratio = rows[-1]["plan_ms"] / least
    return Report(
        "clouds",
        rows,
        (table("A room measured ever finer, CPU time", heads, shown),),
        (
            Promise(f"100,000 points are boxes after {PER_POINTS:g} s at most", f"{most:.3f} s", most <= PER_POINTS),
            Promise(f"the largest cloud: at most {SLOWER:g} times the smallest", f"{ratio:.2f}", ratio <= SLOWER),
            Promise(
                "a cloud with points is the one made at once",
                str(sum(r["same"] for r in rows)),
                all(r["same"] for r in rows),
            ),
            Promise(
                f"a plan with its proof is checked by the auditor in {CHECKED:g} s at most",
                ", ".join(f"{row['checked']:.2f} s" for row in rows if "checked" in row),
                all(row.get("checked", CHECKED) < CHECKED for row in rows),
            ),
            Promise("every plan is proven", shown[-1][-1], all(row["proven"] == row["of"] for row in rows)),
        ),
    )
