"""Files of every kind, mutated and forged: refused with their problems, or read as something that holds."""

from __future__ import annotations

import contextlib
import io
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import planner_service as ps
from benchmarks.attack.harness import Case, Part, Wrong, packed, unpacked
from benchmarks.attack.mutations import changed
from benchmarks.attack.words import MJCF_TEXT, TABLES, draw_word, require_told
from benchmarks.attack.worlds import draw_robot, draw_scene, scene_of, written
from planner_service.certify import ExemptInterval
from planner_service.constraints import load_constraints
from planner_service.errors import PlannerServiceError
from planner_service.execute import Streaming, execute
from planner_service.files.disk_cache import DiskCache
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.records import plan_file
from planner_service.records.problem_set import read_problems
from planner_service.records.request import RequestRecord
from planner_service.roadmap import Roadmap
from planner_service.scene.moveit_scene import read_moveit_scene
from planner_service.scene.urdf_scene import read_urdf_scene
from planner_service.tasks.pick_place import plan_pick_place

__all__ = ["Attack"]

TAKEN = "blue_block"

PROVEN = 0.004
"""Part of the inputs that are forged plans, each driven by an arm that only writes down what it is told."""

WORDS = 0.05
"""Part of the inputs that are robot files with one word more."""

PLACES: dict[str, Callable[[Path], object]] = {
    "folder": Path.mkdir,
    "fifo": os.mkfifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "link to itself": lambda path: path.symlink_to(path),
    "link": lambda path: path.symlink_to(path.with_name("scene.toml")),
    "nothing": lambda path: None,
    "not ours to read": lambda path: path.symlink_to("/proc/1/mem"),
}
"""What may be where a file was, and how it is put there."""

STEP = 4
"""Every so many commands are judged by Coal."""

DEEP = 1e-5
"""Metres of overlap beyond which a command is a collision: Coal's own error is less."""

BEYOND = 1.05
"""Of a limit that commands may reach between the stretches that were checked."""

KEY = "0" * 64


def _ply(points: FloatArray) -> bytes:
    faces = [f"3 {k} {k + 1} {k + 2}" for k in range(len(points) - 2)]
    head = ["ply", "format ascii 1.0", f"element vertex {len(points)}", *(f"property float {axis}" for axis in "xyz")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    return "\n".join([*head, *(" ".join(map(repr, p)) for p in points.tolist()), *faces, ""]).encode()


def _obj(points: FloatArray) -> bytes:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    return "\n".join(lines + [f"f {k} {k + 1} {k + 2}" for k in range(1, len(points) - 1)]).encode()


def _stl(points: FloatArray) -> bytes:
    facets = [points[[k, k + 1, k + 2]] for k in range(len(points) - 2)]
    out = b"\0" * 80 + np.uint32(len(facets)).tobytes()
    return out + b"".join(b"\0" * 12 + facet.astype("<f4").tobytes() + b"\0\0" for facet in facets)


def _stl_text(points: FloatArray) -> bytes:
    lines = ["solid s"]
    for k in range(len(points) - 2):
        corners = [f"vertex {x!r} {y!r} {z!r}" for x, y, z in points[k : k + 3].tolist()]
        lines += ["facet normal 0 0 1", "outer loop", *corners, "endloop", "endfacet"]
    return "\n".join([*lines, "endsolid s"]).encode()


def _stored(save: Callable[..., None], *arrays: FloatArray, **named: FloatArray) -> bytes:
    file = io.BytesIO()
    save(file, *arrays, **named)
    return file.getvalue()


DAE = """<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array><technique_common>
<accessor source="#a" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source><vertices id="v">
<input semantic="POSITION" source="#p"/></vertices><triangles count="4">
<input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2 0 1 3 0 2 3 1 2 3</p></triangles></mesh></geometry>
</library_geometries><library_visual_scenes>
<visual_scene id="s"><node id="n"><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""

WORLD = """<robot name="w"><link name="world"/><link name="t"><collision><geometry><box size="1 1 .1"/>
</geometry></collision></link><joint name="f" type="fixed"><parent link="world"/><child link="t"/><origin xyz="0 0 -.1"
rpy="0 0 1"/></joint></robot>"""

MOVEIT = """(noname)+
* table; 0.5 0 0.1; 0 0 0 1; 2
box; 0.4 0.6 0.2; 0 0 0; 0 0 0 1; 0 0 0 0
mesh; 4 4; 0 0 0; 1 0 0; 0 1 0; 0 0 1; 0 1 2; 0 1 3; 0 2 3; 1 2 3; 0 0 0; 0 0 0 1; 0 0 0 0
1; corner; 0.2 0.3 0.1; 0 0 0 1
* ball; 0.1 0.2 0.3; 0 0 0 1; 1
sphere; 0.2; 0 0 0; 0 0 0 1; 0 0 0 0
0
.
""".replace("; ", "\n")

CONSTRAINTS = """[[constraint]]
kind = "tool region"
name = "above the board"
frame = { position = [0.3, 0.0, 0.2], quaternion_wxyz = [1.0, 0.0, 0.0, 0.0] }
lower = [-inf, -inf, 0.05]
upper = [inf, 0.5, 0.15]
tilt = 0.1
turn = 0.2
tool = { position = [0.05, 0.0, 0.0] }
link = "link_6"
relative_to = "link_2"
[[constraint]]
kind = "joint range"
joint = "joint_4"
lower = -1.0
upper = 1.0
"""

SRDF = """<robot name="drawn"><group name="arm"><chain base_link="l0" tip_link="l1"/></group>
<group_state name="up" group="arm"><joint name="j1" value="0.01"/></group_state>
<disable_collisions link1="l0" link2="l1" reason="Adjacent"/></robot>"""


class _Stock:
    """A file of each kind, how it is read, and what has to be true of what was read."""

    def __init__(self, folder: Path) -> None:
        rng = np.random.default_rng(7)
        self.folder, self.contents, self.trees = folder, dict[str, bytes](), dict[str, Any]()
        self.service = service = ps.PlannerService("wxai", "bin")
        home = service.robot.home
        goal = ps.Pose((0.20, 0.28, 0.15), (0.5**0.5, 0.0, 0.5**0.5, 0.0))
        request = ps.PlanRequest(home, goal, seed=7, time_limit=None)
        self.result = service.plan(request)
        self.task = plan_pick_place(service, TAKEN, "tray", request)
        for kind, made in (("plan", self.result), ("task", self.task)):
            made.save(folder / f"{kind}.json")
            self._tree(kind, (folder / f"{kind}.json").read_bytes())
        memory = ps.PlannerService("wxai", "table").path_memory()
        memory.save(folder / "memory.npz")
        self.contents["roadmap"] = (folder / "memory.npz").read_bytes()
        points = rng.normal(size=(8, 3)) * 0.1
        self.contents |= {"ply": _ply(points), "obj": _obj(points), "stl": _stl(points), "stl text": _stl_text(points)}
        texts = {"dae": DAE, "world": WORLD, "moveit": MOVEIT, "srdf": SRDF, "mjcf": MJCF_TEXT}
        texts["constraints"] = CONSTRAINTS
        for kind, text in texts.items():
            self.contents[kind] = text.encode()
        self.contents["npy"] = _stored(np.save, points)
        self.contents["heights"] = _stored(np.save, np.abs(points[:3]))
        self.contents["npz"] = _stored(np.savez_compressed, points=points)
        ps.save_scene(scene_of(draw_scene(rng, 0.5, 6)), folder / "scene.toml")
        self.contents["scene"] = (folder / "scene.toml").read_bytes()
        drawn = draw_robot(np.random.default_rng(3))
        while "links" not in drawn or drawn["joints"][0]["kind"] == "fixed":
            drawn = draw_robot(rng)
        self.contents["urdf"] = written(drawn, folder).read_bytes()
        self.contents["robot"] = (data_folder("robots") / "planar2" / "robot.toml").read_bytes()
        for beside in (data_folder("robots") / "planar2").iterdir():
            if beside.is_file() and beside.name != "robot.toml":
                (folder / beside.name).write_bytes(beside.read_bytes())
        problem = {"id": "a", "start": [0.0] * 6, "goals": [[0.1] * 6], "obstacles": []}
        problem["obstacles"] = [{"name": "o", "type": "box", "size": [0.1, 0.1, 0.1], "position": [0, 0, 1.0]}]
        problems = {"robot": "r", "joints": [f"j{k}" for k in range(6)], "problems": [problem]}
        self._tree("problems", json.dumps(problems).encode())
        cache = DiskCache(folder / "cache")
        cache.put(KEY, points.tobytes())
        self.contents["cache"] = (folder / "cache" / f"{KEY}.bin").read_bytes()

    def _tree(self, kind: str, content: bytes) -> None:
        self.contents[kind], self.trees[kind] = content, json.loads(content)

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Every link with every obstacle."""
        links = dict.fromkeys(shape.link for shape in self.service.robot.shapes)
        return tuple((link, obstacle.name) for link in links for obstacle in self.service.scene.obstacles)

    def readers(self) -> dict[str, tuple[str, Callable[[Path], Any]]]:
        """By kind: a file's name, and what reads it."""
        urdf, cache = self.folder / "drawn.urdf", DiskCache(self.folder / "cache")
        out: dict[str, tuple[str, Callable[[Path], Any]]] = {
            "plan": ("f.json", plan_file.load_plan_or_task),
            "task": ("f.json", plan_file.load_plan_or_task),
            "roadmap": ("f.npz", Roadmap.load),
            "npy": ("f.npy", lambda path: ps.PointCloud.from_file(path, 0.01)),
            "npz": ("f.npz", lambda path: ps.PointCloud.from_file(path, 0.01)),
            "heights": ("f.npy", lambda path: ps.HeightField.from_file(path, 0.1)),
            "scene": ("f.toml", ps.load_scene),
            "urdf": ("f.urdf", ps.Robot.from_urdf),
            "robot": ("f.toml", ps.load_robot),
            "srdf": ("f.srdf", lambda path: ps.Robot.from_urdf(urdf, srdf=path)),
            "mjcf": ("f.xml", ps.Robot.from_urdf),
            "world": ("f.urdf", read_urdf_scene),
            "moveit": ("f.scene", read_moveit_scene),
            "problems": ("f.json", read_problems),
            "cache": (f"cache/{KEY}.bin", lambda path: cache.get(KEY)),
            "constraints": ("f.toml", load_constraints),
        }
        for kind in ("ply", "obj", "stl", "stl text", "dae"):
            out[kind] = (f"f.{kind.split()[0]}", ps.Mesh.from_file)
        return out


WEIGHTS = {"plan": 0.5, "task": 0.15, "roadmap": 0.7, "urdf": 0.5, "srdf": 0.3, "robot": 0.7, "mjcf": 0.01}
"""How often kinds that take more time are drawn; the others 1."""

TEXTS = frozenset(
    {"plan", "task", "obj", "stl text", "dae", "scene", "robot", "world", "moveit", "constraints", *TABLES}
)


class Attack(Part):
    name = "files"
    what = "files of 21 kinds, bytes, words, lines and structure mutated; forged plans driven by an arm that records"
    lists = ("data",)

    def __init__(self) -> None:
        super().__init__()
        self._judges: dict[str, Any] = {}

    @cached_property
    def _stock(self) -> _Stock:
        return _Stock(Path(tempfile.mkdtemp()))

    def draw(self, rng: np.random.Generator) -> Case:
        if rng.random() < PROVEN:
            return {"forged": (_forged if rng.random() < 0.5 else _forged_task)(self._stock, rng)}
        kinds = list(self._stock.contents)
        weights = np.array([WEIGHTS.get(kind, 1.0) for kind in kinds])
        if rng.random() < WORDS:
            kind = "mjcf" if rng.random() < WEIGHTS["mjcf"] else str(rng.choice(("urdf", "srdf")))
            return draw_word(kind, self._stock.contents[kind].decode(), rng)
        kind = str(rng.choice(kinds, p=weights / weights.sum()))
        if rng.random() < 0.01:
            return {"kind": kind, "place": str(rng.choice(list(PLACES)))}
        text = kind in TEXTS or kind in self._stock.trees or kind in ("ply", "results")
        data = changed(self._stock.contents[kind], rng, self._stock.trees.get(kind), text=text)
        return {"kind": kind, "data": packed(data)}

    def run(self, case: Case) -> None:
        stock = self._stock
        if "forged" in case:
            self._driven(case["forged"])
            return
        if "words" in case:
            name, read = stock.readers()[case["words"]]
            text = stock.contents[case["words"]].decode()
            self.counted[f"words {require_told(case, text, stock.folder / name, read)}"] += 1
            return
        name, read = stock.readers()[case["kind"]]
        path = stock.folder / name
        path.unlink(missing_ok=True)
        if "place" in case:
            PLACES[case["place"]](path)
        else:
            path.write_bytes(unpacked(case["data"]))
        try:
            found = read(path)
        finally:
            _remove(path)
        self.counted[f"{case['kind']} read"] += found is not None
        if case["kind"] == "cache" and found is not None and found + b"" != stock.contents["cache"][32:]:
            raise Wrong("a cache gives what was put there, or nothing")
        if case["kind"] == "constraints" and found is not None:
            home = stock.service.robot.home
            record = RequestRecord.find(ps.PlanRequest(home, home, constraints=found))
            if record is None or RequestRecord.model_validate(record.document()).value.constraints != found:
                raise Wrong("constraints are saved and loaded as they were")
        if isinstance(found, ps.Robot) and not np.isfinite(found.tool_pose(found.home)).all():
            raise Wrong("a robot that was read has a finite tool pose")
        if isinstance(found, ps.Mesh) and not np.isfinite(found.vertices).all():
            raise Wrong("a mesh that was read is finite")
        if isinstance(found, ps.Scene):
            ps.save_scene(found, stock.folder / "again.toml")
            if ps.load_scene(stock.folder / "again.toml") != found:
                raise Wrong("a scene is saved and loaded as it was")

    def _driven(self, tree: Any) -> None:
        """Whatever a forged file says: what the arm is told collides with nothing and is within its limits."""
        from tests.support.arms import FakeArm, FakeTime

        stock = self._stock
        path = stock.folder / "forged.json"
        path.write_text(json.dumps(tree))
        plan = plan_file.load_plan_or_task(path)
        taken = TAKEN if isinstance(plan, plan_file.SavedTask) else ""
        motion = (plan.segments[0].result if isinstance(plan, plan_file.SavedTask) else plan.result).trajectory
        if motion is None:
            return
        arm = FakeArm(motion(0.0), stone=0.045 if taken else 0.0)
        self.counted["forged plans"] += 1
        with patch("planner_service.execute.stream.time", FakeTime()), contextlib.suppress(PlannerServiceError):
            execute(plan, arm, stock.service.robot, Streaming(speed=1.0, settle=0.2))
        if not arm.told:
            return
        self.counted["forged plans driven"] += 1
        judge = self._judge_of(taken)
        limits = stock.service.robot.limits
        for k, (q, qd, qdd) in enumerate(arm.told):
            if k % STEP == 0 and not judge.free(q):
                deep = -min(judge.gaps(q).values())
                if deep > DEEP:
                    raise Wrong("a forged file drives the arm into nothing", f"{deep:.4g} m deep at {q.tolist()}")
            for what, value, most in (("velocity", qd, limits.velocity), ("acceleration", qdd, limits.acceleration)):
                part = float((np.abs(value) / most).max())
                if part > BEYOND:
                    raise Wrong(f"a forged file keeps the {what} limits", f"{part:.3g} of the limit")

    def _judge_of(self, taken: str) -> Any:
        """Judges the arm among what stands still all the time; with what is taken, between fingers as far apart."""
        from auditor.checker import IndependentChecker, tables_of

        if taken not in self._judges:
            scene, folder = self._stock.service.scene, data_folder("robots") / "wxai"
            tables = tables_of(scene.without(taken) if taken else scene)
            self._judges[taken] = IndependentChecker(folder, tables, gripper_width=0.045 if taken else None)
        return self._judges[taken]


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    else:
        path.unlink(missing_ok=True)


def _forged(stock: _Stock, rng: np.random.Generator) -> Any:
    """A valid plan file with another path, time law, exemptions or part of what is proven."""
    tree = json.loads(stock.contents["plan"])
    result = tree["result"]
    path, old = stock.result.unwrap()
    how = str(rng.choice(("straight", "noise", "fast", "exempt", "part", "padding")))
    curve, motion = path, old
    if how in ("straight", "exempt", "part") or rng.random() < 0.3:
        curve = ps.JointPath(path.waypoints[[0, -1]])
    elif how == "noise":
        points = path.waypoints + rng.normal(size=path.waypoints.shape) * float(10.0 ** rng.uniform(-3, -0.3))
        points[0], limits = path.waypoints[0], stock.service.robot.limits
        curve = ps.JointPath(np.clip(points, limits.lower, limits.upper))
    if curve is not path:
        motion = ps.Trapezoidal().time_path(curve, stock.service.robot.limits)
    durations, coefficients = motion.durations.copy(), motion.coefficients.copy()
    if how == "fast":
        factor = float(rng.uniform(0.3, 0.99))
        durations *= factor
        coefficients /= factor ** np.arange(4)
    result["path"] |= {"length": curve.length, "waypoints": curve.waypoints.tolist(), "blends": curve.blends.tolist()}
    law = {"durations": durations.tolist(), "coefficients": coefficients.tolist(), "duration": float(durations.sum())}
    result["trajectory"] |= law
    proof = result["certificate"]
    if how == "exempt":
        reason = str(rng.choice(("grasp", "start", "goal", "support")))
        proof["exempt"] = [{"s_start": 0.0, "s_end": curve.length, "pairs": stock.pairs, "reason": reason}]
    elif how == "part":
        proof["part"] = [0.0, float(rng.uniform(0.0, 0.2)) * curve.length]
    elif how == "padding":
        proof["padding"], proof["clearance"] = float(rng.uniform(0.0, 0.1)), 1.0
    return tree


def _forged_task(stock: _Stock, rng: np.random.Generator) -> Any:
    """A valid task file with a motion or a gripper that does other than what was proven."""
    task, limits = stock.task, stock.service.robot.limits
    parts = list(task.segments)
    k = int(rng.integers(len(parts)))
    how = str(rng.choice(("width", "widths", "left out", "twice", "straight", "fast", "exempt", "world")))
    path, motion = parts[k].result.unwrap()
    proof = parts[k].result.certificate
    if how == "width":
        parts[k] = replace(parts[k], width=float(rng.uniform(0.0, 0.08)))
    elif how == "widths":
        parts = [replace(part, width=parts[k].width) for part in parts]
    elif how == "left out":
        del parts[k]
    elif how == "twice":
        parts.insert(k, parts[k])
    elif how == "world":
        parts[k] = replace(parts[k], result=replace(parts[k].result, origin=None), scene=stock.service.scene)
    elif how == "fast":
        parts[k] = replace(parts[k], result=replace(parts[k].result, trajectory=motion.dilated(rng.uniform(0.3, 0.99))))
    else:
        curve = ps.JointPath(path.waypoints[[0, -1]])
        if how == "exempt" and proof is not None:
            proof = replace(proof, exempt=(ExemptInterval(0.0, curve.length, stock.pairs, "grasp"),))
        law = ps.Trapezoidal().time_path(curve, limits)
        parts[k] = replace(parts[k], result=replace(parts[k].result, path=curve, trajectory=law, certificate=proof))
    return plan_file.SavedTask.of(replace(task, segments=tuple(parts))).document()
