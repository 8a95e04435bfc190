"""What a whole plan costs among 10 to 10,000 obstacles: small boxes at random places around the arm."""

from __future__ import annotations

import time
from statistics import median
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.harness.report import Promise, Report, table

__all__ = ["run"]

COUNTS = {10: 1.0, 100: 1.3, 1_000: 2.0, 10_000: 3.0}
"""Obstacles, and the most CPU time of a plan among them, relative to that among ten."""

EDGE, NEAR, FAR = 0.02, 0.45, 3.0
"""Metres: of the boxes, and how far from the base's axis and the base they stand."""

AROUND = 0.03
"""Part of the boxes within reach: a room is full of what the arm does not reach."""

REACH = 1.2


def scene_of(count: int, seed: int) -> ps.Scene:
    """So many boxes; few of them where the arm is."""
    rng, boxes = np.random.default_rng([seed, count]), list[ps.Obstacle]()
    while len(boxes) < count:
        x, y, z = rng.uniform(-FAR, FAR, 3).tolist() if count > 100 else rng.uniform(-1.0, 1.0, 3).tolist()
        column = (x * x + y * y) ** 0.5 < NEAR and -0.3 < z < 1.3
        reached = (x * x + y * y + z * z) ** 0.5 < REACH
        if not column and not (count > 100 and reached and rng.random() > AROUND):
            boxes.append(ps.Obstacle(f"box {len(boxes)}", ps.Box((EDGE, EDGE, EDGE)), ps.Pose((x, y, z))))
    return ps.Scene(tuple(boxes))


def run(robot: str | None = None, queries: int = 20, seed: int = 5) -> Report:
    """Later plans of one service for each number of obstacles, the same goals by turns."""
    arm = ps.load_robot(robot or "panda_mbm")
    rows: list[dict[str, Any]] = []
    for count in COUNTS:
        service = ps.PlannerService(arm, scene_of(count, seed))
        rng, seconds, bounds = np.random.default_rng(seed), list[float](), list[int]()
        while len(seconds) < queries + 1:
            goal = rng.uniform(*arm.bounds)
            if not service.checker.state_is_free(goal):
                continue
            start = time.process_time()
            certificate = service.plan(ps.PlanRequest(arm.home, goal, seed=seed)).certificate
            if certificate is not None:
                seconds.append(time.process_time() - start)
                bounds.append(certificate.distances)
        rows.append({"obstacles": count, "ms": 1e3 * median(seconds[1:]), "bounds": int(median(bounds[1:]))})
    shown = [(f"{row['obstacles']:,}", f"{row['ms']:.2f}", f"{row['bounds']:,}") for row in rows]
    ratios = [row["ms"] / rows[0]["ms"] for row in rows]
    return Report(
        "scaling",
        tuple(rows),
        (table("A whole plan, CPU time at p50", ("obstacles", "ms", "bounds of the proof"), shown),),
        tuple(
            Promise(f"{count:,} obstacles: at most {most:g} times as long as ten", f"{ratio:.2f}", ratio <= most)
            for (count, most), ratio in list(zip(COUNTS.items(), ratios, strict=True))[1:]
        ),
    )
