"""Every public callable with arguments that are right, and objects that are wrong for nearly all of them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planner_service import (
    PRM,
    RRT,
    Attached,
    Box,
    CancelToken,
    Capsule,
    CollisionChecker,
    Compound,
    Cylinder,
    Handling,
    HeightField,
    JointLimits,
    JointPath,
    JointStep,
    LazyPRM,
    Mesh,
    MotionStep,
    Obstacle,
    Optimise,
    PlannerService,
    PlanRequest,
    PointCloud,
    Pose,
    PoseGoal,
    Roadmap,
    Robot,
    RRTConnect,
    Scene,
    SCurve,
    Sphere,
    Stage,
    ToppRa,
    Trajectory,
    Trapezoidal,
    inverse_kinematics,
    load_robot,
    load_scene,
    move_linear,
    pick,
    place,
    save_scene,
    top_grasps,
)
from planner_service.certify import Certifier, ExemptInterval
from planner_service.collision import Known
from planner_service.datasets import EpisodeWork, episode_task
from planner_service.execute import ArmLimits, Recording, Streaming
from planner_service.geometry.composite import Solid
from planner_service.geometry.shapes import Shape
from planner_service.kinematics import straight_tool_line
from planner_service.optimize import Chomp, TrajOpt
from planner_service.parallel import Processes, Ray, Sequential, engine_named
from planner_service.planners import (
    AORRTC,
    BFMT,
    BKPIECE1,
    FMT,
    KPIECE1,
    LBKPIECE1,
    BITstar,
    InformedRRTstar,
    PRMstar,
    RRTstar,
    SORRTstar,
)
from planner_service.planning import AllowedStretch, Pace
from planner_service.records.plan_file import load_plan, load_plan_or_task, load_task, save_plan
from planner_service.records.problem_set import read_problems
from planner_service.records.trajectory_export import csv_text, joint_trajectory, write_csv
from planner_service.robot_setup.import_robot import Source, import_robot
from planner_service.robot_setup.self_collision_matrix import contact_table
from planner_service.scene.moveit_scene import read_moveit_scene
from planner_service.scene.urdf_scene import read_urdf_scene
from planner_service.scene.worlds import load_world
from planner_service.search import SearchGraph
from planner_service.tasks.pick_place import places_on, plan_pick_place, standing_on
from planner_service.tasks.seeds import best_of_seeds, plan_seeds
from planner_service.view.still.pictures import draw_check

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


HOSTILE: Mapping[str, Callable[[], object]] = {
    "None": lambda: None,
    "True": lambda: True,
    "numpy True": lambda: np.True_,
    "NaN": lambda: float("nan"),
    "infinity": lambda: float("inf"),
    "minus one": lambda: -1,
    "1e308": lambda: 1e308,
    "10**400": lambda: 10**400,
    "complex": lambda: 1 + 5j,
    "numpy complex": lambda: np.complex128(0.1 + 5j),
    "empty text": lambda: "",
    "text": lambda: "x",
    "bytes": lambda: b"x",
    "path": lambda: Path("nothing-there"),
    "control characters": lambda: "a\x1b[31m\x00b",
    "half a surrogate pair": lambda: "a\ud800b",
    "empty tuple": lambda: (),
    "short tuple": lambda: (0,),
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
    "long range": lambda: range(10**12),
}
"""What is given in place of an argument, by name; made anew each time."""


@dataclass(frozen=True)
class Call:
    """A callable with arguments that are right.

    Attributes:
        into: Arguments that name what is written.
    """

    function: Callable[..., Any]
    arguments: Mapping[str, Any]
    into: tuple[str, ...] = ()


SKIPPED: Mapping[str, str] = {
    **dict.fromkeys(
        (
            *(
                "Certificate",
                "CheckCounts",
                "Contact",
                "EdgeProof",
                "Failure",
                "GripperMotion",
                "MotionReport",
                "PlanResult",
            ),
            *("PolishReport", "Refusal", "Replanned", "RoadmapUpdate", "Segment", "StageReport", "TaskResult", "Trace"),
        ),
        "an answer; nobody makes one",
    ),
    **dict.fromkeys(
        (
            *(
                "BrokenInvariant",
                "Cancelled",
                "Interrupted",
                "InvalidFile",
                "InvalidRequest",
                "MissingDependency",
                "NotProven",
            ),
            *("PlannerServiceError", "PlanningFailed", "UnknownName"),
        ),
        "an error",
    ),
    **dict.fromkeys(("EdgeVerdict", "Known", "Outcome", "Reason", "Stage", "Verdict"), "an enumeration"),
    **dict.fromkeys(("CancelToken", "Sequential", "Trapezoidal", "robot_names", "scene_names"), "takes nothing"),
    "Robot": "made by load_robot and Robot.from_urdf",
}
"""Public names that are not attacked, and why."""

CUBE = [[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)]


def calls(folder: Path) -> dict[str, Call]:
    """Every public callable by its name; files are read from and written to ``folder``."""
    return {**_values(folder), **_shapes(), **_methods(), **_planning(folder), **_tasks(folder), **_files(folder)}


def _values(folder: Path) -> dict[str, Call]:
    box, pose = Box((0.1, 0.2, 0.3)), Pose((0.1, 0.2, 0.3))
    path = JointPath(np.array([[0.0, 0.0], [1.0, 1.0]]))
    limits = {"lower": [-3.0, -3.0], "upper": [3.0, 3.0], "velocity": [1.0, 1.0]}
    rates = {"acceleration": [1.0, 1.0], "jerk": [10.0, 10.0]}
    law = Trapezoidal().time_path(path, _limits())
    timed = {"durations": law.durations, "coefficients": law.coefficients, "dilation": 1.0, "part": (0.0, path.length)}
    tree = {"range": 0.5, "goal_bias": 0.05, "checks": 2_000}
    asked: dict[str, Any] = {
        "start": [0.0, 0.5],
        "goal": [0.5, 0.5],
        "planner": RRTConnect(),
        "timing": ToppRa(),
        "seed": 0,
        "max_checks": 1_000,
        "time_limit": 1.0,
        "retries": 0,
        "padding": 0.001,
        "velocity_scale": 1.0,
        "acceleration_scale": 1.0,
        "max_tool_speed": None,
        "blend": 0.5,
        "start_tolerance": 0.01,
        "polish": None,
    }
    pairs = (("a", "b"),)
    return {
        "Pose": Call(Pose, {"position": (0.0, 0.0, 0.0), "quaternion": (1.0, 0.0, 0.0, 0.0)}),
        "Pose.from_matrix": Call(Pose.from_matrix, {"matrix": np.eye(4)}),
        "Pose.from_rpy": Call(Pose.from_rpy, {"position": (0.0, 0.0, 0.0), "rpy": (0.0, 0.0, 0.0)}),
        "Box": Call(Box, {"size": (0.1, 0.2, 0.3)}),
        "Sphere": Call(Sphere, {"radius": 0.1}),
        "Cylinder": Call(Cylinder, {"radius": 0.1, "length": 0.2}),
        "Capsule": Call(Capsule, {"radius": 0.1, "length": 0.2}),
        "Mesh": Call(Mesh, {"vertices": CUBE}),
        "Compound": Call(Compound, {"parts": ((box, pose),)}),
        "Compound.of_pieces": Call(Compound.of_pieces, {"pieces": [box]}),
        "PointCloud": Call(PointCloud, {"points": [[0.0, 0.0, 0.0]], "resolution": 0.1}),
        "PointCloud.from_cells": Call(PointCloud.from_cells, {"cells": [[0, 0, 0]], "resolution": 0.1}),
        "HeightField": Call(HeightField, {"heights": [[0.1, 0.2]], "cell": 0.1, "floor": 0.0}),
        "PoseGoal": Call(
            PoseGoal,
            {"pose": pose, "position_tolerance": 0.01, "orientation_tolerance": 0.1, "free_axis": (1.0, 0.0, 0.0)}
            | {"candidates": 4},
        ),
        "Obstacle": Call(Obstacle, {"name": "a", "shape": box, "pose": pose}),
        "Attached": Call(Attached, {"name": "a", "shape": box, "pose": pose, "touch_links": ("b",)}),
        "Scene": Call(
            Scene,
            {"obstacles": (Obstacle("a", box),), "attached": (Attached("b", box, pose),), "name": "n"}
            | {"description": "d"},
        ),
        "JointLimits": Call(JointLimits, {**limits, **rates}),
        "ArmLimits": Call(ArmLimits, limits),
        "Recording": Call(
            Recording,
            {"t": [0.0], "commanded": [[0.0]], "measured": [[0.0]], "lateness": [0.0], "skipped": 0},
        ),
        "JointPath": Call(JointPath, {"waypoints": [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], "blends": [0.0, 0.1, 0.0]}),
        "Trajectory": Call(Trajectory, {"path": path, **timed}),
        "SearchGraph": Call(SearchGraph, {"milestones": [[0.0, 0.0], [1.0, 1.0]], "edges": [[0, 1]]}),
        "Roadmap": Call(Roadmap.of, {"milestones": [[0.0, 0.0], [1.0, 1.0]], "edges": [[0, 1]], "reach": [1.0, 1.0]}),
        "Roadmap.judged": Call(
            Roadmap.judged,
            {"milestones": [[0.0, 0.0], [1.0, 1.0]], "free": [(0, 1)], "blocked": {}, "reach": [1.0, 1.0]},
        ),
        "AllowedStretch": Call(AllowedStretch, {"first": 0, "last": 1, "pairs": pairs, "reason": "r"}),
        "ExemptInterval": Call(ExemptInterval, {"s_start": 0.0, "s_end": 1.0, "pairs": pairs, "reason": "r"}),
        "Pace": Call(
            Pace,
            {"timing": ToppRa(), "velocity_scale": 0.5, "acceleration_scale": 0.5, "max_tool_speed": 0.1},
        ),
        "PlanRequest": Call(PlanRequest, asked),
        "Handling": Call(
            Handling,
            {"support": "a", "support_gap": 0.005, "open_width": 0.05, "request": PlanRequest(**asked)}
            | {"line_timing": Trapezoidal(), "cancel": CancelToken()},
        ),
        "Streaming": Call(
            Streaming,
            {"speed": 0.5, "rate": 250.0, "start_tolerance": 0.01, "tracking_tolerance": 0.1, "settle": 2.0}
            | {"latest": 0.1, "gripper_time": 1.0, "gripper_tolerance": 0.005, "squeeze": 0.01},
        ),
        "MotionStep": Call(MotionStep, {"distance": 0.01}),
        "JointStep": Call(JointStep, {"angle": 0.02}),
        "ToppRa": Call(ToppRa, {"gridpoints": 50}),
        "SCurve": Call(SCurve, {"jerk": 10.0}),
        "RRTConnect": Call(RRTConnect, {"range": 0.5}),
        "BKPIECE1": Call(BKPIECE1, {"range": 0.5}),
        "LBKPIECE1": Call(LBKPIECE1, {"range": 0.5}),
        "RRT": Call(RRT, {"range": 0.5, "goal_bias": 0.05}),
        "KPIECE1": Call(KPIECE1, {"range": 0.5, "goal_bias": 0.05}),
        "RRTstar": Call(RRTstar, tree),
        "InformedRRTstar": Call(InformedRRTstar, tree),
        "SORRTstar": Call(SORRTstar, tree),
        "AORRTC": Call(AORRTC, {"range": 0.5, "checks": 2_000}),
        "BITstar": Call(BITstar, {"samples": 100, "checks": 2_000}),
        "FMT": Call(FMT, {"samples": 100}),
        "BFMT": Call(BFMT, {"samples": 100}),
        "PRM": Call(PRM, {"milestones": 10, "neighbours": 5, "max_checks": 1_000}),
        "PRMstar": Call(PRMstar, {"milestones": 10, "max_checks": 1_000}),
        "LazyPRM": Call(LazyPRM, {"milestones": 10, "neighbours": 5}),
        "TrajOpt": Call(TrajOpt, {"iterations": 4}),
        "Chomp": Call(Chomp, {"iterations": 4, "voxel": 0.05}),
        "Optimise": Call(
            Optimise,
            {"waypoints": 20, "smoothness": 100.0, "clearance": 0.02, "corners": 4, "method": TrajOpt(), "starts": 1},
        ),
        "Processes": Call(Processes, {"workers": 1}),
        "Ray": Call(Ray, {"address": "auto", "workers": 1}),
        "engine_named": Call(engine_named, {"name": "processes", "workers": 1}),
        "episode_task": Call(episode_task, {"name": "pick-place"}),
        "EpisodeWork": Call(
            EpisodeWork,
            {"robot": load_robot("wxai"), "task": episode_task("pick-place"), "seed": 0, "fps": 30}
            | {"gripper_speed": 0.05, "max_checks": 1_000, "chunk": 10},
        ),
        "Source": Call(
            Source,
            {"urdf": folder / "robot.urdf", "srdf": None, "tool_frame": "tip", "package_dirs": (folder,)}
            | {"locked_joints": {}, "joints": None},
        ),
    }


def _limits() -> JointLimits:
    return JointLimits(*(np.full(2, value) for value in (-3.0, 3.0, 1.0, 1.0, 10.0)))


def _methods() -> dict[str, Call]:
    scene = Scene((Obstacle("a", Box((0.1, 0.1, 0.1))),), (Attached("b", Sphere(0.1), Pose()),))
    path = JointPath(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]))
    law = Trapezoidal().time_path(path, _limits())
    roadmap = Roadmap.of([[0.0, 0.0], [1.0, 1.0]], [[0, 1]])
    arm, wxai = load_robot("planar2"), load_robot("wxai")
    q = [0.1, 0.5]
    timing = {"path": path, "limits": _limits(), "speed_limit": None}
    return {
        "Scene.obstacle": Call(scene.obstacle, {"name": "a"}),
        "Scene.with_obstacle": Call(scene.with_obstacle, {"obstacle": Obstacle("c", Sphere(0.1))}),
        "Scene.without": Call(scene.without, {"name": "a"}),
        "Scene.moved": Call(scene.moved, {"name": "a", "pose": Pose()}),
        "Scene.with_attached": Call(scene.with_attached, {"attached": Attached("c", Sphere(0.1), Pose())}),
        "Scene.without_attached": Call(scene.without_attached, {"name": "b"}),
        "JointPath.__call__": Call(path.__call__, {"s": [0.1, 0.2], "order": 0}),
        "JointPath.with_blends": Call(path.with_blends, {"blends": [0.0, 0.1, 0.0]}),
        "JointPath.turns_back": Call(path.turns_back, {"k": 1}),
        "JointPath.travel": Call(path.travel, {"s": [0.1, 0.2]}),
        "Trajectory.__call__": Call(law.__call__, {"t": [0.1, 0.2], "order": 0}),
        "Trajectory.s": Call(law.s, {"t": [0.1, 0.2], "order": 0}),
        "Trajectory.moving": Call(law.moving, {"t": [0.1, 0.2]}),
        "Trajectory.sample": Call(law.sample, {"dt": 0.1}),
        "Trajectory.dilated": Call(law.dilated, {"factor": 1.5}),
        "ToppRa.time_path": Call(ToppRa().time_path, timing),
        "SCurve.time_path": Call(SCurve().time_path, timing),
        "Trapezoidal.time_path": Call(Trapezoidal().time_path, timing),
        "Pace.of": Call(Pace.of, {"request": PlanRequest(q, q), "timing": ToppRa()}),
        "Pace.limits": Call(Pace(ToppRa()).limits, {"robot": arm}),
        "PlanRequest.goals": Call(PlanRequest(q, q).goals, {"robot": arm}),
        "Roadmap.with_path": Call(roadmap.with_path, {"points": [[0.0, 0.1], [1.0, 0.5]]}),
        "Robot.pose": Call(arm.pose, {"name": "home"}),
        "Robot.body_poses": Call(arm.body_poses, {"q": q}),
        "Robot.body_poses_batch": Call(arm.body_poses_batch, {"Q": [q]}),
        "Robot.tool_pose": Call(arm.tool_pose, {"q": q}),
        "Robot.tool_jacobian": Call(arm.tool_jacobian, {"q": q}),
        "Robot.reach": Call(arm.reach, {"extra": ((1, Sphere(0.1), Pose()),)}),
        "Robot.with_gripper": Call(wxai.with_gripper, {"width": 0.04}),
        "Robot.locked": Call(wxai.locked, {"joints": {wxai.joint_names[0]: 0.0}}),
        "inverse_kinematics": Call(
            inverse_kinematics,
            {"robot": wxai, "pose": Pose((0.3, 0.0, 0.2)), "seed": 0, "seeds": [wxai.home], "still": wxai.home},
        ),
        "straight_tool_line": Call(
            straight_tool_line, {"robot": wxai, "q_start": wxai.home, "to": (0.0, 0.0, 0.01), "points": 5}
        ),
        "contact_table": Call(contact_table, {"robot": arm, "samples": 10, "max_bounds": 1_000}),
    }


def _shapes() -> dict[str, Call]:
    solids: dict[str, Solid] = {
        "Box": Box((0.1, 0.2, 0.3)),
        "Sphere": Sphere(0.1),
        "Cylinder": Cylinder(0.1, 0.2),
        "Capsule": Capsule(0.1, 0.2),
        "Mesh": Mesh(np.array(CUBE)),
        "Compound": Compound(((Box((0.1, 0.2, 0.3)), Pose()),)),
        "PointCloud": PointCloud(np.zeros((1, 3)), 0.1),
        "HeightField": HeightField(np.array([[0.1, 0.2]]), 0.1, 0.0),
    }
    points = [[0.1, 0.2, 0.3], [1.0, 0.0, 0.0]]
    found: dict[str, Call] = {}
    for name, solid in solids.items():
        found[f"{name}.support"] = Call(solid.support, {"direction": points})
        found[f"{name}.distance"] = Call(solid.distance, {"points": points})
        if isinstance(solid, Shape):
            found[f"{name}.grown"] = Call(solid.grown, {"margin": 0.01})
    return found


def _planning(folder: Path) -> dict[str, Call]:
    arm, scene = load_robot("planar2"), load_scene("discs")
    service = PlannerService(arm, scene)
    checker, certifier = CollisionChecker(arm, scene), Certifier(arm, scene)
    request = PlanRequest(arm.home, arm.home + 0.01)
    result = service.plan(request)
    path, _ = result.unwrap()
    bent = JointPath(arm.home + 0.01 * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), np.array([0.0, 0.004, 0.0]))
    q, near = arm.home, arm.home + 0.01
    few = PRM(milestones=10, neighbours=3, max_checks=500)
    roadmap = service.build_roadmap(few)
    edge, token = {"q1": q, "q2": near, "known": Known.NEITHER}, CancelToken()
    return {
        "PlannerService": Call(
            PlannerService,
            {"robot": "planar2", "scene": "discs", "edge_step": MotionStep(0.01), "allowed": ()},
        ),
        "PlannerService.with_scene": Call(service.with_scene, {"scene": scene}),
        "PlannerService.changed": Call(service.changed, {"gripper": None, "scene": scene}),
        "PlannerService.plan": Call(service.plan, {"request": request, "cancel": token, "trace": True}),
        "PlannerService.plan_many": Call(
            service.plan_many, {"requests": [request], "engine": Sequential(), "progress": False}
        ),
        "PlannerService.plan_stream": Call(
            lambda requests, engine: list(service.plan_stream(requests, engine=engine)),
            {"requests": [request], "engine": Sequential()},
        ),
        "PlannerService.replan": Call(
            service.replan,
            {"previous": result, "at_time": 0.01, "latency": 0.01, "scene": scene, "goal": near}
            | {"request": request, "cancel": token},
        ),
        "PlannerService.certify": Call(
            service.certify, {"path": path, "padding": 0.001, "exempt": (), "part": (0.0, path.length)}
        ),
        "PlannerService.follow": Call(
            service.follow,
            {"waypoints": [q, near], "contacts": (), "pace": Pace(Trapezoidal()), "blends": [0.0, 0.0]}
            | {"cancel": token},
        ),
        "PlannerService.build_roadmap": Call(
            service.build_roadmap,
            {"planner": few, "seed": 0, "padding": 0.001, "progress": False, "cancel": token},
        ),
        "PlannerService.path_memory": Call(service.path_memory, {"padding": 0.001}),
        "PlannerService.update_roadmap": Call(service.update_roadmap, {"roadmap": roadmap, "cancel": token}),
        "PlannerService.way_out": Call(service.way_out, {"q": q, "seed": 0}),
        "best_of_seeds": Call(
            best_of_seeds, {"service": service, "request": request, "seeds": [0], "engine": Sequential()}
        ),
        "plan_seeds": Call(plan_seeds, {"service": service, "request": request, "seeds": [0], "engine": Sequential()}),
        "PlanResult.stage": Call(result.stage, {"stage": Stage.SEARCH}),
        "CollisionChecker": Call(
            CollisionChecker,
            {"robot": arm, "scene": scene, "edge_step": MotionStep(), "padding": 0.0, "allowed": ()}
            | {"backend": "auto"},
        ),
        "CollisionChecker.variant": Call(checker.variant, {"padding": 0.001, "allowed": (), "motion_step": 0.01}),
        "CollisionChecker.state_is_free": Call(checker.state_is_free, {"q": q}),
        "CollisionChecker.states_are_free": Call(checker.states_are_free, {"Q": [q, near]}),
        "CollisionChecker.edge_is_free": Call(checker.edge_is_free, edge),
        "CollisionChecker.edge_hit": Call(checker.edge_hit, edge),
        "CollisionChecker.edge_is_free_coarse": Call(checker.edge_is_free_coarse, edge),
        "CollisionChecker.finish_edge": Call(checker.finish_edge, {"q1": q, "q2": near}),
        "CollisionChecker.segments": Call(checker.segments, {"q1": q, "q2": near}),
        "CollisionChecker.path_is_free": Call(checker.path_is_free, {"path": path, "known": Known.NEITHER}),
        "CollisionChecker.blend_is_free": Call(checker.blend_is_free, {"path": bent, "k": 1}),
        "CollisionChecker.limited": Call(
            lambda **given: checker.limited(**given).__enter__(), {"states": 10, "deadline": 1e9, "token": token}
        ),
        "CollisionChecker.clearance": Call(checker.clearance, {"q": q}),
        "CollisionChecker.near": Call(checker.near, {"Q": [q], "within": 0.05}),
        "CollisionChecker.pair_names": Call(checker.pair_names, {"pair": 0}),
        "CollisionChecker.contacts": Call(checker.contacts, {"q": q}),
        "Certifier": Call(Certifier, {"robot": arm, "scene": scene, "allowed": (), "backend": "auto"}),
        "Certifier.certify": Call(
            certifier.certify, {"path": path, "padding": 0.001, "exempt": (), "part": (0.0, path.length)}
        ),
        "Certifier.certify_edge": Call(certifier.certify_edge, {"q1": q, "q2": near, "padding": 0.001}),
        "Certifier.roots": Call(certifier.roots, {"length": 1.0, "exempt": ()}),
        "Certifier.clearances": Call(certifier.clearances, {"Q": [q, near]}),
        "csv_text": Call(csv_text, {"motion": result, "joint_names": arm.joint_names, "dt": 0.05}),
        "joint_trajectory": Call(
            joint_trajectory, {"motion": result, "joint_names": arm.joint_names, "dt": 0.05, "frame_id": "base"}
        ),
        "write_csv": Call(
            write_csv,
            {"motion": result, "path": folder / "out.csv", "joint_names": arm.joint_names, "dt": 0.05},
            into=("path",),
        ),
        "save_plan": Call(save_plan, {"plan": result, "path": folder / "out.json"}, into=("path",)),
        "draw_check": Call(draw_check, {"checker": checker, "q": q, "file": folder / "out.png"}, into=("file",)),
    }


def _tasks(folder: Path) -> dict[str, Call]:
    service = PlannerService("wxai", "bin")
    robot, scene = service.robot, service.scene
    block, tray = scene.obstacle("blue_block"), scene.obstacle("tray")
    request = PlanRequest(robot.home, robot.home, max_checks=2_000, time_limit=1.0)
    grasp = top_grasps(robot, block)[:1]
    held = Attached("held", Box((0.02, 0.02, 0.02)), Pose((0.0, 0.0, 0.0)), touch_links=robot.gripper.links[:0])  # type: ignore[union-attr]
    carrying = PlannerService(robot, Scene((tray,), (held,)))
    return {
        "top_grasps": Call(top_grasps, {"robot": robot, "target": block, "tilts": (0.0,)}),
        "places_on": Call(places_on, {"target": block, "support": tray}),
        "standing_on": Call(standing_on, {"scene": scene, "name": "blue_block"}),
        "move_linear": Call(
            move_linear,
            {"service": service, "start": robot.home, "goal": (0.0, 0.0, 0.01), "points": 5}
            | {"pace": Pace(Trapezoidal()), "cancel": CancelToken()},
        ),
        "pick": Call(
            pick,
            {"service": service, "q": robot.home, "target": "blue_block", "grasps": grasp}
            | {"handling": Handling(request=request)},
        ),
        "place": Call(
            place,
            {"service": carrying, "q": robot.home, "carried": "held", "poses": [tray.pose]}
            | {"handling": Handling(request=request)},
        ),
        "plan_pick_place": Call(
            plan_pick_place,
            {"service": service, "target": "blue_block", "onto": "tray", "request": request},
        ),
    }


def _files(folder: Path) -> dict[str, Call]:
    urdf = folder / "robot.urdf"
    urdf.write_text(
        '<robot name="r"><link name="a"/><link name="tip"><collision><geometry><box size=".1 .1 .1"/></geometry>'
        '</collision></link><joint name="j" type="revolute"><parent link="a"/><child link="tip"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1"/></joint></robot>',
        encoding="utf-8",
    )
    mesh, cloud, heights, roadmap = (folder / name for name in ("cube.obj", "cloud.npy", "heights.npy", "roadmap.npz"))
    mesh.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in CUBE) + "f 1 2 3\n", encoding="utf-8")
    stand = folder / "stand.urdf"
    stand.write_text(
        '<robot name="s"><link name="a"><collision><geometry><box size=".1 .1 .1"/></geometry></collision></link>'
        "</robot>",
        encoding="utf-8",
    )
    np.save(cloud, np.array(CUBE))
    np.save(heights, np.array([[0.1, 0.2]]))
    service = PlannerService("planar2", "discs")
    service.path_memory().save(roadmap)
    read = {"path": folder / "nothing-there"}
    return {
        "load_robot": Call(load_robot, {"name_or_path": "planar2"}),
        "load_scene": Call(load_scene, {"name_or_path": "discs"}),
        "load_world": Call(load_world, {"name_or_path": "discs"}),
        "save_scene": Call(save_scene, {"scene": Scene(), "path": folder / "out.toml"}, into=("path",)),
        "Robot.from_urdf": Call(
            Robot.from_urdf,
            {"path": urdf, "tool_frame": "tip", "srdf": None, "package_dirs": (folder,), "locked_joints": {}}
            | {"joints": ("j",), "decompose": {}},
        ),
        "import_robot": Call(
            import_robot, {"source": Source(urdf), "out": folder / "imported", "force": True}, into=("out",)
        ),
        "Mesh.from_file": Call(Mesh.from_file, {"path": mesh, "scale": (1.0, 1.0, 1.0)}),
        "Compound.of_mesh": Call(Compound.of_mesh, {"path": mesh, "scale": (1.0, 1.0, 1.0), "most": 2}),
        "PointCloud.from_file": Call(PointCloud.from_file, {"path": cloud, "resolution": 0.05}),
        "HeightField.from_file": Call(HeightField.from_file, {"path": heights, "cell": 0.05, "floor": 0.0}),
        "Roadmap.load": Call(Roadmap.load, {"path": roadmap}),
        "Roadmap.save": Call(Roadmap.load(roadmap).save, {"path": folder / "out.npz"}, into=("path",)),
        "read_moveit_scene": Call(read_moveit_scene, read),
        "read_urdf_scene": Call(read_urdf_scene, {"path": stand}),
        "read_problems": Call(read_problems, read),
        "load_plan": Call(load_plan, read),
        "load_task": Call(load_task, read),
        "load_plan_or_task": Call(load_plan_or_task, read),
    }
