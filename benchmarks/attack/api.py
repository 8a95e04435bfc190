"""Public callables with hostile arguments: refused by name, or answered as the laws say; never anything else."""

from __future__ import annotations

import itertools
import math
import pickle
import tempfile
import weakref
from collections.abc import Callable, Mapping
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.attack.harness import Case, Part, Wrong
from planner_service import certify, interchange, plan_file
from planner_service.execute import ArmLimits, Streaming
from planner_service.roadmap import Roadmap

__all__ = ["HOSTILE", "Attack"]


class _OwnError(Exception):
    """What the caller's own object raises: it may come out as it is."""


class _Hater:
    """Anything that is asked of it goes wrong."""

    def _fail(self, *_: object) -> Any:
        raise _OwnError

    __getattr__ = __len__ = __float__ = __eq__ = __repr__ = _fail
    __hash__ = None  # type: ignore[assignment]


def _nested() -> list[Any]:
    out: list[Any] = []
    for _ in range(5000):
        out = [out]
    return out


def _itself() -> list[Any]:
    out: list[Any] = []
    out.append(out)
    return out


HOSTILE: Mapping[str, Callable[[], Any]] = {
    "none": lambda: None,
    "true": lambda: True,
    "np.true": lambda: np.True_,
    "zero": lambda: 0,
    "minus": lambda: -1,
    "five": lambda: 5,
    "half": lambda: 0.5,
    "nan": lambda: math.nan,
    "inf": lambda: math.inf,
    "minus inf": lambda: -math.inf,
    "tiny": lambda: 5e-324,
    "large": lambda: 1e308,
    "huge": lambda: 10**400,
    "long": lambda: 2**63,
    "complex": lambda: 0.1 + 5j,
    "np.complex": lambda: np.complex128(0.1 + 5j),
    "decimal": lambda: Decimal("0.1"),
    "decimal nan": lambda: Decimal("sNaN"),
    "fraction": lambda: Fraction(1, 3),
    "np.float16": lambda: np.float16(0.1),
    "np.longdouble": lambda: np.longdouble("1e4000"),
    "date": lambda: np.datetime64("2020-01-01"),
    "text": lambda: "text",
    "empty text": lambda: "",
    "number text": lambda: "0.1",
    "nul": lambda: "a\0b",
    "controls": lambda: "\x1b[2J\r\n\t\x07",
    "surrogate": lambda: "\ud800",
    "long text": lambda: "x" * 100_000,
    "link name": lambda: "link_1",
    "object name": lambda: "tray",
    "universe": lambda: "universe",
    "bytes": lambda: b"\xff\x00",
    "empty list": list,
    "empty dict": dict,
    "empty tuple": tuple,
    "ragged": lambda: [[0.0] * 6, [0.0] * 5],
    "texts": lambda: ["a", "b"],
    "nans": lambda: [math.nan] * 6,
    "infs": lambda: np.full(6, np.inf),
    "zeros": lambda: [0.0] * 6,
    "seven": lambda: [0.0] * 7,
    "three": lambda: (0.1, 0.1, 0.1),
    "bools": lambda: np.zeros(6, dtype=bool),
    "complexes": lambda: np.zeros(6) + 1j,
    "objects": lambda: np.array([None] * 6, dtype=object),
    "scalar array": lambda: np.array(0.1),
    "no rows": lambda: np.zeros((0, 6)),
    "cube": lambda: np.zeros((2, 2, 2)),
    "masked": lambda: np.ma.masked_all(6),  # type: ignore[no-untyped-call]
    "set": lambda: {1.0, 2.0, 3.0},
    "dict": lambda: {"a": 1.0},
    "generator": lambda: (0.0 for _ in range(6)),
    "endless": itertools.count,
    "range": lambda: range(10**12),
    "nested": _nested,
    "itself": _itself,
    "class": lambda: ps.Box,
    "function": lambda: len,
    "module": lambda: math,
    "hater": _Hater,
    "object": object,
    "path": lambda: Path("/nonexistent/file"),
    "folder": lambda: Path("/"),
    "device": lambda: "/dev/zero",
    "memory": lambda: memoryview(b"abcdef"),
    "weak": lambda: weakref.WeakSet(),
    "box": lambda: ps.Box((0.1, 0.1, 0.1)),
    "scene": ps.Scene,
    "pose": ps.Pose,
    "request": lambda: ps.PlanRequest([0.0] * 6, [0.1] * 6),
    "error": lambda: ValueError("a value"),
}
"""Values that no argument, or hardly any, is meant to take."""

RARE = frozenset({"endless", "range", "nested"})
"""Asked one time in ten: to refuse them may take long."""

Call = tuple[Callable[..., Any], dict[str, Any]]


class _Stock:
    """Valid arguments, and what they are arguments of."""

    def __init__(self, folder: Path) -> None:
        self.service = service = ps.PlannerService("wxai", "bin")
        self.robot, self.scene, self.checker = service.robot, service.scene, service.checker
        q, goal = self.robot.home, np.array([0.8, 1.3, 1.0, -0.8, 0.0, 0.0])
        table = ps.PlannerService("wxai", "table")
        request = ps.PlanRequest(q, goal, time_limit=2.0)
        result = table.plan(request)
        path, motion = result.unwrap()
        certifier = ps.Certifier(self.robot, self.scene)
        box, pose, grip = ps.Box((0.1, 0.2, 0.3)), ps.Pose((0.25, 0.1, 0.2)), self.scene.obstacles[-1]
        pair = (("link_1", "tray"),)
        mesh = ps.Mesh(np.random.default_rng(0).normal(size=(12, 3)))
        field, cloud = ps.HeightField(np.ones((3, 3)) * 0.1, 0.1), ps.PointCloud(np.eye(3), 0.01)
        compound, point = ps.Compound(((box, pose),)), np.array([[1.0, 2.0, 3.0]])
        held = ps.Attached("held", ps.Box((0.02, 0.02, 0.02)), ps.Pose(), ("finger_left",))
        memory = table.path_memory()
        names, file = list(self.robot.joint_names), folder / "out"
        lower, upper = self.robot.limits.lower, self.robot.limits.upper
        each = {"velocity": np.ones(6), "acceleration": np.ones(6), "jerk": np.ones(6)}
        solids = (box, ps.Sphere(0.1), ps.Cylinder(0.1, 0.2), ps.Capsule(0.1, 0.2), mesh, field, cloud, compound)
        stretch: dict[str, Any] = {"s_start": 0.0, "s_end": 0.1, "pairs": pair, "reason": "because"}
        self.calls: dict[str, Call] = {
            "Box": (ps.Box, {"size": (0.1, 0.2, 0.3)}),
            "Sphere": (ps.Sphere, {"radius": 0.1}),
            "Cylinder": (ps.Cylinder, {"radius": 0.1, "length": 0.2}),
            "Capsule": (ps.Capsule, {"radius": 0.1, "length": 0.2}),
            "Mesh": (ps.Mesh, {"vertices": np.random.default_rng(0).normal(size=(12, 3))}),
            "Mesh.from_file": (ps.Mesh.from_file, {"path": file, "scale": (1.0, 1.0, 1.0)}),
            "HeightField": (ps.HeightField, {"heights": np.ones((3, 3)), "cell": 0.1, "floor": 0.0}),
            "HeightField.from_file": (ps.HeightField.from_file, {"path": file, "cell": 0.1, "floor": 0.0}),
            "PointCloud": (ps.PointCloud, {"points": np.eye(3), "resolution": 0.01}),
            "PointCloud.from_cells": (ps.PointCloud.from_cells, {"cells": [[1, 2, 3]], "resolution": 0.01}),
            "PointCloud.from_file": (ps.PointCloud.from_file, {"path": file, "resolution": 0.01}),
            "Compound": (ps.Compound, {"parts": ((box, pose), (box, ps.Pose()))}),
            "Compound.of_pieces": (ps.Compound.of_pieces, {"pieces": [box, mesh]}),
            "Compound.of_mesh": (ps.Compound.of_mesh, {"path": file, "scale": (1.0, 1.0, 1.0), "most": 2}),
            "Pose": (ps.Pose, {"position": (0.0, 0.1, 0.2), "quaternion": (1.0, 0.0, 0.0, 0.0)}),
            "Pose.from_rpy": (ps.Pose.from_rpy, {"position": (0.0, 0.1, 0.2), "rpy": (0.0, 0.1, 0.2)}),
            "Pose.from_matrix": (ps.Pose.from_matrix, {"matrix": np.eye(4)}),
            "PoseGoal": (
                ps.PoseGoal,
                {"pose": pose, "position_tolerance": 0.01, "orientation_tolerance": 0.1}
                | {"free_axis": (0.0, 0.0, 1.0), "candidates": 4},
            ),
            "Obstacle": (ps.Obstacle, {"name": "o", "shape": box, "pose": pose}),
            "Attached": (ps.Attached, {"name": "o", "shape": box, "pose": pose, "touch_links": ("link_6",)}),
            "Scene": (ps.Scene, {"obstacles": (grip,), "attached": (held,), "name": "n", "description": "d"}),
            "Scene.moved": (self.scene.moved, {"name": "tray", "pose": pose}),
            "Scene.obstacle": (self.scene.obstacle, {"name": "tray"}),
            "Scene.without": (self.scene.without, {"name": "tray"}),
            "Scene.without_attached": (ps.Scene((), (held,)).without_attached, {"name": "held"}),
            "Scene.with_obstacle": (self.scene.with_obstacle, {"obstacle": ps.Obstacle("new", box)}),
            "Scene.with_attached": (self.scene.with_attached, {"attached": held}),
            "load_scene": (ps.load_scene, {"name_or_path": "bin"}),
            "save_scene": (ps.save_scene, {"scene": self.scene, "path": file}),
            "load_robot": (ps.load_robot, {"name_or_path": "planar2"}),
            "Robot.from_urdf": (
                ps.Robot.from_urdf,
                {"path": file, "tool_frame": "t", "srdf": None, "package_dirs": (), "locked_joints": {}}
                | {"joints": None, "decompose": None},
            ),
            "Robot.pose": (self.robot.pose, {"name": "home"}),
            "Robot.locked": (self.robot.locked, {"joints": {"joint_5": 0.0}}),
            "Robot.with_gripper": (self.robot.with_gripper, {"width": 0.04}),
            "Robot.tool_pose": (self.robot.tool_pose, {"q": q}),
            "Robot.tool_rows": (self.robot.tool_rows, {"q": q}),
            "Robot.tool_jacobian": (self.robot.tool_jacobian, {"q": q}),
            "Robot.body_poses": (self.robot.body_poses, {"q": q}),
            "Robot.body_poses_batch": (self.robot.body_poses_batch, {"Q": [q, q], "portable": True}),
            "Robot.reach": (self.robot.reach, {"extra": ()}),
            "JointLimits": (ps.JointLimits, {"lower": lower, "upper": upper, **each}),
            "JointPath": (ps.JointPath, {"waypoints": np.array([q, goal, q]), "blends": [0.0, 0.1, 0.0]}),
            "JointPath()": (path, {"s": 0.1, "order": 1}),
            "JointPath.travel": (path.travel, {"s": [0.0, 0.1]}),
            "JointPath.turns_back": (path.turns_back, {"k": 0}),
            "JointPath.with_blends": (path.with_blends, {"blends": None}),
            "Trajectory": (
                ps.Trajectory,
                {"path": path, "durations": motion.durations, "coefficients": motion.coefficients}
                | {"dilation": 1.0, "part": None},
            ),
            "Trajectory()": (motion, {"t": 0.1, "order": 1}),
            "Trajectory.s": (motion.s, {"t": 0.1, "order": 1}),
            "Trajectory.moving": (motion.moving, {"t": 0.1}),
            "Trajectory.sample": (motion.sample, {"dt": 0.05}),
            "Trajectory.dilated": (motion.dilated, {"factor": 2.0}),
            "JointStep": (ps.JointStep, {"angle": 0.02}),
            "MotionStep": (ps.MotionStep, {"distance": 0.02}),
            "Pace": (
                ps.Pace,
                {"timing": ps.ToppRa(), "velocity_scale": 0.5, "acceleration_scale": 0.5, "max_tool_speed": 0.1},
            ),
            "Pace.of": (ps.Pace.of, {"request": request, "timing": None}),
            "Pace.limits": (ps.Pace(ps.ToppRa()).limits, {"robot": self.robot}),
            "ToppRa": (ps.ToppRa, {"gridpoints": 50}),
            "SCurve": (ps.SCurve, {"jerk": 10.0}),
            **{
                f"{law.name}.time_path": (law.time_path, {"path": path, "limits": self.robot.limits})
                for law in (ps.ToppRa(), ps.SCurve(), ps.Trapezoidal())
            },
            **{
                planner.__name__: (planner, {name: getattr(planner(), name) for name in planner.__annotations__})
                for planner in (ps.RRTConnect, ps.RRT, ps.PRM, ps.LazyPRM, ps.PRMstar, ps.BITstar, ps.FMT, ps.BFMT)
                if hasattr(planner, "__annotations__")
            },
            "TrajOpt": (ps.TrajOpt, {"iterations": 4}),
            "Chomp": (ps.Chomp, {"iterations": 4, "voxel": 0.02}),
            "Optimise": (
                ps.Optimise,
                {"waypoints": 20, "smoothness": 10.0, "clearance": 0.02, "corners": 4}
                | {"method": ps.TrajOpt(), "starts": 1},
            ),
            "Processes": (ps.Processes, {"workers": 1}),
            "Ray": (ps.Ray, {"address": None, "workers": 1}),
            "ExemptInterval": (ps.ExemptInterval, stretch),
            "AllowedStretch": (
                ps.AllowedStretch,
                {"first": 0, "last": 1, "pairs": pair, "reason": "because"},
            ),
            "Handling": (
                ps.Handling,
                {"support": "tray", "support_gap": 0.005, "open_width": 0.05, "request": request}
                | {"line_timing": ps.Trapezoidal(), "cancel": None},
            ),
            "PlanRequest": (
                ps.PlanRequest,
                {name: getattr(request, name) for name in ps.PlanRequest.__dataclass_fields__},
            ),
            "PlanRequest.goals": (request.goals, {"robot": self.robot}),
            "checker.state_is_free": (self.checker.state_is_free, {"q": q}),
            "checker.states_are_free": (self.checker.states_are_free, {"Q": [q, goal]}),
            "checker.edge_is_free": (self.checker.edge_is_free, {"q1": q, "q2": goal, "known": ps.Known.NEITHER}),
            "checker.edge_hit": (self.checker.edge_hit, {"q1": q, "q2": goal, "known": ps.Known.NEITHER}),
            "checker.edge_rest": (self.checker.edge_rest, {"q1": q, "q2": goal}),
            "checker.edge_seems_free": (self.checker.edge_seems_free, {"q1": q, "q2": goal}),
            "checker.segments": (self.checker.segments, {"q1": q, "q2": goal}),
            "checker.path_is_free": (self.checker.path_is_free, {"path": path}),
            "checker.blend_is_free": (self.checker.blend_is_free, {"path": path, "k": 0}),
            "checker.contacts": (self.checker.contacts, {"q": q}),
            "checker.clearance": (self.checker.clearance, {"q": q}),
            "checker.near": (self.checker.near, {"Q": [q], "within": 0.1}),
            "checker.pair_names": (self.checker.pair_names, {"pair": 0}),
            "checker.variant": (self.checker.variant, {"padding": 0.01, "allowed": pair, "motion_step": 0.05}),
            "checker.limited": (
                lambda **given: self.checker.limited(**given).__enter__(),
                {"states": None, "deadline": None, "token": None},
            ),
            "CollisionChecker": (
                ps.CollisionChecker,
                {"robot": self.robot, "scene": self.scene, "edge_step": ps.JointStep(), "padding": 0.0}
                | {"allowed": pair, "backend": "auto"},
            ),
            "Certifier": (
                ps.Certifier,
                {"robot": self.robot, "scene": self.scene, "allowed": pair, "backend": "auto"},
            ),
            "certifier.certify": (
                certifier.certify,
                {"path": path, "padding": 0.0, "exempt": (ps.ExemptInterval(**stretch),), "part": (0.0, 0.1)},
            ),
            "certifier.certify_edge": (certifier.certify_edge, {"q1": q, "q2": goal, "padding": 0.0}),
            "certifier.clearances": (certifier.clearances, {"Q": [q]}),
            "certifier.roots": (certifier.roots, {"length": 1.0, "exempt": ()}),
            "certify": (
                certify.certify,
                {"robot": self.robot, "scene": self.scene, "path": path, "allowed": (), "padding": 0.0, "exempt": ()},
            ),
            "PlannerService": (
                ps.PlannerService,
                {"robot": self.robot, "scene": self.scene, "edge_step": ps.JointStep(), "allowed": pair},
            ),
            "service.certify": (service.certify, {"path": path, "padding": 0.0, "exempt": (), "part": None}),
            "service.with_scene": (service.with_scene, {"scene": "empty"}),
            "service.changed": (service.changed, {"gripper": 0.04, "scene": self.scene}),
            "service.way_out": (service.way_out, {"q": q, "seed": 0}),
            "service.path_memory": (service.path_memory, {"padding": 0.001}),
            "service.update_roadmap": (table.update_roadmap, {"roadmap": memory}),
            "inverse_kinematics": (
                ps.inverse_kinematics,
                {"robot": self.robot, "pose": pose, "seed": 0, "seeds": (q,), "still": None},
            ),
            "straight_tool_line": (
                ps.straight_tool_line,
                {"robot": self.robot, "q_start": q, "to": [0.0, 0.0, 0.02], "points": 10},
            ),
            "top_grasps": (ps.top_grasps, {"robot": self.robot, "target": grip, "tilts": (0.0,)}),
            "Roadmap.judged": (
                Roadmap.judged,
                {"milestones": [q, goal], "free": [(0, 1)], "blocked": {}, "reach": None},
            ),
            "Roadmap.load": (Roadmap.load, {"path": file}),
            "Roadmap.save": (memory.save, {"path": file}),
            "save_plan": (plan_file.save_plan, {"plan": result, "path": file}),
            "load_plan": (plan_file.load_plan, {"path": file}),
            "load_task": (plan_file.load_task, {"path": file}),
            "load_plan_or_task": (plan_file.load_plan_or_task, {"path": file}),
            "joint_trajectory": (
                interchange.joint_trajectory,
                {"motion": motion, "joint_names": names, "dt": 0.05},
            ),
            "csv_text": (interchange.csv_text, {"motion": motion, "joint_names": names, "dt": 0.05}),
            "write_csv": (
                interchange.write_csv,
                {"motion": motion, "joint_names": names, "path": file, "dt": 0.05},
            ),
            "load_world": (interchange.load_world, {"name_or_path": file}),
            "read_moveit_scene": (interchange.read_moveit_scene, {"path": file}),
            "read_problems": (interchange.read_problems, {"path": file}),
            "read_urdf_scene": (interchange.read_urdf_scene, {"path": file}),
            "ArmLimits": (ArmLimits, {"lower": lower, "upper": upper, "velocity": np.ones(6)}),
            "Streaming": (Streaming, {name: getattr(Streaming(), name) for name in Streaming.__dataclass_fields__}),
            **{
                f"{type(solid).__name__}.{what}": (getattr(solid, what), {key: value})
                for solid in solids
                for what, key, value in (("distance", "points", point), ("support", "direction", point[0]))
            },
            **{f"{type(s).__name__}.grown": (s.grown, {"margin": 0.01}) for s in solids if hasattr(s, "grown")},
        }
        self.dear: dict[str, Call] = {
            "plan": (table.plan, {"request": request, "cancel": None, "trace": False}),
            "plan_many": (table.plan_many, {"requests": [request], "engine": ps.Sequential(), "progress": False}),
            "plan_stream": (
                lambda **given: list(itertools.islice(table.plan_stream(**given), 3)),
                {"requests": [request], "engine": None},
            ),
            "follow": (
                table.follow,
                {"waypoints": [q, goal], "contacts": (), "pace": None, "blends": None, "cancel": None},
            ),
            "replan": (
                table.replan,
                {"previous": result, "at_time": 0.2, "latency": 0.1, "scene": None, "goal": None, "request": None},
            ),
            "build_roadmap": (
                table.build_roadmap,
                {"planner": ps.LazyPRM(50, 5), "seed": 0, "padding": 0.001, "progress": False},
            ),
            "plan_seeds": (ps.plan_seeds, {"service": table, "request": request, "seeds": [0, 1]}),
            "best_of_seeds": (ps.best_of_seeds, {"service": table, "request": request, "seeds": [0, 1]}),
            "move_linear": (
                ps.move_linear,
                {"service": table, "start": q, "goal": [0.0, 0.0, 0.02], "points": 10, "pace": None, "cancel": None},
            ),
            "pick": (
                ps.pick,
                {"service": service, "q": q, "target": "blue_block", "grasps": (pose,), "handling": None},
            ),
            "place": (
                ps.place,
                {"service": service, "q": q, "carried": "blue_block", "poses": (pose,), "handling": None},
            ),
        }


DEAR = 0.02
"""Part of the calls that may plan."""


class Attack(Part):
    name = "api"
    what = "public callables with one or two arguments replaced, whole or in part, by hostile values"

    def __init__(self) -> None:
        super().__init__()
        self._made: _Stock | None = None

    @property
    def _stock(self) -> _Stock:
        if self._made is None:
            self._made = _Stock(Path(tempfile.mkdtemp()))
        return self._made

    def draw(self, rng: np.random.Generator) -> Case:
        table = self._stock.dear if rng.random() < DEAR else self._stock.calls
        name = str(rng.choice(list(table)))
        keys = list(table[name][1])
        hostile, rare = [key for key in HOSTILE if key not in RARE], sorted(RARE)
        swaps: list[list[Any]] = []
        for key in rng.permutation(keys)[: int(rng.choice((1, 1, 1, 2)))].tolist():
            value = str(rng.choice(rare if rng.random() < 0.005 else hostile))
            inside = table[name][1][key]
            deep = isinstance(inside, (tuple, list, np.ndarray)) and len(inside) and rng.random() < 0.4
            swaps.append([key, int(rng.integers(len(inside))) if deep else None, value])
        if rng.random() < 0.03:
            swaps = []
        return {"call": name, "swaps": swaps}

    def run(self, case: Case) -> None:
        name = case["call"]
        call, valid = {**self._stock.calls, **self._stock.dear}[name]
        given, buffers = dict(valid), []
        for key, value in valid.items():  # copies of the caller's own, which change afterwards
            if isinstance(value, np.ndarray):
                given[key] = value.copy()
                buffers.append(given[key])
        for key, at, label in case["swaps"]:
            value = HOSTILE[label]()
            if at is not None:
                inside = list(valid[key])
                inside[at] = value
                value = tuple(inside) if isinstance(valid[key], tuple) else inside
            given[key] = value
        try:
            answer = call(**given)
        except _OwnError:
            return
        self.counted["answered although hostile"] += bool(case["swaps"])
        _require_kept(name, answer, buffers)
        _require_sane(name, answer)


def _require_kept(name: str, answer: Any, buffers: list[Any]) -> None:
    """What was made of the caller's arrays does not change when these do."""
    if not buffers or not hasattr(answer, "__dataclass_fields__"):
        return
    try:
        before = pickle.dumps(answer)
    except (AttributeError, TypeError, pickle.PicklingError):  # an object of the caller's
        return
    for buffer in buffers:
        buffer[...] = 12345.0
    if pickle.dumps(answer) != before:
        raise Wrong(f"{name} copies what it is given")


def _require_sane(name: str, answer: Any) -> None:
    """No NaN comes out, and a plan is proven."""
    if name.endswith((".distance", ".support")):  # of what is no number
        return
    if isinstance(answer, (float, np.floating, np.ndarray)):
        array = np.asarray(answer)
        if array.dtype.kind == "f" and np.isnan(array).any():
            raise Wrong(f"{name} answers no NaN")
    elif isinstance(answer, ps.PlanResult) and answer.path is not None:
        if answer.certificate is None or not answer.certificate.certified:
            raise Wrong(f"{name}: a plan is proven")
    elif isinstance(answer, (list, tuple)):
        for part in answer:
            if isinstance(part, ps.PlanResult):
                _require_sane(name, part)
