"""What growing a roadmap, querying it and updating it for a moved obstacle costs: a run for each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import islice
from types import MappingProxyType

import planner_service as ps
from benchmarks.harness.pins import fingerprint
from benchmarks.harness.report import Row
from benchmarks.studies.states import STEPS, plan
from benchmarks.worlds import queries
from planner_service.planners import PRMstar
from planner_service.planning import RoadmapUpdate
from planner_service.roadmap import Verdict

__all__ = ["GROWERS", "made"]

STEP = "JointStep(0.02)"
SEED = 0
QUERIES = 5
"""Stored queries of each scene, each asked of the roadmap as it was grown, and remembered."""

MOVED = MappingProxyType(
    {
        "bin": ("demo_post", (0.05, 0.02, 0.0)),
        "shelf": ("shelf_board", (0.02, 0.0, 0.03)),
        "post": ("post_left", (0.06, 0.03, 0.0)),
        "window": ("window_left", (0.0, 0.06, 0.0)),
    }
)
"""For each scene an obstacle, and by how many metres it moves."""


LARGE = ps.PRM(milestones=1000, neighbours=10)
GROWERS: Mapping[str, ps.PRM | PRMstar | ps.LazyPRM] = MappingProxyType(
    {"bin": LARGE, "shelf": LARGE, "post": ps.LazyPRM(milestones=200, neighbours=8), "window": PRMstar(milestones=80)}
)


def made(scenes: Iterable[str] = tuple(GROWERS)) -> dict[str, Row]:
    """Counts and hashes of a roadmap of each scene, of queries of it, and of what a moved obstacle leaves of it."""
    return {f"{scene} {run}": row for scene in scenes for run, row in _of(scene)}


def _of(scene: str) -> Iterator[tuple[str, Row]]:
    service = ps.PlannerService(queries.ROBOT, scene, edge_step=STEPS[STEP])
    roadmap = service.build_roadmap(GROWERS[scene], seed=SEED, progress=False)
    elsewhere = service.with_scene(_moved(service.scene))
    yield "build", _build(roadmap)
    for name, row in _planned(service, roadmap, QUERIES):
        yield f"query {name}", row
    yield "update", _update(elsewhere.update_roadmap(roadmap))
    for name, row in _planned(elsewhere, roadmap, 1):
        yield f"moved {name}", row


def _moved(scene: ps.Scene) -> ps.Scene:
    name, by = MOVED[scene.name]
    pose = scene.obstacle(name).pose
    x, y, z = (at + metres for at, metres in zip(pose.position, by, strict=True))
    return scene.moved(name, ps.Pose((x, y, z), pose.quaternion))


def _build(roadmap: ps.Roadmap) -> Row:
    counts = None if roadmap.built is None else roadmap.built.counts.named
    return {
        "checks": {} if counts is None else {"roadmap": list(counts.values())},
        "milestones": len(roadmap.milestones),
        "free": roadmap.edge_knowledge.count(Verdict.FREE),
        "blocked": roadmap.edge_knowledge.count(Verdict.BLOCKED),
        "hash": roadmap.hash,
    }


def _planned(service: ps.PlannerService, roadmap: ps.Roadmap, count: int) -> Iterator[tuple[str, Row]]:
    for query in islice(queries.load(service.scene.name), count):
        result: ps.PlanResult = plan(service, query, planner=replace(roadmap, remember=True), timing=ps.Trapezoidal())
        learned = None if result.roadmap is None else result.roadmap.hash
        yield query.name, fingerprint(result) | {"learned": learned}


def _update(update: RoadmapUpdate) -> Row:
    numbers = {key: getattr(update, key) for key in ("kept", "judged", "fell", "rose")}
    return {**numbers, "hash": update.roadmap.hash, "checks": {"update": list(update.counts.named.values())}}
