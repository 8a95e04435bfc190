"""Random histories of a scene: after every step each verdict that is said to hold is a fresh checker's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planner_service import (
    Attached,
    Box,
    Capsule,
    Compound,
    Cylinder,
    JointStep,
    LazyPRM,
    MotionStep,
    Obstacle,
    PlannerService,
    PlanRequest,
    PointCloud,
    Pose,
    Roadmap,
    Scene,
    Sphere,
)
from planner_service.roadmap import Terms, Verdict
from tests.support.optional import present
from tests.support.roadmaps import lies
from tests.unit.roadmap.test_truth import false_blames

NAMES = ("a", "b", "c", "d")
NEAR = {"planar2": (0.7, 1.4, 0.2), "wxai": (0.25, 0.5, 0.15)}
"""Metres from the base where obstacles stand, and their size."""


class History:
    """A service whose scene, gripper and settings change, and the roadmap that goes along."""

    def __init__(self, name: str, seed: int) -> None:
        self.rng, self.name = np.random.default_rng(seed), name
        self.step: Any = (JointStep(0.15), MotionStep(0.05))[seed % 2]
        self.allowed: tuple[tuple[str, str], ...] = ()
        self.service = PlannerService(name, Scene(tuple(self.obstacle(n) for n in NAMES[:2])), edge_step=self.step)
        lazy = LazyPRM(milestones=25, neighbours=4)
        self.roadmap: Roadmap = replace(self.service.build_roadmap(lazy, seed=seed, padding=0.01), remember=True)
        self.before = [self.service.scene]
        self.told: list[str] = []

    def obstacle(self, name: str) -> Obstacle:
        least, most, size = NEAR[self.name]
        angle, far = self.rng.uniform(-3.1, 3.1), self.rng.uniform(least, most)
        height = 0.0 if self.name == "planar2" else self.rng.uniform(0.0, 0.5)
        place = Pose.from_rpy((far * np.cos(angle), far * np.sin(angle), height), tuple(self.rng.uniform(-3, 3, 3)))
        a, b = (size * self.rng.uniform(0.4, 1.0, 2)).tolist()
        kinds = (
            Box((a, b, size)),
            Sphere(a / 2),
            Cylinder(a / 2, b),
            Capsule(a / 3, b),
            Compound(((Box((a, a, b)), Pose()), (Sphere(b / 2), Pose((a, 0.0, 0.0))))),
            PointCloud(self.rng.uniform(-a / 2, a / 2, (100, 3)), 0.02),
        )
        return Obstacle(name, kinds[int(self.rng.integers(len(kinds)))], place)

    def in_scene(self, scene: Scene) -> None:
        self.before.append(scene)
        self.service = PlannerService(
            self.service.robot, scene, edge_step=self.step, allowed=[p for p in self.allowed if p[1] in scene.names]
        )

    def change(self) -> None:
        scene, rng = self.service.scene, self.rng
        here = [o.name for o in scene.obstacles]
        free = [name for name in NAMES if name not in here]
        rare = ["carry", "grip"] if rng.random() < 0.2 else []
        what = str(rng.choice(["move", "move", "shape", "come", "go", "back", "swap", "order", "rename", *rare]))
        self.told.append(what)
        if what in ("move", "shape") and here:
            name = str(rng.choice(here))
            new = self.obstacle(name)
            self.in_scene(
                scene.moved(name, new.pose)
                if what == "move"
                else Scene(tuple(new if o.name == name else o for o in scene.obstacles), scene.attached)
            )
        elif what == "come" and free:
            self.in_scene(scene.with_obstacle(self.obstacle(free[0])))
        elif what == "go" and here:
            self.in_scene(scene.without(str(rng.choice(here))))
        elif what == "back":
            self.in_scene(self.before[int(rng.integers(len(self.before)))])
        elif what == "swap" and len(here) > 1:
            one, two, *rest = scene.obstacles
            self.in_scene(Scene((replace(one, name=two.name), replace(two, name=one.name), *rest), scene.attached))
        elif what == "order":
            self.in_scene(Scene(scene.obstacles[::-1], scene.attached))
        elif what == "rename" and here and free:
            first, *rest = scene.obstacles
            self.in_scene(Scene((*rest, replace(first, name=free[0])), scene.attached))
        elif what == "carry":
            robot = self.service.robot
            hand = tuple({shape.link for shape in robot.shapes if shape.body >= robot.tool_body - 1})
            load = Attached("load", Box((0.03, 0.03, 0.1)), Pose((0.0, 0.0, 0.05)), tuple(sorted(hand)))
            self.in_scene(Scene(scene.obstacles, () if scene.attached else (load,)))
        elif what == "grip" and self.service.robot.gripper is not None:
            self.service = self.service.changed(gripper=float(rng.choice([0.0, 0.04])))

    def ask(self) -> None:
        what = int(self.rng.integers(6))
        if what == 0:
            self.told.append("update")
            self.roadmap = self.service.update_roadmap(self.roadmap).roadmap
            return
        checker = self.service.checker.variant(padding=0.01)
        limits = self.service.robot.limits
        points = self.rng.uniform(limits.lower, limits.upper, (60, self.service.robot.n))
        ends = points[checker.states_are_free(points)][:2]
        if len(ends) < 2:
            return
        padding = (0.01, 0.01, 0.01, 0.0, 0.02)[what - 1]
        self.told.append(f"plan {padding}")
        settings: dict[str, Any] = {"max_checks": int(self.rng.integers(20, 5000)), "seed": len(self.told)}
        planner = replace(self.roadmap, fallback=bool(self.rng.random() < 0.7))
        request = PlanRequest(ends[0], ends[1], planner=planner, padding=padding, time_limit=None, **settings)
        result = self.service.plan(request)
        self.roadmap = replace(present(result.roadmap), fallback=True)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", ["planar2", "wxai"])
def test_no_history_makes_a_roadmap_lie(name: str, seed: int) -> None:
    history = History(name, seed)
    held = 0
    for _ in range(14):
        history.change()
        for _ in range(2):
            history.ask()
            roadmap = history.roadmap
            if roadmap.terms == Terms.of(history.service.checker.variant(padding=0.01)):
                assert lies(roadmap, history.service) == [], history.told
                assert false_blames(roadmap, history.service) == [], history.told
                held += roadmap.edge_knowledge.count(Verdict.FREE)
    assert held > 0
