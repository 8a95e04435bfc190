"""Every public callable with arguments that are right, and objects that are wrong for nearly all of them."""

from __future__ import annotations

import inspect
import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
from planner_service import grasping
from planner_service import planners as algorithms
from planner_service.certify import Certifier, ExemptInterval
from planner_service.collision import Known
from planner_service.constraints import (
    InBox,
    JointRange,
    KeepOrientation,
    KeepUpright,
    OnLine,
    OnPlane,
    RelativePose,
    ToolRegion,
    load_constraints,
)
from planner_service.datasets import EpisodeWork, episode_task
from planner_service.execute import ArmLimits, Recording, Streaming
from planner_service.geometry import Shape
from planner_service.geometry.composite import Solid
from planner_service.kinematics import PoseGoal, inverse_arcs, line_branches, straight_tool_line
from planner_service.memory import Memory
from planner_service.optimize import Chomp, TrajOpt
from planner_service.parallel import Processes, Ray, Sequential, engine_named
from planner_service.planning import AllowedStretch, Pace
from planner_service.records import (
    csv_text,
    joint_trajectory,
    load_plan,
    load_plan_or_task,
    load_task,
    read_problems,
    robot_trajectory,
    save_plan,
    write_csv,
)
from planner_service.records.cells import load_cell_plan, load_saved, read_cell_request
from planner_service.records.visits import load_visits, save_visits
from planner_service.robot_setup.import_robot import Source, import_robot
from planner_service.robot_setup.self_collision_matrix import contact_table
from planner_service.scene import load_scene, read_moveit_scene, read_sdf_scene, read_urdf_scene
from planner_service.scheduling import PickJob
from planner_service.search import SearchGraph
from planner_service.tasks import (
    Alternatives,
    Approach,
    Connect,
    Follow,
    Grasp,
    MoveCircular,
    MoveLinear,
    MoveTo,
    Release,
    Repeat,
    Retreat,
    Task,
    Wait,
    best_of_seeds,
    explain_task,
    move_circular,
    pick_steps,
    place_steps,
    places_on,
    plan_pick_place,
    plan_seeds,
    proven_ways,
    solve,
    standing_on,
)
from planner_service.tasks.ordering import Branch, Move, Visit, order, order_moves
from planner_service.view.still.maps import draw_base, draw_map
from planner_service.view.still.pictures import draw_check
from planner_service.workspace import (
    BaseRegion,
    ToolOrientation,
    VoxelGrid,
    VoxelVerdict,
    load_map,
    place_base,
    prove_again,
    reachability,
    save_map,
    seen_from,
)

__all__ = ["HOSTILE", "SKIPPED", "Call", "calls"]


class _Number(float):
    """A float of another class."""


class _Any:
    """An object of no kind that anything expects."""


def _nested() -> list[Any]:
    inner: list[Any] = []
    for _ in range(2_000):
        inner = [inner]
    return inner


def _endless() -> list[Any]:
    inner: list[Any] = []
    inner.append(inner)
    return inner


def of_values(*values: object) -> dict[str, Callable[[], object]]:
    """Values that are never changed, by how they print."""
    return {repr(value)[:40]: lambda value=value: value for value in values}  # type: ignore[misc]


HOSTILE: Mapping[str, Callable[[], object]] = {
    **of_values(None, True, np.True_, math.nan, math.inf, -1, 1e308, 10**400, 1 + 5j, np.complex128(0.1 + 5j), "", "x"),
    **of_values(b"x", Path("nothing-there"), "a\x1b[31m\x00b", "a\ud800b", (), (0,), range(10**12)),
    "empty list": list,
    "mapping": dict,
    "mapping of numbers": lambda: {0: 1.0},
    "set": lambda: {1.0, 2.0},
    "object": _Any,
    "class": lambda: _Any,
    "function": lambda: lambda *_, **__: None,
    "deep list": _nested,
    "list in itself": _endless,
    "ragged rows": lambda: [[0.0, 1.0], [0.0]],
    "numbers and a text": lambda: [0.0, "1"],
    "array of objects": lambda: np.array([0.0, 1.0], dtype=object),
    "array of texts": lambda: np.array("x"),
    "masked array": lambda: np.ma.masked_array([0.0, 0.5], mask=[False, True]),  # type: ignore[no-untyped-call]
    "empty array": lambda: np.zeros((0, 2)),
    "array of NaN": lambda: np.full(2, np.nan),
    "five dimensions": lambda: np.zeros((1, 1, 1, 1, 1)),
    "no end": itertools.count,
    "float of another class": lambda: _Number(0.5),
}
"""What is given in place of an argument, by name; made anew each time unless it cannot change."""


@dataclass(frozen=True)
class Call:
    """A callable with arguments that are right: those given, and the default of every other one.

    Attributes:
        into: Arguments that name what is written.
    """

    function: Callable[..., Any]
    arguments: Mapping[str, Any]
    into: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        parameters = inspect.signature(self.function).parameters.values()
        defaults = {one.name: one.default for one in parameters if one.default is not one.empty}
        object.__setattr__(self, "arguments", defaults | dict(self.arguments))


SKIPPED: Mapping[str, str] = {
    **dict.fromkeys(
        (
            *("Certificate", "CheckCounts", "Contact", "EdgeProof", "Failure", "GripperMotion", "MotionReport"),
            *("PlanResult", "PolishReport", "Refusal", "Replanned", "RoadmapUpdate", "Segment", "StageReport"),
            *("ProvenWay", "StepReport", "TaskResult", "Trace"),
        ),
        "an answer; nobody makes one",
    ),
    **dict.fromkeys(
        (
            *("BrokenInvariant", "Cancelled", "Interrupted", "InvalidFile", "InvalidRequest", "MissingDependency"),
            *("NotProven", "PlannerServiceError", "PlanningFailed", "UnknownName"),
        ),
        "an error",
    ),
    **dict.fromkeys(
        ("EdgeVerdict", "GraspKind", "Kind", "Known", "Outcome", "Reason", "Stage", "Verdict", "VoxelVerdict"),
        "an enumeration",
    ),
    **dict.fromkeys(("CancelToken", "Sequential", "Trapezoidal", "robot_names", "scene_names"), "takes nothing"),
    "Step": "what the steps of tasks have in common",
    "Robot": "made by load_robot and Robot.from_urdf",
}
"""Public names that are not attacked, and why."""

SAMPLES = Path(__file__).parent / "samples"

CUBE = [[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)]


Calls = Iterator[tuple[str, Call]]


def calls(folder: Path) -> dict[str, Call]:
    """Every public callable by its name; files are read from and written to ``folder``."""
    parts = (_values(folder), _shapes(), _methods(), _planning(folder), _tasks(folder), _files(folder), _maps(folder))
    return {name: call for part in parts for name, call in part}


def _call(function: Callable[..., Any], into: tuple[str, ...] = (), /, **arguments: Any) -> tuple[str, Call]:
    """A call, and the name by which its function is public."""
    return function.__qualname__, Call(function, arguments, into)


def _each(values: Mapping[str, Any], *functions: Callable[..., Any]) -> Calls:
    """Calls whose arguments are the values of their names."""
    for function in functions:
        names = inspect.signature(function).parameters
        yield _call(function, **{name: value for name, value in values.items() if name in names})


def _again(value: Any) -> tuple[str, Call]:
    """The call that makes a value."""
    return _call(type(value), **{field.name: getattr(value, field.name) for field in fields(value) if field.init})


def _values(folder: Path) -> Calls:
    box, pose = ps.Box((0.1, 0.2, 0.3)), ps.Pose((0.1, 0.2, 0.3))
    path = ps.JointPath(np.array([[0.0, 0.0], [1.0, 1.0]]))
    limits = {"lower": [-3.0, -3.0], "upper": [3.0, 3.0], "velocity": [1.0, 1.0]}
    rates = {"acceleration": [1.0, 1.0], "jerk": [10.0, 10.0]}
    law = ps.Trapezoidal().time_path(path, _limits())
    timed = {"durations": law.durations, "coefficients": law.coefficients, "dilation": 1.0, "part": (0.0, path.length)}
    graph = {"milestones": [[0.0, 0.0], [1.0, 1.0]], "edges": [[0, 1]]}
    few: dict[str, Any] = {"max_checks": 1_000, "time_limit": 1.0, "retries": 0, "blend": 0.5}
    request = ps.PlanRequest([0.0, 0.5], [0.5, 0.5], ps.BalancedRRTConnect(), ps.ToppRa(), **few)
    pairs = (("a", "b"),)
    point, line = (0.0, 0.0, 0.1), {"start": (0.0, 0.0, 0.0), "end": (1.0, 0.0, 0.0)}
    yield from _each(
        {"position": point, "quaternion": (1.0, 0.0, 0.0, 0.0), "matrix": np.eye(4), "rpy": point}
        | {"size": (0.1, 0.2, 0.3), "radius": 0.1, "length": 0.2, "vertices": CUBE, "parts": ((box, pose),)}
        | {
            "pieces": [box],
            "points": [point],
            "instead_of": (point, point),
            "cells": [[0, 0, 0]],
            "resolution": 0.1,
            "heights": [[0.1, 0.2]],
        }
        | {"cell": 0.1, "floor": 0.0, "name": "a", "shape": box, "pose": pose, "touch_links": ("b",)},
        *(ps.Pose, ps.Pose.from_matrix, ps.Pose.from_rpy, ps.Box, ps.Sphere, ps.Cylinder, ps.Capsule, ps.Mesh),
        *(ps.Compound, ps.Compound.of_pieces, ps.PointCloud, ps.PointCloud.from_cells, ps.HeightField),
        ps.PointCloud(np.array([point]), 0.1).with_points,
        *(ps.Obstacle, ps.Attached),
    )
    yield from _each(
        {"tool_axis": (1.0, 0.0, 0.0), "tolerance": 0.1, "link": "tip", "up": point, "orientation": pose}
        | {"frame": pose, "point": point, "size": (0.1, 0.1, 0.1), "relative_to": "base", "pose": pose}
        | {"position_tolerance": 0.001, "angle_tolerance": 0.1}
        | line,
        *(KeepUpright, KeepOrientation, OnPlane, OnLine, InBox, RelativePose),
    )
    yield from _each(
        {"range": 0.5, "goal_bias": 0.05, "checks": 2_000, "samples": 100, "milestones": 10, "neighbours": 5}
        | {"max_checks": 1_000, "distance": 0.01, "angle": 0.02, "gridpoints": 50, "jerk": 10.0, "iterations": 4}
        | {"voxel": 0.05, "waypoints": 20, "smoothness": 100.0, "clearance": 0.02, "corners": 4, "method": TrajOpt()}
        | {"starts": 1, "workers": 1, "address": "auto"},
        *(ps.MotionStep, ps.JointStep, ps.ToppRa, ps.SCurve, ps.BalancedRRTConnect, ps.RRTConnect, ps.RRT, ps.PRM),
        *(algorithms.BKPIECE1, algorithms.LBKPIECE1, algorithms.KPIECE1, algorithms.RRTstar, algorithms.BITstar),
        *(algorithms.InformedRRTstar, algorithms.SORRTstar, algorithms.AORRTC, algorithms.FMT, algorithms.BFMT),
        *(algorithms.PRMstar, ps.LazyPRM, TrajOpt, Chomp, ps.Optimise, Processes, Ray),
    )
    yield from (
        _again(ps.PoseGoal(pose, 0.01, 0.1, (1.0, 0.0, 0.0), 4)),
        _again(ps.Scene((ps.Obstacle("a", box),), (ps.Attached("b", box, pose),), "n", "d")),
        _call(ps.JointLimits, **limits, **rates),
        _call(ArmLimits, **limits),
        _call(Recording, t=[0.0], commanded=[[0.0]], measured=[[0.0]], lateness=[0.0], skipped=0),
        _again(Memory(("a", "b"), (np.array([[0.0, 0.0], [1.0, 0.0]]),), (np.array([0.0, 0.0, 0.05, 0.03]),))),
        _call(ps.JointPath, waypoints=[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], blends=[0.0, 0.1, 0.0]),
        _call(ps.Trajectory, path=path, **timed),
        _call(SearchGraph, **graph),
        ("Roadmap", Call(ps.Roadmap.of, {**graph, "reach": [1.0, 1.0]})),
        _call(ps.Roadmap.judged, milestones=graph["milestones"], free=[(0, 1)], blocked={}, reach=[1.0, 1.0]),
        _call(AllowedStretch, first=0, last=1, pairs=pairs, reason="r"),
        _call(ExemptInterval, s_start=0.0, s_end=1.0, pairs=pairs, reason="r"),
        _call(Pace, timing=ps.ToppRa(), velocity_scale=0.5, acceleration_scale=0.5, max_tool_speed=0.1),
        _again(request),
        _again(ps.Handling("a", 0.005, 0.05, request, ps.Trapezoidal(), ps.CancelToken())),
        _again(Streaming(speed=0.5)),
        _again(PickJob("a", pose, "b", ("left",))),
        _again(ToolRegion(pose, (-1.0, -1.0, -1.0), (1.0, 1.0, 1.0), 0.3, 0.2, pose, "tip", "base", "region")),
        _again(JointRange("shoulder", -1.0, 1.0)),
        _call(engine_named, name="processes", workers=1),
        _call(episode_task, name="pick-place"),
        _again(EpisodeWork(ps.load_robot("wxai"), episode_task("pick-place"), 0, 30, 0.05, 1_000, 10)),
        _again(Source(folder / "robot.urdf", None, "tip", (folder,))),
    )


def _limits() -> ps.JointLimits:
    return ps.JointLimits(*(np.full(2, value) for value in (-3.0, 3.0, 1.0, 1.0, 10.0)))


def _methods() -> Calls:
    scene = ps.Scene((ps.Obstacle("a", ps.Box((0.1, 0.1, 0.1))),), (ps.Attached("b", ps.Sphere(0.1), ps.Pose()),))
    path = ps.JointPath(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]))
    law = ps.Trapezoidal().time_path(path, _limits())
    roadmap = ps.Roadmap.of([[0.0, 0.0], [1.0, 1.0]], [[0, 1]])
    arm, wxai = ps.load_robot("planar2"), ps.load_robot("wxai")
    q = [0.1, 0.5]
    obstacle, held = ps.Obstacle("c", ps.Sphere(0.1)), ps.Attached("c", ps.Sphere(0.1), ps.Pose())
    yield from _each(
        {"name": "a", "obstacle": obstacle, "pose": ps.Pose(), "attached": held},
        *(scene.obstacle, scene.with_obstacle, scene.without, scene.moved, scene.with_attached),
    )
    yield from _each(
        {"s": [0.1, 0.2], "order": 0, "blends": [0.0, 0.1, 0.0], "k": 1, "t": [0.1, 0.2], "dt": 0.1, "factor": 1.5}
        | {"path": path, "limits": _limits(), "speed_limit": None, "places": [0.05], "points": [[0.0, 0.1], [1.0, 0.5]]}
        | {"robot": arm, "request": ps.PlanRequest(q, q), "timing": ps.ToppRa()},
        *(path.__call__, path.with_blends, path.with_stops, path.turns_back, path.travel),
        *(
            law.__call__,
            law.s,
            law.moving,
            law.sample,
            law.dilated,
            ps.ToppRa().time_path,
            ps.SCurve().time_path,
            ps.Trapezoidal().time_path,
            Pace.of,
        ),
        *(Pace(ps.ToppRa()).limits, ps.PlanRequest(q, q).goals, roadmap.with_path),
    )
    yield from _each(
        {"name": "home", "q": q, "Q": [q], "extra": ((1, ps.Sphere(0.1), ps.Pose()),)},
        *(arm.pose, arm.body_poses, arm.body_poses_batch, arm.tool_pose, arm.tool_jacobian, arm.reach),
    )
    yield from _each(
        {
            "width": 0.04,
            "joints": {wxai.joint_names[0]: 0.0},
            "robot": wxai,
            "pose": ps.Pose((0.3, 0.0, 0.2)),
            "seed": 0,
        }
        | {"seeds": [wxai.home], "still": wxai.home, "q_start": wxai.home, "to": (0.0, 0.0, 0.01), "points": 5},
        *(wxai.with_gripper, wxai.locked, ps.inverse_kinematics, straight_tool_line),
    )
    far = PoseGoal(ps.Pose((2.0, 0.0, 0.2)), free_axis=(0.0, 0.0, 1.0))
    yield _call(inverse_arcs, robot=wxai, pose=far, still=wxai.home)
    at = ps.Pose.from_matrix(wxai.tool_pose(wxai.home))
    yield _call(
        line_branches,
        robot=wxai,
        begin=at,
        to=(0.0, 0.0, 0.05),
        still=wxai.home,
        points=5,
        max_joint_rate=90.0,
        free_axis=(1.0, 0.0, 0.0),
    )
    yield _again(line_branches(wxai, at, (0.0, 0.0, 0.05)))
    yield _call(scene.without_attached, name="b")
    yield _call(contact_table, robot=arm, samples=10, max_bounds=1_000)


def _shapes() -> Calls:
    solids: list[Solid] = [
        ps.Box((0.1, 0.2, 0.3)),
        ps.Sphere(0.1),
        ps.Cylinder(0.1, 0.2),
        ps.Capsule(0.1, 0.2),
        ps.Mesh(np.array(CUBE)),
        ps.Compound(((ps.Box((0.1, 0.2, 0.3)), ps.Pose()),)),
        ps.PointCloud(np.zeros((1, 3)), 0.1),
        ps.HeightField(np.array([[0.1, 0.2]]), 0.1, 0.0),
    ]
    points = [[0.1, 0.2, 0.3], [1.0, 0.0, 0.0]]
    for solid in solids:
        yield _call(solid.support, direction=points)
        yield _call(solid.distance, points=points)
        if isinstance(solid, Shape):
            yield _call(solid.grown, margin=0.01)


def _planning(folder: Path) -> Calls:
    arm, scene = ps.load_robot("planar2"), ps.load_scene("discs")
    service = ps.PlannerService(arm, scene)
    checker, certifier = ps.CollisionChecker(arm, scene), Certifier(arm, scene)
    request = ps.PlanRequest(arm.home, arm.home + 0.01)
    result = service.plan(request)
    path, _ = result.unwrap()
    bent = ps.JointPath(arm.home + 0.01 * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), np.array([0.0, 0.004, 0.0]))
    q, near = arm.home, arm.home + 0.01
    few = ps.PRM(milestones=10, neighbours=3, max_checks=500)
    roadmap = service.build_roadmap(few)
    token, pace = ps.CancelToken(), Pace(ps.Trapezoidal())
    world, kept = {"robot": arm, "scene": scene}, (ToolRegion(lower=(-2.0, -2.0, -2.0), tilt=0.1, name="flat"),)
    yield from _each(
        {"robot": "planar2", "scene": scene, "edge_step": ps.MotionStep(0.01), "allowed": (), "gripper": None}
        | {"request": request, "cancel": token, "trace": True, "previous": result, "at_time": 0.01, "latency": 0.01}
        | {"goal": near, "path": path, "padding": 0.001, "exempt": (), "part": (0.0, path.length), "q": q}
        | {"waypoints": [q, near], "contacts": (), "pace": pace, "blends": [0.0, 0.0], "planner": few, "seed": 0}
        | {"progress": False, "roadmap": roadmap, "plans": 2, "remedies": 1, "service": service, "seeds": [0]}
        | {"engine": Sequential(), "requests": [request], "stage": ps.Stage.SEARCH, "memory": result.memory},
        *(ps.PlannerService, service.with_scene, service.changed, service.plan, service.plan_many, service.replan),
        *(service.certify, service.follow, service.build_roadmap, service.path_memory, service.update_roadmap),
        *(service.way_out, service.explain, best_of_seeds, plan_seeds, result.stage),
    )
    yield from _each(
        {"q": q, "Q": [q, near], "q1": q, "q2": near, "known": Known.NEITHER, "path": path, "within": 0.05, "pair": 0}
        | {"padding": 0.001, "allowed": (), "motion_step": 0.01, "exempt": (), "part": (0.0, path.length)}
        | {"constraints": kept, "length": 1.0},
        *(checker.variant, checker.state_is_free, checker.states_are_free, checker.edge_is_free, checker.edge_hit),
        *(checker.edge_is_free_coarse, checker.finish_edge, checker.segments, checker.path_is_free),
        *(checker.clearance, checker.near, checker.pair_names, checker.contacts, checker.deepest_touching),
        *(certifier.certify, certifier.certify_edge, certifier.roots, certifier.clearances),
    )
    yield from _each(
        {"motion": result, "joint_names": arm.joint_names, "dt": 0.05, "frame_id": "base"},
        *(csv_text, joint_trajectory, robot_trajectory),
    )
    stream = {"requests": [request], "engine": Sequential()}
    within = {"states": 10, "deadline": 1e9, "token": token}
    yield from (
        ("PlannerService.plan_stream", Call(lambda **given: list(service.plan_stream(**given)), stream)),
        ("CollisionChecker.limited", Call(lambda **given: checker.limited(**given).__enter__(), within)),
        _call(result.save, ("path",), path=folder / "kept.json"),
        _call(ps.CollisionChecker, **world, edge_step=ps.MotionStep(), padding=0.0, allowed=(), backend="native"),
        _call(checker.blend_is_free, path=bent, k=1),
        _call(Certifier, **world, allowed=()),
        _call(write_csv, ("path",), motion=result, path=folder / "out.csv", joint_names=arm.joint_names, dt=0.05),
        _call(save_plan, ("path",), plan=result, path=folder / "out.json"),
        _call(save_visits, ("path",), visits=[Visit("here", [q])], path=folder / "visits.json"),
        _call(draw_check, ("file",), checker=checker, q=q, file=folder / "out.png"),
    )


def _tasks(folder: Path) -> Calls:
    service = ps.PlannerService("wxai", "bin")
    robot, scene = service.robot, service.scene
    block, tray = scene.obstacle("blue_block"), scene.obstacle("tray")
    request = ps.PlanRequest(robot.home, robot.home, max_checks=2_000, time_limit=1.0)
    grasp = ps.top_grasps(robot, block)[:1]
    held = ps.Attached("held", ps.Box((0.02, 0.02, 0.02)), ps.Pose((0.0, 0.0, 0.0)))
    carrying = ps.PlannerService(robot, ps.Scene((tray,), (held,)))
    moving, pace = {"service": service, "start": robot.home}, Pace(ps.Trapezoidal())
    handling, two = ps.Handling(request=request), [(0.0, 0.0, 0.01), (0.01, 0.0, 0.0)]
    nearby = Task((MoveTo(),))
    yield from _steps(grasp)
    yield from (
        _call(service.solve, task=nearby, q=robot.home, request=request),
        _call(solve, service=service, task=nearby, q=robot.home, request=request, cancel=ps.CancelToken()),
        _call(explain_task, task=service.solve(nearby, robot.home)),
        (
            "proven_ways",
            Call(
                lambda **given: next(proven_ways(**given)),
                {"service": service, "steps": pick_steps("blue_block", grasp), "q": robot.home},
            ),
        ),
        _call(Branch, q=robot.home, end=robot.home, motions=(), before=service, after=service),
        _call(
            Move, object="blue_block", poses=[tray.pose], grasps=grasp, handling=handling, onto="tray", after=("held",)
        ),
        _call(
            order_moves,
            service=service,
            moves=[Move("blue_block", [block.pose])],
            request=ps.PlanRequest(robot.home, robot.home),
            end=robot.home,
            gap=0.1,
            plans=10,
            grasps=1,
            places=1,
            engine=None,
            cancel=ps.CancelToken(),
        ),
        _call(Visit, name="here", branches=[robot.home], then=None, after=("there",)),
        _call(
            order,
            service=service,
            visits=[Visit("here", [robot.home])],
            request=ps.PlanRequest(robot.home, robot.home),
            end=robot.home,
            gap=0.1,
            plans=10,
            engine=None,
            cancel=ps.CancelToken(),
        ),
        _call(pick_steps, object="blue_block", grasps=grasp, handling=handling),
        _call(place_steps, object="held", poses=[tray.pose], handling=handling),
        _call(ps.top_grasps, robot=robot, target=block, tilts=(0.0,)),
        _call(grasping.side_grasps, robot=robot, target=block, leans=(0.0,)),
        _call(grasping.antipodal_grasps, robot=robot, target=block, friction=0.5, seed=0, most=4),
        _call(grasping.suction_grasps, robot=ps.load_robot("ur5_vacuum"), target=block, most=4),
        _call(grasping.grasp_quality, robot=robot, target=block, grasp=grasp[0], friction=0.5),
        _call(grasping.GraspKinds, kinds=(grasping.GraspKind.SIDE,), friction=0.5, seed=0, most=4),
        _call(grasping.GraspKinds((grasping.GraspKind.SIDE,)).poses, robot=robot, target=block),
        _call(grasping.GraspKinds((grasping.GraspKind.SIDE,)).by_kind, robot=robot, target=block),
        _call(places_on, target=block, support=tray),
        _call(service.torque_limits, scale=0.5),
        _call(service.certify_gripper, q=robot.home, start=0.0, end=0.01),
        _call(standing_on, scene=scene, name="blue_block"),
        _call(ps.move_linear, **moving, goal=(0.0, 0.0, 0.01), points=5, pace=pace, cancel=ps.CancelToken()),
        _call(ps.move_linear, service=service, start=ps.Pose.from_matrix(robot.tool_pose(robot.home)), goal=two),
        _call(ps.move_linear, **moving, goal=two, zone=0.002, max_joint_rate=50.0, partial=True, free_axis=(0, 0, 1)),
        _call(
            move_circular,
            **moving,
            via=(0.0, 0.01, 0.01),
            goal=(0.0, 0.02, 0.0),
            max_joint_rate=50.0,
            free_axis=(0, 0, 1),
        ),
        _call(ps.pick, service=service, q=robot.home, target="blue_block", grasps=grasp, handling=handling),
        _call(ps.place, service=carrying, q=robot.home, carried="held", poses=[tray.pose], handling=handling),
        _call(plan_pick_place, service=service, target="blue_block", onto="tray", request=request),
    )


def _steps(grasp: tuple[ps.Pose, ...]) -> Calls:
    """The steps of tasks."""
    flat = (ToolRegion(lower=(-2.0, -2.0, -2.0), tilt=0.1, name="flat"),)
    pose, wait = ps.Pose(), MoveTo()
    yield from (
        _call(MoveTo, goal=[pose, "home"], frame="a", constraints=flat, name="m"),
        _call(
            MoveLinear,
            goal=[pose, (0.0, 0.0, 0.1)],
            frame="a",
            zone=0.01,
            constraints=flat,
            name="m",
            free_axis=(0, 1, 0),
        ),
        _call(MoveCircular, via=pose, goal=(0.0, 0.0, 0.1), frame="a", constraints=flat, name="m"),
        _call(Follow, waypoints=[[0.0, 0.0], [1.0, 0.0]], blend=0.1, constraints=flat, name="m"),
        _call(Connect, name="m", constraints=flat),
        _call(Approach, name="m", lengths=(0.1,), shorter=(0.02,), direction=(0.0, 0.0, 1.0)),
        _call(Retreat, name="m", lengths=(0.1,), direction=(0.0, 0.0, 1.0)),
        _call(Grasp, object="a", grasps=grasp, frame="b", open_width=0.05, support="b", support_gap=0.01, upright=0.1),
        _call(Release, object="a", poses=[pose], frame="b", open_width=0.05, support="b", support_gap=0.01),
        _call(Wait, seconds=1.0),
        _call(Alternatives, branches=[wait, (wait,)]),
        _call(Repeat, steps=(wait,), times=2),
        _call(Task, steps=(wait,), name="n"),
    )


def _maps(folder: Path) -> Calls:
    arm, scene = ps.load_robot("planar2"), ps.Scene()
    grid, any_turn = VoxelGrid((0.1, 0.1, -0.1), (0.3, 0.3, 0.1), (2, 2, 1)), ToolOrientation(tolerance=math.pi)
    found = reachability(arm, scene, grid, [any_turn], halvings=0)
    about = {"robot": arm, "scene": scene}
    save_map(found, folder / "map.npz")
    region = BaseRegion((-0.1, 0.0, 0.0), (0.1, 0.0, 0.0), (-0.1, 0.1))
    there = ps.Pose.from_matrix(arm.tool_pose([0.5, 0.5]))
    placed = place_base(arm, [there], region, most_bases=1)
    yield from (
        _again(grid),
        _again(ToolOrientation((0.5, 0.5, 0.5, 0.5), 0.1, (0.0, 0.0, 1.0))),
        _again(found),
        _call(grid.cell_of, position=(0.2, 0.2, 0.0)),
        _call(found.verdict, position=(0.2, 0.2, 0.0)),
        _call(found.witness, position=(0.2, 0.2, 0.0)),
        _call(found.share, verdict=VoxelVerdict.UNKNOWN),
        _call(reachability, **about, grid=grid, orientations=[any_turn], still=[0.1, 0.2], halvings=0, time_limit=9.0),
        _call(prove_again, found=found, **about),
        _call(load_map, path=folder / "map.npz", **about),
        _call(save_map, ("path",), found=found, path=folder / "map_again.npz"),
        _again(region),
        _again(placed),
        _again(placed.bases[0]),
        _call(
            place_base, **about, poses=[there], region=region, still=[0.1, 0.2], clearance=0.0, room=0.0, most_boxes=9
        ),
        _call(seen_from, base=ps.Pose(), scene=scene),
        _call(draw_base, ("file",), **about, base=placed.bases[0], file=folder / "base.png"),
        _call(draw_map, ("file",), **about, found=found, file=folder / "map.png", orientation=0, across=(0, 1)),
    )


def _files(folder: Path) -> Calls:
    urdf, stand, mesh, cloud, heights, roadmap = (
        folder / name for name in ("robot.urdf", "stand.urdf", "cube.obj", "cloud.npy", "heights.npy", "roadmap.npz")
    )
    urdf.write_bytes(SAMPLES.joinpath("robot.urdf").read_bytes())
    stand.write_bytes(SAMPLES.joinpath("stand.urdf").read_bytes())
    mesh.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in CUBE) + "f 1 2 3 4 5 6 7 8\n", encoding="utf-8")
    np.save(cloud, np.array(CUBE))
    np.save(heights, np.array([[0.1, 0.2]]))
    service = ps.PlannerService("planar2", "discs")
    service.path_memory().save(roadmap)
    memory = folder / "memory.json"
    Memory().save(memory)
    description = {"path": urdf, "tool_frame": "tip", "srdf": None}
    yield from (
        _call(ps.load_robot, name_or_path="planar2"),
        _call(ps.load_scene, name_or_path="discs"),
        _call(load_scene, name_or_path="discs"),
        _call(ps.save_scene, ("path",), scene=ps.Scene(), path=folder / "out.toml"),
        _call(ps.Robot.from_urdf, **description, package_dirs=(folder,), locked_joints={}, joints=("j",), decompose={}),
        _call(import_robot, ("out",), source=Source(urdf), out=folder / "imported", force=True),
        _call(ps.Mesh.from_file, path=mesh, scale=(1.0, 1.0, 1.0)),
        _call(ps.Compound.of_mesh, path=mesh, scale=(1.0, 1.0, 1.0), most=2),
        _call(ps.PointCloud.from_file, path=cloud, resolution=0.05),
        _call(ps.HeightField.from_file, path=heights, cell=0.05, floor=0.0),
        _call(ps.Roadmap.load, path=roadmap),
        _call(Memory.load, path=memory),
        _call(Memory().save, ("path",), path=folder / "memory_again.json"),
        _call(Memory().with_motion, waypoints=[[0.0], [1.0]], joint_names=("j",)),
        _call(Memory().with_grip, grip=[0.0, 0.05, 0.03], joint_names=("j",)),
        _call(ps.Roadmap.load(roadmap).save, ("path",), path=folder / "out.npz"),
        _call(read_urdf_scene, path=stand),
    )
    scenes, problems = (read_moveit_scene, read_sdf_scene), (load_constraints, read_problems)
    readers = (
        *scenes,
        *problems,
        load_plan,
        load_task,
        load_plan_or_task,
        load_cell_plan,
        load_saved,
        read_cell_request,
        load_visits,
    )
    yield from _each({"path": folder / "nothing-there"}, *readers)
