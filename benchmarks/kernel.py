"""What the compiled kernel saves: states, edges, searches and whole plans next to numpy's sieves and to peers.

Everything is measured in one process, the contestants taking turns; what counts are the ratios of one run.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rich.table import Table

from benchmarks import queries
from benchmarks.backends import case, checkers, compare, edges_of
from benchmarks.naive_manager import NaiveManager
from benchmarks.pairwise import PairwiseFcl
from benchmarks.report import Promise, Report, least_seconds, p50, p95, spread, table
from planner_service import CollisionChecker, JointStep, PlannerService, PlanRequest, RRTConnect
from planner_service.collision.edges import interior
from planner_service.collision.judge import Backend
from planner_service.oracle import SearchOracle
from planner_service.robot import load_robot
from planner_service.scene import load_scene
from planner_service.search import SearchProblem

__all__ = ["run"]

CASES = ("wxai bin", "wxai shelf", "wxai post", "wxai clutter", "panda shelf", "ur5 bin")
PLANNED = ("bin", "shelf", "post", "clutter")
EDGES, FEW = 400, 25
"""Edges for the checkers, and how many of them the slow contestants judge."""

COMPARED: tuple[tuple[Backend, int, int], ...] = (("numpy", 1500, 150), ("fcl", 300, 30))
"""States and edges that the kernel is compared on, with either reference."""

QUERIES = 10
REPEATS = 3

EDGE_PAIRWISE, EDGE_MANAGER, STATE_PAIRWISE, STATE_MANAGER = 300.0, 10.0, 20.0, 1.5
"""What the kernel is to be faster by, per configuration of the bin scene."""


def _judging(name: str) -> dict[str, Any]:
    """Microseconds per configuration of free edges, and per free state, of the four contestants."""
    robot, scene = case(name)
    native, reference = checkers(robot, scene, reference="numpy")
    pairwise, manager = PairwiseFcl(robot, scene), NaiveManager(robot, scene)
    free = [edge for edge in edges_of(reference, EDGES, seed=3) if reference.edge_is_free(*edge)]
    few = free[:FEW]
    batches = [[a, *interior(a.tolist(), b.tolist(), native.segments(a, b)), b] for a, b in few]
    states = [a for a, _ in free]
    lists = [q.tolist() for q in states[: FEW * 4]]
    unlike = sum(not manager.state_is_free(q) for q in lists) + sum(not pairwise.state_is_free(q) for q in lists)

    def judged(edges: list[Any]) -> int:
        return sum(native.segments(a, b) + 1 for a, b in edges)

    def one_by_one(checker: PairwiseFcl | NaiveManager) -> Callable[[], Any]:
        return lambda: [checker.state_is_free(q.tolist()) for batch in batches for q in batch]

    edge = least_seconds(
        lambda: [native.edge_is_free(a, b) for a, b in free],
        lambda: [reference.edge_is_free(a, b) for a, b in few],
        one_by_one(pairwise),
        one_by_one(manager),
        turns=REPEATS,
    )
    state = least_seconds(
        lambda: [native.state_is_free(q) for q in states],
        lambda: [reference.state_is_free(q) for q in states],
        lambda: [pairwise.state_is_free(q) for q in lists],
        lambda: [manager.state_is_free(q) for q in lists],
        turns=REPEATS,
    )
    edge_us = [s / judged(some) * 1e6 for s, some in zip(edge, (free, few, few, few), strict=True)]
    counts = (len(states), len(states), len(lists), len(lists))
    state_us = [s / count * 1e6 for s, count in zip(state, counts, strict=True)]
    return {"case": name, "edge_us": edge_us, "state_us": state_us, "unlike": unlike}


def _agreeing(name: str) -> dict[str, Any]:
    made = [(checkers(*case(name), reference=reference), states, edges) for reference, states, edges in COMPARED]
    found = [compare(pair, states, edges, seed=17) for pair, states, edges in made]
    return {
        "case": name,
        "states": sum(one.states for one in found),
        "edges": sum(one.edges for one in found),
        "differences": [words for one in found for words in one.differences],
    }


def _searched(scene: str) -> dict[str, Any]:
    """RRTConnect's search on the stored queries with kernel and numpy: milliseconds and whether all bits are equal."""
    robot, world = load_robot(queries.ROBOT), load_scene(scene)
    took: dict[str, list[float]] = {"auto": [], "numpy": []}
    told: dict[str, list[Any]] = {"auto": [], "numpy": []}
    backends: tuple[Backend, Backend] = ("auto", "numpy")
    made = {b: CollisionChecker(robot, world, edge_step=JointStep(0.02), backend=b) for b in backends}
    for query in queries.load(scene)[:QUERIES]:
        for backend, checker in made.items():
            before = checker.counts
            limits = (robot.limits.lower, robot.limits.upper)
            problem = SearchProblem(
                query.start, query.goal[None], *limits, oracle=SearchOracle(checker), seed=query.number
            )
            clock = time.perf_counter()
            outcome = RRTConnect().search(problem)
            took[backend].append((time.perf_counter() - clock) * 1e3)
            points = None if outcome.waypoints is None else outcome.waypoints.tolist()
            told[backend].append((points, checker.counts - before))
    return {"scene": scene, "ms": took, "same": told["auto"] == told["numpy"]}


def _planned(scene: str) -> dict[str, Any]:
    """Whole plans, proof and timing included, with the kernel."""
    service = PlannerService(queries.ROBOT, scene, edge_step=JointStep(0.02))
    took: list[float] = []
    for query in queries.load(scene)[:QUERIES]:
        clock = time.perf_counter()
        service.plan(PlanRequest(query.start, query.goal, seed=query.number, time_limit=None))
        took.append((time.perf_counter() - clock) * 1e3)
    return {"scene": scene, "ms": took}


def run() -> Report:
    """Measure it all; about two minutes."""
    judging = [_judging(name) for name in CASES]
    agreeing = [_agreeing(name) for name in CASES]
    searched = [_searched(scene) for scene in PLANNED]
    planned = [_planned(scene) for scene in PLANNED]
    unlike = [row["case"] for row in agreeing if row["differences"]]
    first = judging[0]
    edge, state = first["edge_us"], first["state_us"]
    promises = (
        Promise("the kernel agrees with FCL pair by pair and with numpy", ", ".join(unlike) or "all", not unlike),
        Promise(
            "searches are the same to the last bit with either backend",
            ", ".join(row["scene"] for row in searched if not row["same"]) or "all",
            all(row["same"] for row in searched),
        ),
        _faster("edges, bin: pair by pair", edge[2] / edge[0], EDGE_PAIRWISE),
        _faster("edges, bin: Pinocchio's naive manager", edge[3] / edge[0], EDGE_MANAGER),
        _faster("single states, bin: pair by pair", state[2] / state[0], STATE_PAIRWISE),
        _faster("single states, bin: Pinocchio's naive manager", state[3] / state[0], STATE_MANAGER),
    )
    tables = (_judging_table(judging), _search_table(searched, planned))
    return Report("kernel", (*judging, *agreeing, *searched, *planned), tables, promises)


def _faster(what: str, ratio: float, least: float) -> Promise:
    return Promise(f"{what} takes {least:g} times as long", f"{ratio:.1f}", ratio >= least)


def _judging_table(rows: list[dict[str, Any]]) -> Table:
    columns = ("", "kernel", "numpy", "pair by pair", "naive manager", "x numpy", "x pairs", "x manager")
    cells = []
    for row in rows:
        for what, key in (("edges", "edge_us"), ("states", "state_us")):
            times = row[key]
            ratios = [f"{other / times[0]:.1f}" for other in times[1:]]
            cells.append([f"{row['case']}, {what}", *(f"{value:.2f}" for value in times), *ratios])
    return table("Microseconds per configuration, free, JointStep(0.02)", columns, cells)


def _search_table(searched: list[dict[str, Any]], planned: list[dict[str, Any]]) -> Table:
    columns = ("p50 / p95 ms", "search, kernel", "search, numpy", "x p50", "x p95", "whole plan, kernel")
    cells = []
    for search, plan in zip(searched, planned, strict=True):
        ms = search["ms"]
        ratios = [f"{percentile(ms['numpy']) / percentile(ms['auto']):.1f}" for percentile in (p50, p95)]
        cells.append([search["scene"], spread(ms["auto"], 1), spread(ms["numpy"], 1), *ratios, spread(plan["ms"], 1)])
    return table("RRTConnect on the stored queries, and whole plans", columns, cells)
