"""What stands around the robot and what it carries, as values, and the TOML files they are kept in.

A scene file::

    name = "example"                                    # optional, as is description = "..."

    [[obstacle]]
    name = "post"
    cylinder = { radius = 0.03, length = 0.4 }          # or capsule = {...}, box = [x, y, z] (full lengths), sphere = r
    position = [0.3, 0.0, 0.2]                          # of the shape's centre, in the robot's base frame, metres
    quaternion_wxyz = [1.0, 0.0, 0.0, 0.0]              # optional
    colour = "#c86432"                                  # optional, for pictures

    [[obstacle]]                                        # a mesh is judged as its solid convex hull, in its own frame
    name = "cup"
    mesh = { file = "cup.stl", scale = [0.001, 0.001, 0.001] }   # or mesh = "cup.stl", or mesh = { vertices = [...] };
    position = [0.2, 0.1, 0.0]                          # pieces = 8 cuts it into as many convex ones

    [[obstacle]]                                        # every cell of the grid that holds a point is solid
    name = "bin"
    cloud = { file = "scan.ply", resolution = 0.01 }    # PLY, NPZ or NPY; or heights = { file = "g.npz", cell = 0.01 }
    position = [0.0, 0.0, 0.0]

    [[obstacle]]                                        # several convex shapes as one object
    name = "stool"
    compound = [{ box = [0.3, 0.3, 0.02], position = [0.0, 0.0, 0.2] }, { cylinder = {...}, position = [...] }]
    position = [0.3, 0.0, 0.0]

    [[attached]]                                        # the same, with its pose in the tool frame,
    touch_links = ["finger_left", "finger_right"]       # the links that may touch it, and what motions keep meanwhile,
    constraints = [{ kind = "joint range", ... }]       # with the keys of a constraint file
    mass = 0.4                                          # optional, kilograms, for torque limits
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

from planner_service.constraints.values import Constraint, checked_constraints
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.files.package_data import data_folder
from planner_service.geometry.composite import Compound, HeightField, PointCloud, Solid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Sphere
from planner_service.geometry.validation import MAX_LENGTH, checked_name, items, number, text, unusable_text
from planner_service.presentation.measures import numbers_text
from planner_service.presentation.tables import Block, Table, render_html, render_text
from planner_service.robot.inertia import MAX_MASS

__all__ = ["KIND_SUFFIXES", "Attached", "Obstacle", "Scene", "scene_blocks", "scene_names"]

KIND_SUFFIXES = (" (link)", " (object)")
"""Endings that distinguish a link and an object of one name in print; no object's own name ends so."""
MAX_DESCRIPTION = 1000
COLOUR = re.compile(r"#[0-9a-f]{6}", re.ASCII | re.IGNORECASE)
MAX_OBJECTS = 10_000
"""A scene made by hand or from detections has far fewer; more would rather be a point cloud."""

_KINDS: tuple[type[Solid], ...] = (Box, Sphere, Cylinder, Capsule, Mesh, Compound, PointCloud, HeightField)
_KIND_NAMES: Mapping[type, str] = {PointCloud: "cloud", HeightField: "heights"}
"""What a hash calls a kind of shape, where that is not its class."""

_ANY_KIND = "one of " + ", ".join(kind.__name__ for kind in _KINDS)


def checked_description(value: Any) -> str:
    """The description of a scene, if it can be one."""
    if not isinstance(value, str) or len(value) > MAX_DESCRIPTION or not value.replace("\n", "").isprintable():
        raise unusable_text("description", value, f"at most {MAX_DESCRIPTION} printable characters and line ends")
    return value


def checked_colour(value: Any) -> str:
    """The colour of an obstacle, if it can be one."""
    if not isinstance(value, str) or not COLOUR.fullmatch(value):
        raise unusable_text("colour", value, 'red, green and blue in hexadecimal, such as "#c86432"')
    return value


def _check_body(name: str, shape: Any, pose: Any) -> None:
    if checked_name("name", name).endswith(KIND_SUFFIXES):
        raise InvalidRequest("name", name, f"a name that does not end in {' or '.join(map(repr, KIND_SUFFIXES))}")
    if not isinstance(shape, _KINDS):
        raise InvalidRequest(f"shape of {name!r}", shape, _ANY_KIND)
    if not isinstance(pose, Pose):
        raise InvalidRequest(f"pose of {name!r}", pose, "a Pose")
    if max(abs(v) for v in pose.position) > MAX_LENGTH:
        raise InvalidRequest(f"position of {name!r}", pose.position, f"metres, at most {MAX_LENGTH:g} along each axis")


@dataclass(frozen=True)
class Obstacle:
    """A named shape that stands still in the world; ``pose`` is the shape's in the robot's base frame.

    Args:
        colour: What it is drawn in, as ``"#rrggbb"``; None for one that the viewer chooses. It is kept in scene files
            only, changes no verdict and no hash, and is not compared.

    Raises:
        InvalidRequest: the name is empty, longer than 64 characters, unprintable, has spaces at its
            ends or ends in " (link)" or " (object)"; shape or pose is of another kind; the position is
            beyond 1 km (a unit mistake); the colour is not of that form.
    """

    name: str
    shape: Solid
    pose: Pose = field(default_factory=Pose)
    colour: str | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        _check_body(self.name, self.shape, self.pose)
        if self.colour is not None:
            checked_colour(self.colour)


@dataclass(frozen=True)
class Attached:
    """A named shape that moves with the tool; ``pose`` is the shape's in the tool frame.

    Args:
        touch_links: Names of the robot's links that may touch it, as the fingers that hold it do; they have to have
            collision shapes, which is checked once robot and scene meet.
        constraints: What every motion keeps while it is carried, as in ``PlanRequest.constraints``.
        mass: Kilograms, spread evenly over the shape; None if it is not known, and then left out of torques.

    Raises:
        InvalidRequest: as for ``Obstacle``, or ``touch_links`` is one text, or names a link twice, or ``constraints``
            are none, or ``mass`` is not above 0 and at most 10,000.
    """

    name: str
    shape: Solid
    pose: Pose
    touch_links: tuple[str, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    mass: float | None = None

    def __post_init__(self) -> None:
        _check_body(self.name, self.shape, self.pose)
        if self.mass is not None:
            expected = f"kilograms above 0 and at most {MAX_MASS:g}, or None"
            object.__setattr__(self, "mass", number("mass", self.mass, expected, math.ulp(0.0), MAX_MASS))
        object.__setattr__(self, "constraints", checked_constraints(self.constraints))
        links = items("touch_links", self.touch_links, str, "a sequence of link names")
        object.__setattr__(self, "touch_links", links)
        for link in links:
            checked_name("touch_links", link)
        if len(set(links)) != len(links):
            raise InvalidRequest("touch_links", links, "each link once")


@dataclass(frozen=True)
class Scene:
    """Everything that can be hit besides the robot itself; a value, so every change is a new scene.

    The order of the obstacles is kept and is part of what a scene is: they are judged in that order,
    and counts may depend on it.

    Raises:
        InvalidRequest: a name is there twice (among obstacles and attached objects together), an
            element is no ``Obstacle`` or ``Attached``, there are more than 10,000 of them, or
            ``name`` or ``description`` has unprintable characters or is longer than 64 or 1000.
    """

    obstacles: tuple[Obstacle, ...] = ()
    attached: tuple[Attached, ...] = ()
    name: str = ""
    description: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "obstacles", items("obstacles", self.obstacles, Obstacle, "a sequence of Obstacle"))
        object.__setattr__(self, "attached", items("attached", self.attached, Attached, "a sequence of Attached"))
        if len(self.names) > MAX_OBJECTS:
            raise InvalidRequest("scene", len(self.names), f"at most {MAX_OBJECTS:,} obstacles and attached objects")
        seen: set[str] = set()
        for name in self.names:
            if name in seen:
                raise InvalidRequest("name", name, "each name once among obstacles and attached objects")
            seen.add(name)
        if text("name", self.name) != "":
            checked_name("name of the scene", self.name)
        checked_description(self.description)

    def __repr__(self) -> str:
        attached = f", {len(self.attached)} attached" if self.attached else ""
        return f"Scene({self.name!r}, {len(self.obstacles)} obstacles{attached})"

    def __str__(self) -> str:
        return render_text(scene_blocks(self))

    def _repr_html_(self) -> str:
        return render_html(scene_blocks(self))

    @cached_property
    def constraints(self) -> tuple[Constraint, ...]:
        """What motions keep because of what is attached, each once."""
        return tuple(dict.fromkeys(constraint for held in self.attached for constraint in held.constraints))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the obstacles, then those of the attached objects."""
        return tuple(o.name for o in self.obstacles) + tuple(a.name for a in self.attached)

    def obstacle(self, name: str) -> Obstacle:
        """The obstacle of that name.

        Raises:
            UnknownName: there is none.
        """
        return self.obstacles[self._index(name)]

    def with_obstacle(self, obstacle: Obstacle) -> Scene:
        """This scene with one more obstacle, last in order.

        Raises:
            InvalidRequest: the name is taken.
        """
        return replace(self, obstacles=(*self.obstacles, obstacle))

    def without(self, name: str) -> Scene:
        """This scene without the obstacle of that name.

        Raises:
            UnknownName: there is none.
        """
        k = self._index(name)
        return replace(self, obstacles=self.obstacles[:k] + self.obstacles[k + 1 :])

    def moved(self, name: str, pose: Pose) -> Scene:
        """This scene with that obstacle at another pose, in the same place in order.

        Raises:
            UnknownName: there is no such obstacle.
        """
        k = self._index(name)
        obstacle = replace(self.obstacles[k], pose=pose)
        return replace(self, obstacles=(*self.obstacles[:k], obstacle, *self.obstacles[k + 1 :]))

    def with_attached(self, attached: Attached) -> Scene:
        """This scene with one more object at the tool; an obstacle of that name has to go first.

        Raises:
            InvalidRequest: the name is taken.
        """
        return replace(self, attached=(*self.attached, attached))

    def without_attached(self, name: str) -> Scene:
        """This scene without the attached object of that name.

        Raises:
            UnknownName: there is none.
        """
        text("name", name)
        left = tuple(a for a in self.attached if a.name != name)
        if len(left) == len(self.attached):
            raise UnknownName("attached object", name, (a.name for a in self.attached))
        return replace(self, attached=left)

    @cached_property
    def hash(self) -> str:
        """SHA-256, in hex, of names, shapes, poses, touch links, constraints and masses, to the last bit and in order.

        The scene's own name and description are left out: they change no verdict. Equal scenes
        have equal hashes (-0.0 counts as 0.0); the same obstacles in another order have another.
        """
        content = {
            "obstacles": [_canonical(o) for o in self.obstacles],
            "attached": [_canonical_attached(a) for a in self.attached],
        }
        return _digest(content)

    @cached_property
    def obstacle_hashes(self) -> Mapping[str, str]:
        """SHA-256, in hex, of each obstacle's shape and pose, by its name: which of them two scenes have in common."""
        return MappingProxyType({o.name: _digest(_canonical(o)) for o in self.obstacles})

    @cached_property
    def attached_hash(self) -> str:
        """SHA-256, in hex, of all that is attached to the tool."""
        return _digest([_canonical_attached(a) for a in self.attached])

    def __getstate__(self) -> dict[str, Any]:
        """Sent to another process, a scene leaves behind what it has worked out: views of it cannot be sent."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    def _index(self, name: str) -> int:
        text("name", name)
        for k, obstacle in enumerate(self.obstacles):
            if obstacle.name == name:
                return k
        raise UnknownName("obstacle", name, (o.name for o in self.obstacles))


def _canonical(body: Obstacle | Attached) -> list[Any]:
    return [body.name, *_canonical_shape(body.shape), *_canonical_pose(body.pose)]


def _canonical_attached(held: Attached) -> list[Any]:
    kept = [_canonical_constraint(constraint) for constraint in held.constraints]
    mass = [] if held.mass is None else [["mass", _bits(held.mass)]]
    return [*_canonical(held), list(held.touch_links), *([kept] if kept else []), *mass]


def _canonical_constraint(constraint: Constraint) -> list[Any]:
    values = [getattr(constraint, item.name) for item in fields(constraint)]
    return [_canonical_value(value) for value in values]


def _canonical_value(value: Any) -> Any:
    if isinstance(value, Pose):
        return _canonical_pose(value)
    if isinstance(value, tuple):
        return list(map(_bits, value))
    return _bits(value) if isinstance(value, float) else value


def _canonical_pose(pose: Pose) -> list[str]:
    return list(map(_bits, (*pose.position, *pose.quaternion)))


def _canonical_shape(shape: Solid) -> list[Any]:
    """What makes a solid, to the last bit."""
    kind = _KIND_NAMES.get(type(shape), type(shape).__name__.lower())
    if isinstance(shape, Compound):
        return [kind, *([*_canonical_shape(part), *_canonical_pose(pose)] for part, pose in shape.parts)]
    if isinstance(shape, (Mesh, PointCloud, HeightField)):
        return [kind, shape.digest]
    sizes = shape.size if isinstance(shape, Box) else vars(shape).values()
    return [kind, *map(_bits, sizes)]


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode("ascii")).hexdigest()


def _bits(value: float) -> str:
    return (value + 0.0).hex()  # + 0.0 drops the sign of -0.0


def scene_names() -> tuple[str, ...]:
    """The names of the scenes that come with the package, sorted."""
    return tuple(sorted(path.stem for path in data_folder("scenes").glob("*.toml")))


def scene_blocks(scene: Scene) -> list[Block]:
    """A scene as ``planner-service scenes NAME`` prints it."""
    bodies: list[tuple[Obstacle | Attached, str]] = [(body, body.name) for body in scene.obstacles]
    bodies += [(body, f"{body.name} (attached)") for body in scene.attached]
    title = ": ".join(filter(None, (scene.name or "unnamed scene", " ".join(scene.description.split()))))
    heads = ["obstacle", "shape", "size", "position", "quaternion wxyz"]
    rows: list[tuple[str, ...]] = [
        (name, *_shape_cells(body.shape), numbers_text(body.pose.position), numbers_text(body.pose.quaternion))
        for body, name in bodies
    ]
    if all(body.pose.quaternion == Pose().quaternion for body, _ in bodies):
        heads, rows = heads[:-1], [row[:-1] for row in rows]
    return [title, "", Table(heads, rows)]


def _shape_cells(shape: Solid) -> tuple[str, str]:
    """The kind of a shape, and its size in metres."""
    if isinstance(shape, Box):
        return "box", numbers_text(shape.size)
    if isinstance(shape, Mesh):
        return "mesh", f"{len(shape.vertices)} corners"
    if isinstance(shape, PointCloud):
        return "point cloud", f"{len(shape.cells):,} cells of {shape.resolution:g}"
    if isinstance(shape, HeightField):
        return "height field", f"{shape.heights.size:,} columns of {shape.cell:g}"
    if isinstance(shape, Compound):
        return "compound", f"{len(shape.parts)} parts"
    sizes = ", ".join(f"{name} {value:g}" for name, value in vars(shape).items())
    return type(shape).__name__.lower(), sizes
