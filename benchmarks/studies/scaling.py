"""What more boxes cost: building a checker, judging states and edges, and whole plans, among 10 to 10,000 of them.

Two kinds of scenes, in each of which the same is asked whatever the number of boxes. Boxes spread at random over the
workspace, whose volumes sum up to the same: none comes near the arm on certain edges, which are free, therefore, in all
of them. And the bin scene, whose boxes are cut into ever more pieces that fill the same space: the same searches ask
the same and find the same in all of them.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator, Sequence
from itertools import count
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.harness.report import Promise, Report, Row, cpu_ms, least_ms, least_seconds, p50, table_of
from benchmarks.studies.agreement import random_states
from benchmarks.studies.speed import AskedEdge, asked_edges
from benchmarks.worlds import queries
from planner_service import Box, CollisionChecker, JointStep, Obstacle, PlannerService, PlanRequest, Pose, Robot, Scene
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import load_robot
from planner_service.scene.scene import load_scene

__all__ = ["SIZES", "cut", "free_edges", "promises", "run", "spread_rows", "spread_scenes"]

SIZES = (10, 100, 1_000, 10_000)
SEED = 2026
STEP = JointStep(0.02)
TURNS = 9

VOLUME = 10 * 0.12**3
"""Cubic metres of all boxes together: ten cubes of 12 cm."""

WORKSPACE = ((-0.7, 0.7), (-0.7, 0.7), (0.0, 0.8))
"""Metres: what the arm can reach, in which the centres of the boxes lie."""

AROUND_BASE = 0.15
"""Metres from the base's axis, and its height, that stay free of centres: no box is about the shoulder for ever."""

EDGES, LONGEST, ROOM = 24, 0.8, 0.02
"""Edges that stay free in all scenes, their length (rad) at most, and the metres that every box keeps from them."""

DRAWN = 50
"""Boxes drawn at once at least."""

STATES, FEW = 1_000, 10
"""States at random; states and edges for numpy."""

QUERIES = 3
"""Of the bin, whose plans are timed."""

MOST = 3.0
"""Promised: edges among 1,000 boxes take at most so many times as long as among 10."""


def free_edges(robot: Robot) -> list[tuple[FloatArray, FloatArray]]:
    """Edges at random on which the arm does not touch itself; the same in every call."""
    checker, rng = CollisionChecker(robot, Scene(), edge_step=STEP), np.random.default_rng(SEED)
    found: list[tuple[FloatArray, FloatArray]] = []
    while len(found) < EDGES:
        a = random_states(robot, 1, rng)[0]
        way = rng.normal(size=robot.n)
        way *= LONGEST / math.sqrt(math.fsum((way * way).tolist()))
        b = np.clip(a + way, robot.limits.lower, robot.limits.upper)
        if checker.edge_is_free(a, b) and _above_table(robot, a) and _above_table(robot, b):
            found.append((a, b))
    return found


def _above_table(robot: Robot, q: FloatArray) -> bool:
    """Whether the tool is where boxes are."""
    tip = robot.tool_pose(q)[:3, 3].tolist()
    return all(low <= x <= high for x, (low, high) in zip(tip, WORKSPACE, strict=True))


def spread_scenes(robot: Robot, sizes: Sequence[int] = SIZES) -> Iterator[Scene]:
    """Cubes at random over the workspace, none near the arm on any of ``free_edges``."""
    keep_out = np.concatenate([_samples(a, b) for a, b in free_edges(robot)])
    for size in sizes:
        rng, side = np.random.default_rng([SEED, size]), (VOLUME / size) ** (1.0 / 3.0)
        kept: list[Obstacle] = []
        names = count()
        while len(kept) < size:
            drawn = [Obstacle(f"box {next(names)}", Box((side,) * 3), pose) for pose in _poses(rng, max(size, DRAWN))]
            kept += _apart(robot, drawn, keep_out)
        yield Scene(tuple(kept[:size]), name=f"{size} boxes")


def _poses(rng: np.random.Generator, number: int) -> Iterator[Pose]:
    """Places in the workspace, turned at random about the vertical."""
    low, high = np.array(WORKSPACE).T
    for x, y, z in (low + (high - low) * rng.random((number, 3))).tolist():
        turn = math.pi * float(rng.random())
        if math.hypot(x, y) > AROUND_BASE or z > AROUND_BASE:
            yield Pose((x, y, z), (math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2)))


def _samples(a: FloatArray, b: FloatArray) -> FloatArray:
    """Configurations along an edge, at most 0.05 rad apart (L2)."""
    parts = math.ceil(LONGEST / 0.05)
    return np.asarray(a + (b - a) * (np.arange(parts + 1) / parts)[:, None])


def _apart(robot: Robot, drawn: Sequence[Obstacle], keep_out: FloatArray) -> Iterator[Obstacle]:
    """The obstacles that no moving part of the arm comes near in any of the configurations."""
    own = [(a, b) for a, b in robot.link_pairs]
    for obstacle in drawn:
        checker = CollisionChecker(robot, Scene((obstacle,)), padding=ROOM, allowed=own)
        if checker.states_are_free(keep_out).all():
            yield obstacle


def cut(scene: Scene, size: int) -> Scene:
    """The scene with boxes halved, always the longest across its longest side, until it has so many obstacles."""
    ids = count()
    boxes = [(-max(o.shape.size), next(ids), o) for o in scene.obstacles if isinstance(o.shape, Box)]
    others = [o for o in scene.obstacles if not isinstance(o.shape, Box)]
    heapq.heapify(boxes)
    while len(boxes) + len(others) < size:
        _, _, whole = heapq.heappop(boxes)
        for half in _halves(whole):
            heapq.heappush(boxes, (-max(half.shape.size), next(ids), half))  # type: ignore[union-attr]
    pieces = [Obstacle(f"piece {k}", o.shape, o.pose) for k, (_, _, o) in enumerate(sorted(boxes, key=lambda b: b[1]))]
    return Scene((*others, *pieces), name=f"{scene.name} in {size}")


def _halves(whole: Obstacle) -> Iterator[Obstacle]:
    size = list(whole.shape.size)  # type: ignore[union-attr]
    axis = size.index(max(size))
    size[axis] /= 2.0
    for way in (-0.5, 0.5):
        offset = [0.0, 0.0, 0.0]
        offset[axis] = way * size[axis]
        pose = whole.pose @ Pose((offset[0], offset[1], offset[2]))
        yield Obstacle(whole.name, Box((size[0], size[1], size[2])), pose)


def _built(robot: Robot, scene: Scene, **settings: Any) -> tuple[CollisionChecker, float]:
    """A checker, and the milliseconds of CPU it took to build."""
    ms, checker = cpu_ms(lambda: CollisionChecker(robot, scene, edge_step=STEP, **settings))
    return checker, ms


def _planned(service: PlannerService, asked: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[float, list[Any]]:
    """Milliseconds of CPU of a plan, p50 of some, each the least of two, and counts and bits of all."""
    took, told = [], []
    for k, (start, goal) in enumerate(asked):
        request = PlanRequest(start, goal, seed=k, time_limit=None)
        ms, (*_, result) = least_ms(lambda: service.plan(request), 2)  # noqa: B023
        path = None if result.path is None else result.path.waypoints.tolist()
        took.append(ms)
        told.append((path, result.counts.states, result.counts.edges))
    return p50(took), told


def spread_rows(sizes: Sequence[int] = SIZES, *, plans: bool = True) -> Iterator[Row]:
    """What boxes spread over the workspace cost."""
    robot = load_robot(queries.ROBOT)
    edges = free_edges(robot)
    chance = random_states(robot, STATES, np.random.default_rng(SEED))
    ends = [q for edge in edges for q in edge]
    for size, scene in zip(sizes, spread_scenes(robot, sizes), strict=True):
        checker, build = _built(robot, scene)
        slow, _ = _built(robot, scene, backend="numpy")
        if not all(checker.edge_is_free(a, b) for a, b in edges):
            raise AssertionError(f"{scene.name}: an edge that was to be free is not")
        works: list[tuple[Callable[[], Any], int]] = [
            (lambda: [checker.edge_is_free(a, b) for a, b in edges], _judged(checker, edges)),  # noqa: B023
            (lambda: [checker.state_is_free(q) for q in ends], len(ends)),  # noqa: B023
            (lambda: [checker.state_is_free(q) for q in chance], len(chance)),  # noqa: B023
            (lambda: [slow.edge_is_free(a, b) for a, b in edges[:FEW]], _judged(checker, edges[:FEW])),  # noqa: B023
            (lambda: [slow.state_is_free(q) for q in ends[:FEW]], FEW),  # noqa: B023
        ]
        yield {
            "boxes": size,
            "pairs": checker.pair_count,
            "build": build,
            "us": _microseconds(works),
            "colliding": 1.0 - float(checker.states_are_free(chance).mean()),
            "plan": _planned(PlannerService(robot, scene, edge_step=STEP), edges[:QUERIES])[0] if plans else None,
        }


def bin_rows(sizes: Sequence[int] = SIZES) -> Iterator[Row]:
    """What the pieces of a scene cost that is cut into ever more."""
    robot, whole = load_robot(queries.ROBOT), load_scene("bin")
    asked = asked_edges(CollisionChecker(robot, whole, edge_step=STEP), "bin")
    few = [(query.start, query.goal) for query in queries.load("bin")[:QUERIES]]
    chance = random_states(robot, STATES, np.random.default_rng(SEED))
    told: list[Any] = []
    for size in sizes:
        scene = cut(whole, size)
        checker, build = _built(robot, scene)
        before = checker.counts.states
        verdicts = _asked(checker, asked)
        states = checker.counts.states - before
        works: list[tuple[Callable[[], Any], int]] = [
            (lambda: _asked(checker, asked), states),  # noqa: B023
            (lambda: [checker.state_is_free(q) for q in chance], len(chance)),  # noqa: B023
        ]
        service = PlannerService(robot, scene, edge_step=STEP)
        service.plan(PlanRequest(*few[0], time_limit=None))
        plan, plans = _planned(service, few)
        told.append((verdicts, states, plans))
        yield {
            "boxes": len(scene.obstacles),
            "pairs": checker.pair_count,
            "build": build,
            "us": _microseconds(works),
            "plan": plan,
            "same": told[-1] == told[0],
        }


def _asked(checker: CollisionChecker, edges: Sequence[AskedEdge]) -> list[bool]:
    return [checker.edge_is_free(edge.q1, edge.q2, known=edge.known) for edge in edges]


def _judged(checker: CollisionChecker, edges: Sequence[tuple[FloatArray, FloatArray]]) -> int:
    return sum(checker.segments(a, b) + 1 for a, b in edges)


def _microseconds(works: Sequence[tuple[Callable[[], Any], int]]) -> list[float]:
    """Of each work for one of what it judges, the least of some turns."""
    seconds = [least_seconds(work, turns=TURNS)[0] for work, _ in works]
    return [spent / judged * 1e6 for spent, (_, judged) in zip(seconds, works, strict=True)]


def run() -> Report:
    """Measure both kinds of scenes; about two minutes."""
    spread, pieces = list(spread_rows()), list(bin_rows())
    return Report("scaling", (*spread, *pieces), (_spread_table(spread), _bin_table(pieces)), promises(spread, pieces))


def promises(spread: Sequence[Row], pieces: Sequence[Row]) -> tuple[Promise, ...]:
    """What these figures were to be."""
    first, thousand = (next(row for row in spread if row["boxes"] == size) for size in (10, 1_000))
    ratios = [thousand["us"][k] / first["us"][k] for k in (0, 1)]
    other = [str(row["boxes"]) for row in pieces if not row["same"]]
    spread_ = f"1,000 boxes spread over the workspace cost at most {MOST:g} times as much as 10, along edges"
    same = "the bin in any number of pieces: the same verdicts, counts, paths"
    return (
        Promise(spread_, f"{ratios[0]:.2f}; single free states {ratios[1]:.2f}", ratios[0] <= MOST),
        Promise(same, ", ".join(other) or "all", not other),
    )


def _spread_table(rows: Sequence[Row]) -> Table:
    def line(row: Row) -> Row:
        edge, state, chance, slow_edge, slow_state = row["us"]
        return {
            **{key: f"{row[key]:,}" for key in ("boxes", "pairs")},
            "build ms": f"{row['build']:.0f}",
            "edges us": f"{edge:.2f}",
            "x 10 boxes": f"{edge / rows[0]['us'][0]:.2f}",
            "free states us": f"{state:.1f}",
            "random states us": f"{chance:.1f}",
            "colliding": f"{row['colliding']:.0%}",
            "numpy: edges us": f"{slow_edge:.0f}",
            "states us": f"{slow_state:.0f}",
            "plan ms": "-" if row["plan"] is None else f"{row['plan']:.0f}",
        }

    caption = (
        f"wxai, JointStep({STEP.angle:g}); CPU microseconds per configuration, the least of {TURNS} turns. The cubes "
        f"of every scene have {VOLUME * 1e3:.0f} litres in all; {EDGES} edges of about {LONGEST:g} rad and their ends "
        "are free in all scenes. Plan: p50 of some of these edges, proof and timing included."
    )
    return table_of("Boxes spread over the workspace", map(line, rows), caption=caption)


def _bin_table(rows: Sequence[Row]) -> Table:
    def line(row: Row) -> Row:
        edge, chance = row["us"]
        return {
            "pieces": f"{row['boxes']:,}",
            "pairs": f"{row['pairs']:,}",
            "build ms": f"{row['build']:.0f}",
            "edges us": f"{edge:.2f}",
            "x first": f"{edge / rows[0]['us'][0]:.2f}",
            "random states us": f"{chance:.1f}",
            "plan ms": f"{row['plan']:.0f}",
            "same": "yes" if row["same"] else "no",
        }

    caption = (
        f"Edges: those that searches of stored queries ask for. Plan: p50 of {QUERIES} such queries, search, proof and "
        "timing included, by a service that has planned before. Same: verdicts, counts and paths as in the first row."
    )
    return table_of("The bin scene in pieces", map(line, rows), caption=caption)
