"""The URDF reader: strict, and the only one that sees a file.

Other readers repair, drop or follow what they do not understand: a box with a NaN edge vanishes, swapped limits
load, ``package://../`` is followed. ``read_urdf`` refuses such a file instead, and names all of its problems at once.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar
from xml.etree import ElementTree

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.numerals import plain_float
from planner_service.geometry.arrays import rpy_matrix, rpy_of, vector
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_paths import MeshLoader
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.presentation.progress import bar
from planner_service.robot.elements.table import unlisted_words, words_of
from planner_service.robot.kinematic_tree import MAX_MULTIPLIER, MIN_MULTIPLIER
from planner_service.robot.macros.expansion import expanded_xml, robot_folders
from planner_service.robot.urdf_model import (
    Description,
    Inertial,
    Mimic,
    Urdf,
    UrdfCollision,
    UrdfJoint,
    UrdfLink,
    Vector,
    Visual,
)

__all__ = ["inspect_urdf", "read_urdf"]

T = TypeVar("T")

MAX_ELEMENTS = 500
"""Links, and joints: several times those of a humanoid with hands; pairs of links grow with the square."""
MAX_OFFSET = 1e3
"""Metres: no joint of an arm is a kilometre from its parent, so a longer offset is a unit mistake."""
CONTINUOUS_RANGE = 2.0 * math.pi
"""A continuous joint may turn once in either direction: bounded, with no seam at half a turn."""
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
INSTEAD = {
    "planar": "write two prismatic joints and a revolute one instead, or type fixed if it stands still",
    "floating": "write type fixed and plan for what it carries as it stands",
}
"""What to do about joints of several degrees of freedom, which have no limits."""
ACCELERATIONS = ("acceleration", "deceleration", "drake:acceleration")
"""Attributes of a ``<limit>`` of which the smallest is the acceleration's; Drake's came before URDF 1.2."""
UNIT = 1e-3
"""How far the length of an axis, or of a quaternion, may be from 1: it may be written with three digits."""
VERSIONS = ("1.0", "1.1", "1.2")
SAME = 1e-6
"""Largest difference between entries of equal rotations, one of which may be written with few digits."""


def read_urdf(
    path: Path,
    package_dirs: Sequence[Path] = (),
    decompose: Mapping[str, int] | None = None,
    *,
    visuals: bool = False,
    visual_as_collision: bool = False,
    xacro_args: Mapping[str, str] | None = None,
) -> Urdf:
    """The robot of a URDF file, or of a xacro file (``expanded_xml``).

    Args:
        package_dirs: Folders besides the file's own in which meshes and ``package://`` folders may lie.
        decompose: For links whose meshes are cut into convex pieces: the maximum number of pieces.
        visuals: Read what the links look like, too. A visual element with a problem is left out, and
            ``Urdf.unread_visuals`` says why.
        visual_as_collision: A link without collision elements is checked as it looks.
        xacro_args: Of a xacro file the arguments that do not have their defaults.

    Raises:
        InvalidFile: with every problem of the file.
        MissingDependency: macros have to be expanded, and xacro is not installed.
    """
    given = dict(decompose or {})
    seen = {"visuals": visuals, "visual_as_collision": visual_as_collision}
    urdf, problems = _read(path, package_dirs, given, xacro_args or {}, **seen)
    if problems:
        raise InvalidFile(path, problems)
    return urdf


def inspect_urdf(
    path: Path,
    package_dirs: Sequence[Path] = (),
    decompose: Mapping[str, int] | None = None,
    *,
    visual_as_collision: bool = False,
    xacro_args: Mapping[str, str] | None = None,
) -> tuple[Urdf, Sequence[str]]:
    """What ``read_urdf`` would give, visuals included, and its problems; each has left a stand-in value.

    The root is empty if the links and joints are no tree. Arguments are those of ``read_urdf``.
    """
    given, as_seen = dict(decompose or {}), visual_as_collision
    try:
        return _read(path, package_dirs, given, xacro_args or {}, visuals=True, visual_as_collision=as_seen)
    except InvalidFile as error:
        return Urdf("", "", (), ()), error.problems


def _read(
    path: Path,
    package_dirs: Sequence[Path],
    decompose: dict[str, int],
    xacro_args: Mapping[str, str],
    *,
    visuals: bool,
    visual_as_collision: bool,
) -> tuple[Urdf, Sequence[str]]:
    folders = robot_folders(path, package_dirs)
    reader = _Reader(folders, decompose, visuals=visuals, visual_as_collision=visual_as_collision)
    urdf = reader.robot(expanded_xml(path, folders, xacro_args))
    return replace(urdf, description=Description(path, folders, xacro_args)), reader.problems


def _mimic_circles(mimics: Mapping[str, str]) -> list[str]:
    """Joints that mimic each other, as problems: none of them says where they are."""
    problems, seen = [], set[str]()
    for name in mimics:
        way = [name]
        while way[-1] in mimics and mimics[way[-1]] not in way and way[-1] not in seen:
            way.append(mimics[way[-1]])
        if way[-1] not in seen and mimics.get(way[-1]) in way[:-1]:
            circle = way[way.index(mimics[way[-1]]) :]
            problems.append(f"joints mimic each other in a circle: {' -> '.join([*circle, circle[0]])}")
        seen.update(way)
    return problems


class _Reader:
    """Reads elements and collects every problem; after a problem it goes on with a stand-in value."""

    def __init__(
        self, folders: tuple[Path, ...], decompose: dict[str, int], *, visuals: bool, visual_as_collision: bool
    ) -> None:
        self.meshes = MeshLoader(folders)
        self.surfaces = MeshLoader(folders) if visuals else None
        self.decompose = decompose
        self.visual_as_collision = visual_as_collision
        self.problems: list[str] = []
        self.unread_visuals: list[str] = []
        self.remarks: list[str] = []
        self.notes: list[str] = []
        self.unused: list[str] = []
        self.version = VERSIONS[0]

    def robot(self, root: ElementTree.Element) -> Urdf:
        link_elements, joint_elements = root.findall("link"), root.findall("joint")
        for tag, elements in (("links", link_elements), ("joints", joint_elements)):
            if len(elements) > MAX_ELEMENTS:
                self.problems.append(f"{len(elements)} {tag}; at most {MAX_ELEMENTS}")
                return Urdf("", "", (), ())
        unlisted = unlisted_words(root, words_of("urdf"), as_seen=self.visual_as_collision)
        self.problems += unlisted.refused
        self.notes += unlisted.told
        self.version = root.get("version", self.version)
        if self.version not in VERSIONS:
            self.problems.append(f"<robot> version = {self.version!r}; expected one of {', '.join(VERSIONS)}")
        name = self.text(root, "name", "robot")
        links = self.links(link_elements)
        shaped = {each.get("name") for each in link_elements if self.checked(each)[1]}
        for link in sorted(map(str, self.decompose.keys() - shaped)):
            self.problems.append(f"decompose: {link!r} is not a link with a collision shape")
        joints = tuple(self.joint(element) for element in joint_elements)
        before = len(self.problems)
        top = self.tree(links, joints)
        top = top if len(self.problems) == before else ""
        return Urdf(
            name,
            top,
            links,
            joints,
            unread_visuals=tuple(self.unread_visuals),
            remarks=tuple(self.remarks),
            notes=tuple(self.notes),
            unused_limits=tuple(self.unused),
        )

    def links(self, elements: Sequence[ElementTree.Element]) -> tuple[UrdfLink, ...]:
        """The links; where there are meshes, whose hulls take time, a bar on a terminal shows how many are read."""
        found = []
        with bar("links", None if any(each.find(".//mesh") is not None for each in elements) else False) as report:
            for element in elements:
                found.append(self.link(element))
                if report is not None:
                    report(len(found), len(elements))
        return tuple(found)

    def checked(self, link: ElementTree.Element) -> tuple[str, list[ElementTree.Element]]:
        """The elements of a link that say what is checked, and their tag."""
        tag = "visual" if self.visual_as_collision and link.find("collision") is None else "collision"
        return tag, link.findall(tag)

    def link(self, element: ElementTree.Element) -> UrdfLink:
        name = self.text(element, "name", "link")
        most = self.decompose.get(name, 1)

        def solids(file: str, scale: Vector) -> tuple[Mesh, ...]:
            return (self.meshes.mesh(file, scale),) if most == 1 else self.meshes.pieces(file, scale, most)

        collisions = []
        tag, children = self.checked(element)
        for index, child in enumerate(children):
            where = f"link {name!r} {tag}[{index}]"
            shapes = self.shapes(child, where, solids)
            xyz, rpy = self.origin(child, where)
            collisions += [UrdfCollision(shape, xyz, rpy) for shape in shapes]
        inertial = self.inertial(element, name)
        return UrdfLink(name, tuple(collisions), inertial, self.visuals(element, name))

    def visuals(self, link: ElementTree.Element, name: str) -> tuple[Visual, ...]:
        """What a link looks like; problems are not those of the robot."""
        if self.surfaces is None:
            return ()
        surface, found = self.surfaces.surface, []
        problems, self.problems = self.problems, []
        for index, child in enumerate(link.findall("visual")):
            where, before = f"link {name!r} visual[{index}]", len(self.problems)
            appearances = self.shapes(child, where, lambda file, scale: (surface(file, scale),))
            xyz, rpy = self.origin(child, where)
            if len(self.problems) == before:
                found += [Visual(each, Pose.from_rpy(xyz, rpy)) for each in appearances]
        self.unread_visuals += self.problems
        self.problems = problems
        return tuple(found)

    def shapes(
        self, element: ElementTree.Element, where: str, mesh: Callable[[str, Vector], tuple[T, ...]]
    ) -> tuple[Shape | T, ...]:
        """What a collision or visual element has: a shape, or what ``mesh`` gives; nothing if there is a problem."""
        geometry = self.one(element, "geometry", where)
        kinds = [] if geometry is None else list(geometry)
        if len(kinds) != 1:
            self.problems.append(f"{where}: <geometry> has {len(kinds)} shapes; expected exactly one")
            return ()
        kind = kinds[0]
        try:
            if kind.tag == "mesh":
                one = (1.0, 1.0, 1.0)
                scale = self.numbers(kind, "scale", 3, where, one) if "scale" in kind.attrib else one
                return mesh(kind.get("filename", ""), vector(scale))
            if kind.tag == "box":
                return (Box(self.numbers(kind, "size", 3, where, (1.0, 1.0, 1.0))),)  # type: ignore[arg-type]
            if kind.tag == "cylinder":
                return (Cylinder(self.number(kind, "radius", where, 1.0), self.number(kind, "length", where, 1.0)),)
            if kind.tag == "capsule":
                return (Capsule(self.number(kind, "radius", where, 1.0), self.number(kind, "length", where, 1.0)),)
            if kind.tag == "sphere":
                return (Sphere(self.number(kind, "radius", where, 1.0)),)
        except InvalidRequest as error:
            self.problems.append(f"{where}: {error}" if kind.tag == "mesh" else f"{where}: {kind.tag} {error}")
            return ()
        self.problems.append(f"{where}: unknown geometry <{kind.tag}>; expected box, cylinder, sphere, capsule or mesh")
        return ()

    def inertial(self, link: ElementTree.Element, name: str) -> Inertial | None:
        where = f"link {name!r} inertial"
        element = self.one(link, "inertial", where)
        if element is None:
            return None
        xyz, rpy = self.origin(element, where)
        mass, inertia = self.one(element, "mass", where), self.one(element, "inertia", where)
        if mass is None or inertia is None:
            self.problems.append(f"{where}: expected <mass> and <inertia>")
            return None
        value = self.number(mass, "value", where, 1.0)
        if value < 0.0:
            self.problems.append(f"{where}: mass {value:g}; expected at least 0")
        xx, xy, xz, yy, yz, zz = (
            self.number(inertia, key, where, 0.0) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        return Inertial(value, xyz, rpy, (xx, xy, xz, yy, yz, zz))

    def joint(self, element: ElementTree.Element) -> UrdfJoint:
        name = self.text(element, "name", "joint")
        where = f"joint {name!r}"
        kind = element.get("type", "")
        if kind not in JOINT_TYPES:
            instead = INSTEAD.get(kind, f"expected one of {', '.join(JOINT_TYPES)}")
            self.problems.append(f"{where}: type {kind!r}; {instead}")
            kind = "fixed"
        ends = []
        for tag in ("parent", "child"):
            end = self.one(element, tag, where)
            ends.append("" if end is None else end.get("link", ""))
            if not ends[-1]:
                self.problems.append(f'{where}: expected <{tag} link="..."/>')
        xyz, rpy = self.origin(element, where)
        low, high, velocity, effort = self.limits(element, kind, where)
        hard = (low, high)
        soft = self.soft_limits(element, kind, where, hard)
        lower, upper = soft or hard
        acceleration, jerk = self.rates(element, kind, where)
        return UrdfJoint(
            name=name,
            kind="revolute" if kind == "continuous" else kind,
            parent=ends[0],
            child=ends[1],
            xyz=xyz,
            rpy=rpy,
            axis=self.axis(element, kind, where),
            lower=lower,
            upper=upper,
            velocity=velocity,
            effort=effort,
            mimic=self.mimic(element, where),
            continuous=kind == "continuous",
            hard=None if soft is None else hard,
            acceleration=acceleration,
            jerk=jerk,
        )

    def axis(self, joint: ElementTree.Element, kind: str, where: str) -> Vector:
        element = self.one(joint, "axis", where)
        if element is None or kind == "fixed":
            return (1.0, 0.0, 0.0)  # URDF's default
        x, y, z = self.numbers(element, "xyz", 3, f"{where} axis", (1.0, 0.0, 0.0))
        norm = math.sqrt(x * x + y * y + z * z)
        if not 1e-6 < norm < math.inf:
            given = f"{where}: axis {x:g} {y:g} {z:g}"
            self.problems.append(f"{given} has no direction; expected a vector that is not zero")
            return (1.0, 0.0, 0.0)
        if abs(norm - 1.0) > UNIT:
            self.remarks.append(f"{where}: axis {x:g} {y:g} {z:g} has length {norm:.4g}")
        return (x / norm, y / norm, z / norm)

    def limits(self, joint: ElementTree.Element, kind: str, where: str) -> tuple[float, float, float, float]:
        """Lower, upper, velocity and effort; the last two are 0 where the file does not state them."""
        if kind == "fixed":
            return (0.0, 0.0, 0.0, 0.0)
        span = CONTINUOUS_RANGE if kind == "continuous" else 0.0
        element = self.one(joint, "limit", where)
        if element is None:
            if kind != "continuous":
                self.problems.append(f"{where}: a {kind} joint needs <limit lower upper velocity>")
            return (-span, span, 0.0, 0.0)
        velocity = self.optional(element, "velocity", f"{where} limit", 0.0)
        if velocity < 0.0:
            self.problems.append(f"{where}: velocity {velocity:g}; expected at least 0")
            velocity = 1.0
        effort = self.optional(element, "effort", f"{where} limit", 0.0)
        if effort < 0.0:
            self.problems.append(f"{where}: effort {effort:g}; expected at least 0")
        if kind == "continuous":
            self.unused_limits(element, where)
            return (-span, span, velocity, effort)
        optional = self.version != "1.2"
        lower, upper = (
            0.0 if optional and end not in element.attrib else self.number(element, end, f"{where} limit", 0.0)
            for end in ("lower", "upper")
        )
        if lower > upper:
            self.problems.append(f"{where}: lower {lower:g} is above upper {upper:g}")
            lower, upper = upper, lower
        if max(abs(lower), abs(upper)) > MAX_OFFSET:
            self.problems.append(f"{where}: limits {lower:g} .. {upper:g}; expected at most {MAX_OFFSET:g}")
        return (lower, upper, velocity, effort)

    def unused_limits(self, limit: ElementTree.Element, where: str) -> None:
        """Tell of limits of a continuous joint, which readers ignore; those of URDF 1.2 may not."""
        given = [f"{end}={limit.get(end)!r}" for end in ("lower", "upper") if end in limit.attrib]
        if given:
            text = f"{where}: it is continuous, so {' and '.join(given)} have no effect; a revolute joint has limits"
            (self.problems if self.version == "1.2" else self.unused).append(text)

    def soft_limits(
        self, joint: ElementTree.Element, kind: str, where: str, limits: tuple[float, float]
    ) -> tuple[float, float] | None:
        """The limits within which the robot's own controller keeps a joint, if they are narrower than its others.

        There it slows down and stops, so a plan beyond them would not be followed. MoveIt uses them the same way.
        """
        element = self.one(joint, "safety_controller", where)
        ends = ("soft_lower_limit", "soft_upper_limit")
        if element is None or kind in ("fixed", "continuous") or not any(end in element.attrib for end in ends):
            return None
        where = f"{where} safety_controller"
        if not all(end in element.attrib for end in ends):
            self.problems.append(f"{where}: expected both {' and '.join(ends)}, or neither")
            return None
        given = self.number(element, ends[0], where, limits[0]), self.number(element, ends[1], where, limits[1])
        lower, upper = max(limits[0], given[0]), min(limits[1], given[1])
        if lower >= upper:
            self.notes.append(
                f"{where}: {given[0]:g} .. {given[1]:g} leave no room within {limits[0]:g} .. {limits[1]:g};"
                " these soft limits are not used"
            )
            return None
        return None if (lower, upper) == limits else (lower, upper)

    def rates(self, joint: ElementTree.Element, kind: str, where: str) -> tuple[float, float]:
        """Acceleration and jerk that the file states; 0 where it states none."""
        element = joint.find("limit")
        if element is None or kind == "fixed":
            return (0.0, 0.0)
        found = {}
        for key in (*ACCELERATIONS, "jerk"):
            value = element.get(key, "").strip().lower()
            found[key] = 0.0 if value in ("inf", "+inf") else self.optional(element, key, f"{where} limit", 0.0)
            if found[key] < 0.0 or (key in element.attrib and found[key] == 0.0 and "inf" not in value):
                self.problems.append(f"{where} limit: {key} {value}; expected a positive number")
                found[key] = 0.0
        stated = [found[key] for key in ACCELERATIONS if found[key]]
        return (min(stated, default=0.0), found["jerk"])

    def mimic(self, joint: ElementTree.Element, where: str) -> Mimic | None:
        element = self.one(joint, "mimic", where)
        if element is None:
            return None
        where = f"{where} mimic"
        multiplier = self.optional(element, "multiplier", where, 1.0)
        if multiplier != 0.0 and not MIN_MULTIPLIER <= abs(multiplier) <= MAX_MULTIPLIER:
            expected = f"0, or a size from {MIN_MULTIPLIER:g} to {MAX_MULTIPLIER:g}"
            self.problems.append(f"{where}: multiplier {multiplier:g}; expected {expected}")
        return Mimic(element.get("joint", ""), multiplier, self.optional(element, "offset", where, 0.0))

    def tree(self, links: tuple[UrdfLink, ...], joints: tuple[UrdfJoint, ...]) -> str:
        """The root link; duplicate or missing names, several roots and cycles are problems."""
        for kind, names in (("link", [link.name for link in links]), ("joint", [joint.name for joint in joints])):
            self.problems += [f"{kind} {name!r} is defined {n} times" for name, n in Counter(names).items() if n > 1]
        known = {link.name for link in links}
        joint_names = {joint.name for joint in joints}
        for joint in joints:
            for end, link in (("parent", joint.parent), ("child", joint.child)):
                if link and link not in known:
                    self.problems.append(f"joint {joint.name!r}: {end} link {link!r} does not exist")
            if joint.mimic is not None and joint.mimic.joint not in joint_names - {joint.name}:
                self.problems.append(f"joint {joint.name!r}: mimics {joint.mimic.joint!r}, which is not another joint")
        self.problems += _mimic_circles({joint.name: joint.mimic.joint for joint in joints if joint.mimic is not None})
        parents = Counter(joint.child for joint in joints)
        self.problems += [f"link {name!r} has {n} parent joints; expected one" for name, n in parents.items() if n > 1]
        roots = sorted(known - set(parents))
        if len(roots) != 1:
            listed = ", ".join(roots) or ("none: the joints form a cycle" if known else "no link at all")
            self.problems.append(f"expected exactly one root link; found {listed}")
        return self.reachable(roots[0], known, joints) if len(roots) == 1 else ""

    def reachable(self, root: str, known: set[str], joints: tuple[UrdfJoint, ...]) -> str:
        children: dict[str, list[str]] = {}
        for joint in joints:
            children.setdefault(joint.parent, []).append(joint.child)
        seen, open_links = {root}, [root]
        while open_links:
            fresh = [child for child in children.get(open_links.pop(), []) if child not in seen]
            seen.update(fresh)
            open_links += fresh
        if known - seen:
            self.problems.append(f"links in a cycle, cut off from {root!r}: {', '.join(sorted(known - seen))}")
        return root

    def origin(self, element: ElementTree.Element, where: str) -> tuple[Vector, Vector]:
        origin = self.one(element, "origin", where)
        zero = (0.0, 0.0, 0.0)
        if origin is None:
            return zero, zero
        read = {
            key: self.numbers(origin, key, 3, f"{where} origin", zero) if key in origin.attrib else zero
            for key in ("xyz", "rpy")
        }
        if max(abs(value) for key in read for value in read[key]) > MAX_OFFSET:
            self.problems.append(f"{where}: origin {read['xyz']} {read['rpy']}; expected at most {MAX_OFFSET:g}")
            return zero, zero
        rpy = vector(read["rpy"])
        if "quat_xyzw" in origin.attrib:
            rpy = self.turned(origin, where, rpy if "rpy" in origin.attrib else None)
        return vector(read["xyz"]), rpy

    def turned(self, origin: ElementTree.Element, where: str, rpy: Vector | None) -> Vector:
        """Roll, pitch and yaw of the quaternion of an origin; ``rpy`` is what the origin gives besides."""
        if self.version == "1.0":
            self.problems.append(
                f'{where}: origin quat_xyzw is a word of URDF 1.1; write <robot version="1.1">, or rpy instead'
            )
        x, y, z, w = self.numbers(origin, "quat_xyzw", 4, f"{where} origin", (0.0, 0.0, 0.0, 1.0))
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        if not abs(norm - 1.0) <= UNIT:
            self.problems.append(f"{where}: origin quat_xyzw has length {norm:.4g}; expected 1")
            return (0.0, 0.0, 0.0)
        R = Pose((0.0, 0.0, 0.0), (w / norm, x / norm, y / norm, z / norm)).matrix[:3, :3]
        if rpy is not None and abs(R - rpy_matrix(*rpy)).max() > SAME:
            self.problems.append(f"{where}: origin rpy and quat_xyzw are different rotations; expected one of them")
        return rpy_of(R)

    def one(self, element: ElementTree.Element, tag: str, where: str) -> ElementTree.Element | None:
        """The child with that tag, if any; several are a problem, because readers differ in which one they use."""
        children = element.findall(tag)
        if len(children) > 1:
            self.problems.append(f"{where}: <{tag}> is given {len(children)} times")
        return children[0] if children else None

    def text(self, element: ElementTree.Element, key: str, where: str) -> str:
        value = element.get(key, "")
        if not value or value != value.strip():
            self.problems.append(f"<{where}> {key} = {value!r}; expected a name")
        return value

    def number(self, element: ElementTree.Element, key: str, where: str, stand_in: float) -> float:
        return self.numbers(element, key, 1, where, (stand_in,))[0]

    def optional(self, element: ElementTree.Element, key: str, where: str, default: float) -> float:
        return self.number(element, key, where, default) if key in element.attrib else default

    def numbers(
        self, element: ElementTree.Element, key: str, count: int, where: str, stand_in: tuple[float, ...]
    ) -> tuple[float, ...]:
        text = element.get(key)
        words = (text or "").split()
        try:
            values = tuple(map(plain_float, words))
        except ValueError:
            values = ()
        if len(words) == len(values) == count and all(math.isfinite(value) for value in values):
            return values
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        self.problems.append(f"{where}: {key} = {text!r}; expected {wanted}")
        return stand_in
