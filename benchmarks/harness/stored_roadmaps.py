"""What growing a roadmap, asking it and telling it of a moved obstacle costs, to be stored with the code."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import astuple, replace
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any

from benchmarks.harness.report import Row
from benchmarks.harness.stored import fingerprint
from benchmarks.studies.states import STEPS, plan
from benchmarks.worlds import queries
from planner_service import PRM, PlannerService, PlanResult, Pose, Roadmap, RoadmapUpdate, Scene, Trapezoidal, Verdict

__all__ = ["GOLDEN", "MOVED", "changes", "golden", "roadmap_row", "text_of"]

GOLDEN = Path(__file__).parents[2] / "tests" / "golden" / "roadmaps.json"

STEP = "JointStep(0.02)"
SEED = 0
QUERIES = 5
"""Stored queries of each scene, each asked of the roadmap as it was grown, and remembered."""

MOVED = MappingProxyType({"bin": ("demo_post", (0.05, 0.02, 0.0)), "shelf": ("shelf_board", (0.02, 0.0, 0.03))})
"""For each scene an obstacle, and by how many metres it moves."""


def golden(scenes: Iterable[str] = tuple(MOVED)) -> Row:
    """A row for each scene."""
    return {scene: roadmap_row(scene) for scene in scenes}


def roadmap_row(scene: str) -> Row:
    """Counts and hashes of a roadmap of a scene, of queries of it, and of what a moved obstacle leaves of it."""
    service = PlannerService(queries.ROBOT, scene, edge_step=STEPS[STEP])
    roadmap = service.build_roadmap(PRM(milestones=1000, neighbours=10), seed=SEED, progress=False)
    elsewhere = service.with_scene(_moved(service.scene))
    return {
        "build": _build(roadmap),
        "queries": dict(_asked(service, roadmap, QUERIES)),
        "moved": {"update": _update(elsewhere.update_roadmap(roadmap)), **dict(_asked(elsewhere, roadmap, 1))},
    }


def _moved(scene: Scene) -> Scene:
    name, by = MOVED[scene.name]
    pose = scene.obstacle(name).pose
    x, y, z = (at + metres for at, metres in zip(pose.position, by, strict=True))
    return scene.moved(name, Pose((x, y, z), pose.quaternion))


def _build(roadmap: Roadmap) -> Row:
    counts = None if roadmap.built is None else astuple(roadmap.built.counts)
    return {
        "counts": None if counts is None else list(counts),
        "milestones": len(roadmap.milestones),
        "free": roadmap.edge_knowledge.count(Verdict.FREE),
        "blocked": roadmap.edge_knowledge.count(Verdict.BLOCKED),
        "hash": roadmap.hash,
    }


def _asked(service: PlannerService, roadmap: Roadmap, count: int) -> Iterator[tuple[str, Row]]:
    for query in islice(queries.load(service.scene.name), count):
        result: PlanResult = plan(service, query, planner=replace(roadmap, remember=True), timing=Trapezoidal())
        learned = None if result.roadmap is None else result.roadmap.hash
        yield query.name, fingerprint(result) | {"learned": learned}


def _update(update: RoadmapUpdate) -> Row:
    told = {key: getattr(update, key) for key in ("kept", "judged", "fell", "rose")}
    return told | {"counts": list(astuple(update.counts)), "hash": update.roadmap.hash}


def changes(stored: Any, now: Any, where: str = "") -> list[str]:
    """What is not as stored, each by the keys that lead there; what is only stored is left out."""
    if not (isinstance(stored, Mapping) and isinstance(now, Mapping)):
        return [] if stored == now else [f"{where}: {stored} -> {now}"]
    named = {key: f"{where} {key}".lstrip() for key in now}
    return [line for key, name in named.items() for line in changes(stored.get(key), now[key], name)]


def text_of(content: Mapping[str, Row]) -> str:
    """The stored file: one build, query or update a line."""
    scenes = []
    for scene, row in content.items():
        parts = [f"  {json.dumps('build')}: {json.dumps(row['build'])}"]
        for key in ("queries", "moved"):
            lines = ",\n".join(f"   {json.dumps(name)}: {json.dumps(told)}" for name, told in row[key].items())
            parts.append(f"  {json.dumps(key)}: {{\n{lines}\n  }}")
        scenes.append(f" {json.dumps(scene)}: {{\n" + ",\n".join(parts) + "\n }")
    return "{\n" + ",\n".join(scenes) + "\n}\n"
