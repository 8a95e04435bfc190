"""Every public callable with arguments that are right, and objects that are wrong for nearly all of them."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
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
from planner_service.geometry.composite import Solid
from planner_service.geometry.shapes import Shape
from planner_service.kinematics import straight_tool_line
from planner_service.optimize import Chomp, TrajOpt
from planner_service.parallel import Processes, Ray, Sequential, engine_named
from planner_service.planning import AllowedStretch, Pace
from planner_service.records.evidence import save_plan
from planner_service.records.exports.trajectory_export import csv_text, joint_trajectory, robot_trajectory, write_csv
from planner_service.records.plan_file import load_plan, load_plan_or_task, load_task
from planner_service.records.problem_set import read_problems
from planner_service.robot_setup.import_robot import Source, import_robot
from planner_service.robot_setup.self_collision_matrix import contact_table
from planner_service.scene.moveit_scene import read_moveit_scene
from planner_service.scene.urdf_scene import read_urdf_scene
from planner_service.scene.worlds import load_world
from planner_service.search import SearchGraph
from planner_service.tasks.pick_place import places_on, plan_pick_place, standing_on
from planner_service.tasks.seeds import best_of_seeds, plan_seeds
from planner_service.tasks.tool_motions import move_circular
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
            *("TaskResult", "Trace"),
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
    **dict.fromkeys(("EdgeVerdict", "Known", "Outcome", "Reason", "Stage", "Verdict"), "an enumeration"),
    **dict.fromkeys(("CancelToken", "Sequential", "Trapezoidal", "robot_names", "scene_names"), "takes nothing"),
    "Robot": "made by load_robot and Robot.from_urdf",
}
"""Public names that are not attacked, and why."""

CUBE = [[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)]


def calls(folder: Path) -> dict[str, Call]:
    """Every public callable by its name; files are read from and written to ``folder``."""
    parts = (_values(folder), _shapes(), _methods(), _planning(folder), _tasks(folder), _files(folder))
    return {name: call for part in parts for name, call in part}


Calls = Iterator[tuple[str, Call]]


def _call(function: Callable[..., Any], into: tuple[str, ...] = (), /, **arguments: Any) -> tuple[str, Call]:
    """A call, and the name by which its function is public."""
    return function.__qualname__, Call(function, arguments, into)


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
    tree = {"range": 0.5, "goal_bias": 0.05, "checks": 2_000}
    request = ps.PlanRequest(
        [0.0, 0.5],
        [0.5, 0.5],
        ps.BalancedRRTConnect(),
        ps.ToppRa(),
        max_checks=1_000,
        time_limit=1.0,
        retries=0,
        blend=0.5,
    )
    pairs = (("a", "b"),)
    yield from (
        _call(ps.Pose, position=(0.0, 0.0, 0.0), quaternion=(1.0, 0.0, 0.0, 0.0)),
        _call(ps.Pose.from_matrix, matrix=np.eye(4)),
        _call(ps.Pose.from_rpy, position=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0)),
        _call(ps.Box, size=(0.1, 0.2, 0.3)),
        _call(ps.Sphere, radius=0.1),
        _call(ps.Cylinder, radius=0.1, length=0.2),
        _call(ps.Capsule, radius=0.1, length=0.2),
        _call(ps.Mesh, vertices=CUBE),
        _call(ps.Compound, parts=((box, pose),)),
        _call(ps.Compound.of_pieces, pieces=[box]),
        _call(ps.PointCloud, points=[[0.0, 0.0, 0.0]], resolution=0.1),
        _call(ps.PointCloud.from_cells, cells=[[0, 0, 0]], resolution=0.1),
        _call(ps.HeightField, heights=[[0.1, 0.2]], cell=0.1, floor=0.0),
        _again(ps.PoseGoal(pose, 0.01, 0.1, (1.0, 0.0, 0.0), 4)),
        _call(ps.Obstacle, name="a", shape=box, pose=pose),
        _call(ps.Attached, name="a", shape=box, pose=pose, touch_links=("b",)),
        _again(ps.Scene((ps.Obstacle("a", box),), (ps.Attached("b", box, pose),), "n", "d")),
        _call(ps.JointLimits, **limits, **rates),
        _call(ArmLimits, **limits),
        _call(Recording, t=[0.0], commanded=[[0.0]], measured=[[0.0]], lateness=[0.0], skipped=0),
        _call(ps.JointPath, waypoints=[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], blends=[0.0, 0.1, 0.0]),
        _call(ps.Trajectory, path=path, **timed),
        _call(SearchGraph, milestones=[[0.0, 0.0], [1.0, 1.0]], edges=[[0, 1]]),
        (
            "Roadmap",
            Call(ps.Roadmap.of, {"milestones": [[0.0, 0.0], [1.0, 1.0]], "edges": [[0, 1]], "reach": [1.0, 1.0]}),
        ),
        _call(ps.Roadmap.judged, milestones=[[0.0, 0.0], [1.0, 1.0]], free=[(0, 1)], blocked={}, reach=[1.0, 1.0]),
        _call(AllowedStretch, first=0, last=1, pairs=pairs, reason="r"),
        _call(ExemptInterval, s_start=0.0, s_end=1.0, pairs=pairs, reason="r"),
        _call(Pace, timing=ps.ToppRa(), velocity_scale=0.5, acceleration_scale=0.5, max_tool_speed=0.1),
        _again(request),
        _again(ps.Handling("a", 0.005, 0.05, request, ps.Trapezoidal(), ps.CancelToken())),
        _again(Streaming(speed=0.5)),
        _again(ToolRegion(pose, (-1.0, -1.0, -1.0), (1.0, 1.0, 1.0), 0.3, 0.2, pose, "tip", "base", "region")),
        _again(JointRange("shoulder", -1.0, 1.0)),
        _call(KeepUpright, tool_axis=(1.0, 0.0, 0.0), tolerance=0.1, link="tip", up=(0.0, 0.0, 1.0)),
        _call(KeepOrientation, orientation=pose, tolerance=0.1, link="tip"),
        _call(OnPlane, frame=pose, tolerance=0.001, point=(0.0, 0.0, 0.1), link="tip"),
        _call(OnLine, start=(0.0, 0.0, 0.0), end=(1.0, 0.0, 0.0), tolerance=0.001, point=(0.0, 0.0, 0.1), link="tip"),
        _call(InBox, frame=pose, size=(0.1, 0.1, 0.1), point=(0.0, 0.0, 0.1), link="tip"),
        _call(RelativePose, link="tip", relative_to="base", pose=pose, position_tolerance=0.001, angle_tolerance=0.1),
        _call(ps.MotionStep, distance=0.01),
        _call(ps.JointStep, angle=0.02),
        _call(ps.ToppRa, gridpoints=50),
        _call(ps.SCurve, jerk=10.0),
        _call(ps.BalancedRRTConnect, range=0.5),
        _call(ps.RRTConnect, range=0.5),
        _call(algorithms.BKPIECE1, range=0.5),
        _call(algorithms.LBKPIECE1, range=0.5),
        _call(ps.RRT, range=0.5, goal_bias=0.05),
        _call(algorithms.KPIECE1, range=0.5, goal_bias=0.05),
        _call(algorithms.RRTstar, **tree),
        _call(algorithms.InformedRRTstar, **tree),
        _call(algorithms.SORRTstar, **tree),
        _call(algorithms.AORRTC, range=0.5, checks=2_000),
        _call(algorithms.BITstar, samples=100, checks=2_000),
        _call(algorithms.FMT, samples=100),
        _call(algorithms.BFMT, samples=100),
        _call(ps.PRM, milestones=10, neighbours=5, max_checks=1_000),
        _call(algorithms.PRMstar, milestones=10, max_checks=1_000),
        _call(ps.LazyPRM, milestones=10, neighbours=5),
        _call(TrajOpt, iterations=4),
        _call(Chomp, iterations=4, voxel=0.05),
        _call(ps.Optimise, waypoints=20, smoothness=100.0, clearance=0.02, corners=4, method=TrajOpt(), starts=1),
        _call(Processes, workers=1),
        _call(Ray, address="auto", workers=1),
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
    timing, reached = {"path": path, "limits": _limits(), "speed_limit": None}, ps.Pose((0.3, 0.0, 0.2))
    yield from (
        _call(scene.obstacle, name="a"),
        _call(scene.with_obstacle, obstacle=ps.Obstacle("c", ps.Sphere(0.1))),
        _call(scene.without, name="a"),
        _call(scene.moved, name="a", pose=ps.Pose()),
        _call(scene.with_attached, attached=ps.Attached("c", ps.Sphere(0.1), ps.Pose())),
        _call(scene.without_attached, name="b"),
        _call(path.__call__, s=[0.1, 0.2], order=0),
        _call(path.with_blends, blends=[0.0, 0.1, 0.0]),
        _call(path.turns_back, k=1),
        _call(path.travel, s=[0.1, 0.2]),
        _call(law.__call__, t=[0.1, 0.2], order=0),
        _call(law.s, t=[0.1, 0.2], order=0),
        _call(law.moving, t=[0.1, 0.2]),
        _call(law.sample, dt=0.1),
        _call(law.dilated, factor=1.5),
        _call(ps.ToppRa().time_path, **timing),
        _call(ps.SCurve().time_path, **timing),
        _call(ps.Trapezoidal().time_path, **timing),
        _call(Pace.of, request=ps.PlanRequest(q, q), timing=ps.ToppRa()),
        _call(Pace(ps.ToppRa()).limits, robot=arm),
        _call(ps.PlanRequest(q, q).goals, robot=arm),
        _call(roadmap.with_path, points=[[0.0, 0.1], [1.0, 0.5]]),
        _call(arm.pose, name="home"),
        _call(arm.body_poses, q=q),
        _call(arm.body_poses_batch, Q=[q]),
        _call(arm.tool_pose, q=q),
        _call(arm.tool_jacobian, q=q),
        _call(arm.reach, extra=((1, ps.Sphere(0.1), ps.Pose()),)),
        _call(wxai.with_gripper, width=0.04),
        _call(wxai.locked, joints={wxai.joint_names[0]: 0.0}),
        _call(ps.inverse_kinematics, robot=wxai, pose=reached, seed=0, seeds=[wxai.home], still=wxai.home),
        _call(straight_tool_line, robot=wxai, q_start=wxai.home, to=(0.0, 0.0, 0.01), points=5),
        _call(contact_table, robot=arm, samples=10, max_bounds=1_000),
    )


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
    edge, token = {"q1": q, "q2": near, "known": Known.NEITHER}, ps.CancelToken()
    moving, pace = {"previous": result, "at_time": 0.01, "latency": 0.01}, Pace(ps.Trapezoidal())
    world, kept = {"robot": arm, "scene": scene}, (ToolRegion(lower=(-2.0, -2.0, -2.0), tilt=0.1, name="flat"),)
    yield from (
        _call(ps.PlannerService, robot="planar2", scene="discs", edge_step=ps.MotionStep(0.01), allowed=()),
        _call(service.with_scene, scene=scene),
        _call(service.changed, gripper=None, scene=scene),
        _call(service.plan, request=request, cancel=token, trace=True),
        _call(service.plan_many, requests=[request], engine=Sequential(), progress=False),
        (
            "PlannerService.plan_stream",
            Call(
                lambda requests, engine: list(service.plan_stream(requests, engine=engine)),
                {"requests": [request], "engine": Sequential()},
            ),
        ),
        _call(service.replan, **moving, scene=scene, goal=near, request=request, cancel=token),
        _call(service.certify, path=path, padding=0.001, exempt=(), part=(0.0, path.length)),
        _call(service.follow, waypoints=[q, near], contacts=(), pace=pace, blends=[0.0, 0.0], cancel=token),
        _call(service.build_roadmap, planner=few, seed=0, padding=0.001, progress=False, cancel=token),
        _call(service.path_memory, padding=0.001),
        _call(service.update_roadmap, roadmap=roadmap, cancel=token),
        _call(service.way_out, q=q, padding=0.001),
        _call(service.explain, request=request, plans=2, remedies=1, cancel=token),
        _call(result.save, ("path",), path=folder / "kept.json"),
        _call(best_of_seeds, service=service, request=request, seeds=[0], engine=Sequential()),
        _call(plan_seeds, service=service, request=request, seeds=[0], engine=Sequential()),
        _call(result.stage, stage=ps.Stage.SEARCH),
        _call(ps.CollisionChecker, **world, edge_step=ps.MotionStep(), padding=0.0, allowed=(), backend="native"),
        _call(checker.variant, padding=0.001, allowed=(), motion_step=0.01),
        _call(checker.state_is_free, q=q),
        _call(checker.states_are_free, Q=[q, near]),
        _call(checker.edge_is_free, **edge),
        _call(checker.edge_hit, **edge),
        _call(checker.edge_is_free_coarse, **edge),
        _call(checker.finish_edge, q1=q, q2=near),
        _call(checker.segments, q1=q, q2=near),
        _call(checker.path_is_free, path=path, known=Known.NEITHER),
        _call(checker.blend_is_free, path=bent, k=1),
        (
            "CollisionChecker.limited",
            Call(lambda **given: checker.limited(**given).__enter__(), {"states": 10, "deadline": 1e9, "token": token}),
        ),
        _call(checker.clearance, q=q),
        _call(checker.near, Q=[q], within=0.05),
        _call(checker.pair_names, pair=0),
        _call(checker.contacts, q=q),
        _call(Certifier, **world, allowed=()),
        _call(certifier.certify, path=path, padding=0.001, exempt=(), part=(0.0, path.length), constraints=kept),
        _call(certifier.certify_edge, q1=q, q2=near, padding=0.001),
        _call(certifier.roots, length=1.0, exempt=()),
        _call(certifier.clearances, Q=[q, near]),
        _call(csv_text, motion=result, joint_names=arm.joint_names, dt=0.05),
        _call(joint_trajectory, motion=result, joint_names=arm.joint_names, dt=0.05, frame_id="base"),
        _call(robot_trajectory, motion=result, joint_names=arm.joint_names, dt=0.05, frame_id="base"),
        _call(write_csv, ("path",), motion=result, path=folder / "out.csv", joint_names=arm.joint_names, dt=0.05),
        _call(save_plan, ("path",), plan=result, path=folder / "out.json"),
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
    handling = ps.Handling(request=request)
    yield from (
        _call(ps.top_grasps, robot=robot, target=block, tilts=(0.0,)),
        _call(places_on, target=block, support=tray),
        _call(service.torque_limits, scale=0.5),
        _call(service.certify_gripper, q=robot.home, start=0.0, end=0.01),
        _call(standing_on, scene=scene, name="blue_block"),
        _call(ps.move_linear, **moving, goal=(0.0, 0.0, 0.01), points=5, pace=pace, cancel=ps.CancelToken()),
        _call(
            ps.move_linear,
            **moving,
            goal=[(0.0, 0.0, 0.01), (0.01, 0.0, 0.0)],
            zone=0.002,
            max_joint_rate=50.0,
            partial=True,
        ),
        _call(move_circular, **moving, via=(0.0, 0.01, 0.01), goal=(0.0, 0.02, 0.0), max_joint_rate=50.0, partial=True),
        _call(ps.pick, service=service, q=robot.home, target="blue_block", grasps=grasp, handling=handling),
        _call(ps.place, service=carrying, q=robot.home, carried="held", poses=[tray.pose], handling=handling),
        _call(plan_pick_place, service=service, target="blue_block", onto="tray", request=request),
    )


def _files(folder: Path) -> Calls:
    urdf = folder / "robot.urdf"
    urdf.write_text(
        '<robot name="r"><link name="a"/><link name="tip"><collision><geometry><box size=".1 .1 .1"/></geometry>'
        '</collision></link><joint name="j" type="revolute"><parent link="a"/><child link="tip"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1"/></joint></robot>',
        encoding="utf-8",
    )
    mesh, cloud, heights, roadmap = (folder / name for name in ("cube.obj", "cloud.npy", "heights.npy", "roadmap.npz"))
    mesh.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in CUBE) + "f 1 2 3 4 5 6 7 8\n", encoding="utf-8")
    stand = folder / "stand.urdf"
    stand.write_text(
        '<robot name="s"><link name="a"><collision><geometry><box size=".1 .1 .1"/></geometry></collision></link>'
        "</robot>",
        encoding="utf-8",
    )
    np.save(cloud, np.array(CUBE))
    np.save(heights, np.array([[0.1, 0.2]]))
    service = ps.PlannerService("planar2", "discs")
    service.path_memory().save(roadmap)
    read, description = {"path": folder / "nothing-there"}, {"path": urdf, "tool_frame": "tip", "srdf": None}
    yield from (
        _call(ps.load_robot, name_or_path="planar2"),
        _call(ps.load_scene, name_or_path="discs"),
        _call(load_world, name_or_path="discs"),
        _call(ps.save_scene, ("path",), scene=ps.Scene(), path=folder / "out.toml"),
        _call(ps.Robot.from_urdf, **description, package_dirs=(folder,), locked_joints={}, joints=("j",), decompose={}),
        _call(import_robot, ("out",), source=Source(urdf), out=folder / "imported", force=True),
        _call(ps.Mesh.from_file, path=mesh, scale=(1.0, 1.0, 1.0)),
        _call(ps.Compound.of_mesh, path=mesh, scale=(1.0, 1.0, 1.0), most=2),
        _call(ps.PointCloud.from_file, path=cloud, resolution=0.05),
        _call(ps.HeightField.from_file, path=heights, cell=0.05, floor=0.0),
        _call(ps.Roadmap.load, path=roadmap),
        _call(ps.Roadmap.load(roadmap).save, ("path",), path=folder / "out.npz"),
        _call(load_constraints, **read),
        _call(read_moveit_scene, **read),
        _call(read_urdf_scene, path=stand),
        _call(read_problems, **read),
        _call(load_plan, **read),
        _call(load_task, **read),
        _call(load_plan_or_task, **read),
    )
