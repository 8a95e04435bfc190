"""Is a proof that there is no plan right, and is there one where there should be?

- ``planar2`` among random discs: each query planned, by a search or along a way that dividing joint space finds, or
  proven impossible. A flood fill of joint space, by closed forms
  of its own, looks at some: start and goal are joined by nodes of a grid that are farther from the discs than half a
  step moves any point, or not even by nodes that overlap them by less, corners included; in between it decides nothing.
- Stored pockets, which a link cannot leave (``benchmarks.worlds.unsolvable``): most are to be proven.
- Stored tool poses, of which every configuration collides (``benchmarks.worlds.unsolvable``): all to be proven.
- Queries with a known path, four robots: none may be proven impossible.
"""

from __future__ import annotations

import math
import random
import time

import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from scipy.ndimage import label

import planner_service as ps
from benchmarks.harness.report import Promise, Report, Row, grouped, p50, p95, spread, table_of
from benchmarks.studies.evidence.worlds import plans
from benchmarks.worlds.unsolvable import POSES_ROBOT, BlockedPose, Pocket, load_pockets, load_poses
from planner_service.geometry.arrays import BoolArray, FloatArray
from planner_service.infeasibility import prove_no_path
from planner_service.records import SavedPlan

__all__ = ["discs", "known_paths", "pockets", "poses"]

WORLDS = 1_000
FLOODED = 5
"""Of so many worlds one is filled: that takes seconds."""

CELL = 0.002
"""Radians."""

REACHES = (1.5, 0.5)
"""Metres that a point of ``planar2`` may be from the axis of each joint."""

HALF_WIDTH = 0.01
"""Metres, of its links."""

POCKET_BOXES, POCKETS_PROVEN = 300_000, 0.8

DRAWS = 200
"""Configurations among which two have to be free."""

KNOWN = 2_000
"""Queries with a known path."""

BOXES = 1_000
"""For each query with a known path."""


ComplexArray = NDArray[np.complex128] | NDArray[np.complex64]


def discs(queries: int | None, seed: int) -> Report:
    """Measure so many worlds of discs."""
    rows = [_planar(seed, number) for number in range(queries or WORLDS)]
    open_ = [row for row in rows if row["planned"] == row["proven"]]
    against = [row for row in rows if row["flood"] is not None and row["flood"] != row["planned"]]
    flooded = sum(row["flood"] is not None for row in rows)
    promises = (
        Promise(
            f"each of {len(rows):,} disc worlds is planned or proven impossible", f"{len(open_)} are not", not open_
        ),
        Promise("a flood fill agrees wherever it decides", f"{len(against)} of {flooded} differ", not against),
    )
    return Report("evidence", tuple(rows), (_table(rows),), promises)


def pockets(queries: int | None, seed: int) -> Report:
    """Measure the first so many stored pockets."""
    rows = [_pocket(pocket) for pocket in load_pockets()[:queries]]
    proven = sum(row["proven"] for row in rows)
    promise = f"at least {POCKETS_PROVEN:.0%} of {len(rows)} stored pockets are proven"
    promises = (Promise(promise, f"{proven}", proven >= POCKETS_PROVEN * len(rows)),)
    return Report("evidence", tuple(rows), (_pockets_table(rows),), promises)


def poses(queries: int | None, seed: int) -> Report:
    """Measure the first so many stored tool poses of which every configuration collides."""
    rows = [_pose(pose) for pose in load_poses()[:queries]]
    missing = sum(not row["proven"] for row in rows)
    promise = f"all of {len(rows)} poses that collide in every configuration are proven"
    line = {"poses": str(len(rows)), "proven": str(len(rows) - missing), "ms": spread([row["ms"] for row in rows])}
    table = table_of("Tool poses that collide in every configuration", [line], caption="ms: p50 / p95 of CPU time")
    return Report("evidence", tuple(rows), (table,), (Promise(promise, f"{missing} are not", not missing),))


def known_paths(queries: int | None, seed: int) -> Report:
    """Measure so many queries with a known path."""
    rows = [_known(plan) for plan in plans(queries or KNOWN, seed + 1)]
    false = sum(row["proven"] for row in rows)
    promise = f"none of {len(rows):,} queries with a known path is proven impossible"
    lines = [
        {"queries": name, "count": str(len(group)), "ms": spread([row["ms"] for row in group])}
        for name, group in grouped(rows, "robot").items()
    ]
    table = table_of("Queries with a known path", lines, caption="ms: p50 / p95 of CPU time until nothing is proven")
    return Report("evidence", tuple(rows), (table,), (Promise(promise, f"{false} are", not false),))


def _planar(seed: int, number: int) -> Row:
    chance = random.Random(f"discs {seed} {number}")
    service, ends = _discs(chance), list[FloatArray]()
    while len(ends) < 2:
        drawn = [np.array([chance.uniform(-3.14159, 3.14159) for _ in range(2)]) for _ in range(DRAWS)]
        ends = [q for q in drawn if service.checker.state_is_free(q)][:2]
        service = service if len(ends) == 2 else _discs(chance)  # a disc on the base leaves nothing free
    request = ps.PlanRequest(ends[0], ends[1], seed=number, time_limit=None, max_checks=20_000)
    planned, way = service.plan(request).ok, False
    clock = time.process_time()
    proven = prove_no_path(service.robot, service.scene, ends[0], [ends[1]]) is not None
    seconds = time.process_time() - clock
    if not planned and not proven:
        way = service.explain(request, plans=1).way is not None
    flood = _flooded(service, ends) if number % FLOODED == 0 else None
    return {
        "world": number,
        "planned": planned or way,
        "way": way,
        "proven": proven,
        "ms": seconds * 1e3,
        "flood": flood,
    }


def _discs(chance: random.Random) -> ps.PlannerService:
    obstacles = []
    for k in range(chance.randrange(3, 9)):
        x, y, radius = chance.uniform(-1.5, 1.5), chance.uniform(-1.5, 1.5), chance.uniform(0.05, 0.25)
        obstacles.append(ps.Obstacle(f"disc_{k}", ps.Cylinder(radius, 0.2), ps.Pose((x, y, 0.0))))
    return ps.PlannerService("planar2", ps.Scene(tuple(obstacles)))


def _flooded(service: ps.PlannerService, ends: list[FloatArray]) -> bool | None:
    """Whether a path exists, as far as a grid can tell."""
    low, high = service.robot.limits.lower, service.robot.limits.upper
    axes = [np.linspace(a, b, math.ceil((b - a) / CELL) + 1) for a, b in zip(low.tolist(), high.tolist(), strict=True)]
    cells = [tuple(int(np.abs(axis - q).argmin()) for axis, q in zip(axes, end, strict=True)) for end in ends]
    moved = 0.5 * sum(reach * float(axis[1] - axis[0]) for reach, axis in zip(REACHES, axes, strict=True))
    gaps = _gaps(service.scene, axes[0], axes[1], 2.0 * moved)
    if not _joined(gaps > -moved, cells, np.ones((3, 3))):
        return False
    return True if _joined(gaps > moved, cells, None) else None


def _gaps(scene: ps.Scene, shoulder: FloatArray, elbow: FloatArray, enough: float) -> FloatArray:
    """The gaps between the arm and the discs, those above ``enough`` as that."""
    gaps = np.full((len(shoulder), len(elbow)), enough)
    turned, bent = np.exp(-1j * shoulder), np.exp(-1j * elbow).astype(np.complex64)
    for disc in scene.obstacles:
        assert isinstance(disc.shape, ps.Cylinder)
        x, y, _ = disc.pose.position
        seen = (x + 1j * y) * turned
        np.minimum(gaps, (_to_bar(seen, 1.0) - disc.shape.radius)[:, None], out=gaps)
        rows = np.flatnonzero(np.abs(seen - 1.0) < 0.5 + HALF_WIDTH + disc.shape.radius + enough)
        for part in np.array_split(rows, max(1, len(rows) // 200)):
            from_elbow = (seen[part, None] - 1.0).astype(np.complex64) * bent
            gaps[part] = np.minimum(gaps[part], _to_bar(from_elbow, 0.5) - np.float32(disc.shape.radius))
    return gaps


def _to_bar(points: ComplexArray, length: float) -> FloatArray:
    """The distance to a link that begins at zero and lies along x."""
    beyond = np.maximum(np.abs(points.real - 0.5 * length) - 0.5 * length, 0.0)
    beside = np.maximum(np.abs(points.imag) - HALF_WIDTH, 0.0)
    return np.asarray(np.hypot(beyond, beside))


def _joined(free: BoolArray, cells: list[tuple[int, ...]], around: FloatArray | None) -> bool:
    names, _ = label(free, structure=around)
    first, second = (int(names[cell]) for cell in cells)
    return first == second != 0


def _pocket(pocket: Pocket) -> Row:
    """A stored query without a path."""
    clock = time.process_time()
    proof = prove_no_path(
        ps.load_robot(pocket.robot), pocket.scene, pocket.start, [pocket.goal], max_boxes=POCKET_BOXES
    )
    row: Row = {"kind": f"{pocket.robot}, {pocket.joints} joints", "proven": proof is not None}
    return row | {"ms": (time.process_time() - clock) * 1e3, "boxes": proof.boxes if proof is not None else None}


def _pose(pose: BlockedPose) -> Row:
    service = ps.PlannerService(POSES_ROBOT, pose.scene)
    clock = time.process_time()
    failure = service.plan(ps.PlanRequest(service.robot.home, pose.pose)).failure
    row: Row = {"solutions": pose.solutions, "ms": (time.process_time() - clock) * 1e3}
    return row | {"proven": failure is not None and failure.proven}


def _known(found: tuple[str, ps.PlannerService, SavedPlan]) -> Row:
    """A query that has a path, asked whether it has none."""
    name, service, plan = found
    path = plan.result.unwrap()[0]
    begin, goals = path.waypoints[0], [path.waypoints[-1]]
    clock = time.process_time()
    proof = prove_no_path(service.robot, service.scene, begin, goals, max_boxes=BOXES)
    return {"robot": name, "proven": proof is not None, "ms": (time.process_time() - clock) * 1e3}


def _table(worlds: list[Row]) -> Table:
    proven, none = ([row["ms"] for row in worlds if row["proven"] is which] for which in (True, False))
    line = {
        "worlds": f"{len(worlds):,}",
        "planned": f"{sum(row['planned'] for row in worlds):,}",
        "along a way": sum(row["way"] for row in worlds),
        "proven": f"{len(proven):,}",
        "flooded": sum(row["flood"] is not None for row in worlds),
        "proof ms": spread(proven) if proven else "-",
        "no proof ms": f"{p50(none):.0f} / {p95(none):.0f}" if none else "-",
    }
    return table_of("planar2 among random discs", [line], caption="p50 / p95 of CPU time")


def _pockets_table(rows: list[Row]) -> Table:
    lines = []
    for kind, group in grouped(rows, "kind").items():
        ms = [row["ms"] for row in group if row["proven"]]
        line = {"kind": kind, "pockets": str(len(group)), "proven": str(len(ms))}
        lines.append(line | {"ms": spread(ms) if ms else "-"})
    return table_of("Pockets that a link cannot leave", lines, caption="ms: p50 / p95 of CPU time of proofs")
