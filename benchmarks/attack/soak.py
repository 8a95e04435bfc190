"""Soak: mixed calls without end, memory flat, and a canary that is answered with the same bits all along."""

from __future__ import annotations

import gc
import tempfile
from functools import cached_property
from pathlib import Path

import numpy as np

import planner_service as ps
from benchmarks.attack.harness import Case, Part, Wrong
from benchmarks.attack.jail import rss
from benchmarks.attack.threads import Reference
from benchmarks.studies.agreement import random_states
from planner_service.records.plan_file import load_plan

__all__ = ["Attack"]

WHAT = ("check", "edge", "contacts", "certify", "kinematics", "plan", "scene", "service", "file", "roadmap")
SHARES = (0.3, 0.2, 0.1, 0.1, 0.1, 0.05, 0.05, 0.03, 0.05, 0.02)

WARM, EVERY = 3_000, 500
"""Calls before memory is measured for the first time, and between two measurements."""

GROWTH = 60_000_000
"""Bytes that memory may have grown since then."""


class Attack(Part):
    name = "soak"
    what = "mixed calls with memory measured, and a plan asked again and again for the same bits"

    def __init__(self) -> None:
        super().__init__()
        self._calls, self._base = 0, 0

    @cached_property
    def _known(self) -> Reference:
        return Reference.of("bin")

    def draw(self, rng: np.random.Generator) -> Case:
        return {"what": str(rng.choice(WHAT, p=SHARES)), "seed": int(rng.integers(2**31))}

    def run(self, case: Case) -> None:
        self._call(case["what"], self._known.service, self._known.requests, case["seed"])
        self._calls += 1
        if self._calls % EVERY:
            return
        number = self._calls // EVERY % len(self._known.requests)
        self._known.require_same(number, "the canary plan is the same")
        self.counted["canaries"] += 1
        gc.collect()
        now = rss()
        if self._calls == WARM:
            self._base = now
        if self._base:
            grown = now - self._base
            self.extreme("most MB grown since warm:", grown / 1e6)
            if grown > GROWTH:
                self._base = now
                raise Wrong("memory stays flat", f"{grown / 1e6:.0f} MB more after {self._calls} calls")

    def _call(self, what: str, service: ps.PlannerService, asked: list[ps.PlanRequest], seed: int) -> None:
        robot, checker, rng = service.robot, service.checker, np.random.default_rng(seed)
        Q = random_states(robot, 4, rng)
        request = asked[int(rng.integers(len(asked)))]
        if what == "check":
            checker.states_are_free(Q)
        elif what == "edge":
            checker.edge_is_free(Q[0], Q[1])
        elif what == "contacts":
            checker.contacts(Q[0])
            checker.clearance(Q[1])
        elif what == "certify":
            service.certify(Q[:2])
        elif what == "kinematics":
            ps.inverse_kinematics(robot, ps.Pose.from_matrix(robot.tool_pose(Q[0])))
        elif what == "plan":
            service.plan(request)
        elif what == "scene":
            box = ps.Obstacle("new", ps.Box((0.1, 0.1, 0.1)), ps.Pose(tuple(rng.uniform(0.5, 1.0, 3))))
            ps.CollisionChecker(robot, ps.Scene((*service.scene.obstacles, box))).state_is_free(Q[0])
        elif what == "service":
            ps.PlannerService(robot, service.scene).certify(Q[:2])
        elif what == "file":
            with tempfile.TemporaryDirectory() as name:
                ps.save_scene(service.scene, Path(name) / "s.toml")
                ps.load_scene(Path(name) / "s.toml")
                service.plan(request).save(Path(name) / "p.json")
                load_plan(Path(name) / "p.json")
        else:
            service.build_roadmap(ps.LazyPRM(30, 4), seed=int(rng.integers(100)), progress=False)
