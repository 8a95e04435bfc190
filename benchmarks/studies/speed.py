"""Microseconds per judged state, next to python-fcl asked pair by pair, on the same states in the same run."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.baselines.pairwise import PairwiseFcl
from benchmarks.harness.environment import ROOT
from benchmarks.harness.report import Promise, Report, Row, p50, table_of
from benchmarks.studies.agreement import random_states
from benchmarks.worlds import queries
from planner_service import BalancedRRTConnect, CollisionChecker, MotionStep
from planner_service.collision import Known
from planner_service.collision.edge_sampling import interior
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import load_robot
from planner_service.scene.scene import load_scene
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import SearchProblem

__all__ = ["AskedEdge", "Recorder", "asked_edges", "run"]

STATES = 200
REPEATS = 5
QUERIES = 2
"""Stored queries of a scene whose searches give the edges."""

EDGES = 100
"""Edges of each kind at most."""

SINGLE, ALONG_EDGES, IMPORT_SECONDS = 2.0, 8.0, 0.5


@dataclass(frozen=True, eq=False)
class AskedEdge:
    """An edge that a search asked about, which of its ends it knew to be free, and whether it was free."""

    q1: FloatArray
    q2: FloatArray
    known: Known
    free: bool

    def states(self, checker: CollisionChecker) -> FloatArray:
        """What has to be judged, in the stated order: ends not known, then the interior in bisection order."""
        ends = [q for q, end in ((self.q1, Known.START), (self.q2, Known.END)) if end not in self.known]
        inner = interior(self.q1.tolist(), self.q2.tolist(), checker.segments(self.q1, self.q2))
        return np.concatenate([np.array(ends).reshape(-1, len(self.q1)), inner])


class Recorder:
    """An oracle that judges each edge in full when it is asked, and keeps what it was asked about."""

    def __init__(self, checker: CollisionChecker) -> None:
        self._oracle = SearchOracle(checker)
        self.edges: list[AskedEdge] = []

    @property
    def states(self) -> int:
        """States judged so far."""
        return self._oracle.states

    def state_is_free(self, q: FloatArray) -> bool:
        """Whether one configuration is free."""
        return self._oracle.state_is_free(q)

    def edge_is_free(self, q1: FloatArray, q2: FloatArray, *, known: Known = Known.NEITHER) -> bool:
        """Whether an edge is free, which is kept with the question."""
        free = self._oracle.edge_is_free(q1, q2, known=known)
        self.edges.append(AskedEdge(q1, q2, known, free))
        return free


def asked_edges(checker: CollisionChecker, scene: str) -> list[AskedEdge]:
    """Edges that the default planner asks about on the first queries of a scene."""
    limits = checker.robot.limits
    recorder = Recorder(checker)
    for query in queries.load(scene)[:QUERIES]:
        ends = (query.start, query.goal[None], limits.lower, limits.upper)
        BalancedRRTConnect().search(SearchProblem(*ends, oracle=recorder, seed=query.number))
    return recorder.edges


def _medians(*works: Callable[[], Any]) -> list[float]:
    """CPU seconds of each, the works taking turns so that a noisy moment hits all of them."""
    times: list[list[float]] = [[] for _ in works]
    for _ in range(REPEATS):
        for work, seconds in zip(works, times, strict=True):
            clock = time.process_time()
            work()
            seconds.append(time.process_time() - clock)
    return [p50(seconds) for seconds in times]


def _single(row: Row, checker: CollisionChecker, fcl: PairwiseFcl, Q: FloatArray) -> Row:
    """Judge states one at a time."""
    lists = Q.tolist()
    if [checker.state_is_free(q) for q in Q] != [fcl.state_is_free(q) for q in lists]:
        raise AssertionError(f"{row}: the checker and FCL disagree on a state")
    ours, theirs = _medians(
        lambda: [checker.state_is_free(q) for q in Q], lambda: [fcl.state_is_free(q) for q in lists]
    )
    return row | _figures(ours, theirs, len(Q))


def _edges(row: Row, checker: CollisionChecker, fcl: PairwiseFcl, edges: list[AskedEdge]) -> Row:
    """Judge edges as the search asked about them."""
    batches = [e.states(checker) for e in edges]
    hits = [fcl.first_collision(Q) for Q in batches]
    judged = sum(len(Q) if hit is None else hit + 1 for Q, hit in zip(batches, hits, strict=True))
    before = checker.counts.states
    verdicts = [checker.edge_is_free(e.q1, e.q2, known=e.known) for e in edges]
    if checker.counts.states - before != judged or verdicts != [e.free for e in edges]:
        raise AssertionError(f"{row}: the checker and FCL disagree on an edge")
    ours, theirs = _medians(
        lambda: [checker.edge_is_free(e.q1, e.q2, known=e.known) for e in edges],
        lambda: [fcl.first_collision(Q) for Q in batches],
    )
    return row | _figures(ours, theirs, judged)


def _figures(ours: float, theirs: float, states: int) -> Row:
    each = {"checker_us": ours / states * 1e6, "pairwise_us": theirs / states * 1e6}
    return {"states": states, **each, "ratio": theirs / ours}


def _scene_rows(scene: str) -> Iterable[Row]:
    robot, world = load_robot(queries.ROBOT), load_scene(scene)
    checker, fcl = CollisionChecker(robot, world, edge_step=MotionStep(0.010)), PairwiseFcl(robot, world)
    if checker.pair_count != fcl.pair_count:
        raise AssertionError(f"{scene}: the checker judges {checker.pair_count} pairs, there are {fcl.pair_count}")
    row = {"scene": scene, "self_pairs": len(fcl.self_pairs), "scene_pairs": len(fcl.scene_pairs)}
    rng = np.random.default_rng(queries.SEED)
    Q = random_states(robot, 20 * STATES, rng)
    free = np.array([q for q in Q if checker.state_is_free(q)])
    edges = asked_edges(checker, scene)
    yield _single(row | {"work": "single states, free"}, checker, fcl, free[:STATES])
    yield _single(row | {"work": "single states, uniform"}, checker, fcl, Q[:STATES])
    yield _edges(row | {"work": "edges, free"}, checker, fcl, [e for e in edges if e.free][:EDGES])
    yield _edges(row | {"work": "edges, as a search asks"}, checker, fcl, edges[:EDGES])


def import_seconds() -> float:
    """Best of five fresh processes."""
    code = "import time; t = time.perf_counter(); import planner_service; print(time.perf_counter() - t)"
    command = [sys.executable, "-c", code]
    return min(float(subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout) for _ in range(5))


def run() -> Report:
    """All scenes, and the import."""
    rows = [row for scene in queries.SCENES for row in _scene_rows(scene)]
    seconds = import_seconds()
    rows.append({"work": "import planner_service", "seconds": seconds})
    promises = [
        _worst(rows, "single states, free", SINGLE),
        _worst(rows, "edges, free", ALONG_EDGES),
        _worst(rows, "edges, as a search asks", ALONG_EDGES),
        Promise(f"import planner_service under {IMPORT_SECONDS} s", f"{seconds:.3f} s", seconds < IMPORT_SECONDS),
    ]
    return Report("speed", tuple(rows), (_table(rows),), tuple(promises))


def _worst(rows: list[Row], work: str, wanted: float) -> Promise:
    """The median over the scenes counts; the worst scene is told, too."""
    ratios = [row["ratio"] for row in rows if row["work"] == work]
    text = f"{work}: at least {wanted:g} x as fast as pair by pair (median of the scenes)"
    return Promise(text, f"{p50(ratios):.1f} x (worst {min(ratios):.1f} x)", p50(ratios) >= wanted)


def _sum(own: int, with_scene: int) -> str:
    return f"{own} + {with_scene} = {own + with_scene}"


def _table(rows: list[Row]) -> Table:
    lines = (
        {
            **{key: row[key] for key in ("scene", "work")},
            "pairs: self + scene": _sum(row["self_pairs"], row["scene_pairs"]),
            "states": f"{row['states']:,}",
            "pair by pair us": f"{row['pairwise_us']:.1f}",
            "checker us": f"{row['checker_us']:.1f}",
            "ratio": f"{row['ratio']:.1f}",
        }
        for row in rows
        if "ratio" in row
    )
    caption = (
        f"CPU time per state, medians of {REPEATS}; edges of {BalancedRRTConnect.name} at MotionStep(0.010). "
        "In a free state every pair has to be judged; a uniform one often ends at its first touching pair."
    )
    return table_of("Judging every self and scene pair", lines, caption=caption)
