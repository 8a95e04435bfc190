"""What the compiled proof saves, that it says what the reference says, and that its verdicts on edges are true.

Paths are those of the stored queries and of every sixth public Panda problem. Edges are drawn as a planner asks for
them. Of an edge proven free a sampling by the compiled collision kernel every half milliradian must find no collision;
where one is proven to collide, FCL must say so of that very configuration, and of some sample of a fine sampling.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np
from rich.table import Table

from benchmarks.harness.report import Promise, Report, Row, least_ms, least_seconds, p50, spread, table_of
from benchmarks.studies import problems
from benchmarks.studies.backends import LONGEST, case, edges_of
from benchmarks.worlds import queries
from planner_service import CollisionChecker, JointPath, JointStep, PlannerService, PlanRequest
from planner_service.certify import MARGIN, Certifier, EdgeProof, EdgeVerdict
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot, load_robot
from planner_service.scene.scene import Scene

__all__ = ["run"]

SCENES = ("bin", "shelf", "post", "clutter")
EVERY = 6
"""Of the 70 Panda problems one of so many: a dozen."""

TURNS = 5
EDGES = {"wxai bin": 20_000, "panda shelf": 20_000, "ur5 bin": 5_000, "wxai cloud": 5_000}
TWICE = 150
"""Edges that the reference judges too: it takes some milliseconds for each."""

FINE, FINEST = 0.0005, 0.00005
"""Radians between samples; the second where the first finds nothing although a collision is proven."""

STATES = 300

MS_WXAI, MS_PANDA, EDGE_US, UNDECIDED = 2.0, 6.0, 30.0, 0.002
"""Promises: milliseconds of a certificate at p50, microseconds of a verdict on an edge, share of undecided ones."""


def _paths(name: str) -> Iterator[tuple[Robot, Scene, JointPath]]:
    """The paths of plans of a scene's stored queries, or of the Panda problems."""
    if name == problems.ROBOT:
        robot = load_robot(name)
        for problem in problems.public_problems().problems[::EVERY]:
            path = problems.planned(robot, problem).path
            if path is not None:
                yield robot, problem.scene, path
        return
    service = PlannerService(queries.ROBOT, name)
    for query in queries.load(name):
        path = service.plan(PlanRequest(query.start, query.goal, seed=query.number, time_limit=None)).path
        if path is not None:
            yield service.robot, service.scene, path


def _certified(name: str) -> Row:
    """Milliseconds of the certificates of some plans by either backend, and whether all is the same."""
    native_ms, numpy_ms, bounds, unlike = [], [], [], 0
    for robot, scene, path in _paths(name):
        native, reference = Certifier(robot, scene), Certifier(robot, scene, backend="numpy")
        charged: tuple[list[int], list[int]] = ([], [])
        found = native.certify(path, charge=charged[0].append)
        unlike += found != reference.certify(path, charge=charged[1].append) or charged[0] != charged[1]
        bounds.append(found.distances)
        native_ms.append(least_ms(lambda: native.certify(path), TURNS)[0])  # noqa: B023
        numpy_ms.append(least_ms(lambda: reference.certify(path), 1)[0])  # noqa: B023
    return {"paths": name, "count": len(bounds), "bounds": bounds, "ms": native_ms, "numpy": numpy_ms, "unlike": unlike}


def _judged(name: str) -> Row:
    """Verdicts on drawn edges: microseconds, shares, and how many are false."""
    robot, scene = case(name)
    certifier, reference = Certifier(robot, scene), Certifier(robot, scene, backend="numpy")
    checker = CollisionChecker(robot, scene, edge_step=JointStep(FINE))
    edges = list(edges_of(checker, EDGES[name], seed=31))
    clock = time.process_time()
    found = [certifier.certify_edge(a, b) for a, b in edges]
    seconds = time.process_time() - clock
    twice = [reference.certify_edge(a, b) for a, b in edges[:TWICE]]
    Q = np.array([a for a, _ in edges[:STATES]])
    same_gaps = np.array_equal(certifier.clearances(Q), reference.clearances(Q))
    clearance = least_seconds(lambda: certifier.clearances(Q), lambda: reference.clearances(Q), turns=TURNS)
    counts = {verdict.name: sum(proof.verdict is verdict for proof in found) for verdict in EdgeVerdict}
    return {
        "edges": name,
        "count": len(edges),
        "us": seconds / len(edges) * 1e6,
        **counts,
        "unlike": sum(one != two for one, two in zip(found, twice, strict=False)) + (not same_gaps),
        "clearance_us": [value / STATES * 1e6 for value in clearance],
        **_false(checker, edges, found),
    }


def _false(
    checker: CollisionChecker, edges: Sequence[tuple[FloatArray, FloatArray]], found: Sequence[EdgeProof]
) -> Row:
    """Verdicts that samples contradict."""
    step = JointStep(FINEST)
    judge = CollisionChecker(checker.robot, checker.scene, backend="fcl")
    finer = CollisionChecker(checker.robot, checker.scene, edge_step=step)
    not_free = not_there = not_found = 0
    for (a, b), proof in zip(edges, found, strict=True):
        if proof.free:
            not_free += not checker.edge_is_free(a, b)
        elif proof.colliding:
            not_there += judge.state_is_free(JointPath(np.array([a, b]))(proof.s))
            not_found += checker.edge_is_free(a, b) and finer.edge_is_free(a, b)
    return {"not_free": not_free, "not_there": not_there, "not_found": not_found}


def run() -> Report:
    """Measure it all; about three minutes."""
    paths = [_certified(name) for name in (*SCENES, problems.ROBOT)]
    edges = [_judged(name) for name in EDGES]
    unlike = sum(row["unlike"] for row in (*paths, *edges))
    wxai = [ms for row in paths[:-1] for ms in row["ms"]]
    first = edges[0]
    undecided = max(row["UNDECIDED"] / row["count"] for row in edges)
    lies = {key: sum(row[key] for row in edges) for key in ("not_free", "not_there", "not_found")}
    promises = (
        Promise("compiled proofs say what the reference says, to the last bit", f"{unlike} differences", not unlike),
        _at_most("certificate of a wxai plan, p50 ms", p50(wxai), MS_WXAI),
        _at_most("certificate of a panda_mbm plan, p50 ms", p50(paths[-1]["ms"]), MS_PANDA),
        _at_most(f"verdict on an edge of at most {LONGEST} rad, wxai bin, us", first["us"], EDGE_US),
        Promise(f"at most {UNDECIDED:.1%} of edges are undecided", f"{undecided:.3%} at worst", undecided <= UNDECIDED),
        _none(f"no edge proven free has a collision at {FINE} rad", lies["not_free"]),
        _none("where an edge is proven to collide FCL says so too", lies["not_there"]),
        _none("and so does some sample of it", lies["not_found"]),
    )
    return Report("certificates", (*paths, *edges), (_path_table(paths), _edge_table(edges)), promises)


def _at_most(what: str, value: float, limit: float) -> Promise:
    return Promise(f"{what}, at most {limit:g}", f"{value:.2f}", value <= limit)


def _none(what: str, count: int) -> Promise:
    return Promise(what, f"{count} edges", count == 0)


def _path_table(rows: Sequence[Row]) -> Table:
    lines = (
        {
            "paths of plans": row["paths"],
            "paths": row["count"],
            "bounds": spread(row["bounds"]),
            "compiled, ms": spread(row["ms"], 2),
            "numpy, ms": spread(row["numpy"], 1),
            "x p50": f"{p50(row['numpy']) / p50(row['ms']):.0f}",
        }
        for row in rows
    )
    return table_of("Certificates of whole plans, p50 / p95", lines)


def _edge_table(rows: Sequence[Row]) -> Table:
    lines = (
        {
            "edges": row["edges"],
            "count": f"{row['count']:,}",
            "us": f"{row['us']:.1f}",
            **{verdict.name.lower(): f"{row[verdict.name] / row['count']:.2%}" for verdict in EdgeVerdict},
            "clearance, us": f"{row['clearance_us'][0]:.1f}",
            "numpy, us": f"{row['clearance_us'][1]:.1f}",
        }
        for row in rows
    )
    caption = f"Free: farther apart than {MARGIN * 1e6:g} um all along. A clearance is that of one configuration."
    return table_of(f"Verdicts on straight edges of at most {LONGEST} rad", lines, caption=caption)
