"""What the studies of the server ask, and what the library answers: by the digests of its bits."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

import planner_service as ps
from benchmarks.worlds import queries
from planner_service.records import SavedPlan, SavedTask
from planner_service.tasks import plan_pick_place

__all__ = ["Tasks", "digest", "plan_bodies", "plan_requests", "planned", "task_bodies", "task_requests"]

SCENE = "bin"


def digest(document: Mapping[str, Any]) -> str:
    """Of all of a plan or task file but what a clock says."""
    return hashlib.sha256(json.dumps(_still(document), sort_keys=True).encode()).hexdigest()


def _still(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _still(entry) for name, entry in value.items() if name != "seconds"}
    return [_still(entry) for entry in value] if isinstance(value, list) else value


def plan_requests(count: int) -> list[ps.PlanRequest]:
    """The stored queries, again and again with other seeds."""
    return list(islice(_plan_requests(), count))


def _plan_requests() -> Iterator[ps.PlanRequest]:
    stored, seed = queries.load(SCENE), 0
    while True:
        yield from (ps.PlanRequest(query.start, query.goal, seed=seed, time_limit=None) for query in stored)
        seed += 1


def plan_bodies(requests: Iterable[ps.PlanRequest]) -> list[dict[str, Any]]:
    """The same as a server takes them."""
    return [
        {
            "scene": SCENE,
            "request": {
                "start": list(map(float, request.start)),  # type: ignore[arg-type]
                "goals": [{"joints": list(map(float, request.goal))}],  # type: ignore[arg-type]
                "seed": request.seed,
                "time_limit": None,
            },
        }
        for request in requests
    ]


def planned(service: ps.PlannerService, request: ps.PlanRequest) -> str:
    """The digest of what the library plans."""
    return digest(json.loads(SavedPlan.of(service.plan(request)).file_text()))


def task_requests(count: int) -> list[int]:
    """Seeds of pick-and-place tasks."""
    return list(range(count))


def task_bodies(seeds: Iterable[int]) -> list[dict[str, Any]]:
    """Pick-and-places as a server takes them."""
    return [
        {"scene": SCENE, "target": "blue_block", "onto": "tray", "request": {"seed": seed, "time_limit": None}}
        for seed in seeds
    ]


@dataclass(frozen=True)
class Tasks:
    """The same tasks as the work of an engine, which is how ``plan_many`` plans many motions."""

    service: ps.PlannerService

    def prepare(self) -> None:
        """Plan once: what the first one builds, a server has built, too."""
        self(0)

    def __call__(self, seed: int) -> str:
        """The digest of one task."""
        return digest(json.loads(SavedTask.of(self.task(seed)).file_text()))

    def task(self, seed: int) -> ps.TaskResult:
        """One task."""
        home = self.service.robot.home
        return plan_pick_place(
            self.service, "blue_block", "tray", ps.PlanRequest(home, home, seed=seed, time_limit=None)
        )
