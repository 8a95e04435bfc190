"""Equal roadmaps answer equally: in memory or from a file, whatever was asked before, in every process."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.worlds import queries
from planner_service import PRM, JointStep, LazyPRM, PlannerService, PlanRequest, Roadmap
from tests.integration.test_pins import OTHER_CPU
from tests.support.optional import present

ROOT = Path(__file__).parents[3]


def cell() -> PlannerService:
    return PlannerService("wxai", "bin", edge_step=JointStep(0.05))


def answer(service: PlannerService, roadmap: Roadmap, number: int) -> dict[str, Any]:
    """All of a result that must not depend on anything but the request."""
    query = queries.load("bin")[number]
    result = service.plan(PlanRequest(query.start, query.goal, planner=roadmap, time_limit=None))
    counts = result.counts
    return {
        "counts": [counts.states, counts.edges, counts.distances],
        "path": present(result.path).waypoints.tobytes().hex(),
        "roadmap": present(result.roadmap).hash,
        "notes": [stage.note for stage in result.stages],
    }


@lru_cache
def chain(lazy: bool) -> tuple[Roadmap, ...]:
    """Roadmaps that learned one from the other."""
    service, planner = cell(), LazyPRM(milestones=300) if lazy else PRM(milestones=150, neighbours=8)
    roadmaps = [replace(service.build_roadmap(planner, seed=1), remember=True)]
    for query in queries.load("bin")[:8]:
        result = service.plan(PlanRequest(query.start, query.goal, planner=roadmaps[-1], time_limit=None))
        roadmaps.append(present(result.roadmap))
    return tuple(roadmaps)


@pytest.mark.slow
@pytest.mark.parametrize("lazy", [False, True], ids=["prm", "lazy"])
def test_one_from_a_file_answers_as_the_one_in_memory(lazy: bool, tmp_path: Path) -> None:
    service = cell()
    for k, roadmap in enumerate(chain(lazy)):
        roadmap.save(tmp_path / "a.npz")
        loaded = Roadmap.load(tmp_path / "a.npz")
        assert loaded.hash == roadmap.hash
        for number in (k, k + 7):
            assert answer(service, loaded, number) == answer(service, roadmap, number)


def test_roadmaps_of_which_nothing_was_asked_before_they_learned_answer_the_same() -> None:
    rng, service = np.random.default_rng(0), cell()
    roadmap = chain(False)[0]
    paths = [roadmap.milestones[rng.integers(0, len(roadmap.milestones), 4)] for _ in range(40)]
    asked = unasked = roadmap
    for k, path in enumerate(paths):
        asked, unasked = asked.with_path(path), unasked.with_path(path)
        if k % 10 == 0:
            answer(service, asked, k % 5)
    assert asked.hash == unasked.hash
    assert answer(service, asked, 11) == answer(service, unasked, 11)


CODE = """
import json, sys
from planner_service import Roadmap
from tests.unit.roadmap.test_repeatability import answer, cell
roadmap = Roadmap.load(sys.argv[1])
print(json.dumps([roadmap.hash, cell().build_roadmap({planner}, seed=2).hash, answer(cell(), roadmap, 4)]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("cpu", [{}, OTHER_CPU], ids=["this CPU", "an older CPU"])
def test_another_process_answers_the_same_to_the_last_bit(cpu: dict[str, str], tmp_path: Path) -> None:
    roadmap, planner = chain(True)[-1], PRM(milestones=40)
    roadmap.save(tmp_path / "a.npz")
    code = CODE.format(planner="__import__('planner_service').PRM(milestones=40)")
    environment = {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "12345", **cpu}
    command = [sys.executable, "-c", code, str(tmp_path / "a.npz")]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    here = [roadmap.hash, cell().build_roadmap(planner, seed=2).hash, answer(cell(), roadmap, 4)]
    assert json.loads(done.stdout) == here
