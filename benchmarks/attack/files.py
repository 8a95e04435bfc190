"""Files of every kind, mutated: refused with their problems, or read as something that holds."""

from __future__ import annotations

import base64
import io
import json
import math
import os
import tempfile
import zlib
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.attack.harness import Case, Part, Wrong, packed, unpacked
from benchmarks.attack.mutations import changed
from benchmarks.attack.words import TABLES, draw_word, require_told
from benchmarks.attack.worlds import draw_robot, draw_scene, scene_of, written
from planner_service.cell import Arm, Cell, CellPlan
from planner_service.constraints import load_constraints
from planner_service.files.disk_cache import DiskCache
from planner_service.files.package_data import data_folder
from planner_service.gate import ActionGate, Tracking
from planner_service.gate.log_reader import read_log
from planner_service.geometry.arrays import FloatArray
from planner_service.grasping import GraspKind, GraspKinds
from planner_service.memory import Memory
from planner_service.records import plan_file, read_problems
from planner_service.records.cells import SavedCellPlan, load_cell_plan, prove_cell, read_cell_request, save_cell_plan
from planner_service.records.request import RequestRecord
from planner_service.records.visits import load_visits, save_visits
from planner_service.scene import read_moveit_scene, read_urdf_scene
from planner_service.tasks import Alternatives, MoveTo, Repeat, Task, Wait, pick_steps, plan_pick_place
from planner_service.tasks.ordering import Branch, Visit
from planner_service.workspace import ToolOrientation, VoxelGrid, load_map, reachability, save_map

__all__ = ["Attack", "crossing_arms"]

TAKEN = "blue_block"

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

KEY = "0" * 64

AMONG_CELLS = "plan among cells"
"""A kind of file: a plan with evidence in a scene with a cloud."""


CELL, CELL_REQUEST = "plan of a cell", "request of a cell"

ASKED = """scene = "discs"
delay = 0.1

[[arm]]
name = "left"
robot = "planar2"
start = [0.0, 0.1]
goal = { position = [1.0, 1.0, 0.0], quaternion_wxyz = [1.0, 0.0, 0.0, 0.0] }
velocity_scale = 0.2

[[arm]]
name = "right"
robot = "planar2"
position = [2.2, 0.0, 0.0]
stands = "folded"
"""


def crossing_arms() -> CellPlan:
    """Two planar arms, of which one waits until the other has left."""
    robot = ps.load_robot("planar2")
    cell = Cell({"left": robot, "right": Arm(robot, ps.Pose((2.2, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))}, ps.Scene())
    leaves = ps.PlanRequest([0.0, 0.1], [1.5, 0.1], velocity_scale=0.2)
    return cell.plan({"left": leaves, "right": ps.PlanRequest([0.6, 0.1], [-0.6, 0.1])}, delay=0.1)


def _stored(save: Callable[..., None], *arrays: FloatArray, **named: FloatArray) -> bytes:
    file = io.BytesIO()
    save(file, *arrays, **named)
    return file.getvalue()


SAMPLES = Path(__file__).parent / "samples"
WRITTEN = {
    "dae": "mesh.dae",
    "world": "world.urdf",
    "moveit": "world.scene",
    "srdf": "drawn.srdf",
    "mjcf": "drawn.xml",
    "constraints": "constraints.toml",
    "ply": "mesh.ply",
    "obj": "mesh.obj",
    "stl": "mesh.stl",
    "stl text": "mesh_text.stl",
    "glb": "mesh.glb",
    "sdf": "world.sdf",
    "pcd": "scan.pcd",
    "packed pcd": "packed.pcd",
    "xyz": "scan.xyz",
    "bt": "map.bt",
    "ot": "map.ot",
}
"""Files that are stored."""


class _Stock:
    """A file of each kind, and how it is read."""

    def __init__(self, folder: Path) -> None:
        rng = np.random.default_rng(7)
        self.folder, self.contents, self.trees = folder, dict[str, bytes](), dict[str, Any]()
        self.service = service = ps.PlannerService("wxai", "bin")
        home = service.robot.home
        goal = ps.Pose((0.20, 0.28, 0.15), (0.5**0.5, 0.0, 0.5**0.5, 0.0))
        request = ps.PlanRequest(home, goal, seed=7, time_limit=None)
        self.result = service.plan(request)
        self.task = plan_pick_place(service, TAKEN, "tray", request)
        wall = ps.PointCloud(np.stack([0.0 * rng.random(300), *rng.uniform(-0.2, 0.2, (2, 300))], axis=1), 0.03)
        among = ps.PlannerService("wxai", ps.Scene((ps.Obstacle("wall", wall, ps.Pose((-0.3, 0.0, 0.3))),)))
        cells = among.plan(ps.PlanRequest(home, home + 0.2, time_limit=None, evidence=True))
        for kind, made in (("plan", self.result), ("task", self.task), (AMONG_CELLS, cells)):
            made.save(folder / f"{kind}.json")
            self._tree(kind, (folder / f"{kind}.json").read_bytes())
        save_cell_plan(crossing_arms(), folder / f"{CELL}.json")
        self._tree(CELL, (folder / f"{CELL}.json").read_bytes())
        self.contents[CELL_REQUEST] = ASKED.encode()
        memory = ps.PlannerService("wxai", "table").path_memory()
        memory.save(folder / "memory.npz")
        self.contents["roadmap"] = (folder / "memory.npz").read_bytes()
        grid = VoxelGrid((0.1, 0.1, -0.1), (0.3, 0.3, 0.1), (2, 2, 1))
        found = reachability(ps.load_robot("planar2"), ps.Scene(), grid, [ToolOrientation(tolerance=math.pi)])
        save_map(found, folder / "map.npz")
        self.contents["map"] = (folder / "map.npz").read_bytes()
        kinds = GraspKinds([GraspKind.SIDE], friction=0.4)
        Task((*pick_steps(TAKEN, kinds), Repeat([Alternatives([MoveTo("home"), Wait(1.0)])], 2))).save(
            folder / "steps.json"
        )
        self._tree("steps", (folder / "steps.json").read_bytes())
        ways: list[Branch | ps.Pose] = [Branch(home), ps.Pose((0.3, 0.0, 0.2))]
        save_visits(
            [Visit("one", ways, Visit("two", [home])), Visit("three", ways, after=["one"])], folder / "visits.json"
        )
        self._tree("visits", (folder / "visits.json").read_bytes())
        gate = ActionGate(service, rate=30, tracking=Tracking(0.1, 0.005), log=folder / "gate.jsonl")
        for k in range(4):
            gate.check(home, home + 0.3 * k, sent=0 if k else None)
        self.contents["gate log"] = (folder / "gate.jsonl").read_bytes()
        self.result.memory.save(folder / "memory.json")
        self._tree("memory", (folder / "memory.json").read_bytes())
        points = rng.normal(size=(8, 3)) * 0.1
        self.contents |= {kind: SAMPLES.joinpath(name).read_bytes() for kind, name in WRITTEN.items()}
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

    def readers(self) -> dict[str, tuple[str, Callable[[Path], Any]]]:
        """By kind: a file's name, and what reads it."""
        urdf, cache = self.folder / "drawn.urdf", DiskCache(self.folder / "cache")
        planar = ps.load_robot("planar2")
        out: dict[str, tuple[str, Callable[[Path], Any]]] = {
            "plan": ("f.json", plan_file.load_plan_or_task),
            "task": ("f.json", plan_file.load_plan_or_task),
            AMONG_CELLS: ("f.json", plan_file.load_plan_or_task),
            CELL: ("f.json", _proven_cell),
            CELL_REQUEST: ("f.toml", read_cell_request),
            "steps": ("f.json", Task.load),
            "visits": ("f.json", load_visits),
            "gate log": ("f.jsonl", lambda path: read_log(path, 6)),
            "roadmap": ("f.npz", ps.Roadmap.load),
            "map": ("f.npz", lambda path: load_map(path, planar, ps.Scene())),
            "memory": ("f.json", Memory.load),
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
        for kind in ("ply", "obj", "stl", "stl text", "dae", "glb"):
            out[kind] = (f"f.{kind.split()[0]}", ps.Mesh.from_file)
        for kind in ("sdf", "pcd", "packed pcd", "xyz", "bt", "ot"):
            out[kind] = (f"f.{kind.split()[-1]}", ps.load_scene)
        return out


def _proven_cell(path: Path) -> SavedCellPlan:
    """The plan of a cell, proven again if it is one."""
    saved = load_cell_plan(path)
    if saved.failure is None:
        prove_cell(saved)
    return saved


WEIGHTS = {"plan": 0.5, "task": 0.15, "roadmap": 0.7, "urdf": 0.5, "srdf": 0.3, "robot": 0.7, "mjcf": 0.01, CELL: 0.5}
"""How often kinds that take more time are drawn; the others 1."""

TEXTS = frozenset(
    {
        "plan",
        "task",
        CELL,
        CELL_REQUEST,
        "steps",
        "visits",
        "gate log",
        "obj",
        "stl text",
        "dae",
        "scene",
        "robot",
        "world",
        "sdf",
        "xyz",
        "moveit",
        "constraints",
        *TABLES,
    }
)


class Attack(Part):
    name = "files"
    what = "files of 35 kinds, bytes, words, lines and structure mutated"

    @cached_property
    def _stock(self) -> _Stock:
        return _Stock(Path(tempfile.mkdtemp()))

    def draw(self, rng: np.random.Generator) -> Case:
        kinds = list(self._stock.contents)
        weights = np.array([WEIGHTS.get(kind, 1.0) for kind in kinds])
        if rng.random() < WORDS:
            kind = "mjcf" if rng.random() < WEIGHTS["mjcf"] else str(rng.choice(("urdf", "srdf")))
            return draw_word(kind, self._stock.contents[kind].decode(), rng)
        kind = str(rng.choice(kinds, p=weights / weights.sum()))
        if rng.random() < 0.01:
            return {"kind": kind, "place": str(rng.choice(list(PLACES)))}
        if kind == AMONG_CELLS and rng.random() < 0.5:
            return {"kind": kind, "data": packed(_repacked(self._stock.trees[kind], rng))}
        text = kind in TEXTS or kind in self._stock.trees or kind in ("ply", "results")
        data = changed(self._stock.contents[kind], rng, self._stock.trees.get(kind), text=text)
        return {"kind": kind, "data": packed(data)}

    def run(self, case: Case) -> None:
        stock = self._stock
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


def _repacked(tree: Any, rng: np.random.Generator) -> bytes:
    """The plan with the cells of its cloud changed, left out, made many, or cut off after they were packed."""
    document = json.loads(json.dumps(tree))
    (solid,) = (each["shape"] for each in document["scene"]["obstacles"])
    steps = bytearray(zlib.decompress(base64.b64decode(solid["packed"])))
    way = int(rng.integers(5))
    if way == 0:
        steps[int(rng.integers(len(steps)))] ^= 1 << int(rng.integers(8))
    elif way == 1:
        del steps[: int(rng.choice((4, 12, 13, len(steps))))]
    elif way == 2:
        steps *= int(rng.choice((2, 40, 5_000)))
    data = zlib.compress(bytes(steps))
    if way == 3:
        data = data[: int(rng.integers(len(data)))]
    if way == 4:
        data += bytes(int(rng.integers(1, 9)))
    solid["packed"] = base64.b64encode(data).decode()
    return json.dumps(document).encode()


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    else:
        path.unlink(missing_ok=True)
