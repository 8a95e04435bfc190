"""What the compiled kernel saves: states, edges and searches next to numpy's sieves and to peers.

Everything is measured in one process, the contestants taking turns; what counts are the ratios of one run.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rich.table import Table

from benchmarks.baselines.naive_manager import NaiveManager
from benchmarks.baselines.pairwise import PairwiseFcl
from benchmarks.harness.report import Promise, Report, Row, least_ms, least_seconds, spread, table, table_of
from benchmarks.studies.backends import case, checkers, edges_of
from benchmarks.worlds import queries
from planner_service import BalancedRRTConnect, CollisionChecker, JointStep, RRTConnect
from planner_service.collision.backends import BackendName
from planner_service.collision.edge_sampling import interior
from planner_service.robot.model import load_robot
from planner_service.scene.scene import load_scene
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import Planner, SearchProblem

__all__ = ["run"]

CASES = ("wxai bin", "wxai shelf", "wxai post", "wxai clutter", "panda shelf", "ur5 bin")
PLANNED = ("bin", "shelf", "post", "clutter")
EDGES, FEW = 400, 25
"""Edges for the checkers, and how many of them the slow contestants judge."""

REPEATS = 3

SEARCHED: tuple[tuple[BackendName, int, int], ...] = (
    ("auto", queries.PER_SCENE, REPEATS),
    ("numpy", queries.PER_SCENE // 2, 1),
    ("fcl", queries.PER_SCENE // 2, 1),
)
"""How many of a scene's stored queries are searched with each backend, and how often."""

EDGE_PAIRWISE, EDGE_MANAGER, STATE_PAIRWISE, STATE_MANAGER = 300.0, 10.0, 20.0, 1.5
"""What the kernel is to be faster by, per configuration of the bin scene."""

SEARCH_PAIRWISE = 50.0
"""What a search is to be faster by, in each scene."""

PLANNERS: tuple[Planner, ...] = (BalancedRRTConnect(), RRTConnect())


def _judging(name: str) -> Row:
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


def _searched(scene: str, planner: Planner) -> Row:
    """A planner's search on stored queries with each backend: milliseconds, and whether all bits are equal.

    The kernel's are the least of some turns; the others, of which some seconds are asked, have one.
    """
    robot, world = load_robot(queries.ROBOT), load_scene(scene)
    took: dict[str, list[float]] = {}
    told: dict[str, list[Any]] = {}
    for backend, count, turns in SEARCHED:
        checker = CollisionChecker(robot, world, edge_step=JointStep(0.02), backend=backend)
        ran = [_search(checker, planner, query, turns) for query in queries.load(scene)[:count]]
        took[backend], told[backend] = [ms for ms, _ in ran], [outcome for _, outcome in ran]
    same = all(outcomes == told["auto"][: len(outcomes)] for outcomes in told.values())
    return {"scene": scene, "planner": planner.name, "ms": took, "same": same}


def _search(checker: CollisionChecker, planner: Planner, query: queries.Query, turns: int) -> tuple[float, Any]:
    """The least CPU milliseconds of some searches, and the path and the counts of each of them."""
    limits = checker.robot.limits
    ends = (query.start, query.goal[None], limits.lower, limits.upper)

    def searched() -> Any:
        before = checker.counts
        problem = SearchProblem(*ends, oracle=SearchOracle(checker), seed=query.number)
        waypoints = planner.search(problem).waypoints
        return None if waypoints is None else waypoints.tolist(), checker.counts - before

    least, found = least_ms(searched, turns)
    return least, found[0] if all(one == found[0] for one in found) else found


def run() -> Report:
    """Measure it all; about two minutes."""
    judging = [_judging(name) for name in CASES]
    searched = [_searched(scene, planner) for scene in PLANNED for planner in PLANNERS]
    unlike = [row["case"] for row in judging if row["unlike"]]
    first = judging[0]
    edge, state = first["edge_us"], first["state_us"]
    other, ratios = (
        [f"{row['scene']} {row['planner']}" for row in searched if not row["same"]],
        [_ratio(row["ms"], "fcl") for row in searched],
    )
    same = "paths and counts of searches are the same to the last bit with each backend"
    search = f"searches of {', '.join(PLANNED)}: FCL pair by pair takes {SEARCH_PAIRWISE:g} times as long"
    promises = (
        Promise(
            "FCL pair by pair and the naive manager find the states free, too", ", ".join(unlike) or "all", not unlike
        ),
        Promise(same, ", ".join(other) or "all", not other),
        Promise(search, ", ".join(f"{ratio:.0f}" for ratio in ratios), min(ratios) >= SEARCH_PAIRWISE),
        _faster("edges, bin: pair by pair", edge[2] / edge[0], EDGE_PAIRWISE),
        _faster("edges, bin: Pinocchio's naive manager", edge[3] / edge[0], EDGE_MANAGER),
        _faster("single states, bin: pair by pair", state[2] / state[0], STATE_PAIRWISE),
        _faster("single states, bin: Pinocchio's naive manager", state[3] / state[0], STATE_MANAGER),
    )
    tables = (_judging_table(judging), _search_table(searched))
    return Report("kernel", (*judging, *searched), tables, promises)


def _faster(what: str, ratio: float, least: float) -> Promise:
    return Promise(f"{what} takes {least:g} times as long", f"{ratio:.1f}", ratio >= least)


def _judging_table(rows: list[Row]) -> Table:
    columns = ("", "kernel", "numpy", "pair by pair", "naive manager", "x numpy", "x pairs", "x manager")
    cells = []
    for row in rows:
        for what, key in (("edges", "edge_us"), ("states", "state_us")):
            times = row[key]
            ratios = [f"{other / times[0]:.1f}" for other in times[1:]]
            cells.append([f"{row['case']}, {what}", *(f"{value:.2f}" for value in times), *ratios])
    return table("Microseconds per configuration, free, JointStep(0.02)", columns, cells)


def _ratio(ms: dict[str, list[float]], backend: str) -> float:
    """How many times as long the queries take with that backend that were searched with it."""
    return sum(ms[backend]) / sum(ms["auto"][: len(ms[backend])])


def _search_table(rows: list[Row]) -> Table:
    named = {"auto": "kernel", "numpy": "numpy", "fcl": "FCL, every pair"}
    lines = (
        {
            "scene": row["scene"],
            "planner": row["planner"],
            **{named[backend]: spread(row["ms"][backend], 1) for backend, *_ in SEARCHED},
            "x numpy": f"{_ratio(row['ms'], 'numpy'):.1f}",
            "x FCL": f"{_ratio(row['ms'], 'fcl'):.1f}",
            "same bits": "yes" if row["same"] else "no",
        }
        for row in rows
    )
    counts = ", ".join(str(count) for _, count, _ in SEARCHED)
    caption = (
        f"CPU ms, p50 / p95 of {counts} stored queries; seed: the query's number, JointStep(0.02), no padding. x: the "
        "same queries next to the kernel's, in all."
    )
    return table_of("Searches", lines, caption=caption)
