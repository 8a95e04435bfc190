"""Roadmaps through histories of scenes that change: what is called free or blocked is, a fresh checker says."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.attack.domain import HISTORY
from benchmarks.attack.harness import Case, Part, Wrong
from benchmarks.attack.worlds import World, draw_obstacle, draw_robot, draw_scene, scene_of
from benchmarks.worlds.contacts import random_states
from planner_service.roadmap import Verdict

__all__ = ["Attack"]

PADDING = 0.001
EDGES = 250
"""That are judged again after each step, at most."""


class Attack(Part):
    name = "roadmaps"
    what = "histories of obstacles that come, move, go and are renamed, with plans, updates, saves and loads between"

    def draw(self, rng: np.random.Generator) -> Case:
        reach = float(rng.uniform(0.3, 0.8))
        history: list[list[Any]] = []
        for k in range(int(rng.integers(3, HISTORY + 1))):
            what = str(rng.choice(("add", "move", "remove", "rename", "swap", "back")))
            history.append([what, draw_obstacle(rng, reach, f"n{k}"), int(rng.integers(100))])
            does = rng.choice(("plan", "update", "save", "nothing"), size=int(rng.integers(1, 3)))
            history += [[str(do), None, int(rng.integers(2**31))] for do in does]
        case: Case = {"robot": draw_robot(rng), "obstacles": draw_scene(rng, reach, 4), "history": history}
        return case | {"milestones": int(rng.integers(10, 120)), "lazy": bool(rng.random() < 0.5)}

    def run(self, case: Case) -> None:
        with tempfile.TemporaryDirectory() as name:
            self._run(case, Path(name))

    def _run(self, case: Case, folder: Path) -> None:
        world = World(case, folder)
        grower = ps.LazyPRM(case["milestones"], 6) if case["lazy"] else ps.PRM(case["milestones"], 6, 20_000)
        obstacles = [dict(obstacle) for obstacle in case["obstacles"]]
        old = obstacles
        service = ps.PlannerService(world.robot, scene_of(obstacles))
        try:
            roadmap = service.build_roadmap(grower, seed=1, padding=PADDING, progress=False)
        except ps.InvalidRequest:  # nothing is free
            return
        for what, drawn, number in case["history"]:
            if drawn is not None:
                before, obstacles = obstacles, _edited(what, obstacles, old, drawn, number)
                old = before
                service = service.with_scene(scene_of(obstacles))
                continue
            if what == "save":
                roadmap.save(folder / "r.npz")
                again = ps.Roadmap.load(folder / "r.npz")
                if not np.array_equal(again.verdicts, roadmap.verdicts) or again.terms != roadmap.terms:
                    raise Wrong("a roadmap is saved and loaded as it was")
                roadmap = again
            elif what == "update":
                roadmap = service.update_roadmap(roadmap).roadmap
                self._judge(roadmap, service)
            elif what == "plan":
                roadmap = self._planned(roadmap, service, number)
        self.counted["histories"] += 1

    def _planned(self, roadmap: ps.Roadmap, service: ps.PlannerService, number: int) -> ps.Roadmap:
        rng = np.random.default_rng(number)
        Q = random_states(service.robot, 40, rng)
        Q = Q[service.checker.states_are_free(Q)]
        if len(Q) < 2:
            return roadmap
        request = ps.PlanRequest(Q[0], Q[1], planner=roadmap, padding=PADDING, time_limit=2.0, retries=0)
        found = service.plan(request)
        self.counted["plans"] += 1
        if found.path is not None and (found.certificate is None or not found.certificate.certified):
            raise Wrong("a plan over a roadmap is proven")
        if found.roadmap is None:
            return roadmap
        self._judge(found.roadmap, service)
        return found.roadmap

    def _judge(self, roadmap: ps.Roadmap, service: ps.PlannerService) -> None:
        """A verdict that holds now is that of a checker that knows nothing but the scene."""
        terms = roadmap.terms
        if terms is None or terms.scene_hash != service.scene.hash:  # a straight line was free: it was not asked
            return
        checker = ps.CollisionChecker(
            service.robot, service.scene, padding=terms.padding
        )  # near an end a plan keeps less
        verdicts, ends, points = roadmap.verdicts, roadmap.edges, roadmap.milestones
        held = np.flatnonzero((verdicts == Verdict.FREE) | (verdicts == Verdict.BLOCKED))
        for edge in held[:: max(1, len(held) // EDGES)].tolist():
            free = verdicts[edge] == Verdict.FREE
            self.counted["edges judged again"] += 1
            if checker.edge_is_free(points[ends[edge, 0]], points[ends[edge, 1]]) != free:
                raise Wrong(f"an edge that a roadmap calls {'free' if free else 'blocked'} is", f"edge {edge}")


def _edited(what: str, now: list[Any], old: list[Any], drawn: Any, number: int) -> list[Any]:
    """The obstacles after a change."""
    if what == "back":
        return old
    if what == "add" or not now:
        return [*(o for o in now if o["name"] != drawn["name"]), drawn]
    k = number % len(now)
    rest = [obstacle for m, obstacle in enumerate(now) if m != k]
    if what == "remove":
        return rest
    if what == "move":
        near = np.array(now[k]["xyz"]) + 0.1 * np.array(drawn["xyz"])
        return [*rest, now[k] | {"xyz": near.tolist() if number % 2 else drawn["xyz"]}]
    if what == "rename":
        return [*rest, now[k] | {"name": drawn["name"]}]
    m = (k + 1) % len(now)  # two change names
    return [
        obstacle | {"name": now[m if j == k else k]["name"]} if j in (k, m) else obstacle
        for j, obstacle in enumerate(now)
    ]
