"""A UR5 around a mesh and a point cloud: what a state costs next to the same scene of boxes, and plans audited by Coal.

The cloud is what a depth camera would make of five boxes: 50,000 points on their faces with a millimetre of noise.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from rich.table import Table

from auditor.checker import IndependentChecker
from benchmarks.harness.audit import JOINT_STEP, independent, touch_in_time
from benchmarks.harness.report import Promise, Report, Row, least_seconds, p50, spread, table_of
from benchmarks.studies.agreement import around_contacts, random_states
from planner_service import CollisionChecker, Obstacle, PlannerService, PlanRequest, PointCloud, Pose, Robot, Scene
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Solid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box
from planner_service.robot.model import load_robot

__all__ = ["POINTS", "RESOLUTION", "ROBOT", "camera_cloud", "run", "scenes"]

ROBOT = "ur5"
SEED = 11
POINTS, NOISE, RESOLUTION = 50_000, 0.001, 0.010
PLANS = 20
STATES, EDGES, LONGEST = 300, 150, 0.8
"""Single states of each kind, edges, and their length in rad at most."""

VERDICTS = 10_000
WITHIN = 1e-4
"""Metres from contact within which Coal's octree may say otherwise."""

REPEATS = 5
FACTOR = 3.0
"""A state among the cloud's cells costs at most so many times one among the boxes."""

BOXES: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...] = (
    ((0.35, -0.30, -0.05), (0.75, 0.30, 0.02)),
    ((0.45, -0.30, 0.02), (0.50, 0.30, 0.45)),
    ((-0.60, 0.35, -0.05), (-0.20, 0.70, 0.30)),
    ((-0.10, -0.80, -0.05), (0.30, -0.50, 0.50)),
    ((-0.80, -0.20, 0.50), (-0.50, 0.20, 0.55)),
)
"""Lower and upper corners, metres: a board with a wall on it, two crates and a shelf behind the arm."""


def camera_cloud() -> FloatArray:
    """The points (50000, 3) on the faces of the boxes."""
    chance = np.random.default_rng(SEED)
    each = POINTS // len(BOXES)
    found = []
    for low, high in BOXES:
        points = chance.uniform(low, high, (each, 3))
        axis, side = chance.integers(0, 3, each), chance.integers(0, 2, each)
        points[np.arange(each), axis] = np.where(side == 0, np.array(low)[axis], np.array(high)[axis])
        found.append(points)
    return np.concatenate(found) + chance.normal(0.0, NOISE, (POINTS, 3))


def scenes() -> tuple[Scene, Scene]:
    """The scene of boxes, and that of a mesh and the cloud."""
    boxes: list[tuple[str, Solid, Pose]] = []
    for k, (low, high) in enumerate(BOXES):
        x, y, z = (b - a for a, b in zip(low, high, strict=True))
        centre = tuple((a + b) / 2 for a, b in zip(low, high, strict=True))
        boxes.append((f"box{k}", Box((x, y, z)), Pose((centre[0], centre[1], centre[2]))))
    stone = Mesh(np.random.default_rng(SEED).normal(0.0, 0.06, (60, 3)))
    cloud = PointCloud(camera_cloud(), RESOLUTION)
    among: list[tuple[str, Solid, Pose]] = [("cloud", cloud, Pose()), ("stone", stone, Pose((0.3, 0.3, 0.6)))]
    plain, measured = (Scene(tuple(Obstacle(*body) for body in bodies)) for bodies in (boxes, among))
    return plain, measured


def _anywhere(robot: Robot, chance: np.random.Generator, count: int) -> FloatArray:
    return chance.uniform(robot.limits.lower, robot.limits.upper, (count, robot.n))


def _cost(work: str, checkers: Sequence[CollisionChecker], ask: Callable[[CollisionChecker], Any]) -> Row:
    """Microseconds per judged state in both scenes."""
    judged = []
    for checker in checkers:
        before = checker.counts.states
        ask(checker)
        judged.append(checker.counts.states - before)
    seconds = least_seconds(*(partial(ask, checker) for checker in checkers), turns=REPEATS)
    boxes, cloud = (1e6 * spent / states for spent, states in zip(seconds, judged, strict=True))
    return {"work": work, "states": judged[1], "boxes_us": boxes, "cloud_us": cloud, "ratio": cloud / boxes}


def _costs(robot: Robot, plain: Scene, measured: Scene) -> Iterator[Row]:
    chance = np.random.default_rng(SEED)
    checkers = [CollisionChecker(robot, scene) for scene in (plain, measured)]
    Q = _anywhere(robot, chance, 10 * STATES)
    free = np.array([q for q in Q if all(checker.state_is_free(q) for checker in checkers)])
    edges = []
    for q in free[:EDGES]:
        other = _anywhere(robot, chance, 1)[0]
        edges.append((q, q + (other - q) * min(1.0, LONGEST / math.dist(q, other))))
    yield _cost("along edges from free states", checkers, lambda c: [c.edge_is_free(*edge) for edge in edges])
    yield _cost("single states, free", checkers, lambda c: [c.state_is_free(q) for q in free[:STATES]])
    yield _cost("single states, uniform", checkers, lambda c: [c.state_is_free(q) for q in Q[:STATES]])


def _asked(robot: Robot, plain: Scene, measured: Scene) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Random ends, free in both scenes, that no straight line joins, and that a plan among the boxes does."""
    among_boxes = PlannerService(robot, plain)
    checkers = [among_boxes.checker, CollisionChecker(robot, measured)]
    chance = np.random.default_rng(SEED + 1)
    while True:
        start, goal = _anywhere(robot, chance, 2)
        if not all(checker.state_is_free(q) for checker in checkers for q in (start, goal)):
            continue
        blocked = not any(checker.edge_is_free(start, goal) for checker in checkers)
        if blocked and among_boxes.plan(PlanRequest(start, goal, seed=0, time_limit=None)).ok:
            yield start, goal


def _plans(robot: Robot, plain: Scene, measured: Scene) -> Iterator[Row]:
    second = independent(ROBOT, measured)
    service = PlannerService(robot, measured)
    for start, goal in islice(_asked(robot, plain, measured), PLANS):
        clock = time.process_time()
        result = service.plan(PlanRequest(start, goal, seed=0, time_limit=None))
        row: Row = {"work": "plan", "seconds": time.process_time() - clock, "states": result.counts.states}
        row |= {"bounds": result.counts.distances, "failure": None if result.ok else str(result.failure)}
        if result.trajectory is not None and result.certificate is not None:
            row["clearance"] = result.certificate.clearance
            row["touch"] = touch_in_time(second, result.trajectory)
        yield row


def _verdicts(robot: Robot, scene: Scene) -> Row:
    """Verdicts next to those of Coal, which makes an octree of the points: half of them around contacts."""
    checker, second = CollisionChecker(robot, scene), independent(ROBOT, scene)
    chance = np.random.default_rng(SEED + 2)
    near, _ = around_contacts(checker, VERDICTS // 2, chance)
    Q = np.concatenate([random_states(robot, VERDICTS - len(near), chance), near])
    ours = checker.states_are_free(Q)
    differing = [k for k, q in enumerate(Q) if second.free(q) != ours[k]]
    far = [_from_contact(checker, second, Q[k], free=bool(ours[k])) for k in differing]
    counts = {"states": len(Q), "free": int(ours.sum()), "differ": len(far)}
    return {"work": "verdicts", **counts, "worst": max([0.0, *far])}


def _from_contact(checker: CollisionChecker, second: IndependentChecker, q: FloatArray, *, free: bool) -> float:
    """How far from contact a state is on which the two differ: what one proves apart, or the other says it is."""
    return max(0.0, checker.clearance(q)) if free else max(0.0, min(second.gaps(q).values()))


def run() -> Report:
    """Costs, plans, then verdicts."""
    robot, (plain, measured) = load_robot(ROBOT), scenes()
    costs, plans = list(_costs(robot, plain, measured)), list(_plans(robot, plain, measured))
    verdicts = _verdicts(robot, measured)
    done = [row for row in plans if row["failure"] is None]
    rejected = [row["touch"] for row in done if row["touch"] is not None]
    promises = []
    for row in costs:
        text = f"{row['work']}: at most {FACTOR:g} x the cost among boxes"
        promises.append(Promise(text, f"{row['ratio']:.2f} x", row["ratio"] <= FACTOR))
    text = "what is planned among the boxes is planned around the cloud"
    promises.append(Promise(text, f"{len(done)} of {PLANS}", len(done) == PLANS))
    promises.append(Promise("Coal rejects none of them", f"{len(rejected)} rejected", not rejected))
    text = f"{verdicts['states']:,} verdicts are those of Coal's octree but within {WITHIN * 1e3:g} mm of contact"
    differ = f"{verdicts['differ']} differ, at most {verdicts['worst'] * 1e6:.2f} um from contact"
    promises.append(Promise(text, differ, verdicts["worst"] <= WITHIN))
    tables = (_cost_table(costs, measured), _plan_table(plans))
    return Report("clouds", (*costs, *plans, verdicts), tables, tuple(promises))


def _cost_table(rows: Sequence[Row], scene: Scene) -> Table:
    cloud = scene.obstacles[0].shape
    assert isinstance(cloud, PointCloud)
    keys = {"among boxes us": "boxes_us", "in the cloud us": "cloud_us", "ratio": "ratio"}
    lines = (
        {"work": row["work"], "states": f"{row['states']:,}"} | {name: f"{row[key]:.1f}" for name, key in keys.items()}
        for row in rows
    )
    caption = (
        f"Robot {ROBOT}; {POINTS:,} points in {len(cloud.cells):,} cells of {RESOLUTION * 1e3:g} mm, joined to "
        f"{len(cloud.pieces.shapes):,} boxes, and a mesh; next to {len(BOXES)} boxes. CPU time, the least of {REPEATS}."
    )
    return table_of("A state next to a measured cloud", lines, caption=caption)


def _plan_table(rows: Sequence[Row]) -> Table:
    done = [row for row in rows if row["failure"] is None]
    line = {
        "planned": f"{len(done)}/{len(rows)}",
        f"rejected {JOINT_STEP:g} rad": sum(row["touch"] is not None for row in done),
        "ms": spread([row["seconds"] * 1e3 for row in rows]),
        **{key: spread([row[key] for row in rows]) for key in ("states", "bounds")},
        "proven mm p50": f"{p50(row['clearance'] * 1e3 for row in done):.2f}" if done else "-",
    }
    caption = "Ends that a plan among the boxes joins, but no straight line; no clock. Coal has an octree."
    return table_of("Plans around the cloud", [line], caption=caption)
