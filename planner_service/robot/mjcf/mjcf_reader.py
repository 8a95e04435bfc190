"""MJCF files: what mujoco makes of a robot's bodies, joints and geoms, as the values that a URDF and its SRDF give."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from planner_service.concurrency.confined import ScriptFailed, run_confined
from planner_service.errors import InvalidFile, InvalidRequest, MissingDependency
from planner_service.files.reading import read_bytes
from planner_service.files.xml_reader import MAX_XML_BYTES, Malformed, parse_xml, read_xml
from planner_service.geometry.around import around_ellipsoid
from planner_service.geometry.arrays import FloatArray, Vector, rpy_of, vector
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_paths import Surface
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.robot.elements.table import unlisted_words, words_of
from planner_service.robot.inertia import tensor_numbers
from planner_service.robot.model import AllowedContact
from planner_service.robot.srdf import Srdf
from planner_service.robot.urdf_model import Inertial, Mimic, Urdf, UrdfCollision, UrdfJoint, UrdfLink, Visual
from planner_service.robot.urdf_reader import CONTINUOUS_RANGE, MAX_ELEMENTS, MAX_OFFSET

__all__ = ["JointPlaces", "inspect_mjcf", "joint_places", "read_mjcf"]

SECONDS = 60
MEMORY = 8_000_000_000
"""Bytes of address space, of which mujoco reserves much more than it uses."""
JOINTS = ("free", "ball", "slide", "hinge")
GEOMS = ("plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh", "sdf")
"""mujoco's types of joints and geoms, by number (mjtJoint, mjtGeom)."""
UNSEEN = ("plane", "hfield", "sdf")
"""Those that are no part of a robot."""
KINDS = {"hinge": "revolute", "slide": "prismatic"}
INSTEAD = {
    "free": "take it out: the robot stands on its base",
    "ball": "write three hinges instead, or take it out if it stands still",
}
"""What to do about joints of several degrees of freedom, which have no limits."""
FREE = (
    "its joints are then planned for as if nothing coupled them, and --lock joint=value (locked_joints) holds one still"
)
LOOP = f"a closed loop of bodies; expected a tree: take it out of <equality>; {FREE}"
TENDON = "tendons couple joints; write <joint joint1=... joint2=...> instead, or take it out of <equality>"
LOOPS = {"tendon": f"{TENDON}; {FREE}"}
"""What to do about equalities that are not of two joints."""
Quaternion = tuple[float, float, float, float]

PLACES = ("meshdir", "texturedir", "assetdir")
"""Attributes that say where the files are that others name."""
INCLUDING = ("include", "model")
"""Elements whose file is MJCF, too."""
MAX_INCLUDED = 100


def read_mjcf(path: Path, folders: Sequence[Path]) -> tuple[Urdf, Srdf]:
    """The robot of an MJCF file, and what a URDF has no place for: excluded contacts, and keyframes as named poses.

    Links are bodies; geoms that collide with anything are their shapes. Each site that has a name is a link without
    shapes, fixed to its body. An ellipsoid becomes a polytope around it, and planes, which are no part of a robot, are
    left out: ``Urdf.notes`` says so, and what else has no effect. A hinge without a range is continuous. A joint that
    follows another by an equality mimics it. mujoco compiles the file in a process of its own, in 60 s and 8 GB.

    Args:
        folders: Resolved folders in which all files that it names have to be; the file's own first.

    Raises:
        InvalidFile: with every problem of the file; ball and free joints are among them, with what to do instead.
        MissingDependency: mujoco is not installed.
    """
    urdf, srdf, problems = _inspected(path, folders, looks=False)
    if problems:
        raise InvalidFile(path, problems)
    return urdf, srdf


def inspect_mjcf(path: Path, folders: Sequence[Path]) -> tuple[Urdf, Srdf, Sequence[str]]:
    """What ``read_mjcf`` would give, visuals included, and its problems; each has left a stand-in value.

    Visuals are the geoms that collide with nothing and are not hidden.

    Raises:
        InvalidFile: mujoco cannot compile the file.
        MissingDependency: as of ``read_mjcf``.
    """
    return _inspected(path, folders, looks=True)


def _inspected(path: Path, folders: Sequence[Path], *, looks: bool) -> tuple[Urdf, Srdf, Sequence[str]]:
    root = _whole(path, folders)
    reader = _Reader(_compiled(path, folders, looks=looks), [*unlisted_words(root, words_of("mjcf")).told])
    return reader.urdf, reader.srdf, reader.problems


ENTRIES = {
    "bodies": ("body", 2),
    "joints": ("joint", 3),
    "geoms": ("geom", 4),
    "seen": ("geom", 4),
    "sites": ("site", 2),
    "meshes": ("mesh", 0),
    "follows": ("equality", 0),
    "keys": ("key", 0),
}
"""What an entry of each list of ``mjcf_child`` is called, and which of its columns says where it is; 0: none."""


@dataclass(frozen=True)
class JointPlaces:
    """Where the joints of an MJCF model stand in its ``qpos`` and ``qvel``.

    Attributes:
        qpos: The model's own positions, of all its joints.
        velocities: How many entries ``qvel`` has.
        places: By name of each hinge or slide that has one, its entry in ``qpos`` and that in ``qvel``.
    """

    qpos: tuple[float, ...]
    velocities: int
    places: Mapping[str, tuple[int, int]]


def joint_places(path: Path, folders: Sequence[Path]) -> JointPlaces:
    """Where the joints of an MJCF model stand; it need not be a robot's alone.

    Raises:
        InvalidFile, MissingDependency: as of ``read_mjcf``.
    """
    told = _compiled(path, folders)
    places = {
        name: (int(position), int(velocity))
        for (_, _, kind, *_), (name, position, velocity) in zip(told["joints"], told["places"], strict=True)
        if name and JOINTS[kind] in KINDS
    }
    return JointPlaces(tuple(told["qpos"]), told["velocities"], places)


def _compiled(path: Path, folders: Sequence[Path], *, looks: bool = False) -> dict[str, Any]:
    """What ``mjcf_child`` reports about a file."""
    _require_inside(path, folders)
    if find_spec("mujoco") is None:
        raise MissingDependency("mujoco", "mjcf")
    script = Path(__file__).with_name("mjcf_child.py")
    try:
        job = {"file": str(path.resolve()), "looks": looks}
        told: dict[str, Any] = json.loads(run_confined(script, job, seconds=SECONDS, memory=MEMORY, bare=True))
        problem = told.get("problem")
    except ScriptFailed as error:
        problem = str(error)
    if problem is not None:
        raise InvalidFile(path, [f"mujoco cannot compile it: {problem}"])
    if problems := list(_beyond(told)):
        raise InvalidFile(path, problems)
    return told


def _beyond(told: Mapping[str, Any]) -> Iterator[str]:
    """What of a model has a number that is not finite, or is too far away: mujoco takes both."""
    for key, (kind, place) in ENTRIES.items():
        for row in told.get(key, ()):
            where = " ".join([kind, *(repr(each) for each in row if isinstance(each, str))])
            if not _is_finite(row):
                yield f"{where}: not finite; expected finite numbers"
            elif place and max(map(abs, row[place])) > MAX_OFFSET:
                yield f"{where}: at {row[place]}; expected at most {MAX_OFFSET:g} m"


def _is_finite(value: Any) -> bool:
    if isinstance(value, list):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def _require_inside(path: Path, folders: Sequence[Path]) -> None:
    """Raise if the file, or one that it includes, names a file outside the folders."""
    own, files, places = path.resolve().parent, [path], [""]
    named: list[tuple[Path, str]] = []
    for file in files:  # grows while it is read
        root = read_xml(path, "mujoco") if file == path else _included(file)
        for element in root.iter():
            named += [(file.parent, value) for key, value in element.attrib.items() if key.startswith("file")]
            places += [value for key, value in element.attrib.items() if key in PLACES]
            if element.tag in INCLUDING and "file" in element.attrib:
                at = [start / element.get("file", "") for start in dict.fromkeys((own, file.parent))]
                files += [each for each in at if each not in files and _inside(each, folders) and each.is_file()]
        if len(files) > MAX_INCLUDED:
            raise InvalidFile(path, [f"includes more than {MAX_INCLUDED} files"])
    for folder, name in dict.fromkeys(named):
        if not all(
            _inside(start / place / name, folders) for start in (own, folder) for place in dict.fromkeys(places)
        ):
            allowed = ", ".join(map(str, folders))
            raise InvalidFile(path, [f"file {name!r} lies outside the folders that may be read ({allowed})"])


def _whole(path: Path, folders: Sequence[Path]) -> ElementTree.Element:
    """The file with what it includes in the places of the ``<include>``, as far as that can be found."""
    _require_inside(path, folders)
    own, left = path.resolve().parent, [MAX_INCLUDED]

    def fill(element: ElementTree.Element, folder: Path) -> None:
        children = []
        for child in element:
            places = [start / child.get("file", "") for start in dict.fromkeys((own, folder))]
            file = next((each for each in places if _inside(each, folders) and each.is_file()), None)
            if child.tag == "include" and file is not None and left[0] > 0:
                left[0] -= 1
                included = _included(file)
                fill(included, file.parent)
                children += list(included)
            else:
                fill(child, folder)
                children.append(child)
        element[:] = children

    root = read_xml(path, "mujoco")
    fill(root, own)
    return root


def _inside(path: Path, folders: Sequence[Path]) -> bool:
    real = path.resolve()
    return any(real.is_relative_to(folder) for folder in folders)


def _included(file: Path) -> ElementTree.Element:
    try:
        return parse_xml(read_bytes(file, MAX_XML_BYTES))
    except Malformed as error:
        raise InvalidFile(file, [str(error)]) from None


class _Reader:
    """Turns the report of ``mjcf_child`` into links and joints, and collects problems and notes."""

    def __init__(self, told: dict[str, Any], notes: list[str]) -> None:
        self.problems = [f"{kind} {name!r}: {LOOPS.get(kind, LOOP)}" for kind, name in told["loops"]]
        self.notes = notes
        self.told = told
        self.names = [body[0] for body in told["bodies"]]
        mimics = self.mimics()
        links, joints = [], []
        for index, (name, parent, at, quat, *inertial) in enumerate(told["bodies"]):
            links.append(UrdfLink(name, self.shapes(index), _inertial(*inertial), tuple(self.visuals(index))))
            if index:
                chain = [(k, joint) for k, joint in enumerate(told["joints"]) if joint[1] == index]
                made = self.joints(name, self.names[parent], Pose(at, quat).matrix, chain, mimics)
                links += [UrdfLink(joint.child, (), None) for joint in made[:-1]]
                joints += made
        for index, name, at, quat in told["sites"]:
            taken = any(link.name == name for link in links) or name in self.names
            link, T = f"site/{name}" if taken else name, Pose(at, quat).matrix
            links.append(UrdfLink(link, (), None))
            joints.append(_fixed(link, self.names[index], T))
        for kind, each in (("body", [link.name for link in links]), ("joint", [joint.name for joint in joints])):
            self.problems += [f"{kind} {name!r} would be there {n} times" for name, n in Counter(each).items() if n > 1]
        if len(links) > MAX_ELEMENTS:
            self.problems.append(f"{len(links)} bodies; at most {MAX_ELEMENTS}")
        self.urdf = Urdf(told["name"], self.names[0], tuple(links), tuple(joints), notes=tuple(self.notes))
        excluded = tuple(
            AllowedContact((self.names[a], self.names[b]), "excluded in the MJCF")
            for a, b in told["excludes"]
            if a != b
        )
        moving = [joint[0] for joint in told["joints"]]
        self.srdf = Srdf(excluded, {name: dict(zip(moving, q, strict=True)) for name, q in told["keys"]})

    def joints(
        self, name: str, parent: str, T: FloatArray, chain: list[tuple[int, Any]], mimics: dict[int, Mimic]
    ) -> list[UrdfJoint]:
        """The joints from a parent to a body at T in it; a link without shapes stands at each but the last."""
        made: list[UrdfJoint] = []
        for k, (label, _, number, at, axis, limited, span, rest, effort) in chain:
            kind = JOINTS[number]
            if kind not in KINDS:
                self.problems.append(f"joint {label!r}: type {kind}; {INSTEAD[kind]}")
                continue
            if kind == "slide" and not limited:
                self.problems.append(f"joint {label!r}: slides without a range; expected one")
            low, high = span if limited else (-CONTINUOUS_RANGE, CONTINUOUS_RANGE)
            if max(abs(low), abs(high)) > MAX_OFFSET:
                self.problems.append(f"joint {label!r}: range {low:g} .. {high:g}; expected at most {MAX_OFFSET:g}")
            anchor = _shift(at)
            T = T @ anchor @ _motion(kind, axis, -rest)
            xyz, rpy = _origin(T)
            T = _shift([-each for each in at])
            ends = (made[-1].child if made else parent, f"{label}_anchor")
            limits = (float(low), float(high), 0.0, float(effort))
            endless = kind == "hinge" and not limited
            made.append(UrdfJoint(label, KINDS[kind], *ends, xyz, rpy, tuple(axis), *limits, mimics.get(k), endless))
        if made and np.array_equal(T, np.eye(4)):
            made.append(replace(made.pop(), child=name))
        else:
            made.append(_fixed(name, made[-1].child if made else parent, T))
        return made

    def mimics(self) -> dict[int, Mimic]:
        """By follower: q1 - r1 = a0 + a1 (q2 - r2), r being the positions at rest."""
        out = {}
        joints = self.told["joints"]
        for one, two, (a0, a1, *higher) in self.told["follows"]:
            if two < 0 or any(higher):
                self.problems.append(f"joint {joints[one][0]!r}: expected an equality that is linear in another joint")
            else:
                out[one] = Mimic(joints[two][0], a1, joints[one][7] + a0 - a1 * joints[two][7])
        return out

    def shapes(self, body: int) -> tuple[UrdfCollision, ...]:
        found = []
        for name, of, number, size, at, quat, mesh in self.told["geoms"]:
            if of != body:
                continue
            kind = GEOMS[number]
            if kind == "plane":
                self.notes.append(f"geom {name!r}: a plane is no part of a robot; put it into the scene")
                continue
            try:
                shape = self.shape(name, kind, size, mesh)
            except InvalidRequest as error:
                self.problems.append(f"geom {name!r}: {error}")
                continue
            if shape is None:
                self.problems.append(
                    f"geom {name!r}: {kind}; expected box, sphere, capsule, cylinder, ellipsoid or mesh"
                )
            else:
                found.append(UrdfCollision(shape, *_origin(Pose(at, quat).matrix)))
        return tuple(found)

    def visuals(self, body: int) -> Iterator[Visual]:
        """What a body looks like, as far as it was asked for."""
        for _, of, number, size, at, quat, mesh in self.told.get("seen", ()):
            kind = GEOMS[number]
            if of != body or kind in UNSEEN:
                continue
            if kind == "mesh":
                vertices, faces = np.array(self.told["meshes"][mesh]), np.array(self.told["faces"][mesh], dtype=np.intp)
                yield Visual(Surface(vertices, faces), Pose(at, quat))
            else:
                appearance = around_ellipsoid(size)[0] if kind == "ellipsoid" else _solid(kind, *size)
                yield Visual(appearance, Pose(at, quat))

    def shape(self, name: str, kind: str, size: list[float], mesh: int) -> Shape | None:
        if kind == "mesh":
            return Mesh(np.array(self.told["meshes"][mesh]))
        if kind == "ellipsoid":
            around, growth = around_ellipsoid(size)
            larger = f"up to {growth * 1e3:.2g} mm larger"
            self.notes.append(f"geom {name!r}: an ellipsoid is checked as a polytope around it, {larger}")
            return around
        return None if kind in UNSEEN else _solid(kind, *size)


def _solid(kind: str, a: float, b: float, c: float) -> Shape:
    """A box, sphere, capsule or cylinder of mujoco's sizes."""
    if kind == "box":
        return Box((2.0 * a, 2.0 * b, 2.0 * c))
    if kind == "sphere":
        return Sphere(a)
    return Capsule(a, 2.0 * b) if kind == "capsule" else Cylinder(a, 2.0 * b)


def _fixed(name: str, parent: str, T: FloatArray) -> UrdfJoint:
    """The joint that fixes a link to its parent at T in it."""
    return UrdfJoint(f"{name}_fixed", "fixed", parent, name, *_origin(T))


def _inertial(
    mass: float, at: Vector, quat: tuple[float, float, float, float], moments: Sequence[float]
) -> Inertial | None:
    if mass <= 0.0:
        return None
    R = Pose(at, quat).matrix[:3, :3]
    return Inertial(mass, vector(at), (0.0, 0.0, 0.0), tensor_numbers(R @ np.diag(moments) @ R.T))


def _shift(at: Sequence[float]) -> FloatArray:
    T = np.eye(4)
    T[:3, 3] = at
    return T


def _motion(kind: str, axis: Sequence[float], by: float) -> FloatArray:
    """The move of a joint by an angle or a distance."""
    if by == 0.0:
        return np.eye(4)
    if kind == "slide":
        return _shift([by * each for each in axis])
    x, y, z = axis
    sine = math.sin(0.5 * by)
    return Pose((0.0, 0.0, 0.0), (math.cos(0.5 * by), sine * x, sine * y, sine * z)).matrix


def _origin(T: FloatArray) -> tuple[Vector, Vector]:
    """xyz and rpy of a 4 x 4 pose, as URDF writes them: the rotation is yaw after pitch after roll."""
    return vector(T[:3, 3].tolist()), rpy_of(T[:3, :3])
