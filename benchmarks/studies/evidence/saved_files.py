"""Files to be forged: plans, tasks and proofs of no path, with evidence, of several robots and grippers."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Iterator
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.worlds.drawn import blocked_ends, draw_objects
from planner_service.constraints import InBox, KeepUpright
from planner_service.infeasibility import prove_no_path
from planner_service.records import SavedPlan, SavedTask
from planner_service.records.evidence import with_evidence
from planner_service.records.exports.no_path_file import no_path_document
from planner_service.tasks import plan_pick_place

__all__ = ["Document", "saved_files"]

Document = dict[str, Any]

DOWN = (0.5**0.5, 0.0, 0.5**0.5, 0.0)
DRAWN = ("wxai", "wxai", "panda_mbm", "ur5", "wxai_dual")


def saved_files(seed: int) -> Iterator[tuple[str, Document]]:
    """Each with a name; a third of them are tasks."""
    for number, robot in enumerate(DRAWN):
        yield f"plan {number}, {robot}", _drawn(robot, random.Random(f"saved {seed} {number}"))
    flat = ps.PlannerService("planar2", ps.load_scene("discs"))
    yield "plan, planar2", _certain(flat, ps.PlanRequest((0.0, 0.0), (math.pi / 2, -math.pi / 2), time_limit=None))
    yield "plan, constraints", _constrained()
    yield "plan, load and clouds", _loaded(seed)
    yield "plan, bundles", _bundled(seed)
    yield "plan, touching start", _touching()
    for robot in ("wxai", "ur5_vacuum", "kinova_gripper"):
        service = ps.PlannerService(robot, ps.load_scene("bin"))
        home = service.robot.home
        task = plan_pick_place(service, "blue_block", "tray", ps.PlanRequest(home, home, time_limit=None), upright=0.3)
        yield f"task, {robot}", _document(SavedTask.of(task))
    yield "no path", _enclosed()


def _document(saved: SavedPlan | SavedTask) -> Document:
    document: Document = json.loads(with_evidence(saved).file_text())
    return document


def _planned(service: ps.PlannerService, request: ps.PlanRequest) -> Document | None:
    found = service.plan(request)
    return _document(SavedPlan.of(found)) if found.ok else None


def _certain(service: ps.PlannerService, request: ps.PlanRequest) -> Document:
    document = _planned(service, request)
    assert document is not None
    return document


def _drawn(robot: str, chance: random.Random) -> Document:
    arm = ps.load_robot(robot)
    while True:
        service = ps.PlannerService(arm, ps.Scene(tuple(draw_objects(chance, 4))))
        try:
            start, goal = next(blocked_ends(service.checker, chance))
        except ps.BrokenInvariant:  # a scene without room
            continue
        limits = {"time_limit": None, "max_checks": 50_000}
        document = _planned(service, ps.PlanRequest(start, goal, **limits))  # type: ignore[arg-type]
        if document is not None and document["result"]["certificate"]["clearance"] is not None:
            return document


def _constrained() -> Document:
    service = ps.PlannerService("wxai", ps.load_scene("table"))
    poses = dict(service.robot.named_poses)
    high = InBox(ps.Pose((0.0, 0.0, 0.5)), (2.0, 2.0, 2.0))
    start, goal = poses["home"], poses["home"] + np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
    asked = ps.PlanRequest(start, goal, constraints=(KeepUpright((0.0, 0.0, 1.0), 3.0), high), time_limit=None)
    return _certain(service, asked)


def _loaded(seed: int) -> Document:
    chance = np.random.default_rng(seed)
    things = (
        ps.Obstacle("cloud", ps.PointCloud(chance.uniform(-0.05, 0.05, (30, 3)), 0.02), ps.Pose((0.35, -0.35, 0.2))),
        ps.Obstacle("hills", ps.HeightField(chance.uniform(0.02, 0.06, (4, 5)), 0.05), ps.Pose((-0.6, -0.2, 0.0))),
        ps.Obstacle("wedge", ps.Mesh(chance.uniform(-0.08, 0.08, (12, 3))), ps.Pose((0.4, 0.4, 0.1))),
        ps.Obstacle(
            "cross",
            ps.Compound(((ps.Box((0.2, 0.02, 0.02)), ps.Pose()), (ps.Sphere(0.03), ps.Pose((0.1, 0.0, 0.0))))),
            ps.Pose((0.0, 0.5, 0.4)),
        ),
    )
    held = ps.Attached(
        "held", ps.Cylinder(0.01, 0.05), ps.Pose((0.09, 0.0, 0.0)), constraints=(KeepUpright((1.0, 0.0, 0.0), 3.0),)
    )
    service = ps.PlannerService("wxai", ps.Scene(things, (held,)))
    home = service.robot.home
    goal = home + np.array([0.7, 0.1, 0.1, 0.0, 0.2, 0.1])
    return _certain(service, ps.PlanRequest(home, goal, timing=ps.SCurve(), velocity_scale=0.6, time_limit=None))


def _bundled(seed: int) -> Document:
    """Between a wall of points and many small things, which are looked at as bundles."""
    chance = np.random.default_rng(seed)
    y, z = chance.uniform(-0.4, 0.4, 900), chance.uniform(0.0, 0.6, 900)
    wall = ps.PointCloud(np.stack([0.01 * np.sin(9.0 * y), y, z], axis=1), 0.02)
    things = [ps.Obstacle("wall", wall, ps.Pose.from_rpy((-0.35, 0.1, 0.05), (0.0, 0.0, 0.4)))]
    for k, (x, y, z) in enumerate(chance.uniform((-0.2, -0.7, 0.0), (0.6, -0.45, 0.7), (80, 3)).tolist()):
        shape = (ps.Box((0.02, 0.03, 0.02)), ps.Sphere(0.012), ps.Cylinder(0.01, 0.04))[k % 3]
        things.append(ps.Obstacle(f"thing {k}", shape, ps.Pose((x, y, z))))
    service = ps.PlannerService("wxai", ps.Scene(tuple(things)))
    home = service.robot.home
    return _certain(service, ps.PlanRequest(home, home + np.array([-0.9, 0.3, 0.2, 0.0, 0.3, 0.2]), time_limit=None))


def _touching() -> Document:
    service = ps.PlannerService("wxai", ps.load_scene("table"))
    for z in (-0.0014, -0.0016, -0.0018, -0.002):
        for q in ps.inverse_kinematics(service.robot, ps.Pose((0.3, 0.0, z), DOWN)):
            document = _planned(service, ps.PlanRequest(q, service.robot.home, time_limit=None))
            if document is not None and document["result"]["certificate"]["exempt"]:
                return document
    raise AssertionError("no start of these touches the table")


def _enclosed() -> Document:
    discs = [
        ps.Obstacle(name, ps.Cylinder(0.1, 0.2), ps.Pose((0.5, y, 0.0))) for name, y in (("left", 0.5), ("right", -0.5))
    ]
    service = ps.PlannerService("planar2", ps.Scene(tuple(discs)))
    start, goals = [0.0, 0.0], [[3.0, 0.0], [2.9, 0.2]]
    proof = prove_no_path(service.robot, service.scene, start, goals)
    assert proof is not None
    document: Document = json.loads(json.dumps(no_path_document(proof, service.world, start, goals)))
    return document
