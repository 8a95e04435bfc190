"""What planning the stored queries costs, by both rules for sampling edges: a run for each."""

from __future__ import annotations

from collections.abc import Iterable

import planner_service as ps
from benchmarks.harness.pins import fingerprint
from benchmarks.harness.report import Row
from benchmarks.studies.states import STEPS, plan
from benchmarks.worlds import queries
from benchmarks.worlds.queries import Query

__all__ = ["made", "planned"]


def planned(step: str, scene: str, chosen: Iterable[Query]) -> dict[str, Row]:
    """What some queries of a scene cost. The timing law touches neither counts nor geometry: the quickest will do."""
    service = ps.PlannerService(queries.ROBOT, scene, edge_step=STEPS[step])
    return {f"{query.name} {step}": fingerprint(plan(service, query, timing=ps.Trapezoidal())) for query in chosen}


def made() -> dict[str, Row]:
    """What all stored queries cost."""
    return {
        run: row
        for step in STEPS
        for scene in queries.SCENES
        for run, row in planned(step, scene, queries.load(scene)).items()
    }
