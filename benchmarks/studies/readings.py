"""What Pinocchio, MuJoCo and yourdfpy read in robot files of others, next to what we read: frames, limits and shapes.

Each file is read in a process of its own. A difference is either explained, by what the file says and a reader does not
read, or it is a fault of somebody. What ``robot check`` says of the file is listed beside.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import numpy as np
from rich.table import Table

from benchmarks.harness.fresh_process import told_by
from benchmarks.harness.report import Promise, Report, Row, table, table_of
from benchmarks.worlds.foreign import READINGS, ForeignRobot
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray

__all__ = ["run"]

CONFIGURATIONS = 50
SAME = 1e-6
"""Metres, and entries of rotations: files write poses with a few digits, and readers keep them as doubles."""
SAME_FLAT = 1e-5
"""The same of an MJCF file that MuJoCo wrote in one piece, with six digits, as Pinocchio cannot follow an include."""
SAME_LIMIT = 1e-9
SAME_SIZE = 1e-4
"""Metres between the boxes around a mesh, of which readers keep single or double precision."""
SECONDS = 300.0
ENDLESS = 1e10
"""Radians from which on a limit means that there is none."""
READERS = ("Pinocchio", "MuJoCo", "yourdfpy")

Frames = Callable[[Mapping[str, float]], Mapping[str, FloatArray]]
"""The pose of each link (4, 4) in the root's frame, with movable joints at these positions."""


def run(
    configurations: int = CONFIGURATIONS, seed: int = 0, robot: str | None = None, *, listed: bool = True
) -> Report:
    """Read the robot files of others, or those of the robot of that name.

    Args:
        listed: Whether to list what explains differences, and what is not understood.
    """
    rows = tuple(_row(one, configurations, seed) for one in READINGS if robot in (None, one.name))
    return Report("robots", rows, tuple(_tables(rows, listed=listed)), tuple(_promises(rows)))


def _row(one: ForeignRobot, configurations: int, seed: int) -> Row:
    row: Row = {"robot": one.name, "source": f"{one.distribution}, {one.file}"}
    try:
        source = one.source()
    except InvalidRequest as error:
        return row | {"missing": str(error).splitlines()[0]}
    return row | told_by("benchmarks.studies.readings", source, configurations, seed, seconds=SECONDS)


def _tables(rows: Sequence[Row], *, listed: bool) -> Iterator[Table]:
    cells = [
        {
            "robot": row["robot"],
            "joints": row["joints"],
            "links": row["links"],
            "shapes": row["shapes"],
            **{reader: row["readers"].get(reader, "-") for reader in READERS},
            "explained": len(row["explained"]),
            "unexplained": len(row["unexplained"]),
            "not understood": len(row["told"]),
            "refused": len(row["refused"]),
        }
        for row in rows
        if "readers" in row
    ]
    caption = (
        "The largest difference of a link's pose from each reader's, in random configurations (m, and entries of "
        "rotations); differences of poses, limits and shapes that the file explains, and others; what robot check does "
        "not understand."
    )
    if cells:
        yield table_of("Robot files as four readers understand them", cells, caption=caption)
    for key, title in (("unexplained", "Differences without an explanation"), ("explained", "Explained differences")):
        told = [(row["robot"], line) for row in rows for line in row.get(key, ())]
        if told and (listed or key == "unexplained"):
            yield table(title, ("robot", "difference"), told)
    told = [(row["robot"], line) for row in rows for key in ("refused", "told") for line in row.get(key, ())]
    if told and listed:
        yield table("What robot check does not understand, or refuses", ("robot", "what"), told)
    told = [(row["robot"], row[key]) for row in rows for key in ("missing", "error") if key in row]
    if told:
        yield table("Files that were not read", ("robot", "why"), told)


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    read = [row for row in rows if "readers" in row]
    failed = [row["robot"] for row in rows if row not in read]
    yield Promise("every file is read or refused by name", ", ".join(failed) or f"{len(read)} files", not failed)
    wrong = [row["robot"] for row in read if row["unexplained"]]
    compared = sum(len(row["readers"]) for row in read)
    yield Promise("no difference without an explanation", ", ".join(wrong) or f"0 in {compared} readings", not wrong)


def _listed(text: str) -> str:
    return text if len(text) <= 160 else f"{text[:160]}..."


class _Comparison:
    """What we read of a file, and how others differ from it."""

    def __init__(self, source: str, place: Path, configurations: int, seed: int) -> None:
        from benchmarks.worlds.foreign import described_file
        from planner_service.robot.loading import Selection, is_mjcf, read_description, robot_of
        from planner_service.robot.macros.expansion import package_folders
        from planner_service.robot_setup.check_robot import FindingKind, check_robot

        self.path = described_file(source, place)
        self.original = described_file(source, None)
        folders = [*package_folders(self.original), *list(self.original.parents)[:5]]
        self.folders = [str(folder) for folder in folders]
        found = check_robot(self.original, folders).findings
        self.told = [_listed(f.text) for f in found if f.kind in (FindingKind.NOT_UNDERSTOOD, FindingKind.LIMITS)]
        self.refused = [_listed(f.text) for f in found if f.is_error]
        self.explained: list[str] = []
        self.unexplained: list[str] = []
        self.readers: dict[str, str] = {}
        self.urdf, _ = read_description(self.original, folders, Selection())
        self.mjcf = is_mjcf(self.original)
        freed = {j.name: j for j in self.urdf.joints if j.kind != "fixed"}
        still = {name: j.lower for name, j in freed.items() if j.lower >= j.upper and j.mimic is None}
        bare = replace(self.urdf, joints=tuple(replace(j, mimic=None) for j in self.urdf.joints))
        robot = robot_of(self.original, bare, Selection(locked_joints=still))
        self.robot, self.joints = robot, freed
        rng = np.random.default_rng(seed)
        lower, upper = robot.limits.lower, robot.limits.upper
        self.at = [
            dict(zip(robot.joint_names, q, strict=True)) | still
            for q in rng.uniform(lower, upper, (configurations, robot.n)).tolist()
        ]
        self.ours = [self._frames(positions) for positions in self.at]

    def _frames(self, positions: Mapping[str, float]) -> dict[str, FloatArray]:
        from planner_service.robot.kinematic_tree import body_matrix

        q = np.array([positions[name] for name in self.robot.joint_names])
        bodies = [body_matrix(pose) for pose in self.robot.body_poses(q)]
        return {frame.link: bodies[frame.body] @ frame.pose.matrix for frame in self.robot.link_frames}

    def frames(self, reader: str, theirs: Frames) -> None:
        """Compare the poses of all links, relative to the root's."""
        worst, links = 0.0, set[str]()
        root = self.urdf.root
        for positions, ours in zip(self.at, self.ours, strict=True):
            poses = theirs(positions)
            base = np.linalg.inv(poses[root]) if root in poses else np.eye(4)
            for link, T in poses.items():
                if link not in ours:
                    continue
                apart = float(np.abs(base @ T - ours[link]).max())
                worst = max(worst, apart)
                if not apart <= (SAME_FLAT if self.mjcf and reader == "Pinocchio" else SAME):
                    links.add(link)
        self.readers[reader] = f"{worst:.0e}"
        if links:
            text = f"{reader} puts {len(links)} links elsewhere, by up to {worst:.3g}: {', '.join(sorted(links)[:4])}"
            self.unexplained.append(text)

    def limits(self, reader: str, theirs: Mapping[str, Mapping[str, float]]) -> None:
        """Compare limits by joint and kind; a kind that a reader does not read is left out by it."""
        endless, soft = list[str](), list[str]()
        for name, values in theirs.items():
            joint = self.joints.get(name)
            if joint is None:
                self.unexplained.append(f"{reader} has a joint {name!r} that we have not")
                continue
            hard = joint.hard or (joint.lower, joint.upper)
            own = {"lower": hard[0], "upper": hard[1], "velocity": joint.velocity, "effort": joint.effort}
            for kind, value in values.items():
                if joint.continuous and kind in ("lower", "upper"):
                    if math.isfinite(value) and abs(value) < ENDLESS and name not in endless:
                        endless.append(name)
                elif not abs(value - own[kind]) <= SAME_LIMIT * max(1.0, abs(value)):
                    self.unexplained.append(f"{name}: {kind} {own[kind]:.9g}, {reader} reads {value:.9g}")
            if joint.hard is not None:
                soft.append(f"{name} [{joint.lower:.3g}, {joint.upper:.3g}] in [{hard[0]:.3g}, {hard[1]:.3g}]")
        if endless:
            self.explained.append(f"{reader} keeps limits of {', '.join(endless)}: a continuous joint has none")
        if soft:
            self.explained.append(f"{reader} does not read soft limits, we do: {', '.join(soft)}")
        missing = sorted(self.joints.keys() - theirs.keys())
        if missing:
            self.unexplained.append(f"{reader} has no joints {', '.join(missing)}")

    def shapes(self, reader: str, theirs: Mapping[str, Sequence[tuple[str, FloatArray | None]]]) -> None:
        """Compare the kinds of shapes of each link in order, and the sizes of boxes around meshes where known."""
        from planner_service.geometry.composite import extent

        for link in self.urdf.links:
            own = [(type(item.shape).__name__.lower(), extent(item.shape)) for item in link.collisions]
            given = list(theirs.get(link.name, ()))
            if [kind for kind, _ in own] != [kind for kind, _ in given]:
                kinds = [", ".join(kind for kind, _ in each) or "nothing" for each in (own, given)]
                text = f"{link.name}: we check {kinds[0]}, {reader} reads {kinds[1]}"
                wished = any(f"link {link.name!r}: <collision_checking>" in line for line in self.told)
                if wished:
                    self.explained.append(f"{text}: it reads <collision_checking>, of which robot check warns")
                else:
                    self.unexplained.append(text)
                continue
            for (kind, size), (_, other) in zip(own, given, strict=True):
                if other is not None and float(np.abs(size - other).max()) > SAME_SIZE:
                    self.size(reader, link.name, kind, size, other)

    def size(self, reader: str, link: str, kind: str, size: FloatArray, other: FloatArray) -> None:
        sizes = [" x ".join(f"{value:.4g}" for value in each.tolist()) for each in (size, other)]
        text = f"{link}: our {kind} measures {sizes[0]}, {reader}'s {sizes[1]}"
        growth = max(getattr(i.shape, "growth", 0.0) for n in self.urdf.links if n.name == link for i in n.collisions)
        if (
            growth
            and float((size - other).min()) >= -SAME_SIZE
            and float((size - other).max()) <= 2.0 * growth + SAME_SIZE
        ):
            self.explained.append(f"{text}: a simpler hull around it")
        else:
            self.unexplained.append(text)


def _pinocchio(case: _Comparison) -> None:
    import pinocchio as pin

    model = pin.buildModelFromMJCF(str(case.path)) if case.mjcf else pin.buildModelFromUrdf(str(case.path))
    data = model.createData()
    links = [link.name for link in case.urdf.links if model.existBodyName(link.name)]

    def frames(positions: Mapping[str, float]) -> dict[str, FloatArray]:
        q = pin.neutral(model)
        for name, value in positions.items():
            joint = model.joints[model.getJointId(name)]
            q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (math.cos(value), math.sin(value))
        pin.framesForwardKinematics(model, data, q)
        return {name: np.array(data.oMf[model.getBodyId(name)].homogeneous) for name in links}

    case.frames("Pinocchio", frames)
    limits: dict[str, dict[str, float]] = {}
    for name in list(model.names)[1:]:
        joint = model.joints[model.getJointId(name)]
        q, v = joint.idx_q, joint.idx_v
        limits[name] = (
            {} if joint.nq != 1 else {"lower": model.lowerPositionLimit[q], "upper": model.upperPositionLimit[q]}
        )
        if not case.mjcf:
            limits[name] |= {"velocity": model.upperVelocityLimit[v], "effort": model.upperEffortLimit[v]}
    case.limits("Pinocchio", limits)
    if case.mjcf:
        return
    geometry = pin.buildGeomFromUrdf(model, str(case.path), pin.GeometryType.COLLISION, case.folders)
    found: dict[str, list[tuple[str, FloatArray | None]]] = {}
    for item in geometry.geometryObjects:
        name = str(model.frames[item.parentFrame].name)
        kind = {"BVHModelOBBRSS": "mesh", "ConvexBase": "mesh"}.get(type(item.geometry).__name__)
        kind = kind or type(item.geometry).__name__.lower()
        size = None
        if kind == "mesh":
            scale = np.ones(3)
            item.geometry.computeLocalAABB()
            box = item.geometry.aabb_local
            size = np.abs(np.array(box.max_) - np.array(box.min_)) * scale
        found.setdefault(name, []).append((kind, size))
    case.shapes("Pinocchio", found)


def _yourdfpy(case: _Comparison) -> None:
    if case.mjcf:
        return
    import yourdfpy

    other = yourdfpy.URDF.load(str(case.path), load_meshes=False, build_collision_scene_graph=False)
    joints = {joint.name: joint for joint in other.robot.joints if joint.type != "fixed"}
    for joint in joints.values():
        joint.mimic = None  # so that each joint is placed where we say
    other = yourdfpy.URDF(other.robot, load_meshes=False, build_collision_scene_graph=False)

    def frames(positions: Mapping[str, float]) -> dict[str, FloatArray]:
        other.update_cfg({name: positions[name] for name in other.actuated_joint_names})
        return {link.name: np.array(other.get_transform(link.name)) for link in other.robot.links}

    case.frames("yourdfpy", frames)
    kinds = {"lower": "lower", "upper": "upper", "velocity": "velocity", "effort": "effort"}
    case.limits(
        "yourdfpy",
        {
            name: {
                kind: float(value)
                for kind, at in kinds.items()
                if joint.limit is not None and (value := getattr(joint.limit, at)) is not None
            }
            for name, joint in joints.items()
        },
    )
    shapes: dict[str, list[tuple[str, FloatArray | None]]] = {}
    for link in other.robot.links:
        for item in link.collisions:
            kinds_of = [
                kind for kind in ("box", "cylinder", "sphere", "mesh") if getattr(item.geometry, kind) is not None
            ]
            shapes.setdefault(link.name, []).append((kinds_of[0], None))
    case.shapes("yourdfpy", shapes)


def _mujoco(case: _Comparison) -> None:
    import mujoco

    if case.mjcf:
        model = mujoco.MjModel.from_xml_path(str(case.original))
    else:
        model = mujoco.MjModel.from_xml_string(_bones(case.path))
    data = mujoco.MjData(model)
    joints = {str(model.joint(k).name): k for k in range(model.njnt)}

    def frames(positions: Mapping[str, float]) -> dict[str, FloatArray]:
        for name, value in positions.items():
            data.qpos[model.jnt_qposadr[joints[name]]] = value
        mujoco.mj_kinematics(model, data)
        out = {}
        for k in range(model.nbody):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = data.xmat[k].reshape(3, 3), data.xpos[k]
            out[str(model.body(k).name)] = T
        for k in range(model.nsite if case.mjcf else 0):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = data.site_xmat[k].reshape(3, 3), data.site_xpos[k]
            name = str(model.site(k).name)
            out[f"site/{name}" if name in out else name] = T
        return out

    case.frames("MuJoCo", frames)
    limits = {}
    for name, k in joints.items():
        lower, upper = model.jnt_range[k].tolist() if model.jnt_limited[k] else (-math.inf, math.inf)
        limits[name] = {"lower": lower, "upper": upper}
    case.limits("MuJoCo", limits)


def _bones(path: Path) -> str:
    """A URDF without shapes, for MuJoCo, which does not know packages, and wants a mass for each body that moves."""
    root = ElementTree.parse(path).getroot()
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
    for link in root.findall("link"):
        for child in list(link):
            link.remove(child)
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "mass", {"value": "1"})
        ElementTree.SubElement(
            inertial, "inertia", dict.fromkeys(("ixx", "iyy", "izz"), "1") | dict.fromkeys(("ixy", "ixz", "iyz"), "0")
        )
    settings = ElementTree.SubElement(root, "mujoco")
    ElementTree.SubElement(settings, "compiler", {"fusestatic": "false", "strippath": "false"})
    return ElementTree.tostring(root, encoding="unicode")


def main(source: str, configurations: int, seed: int) -> None:
    """Print a row about the file of ``source``."""
    from planner_service.errors import InvalidFile

    with TemporaryDirectory() as place:
        try:
            case = _Comparison(source, Path(place), configurations, seed)
        except InvalidFile as error:
            empty = {
                "joints": 0,
                "links": 0,
                "shapes": 0,
                "readers": {},
                "explained": [],
                "unexplained": [],
                "told": [],
            }
            print(json.dumps(empty | {"refused": [_listed(line) for line in error.problems]}))
            return
        for name, read in (("Pinocchio", _pinocchio), ("MuJoCo", _mujoco), ("yourdfpy", _yourdfpy)):
            try:
                read(case)
            except Exception as error:  # of any kind: these readers refuse by exceptions of all kinds
                case.explained.append(
                    _listed(f"{name} cannot read it: {type(error).__name__}: {' '.join(str(error).split())}")
                )
        told: dict[str, Any] = {"joints": len(case.joints), "links": len(case.urdf.links)}
        told |= {"shapes": sum(len(link.collisions) for link in case.urdf.links), "readers": case.readers}
        told |= {"explained": case.explained, "unexplained": case.unexplained}
        print(json.dumps(told | {"told": case.told, "refused": case.refused}))


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:4]))
