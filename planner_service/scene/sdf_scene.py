"""Worlds in SDFormat, as Gazebo, Drake and Isaac take them (sdformat.org/spec).

A pose stands in the frame that ``relative_to`` names, else in what holds it; frames are links, joints, nested models
and ``<frame>``, called by their names in their model and by ``model::name`` from outside. Nothing moves: joints stand
at zero. A table of all words (``docs/reference/robot-words.md``) says what is read, has no effect or is refused.
"""

from __future__ import annotations

import math
import os
import reprlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.files.numerals import plain_floats
from planner_service.files.reading import as_path, tell_notes
from planner_service.files.xml_reader import read_xml
from planner_service.geometry.around import Plane, around_cone, around_ellipsoid
from planner_service.geometry.composite import Compound, Solid
from planner_service.geometry.mesh_paths import MeshLoader
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Sphere
from planner_service.robot.elements.table import unlisted_words, words_of
from planner_service.scene.obstacle_list import ObstacleList
from planner_service.scene.scene import Scene

__all__ = ["read_sdf_scene"]

VERSIONS = tuple(f"1.{minor}" for minor in range(4, 13))

MAX_PIECES = 16
"""Convex pieces of a mesh whose hull fills much more than it does."""

SAME = 1e-6
"""Difference of poses that is rounding, in metres and entries of a rotation."""

SIZED: Mapping[str, tuple[Callable[..., Solid], tuple[str, ...]]] = {
    "sphere": (Sphere, ("radius",)),
    "cylinder": (Cylinder, ("radius", "length")),
    "capsule": (Capsule, ("radius", "length")),
    "cone": (around_cone, ("radius", "length")),
}
"""Shapes by a function of their sizes, and the elements that have these."""


def read_sdf_scene(path: str | os.PathLike[str]) -> Scene:
    """The collision shapes of an SDFormat world, or of the models of a file without one, in the file's order.

    The frame of the world is taken as the robot's base frame. The obstacle of a model with one link that has shapes is
    called as the model, else ``model::link``; the second shape of a link has ``#2`` behind that. Cones and ellipsoids
    become polytopes around them, a plane a box below it, and meshes are cut where their hulls fill much more.

    Raises:
        InvalidFile: with every problem found: a word that is refused or not known, another file, a name that is taken
            or leads nowhere, a size or pose that is none.
    """
    path = as_path("path", path)
    root = read_xml(path, "sdf")
    reader = _Reader(path)
    words = unlisted_words(root, words_of("sdf"))
    reader.found.problems += words.refused
    reader.read(root)
    scene = reader.found.scene(path, reader.name)
    tell_notes(path, [*words.told, *reader.notes])
    return scene


@dataclass(eq=False)
class _Frame:
    """Where a named frame is: a pose in the frame that ``relative_to`` names in its scope."""

    relative_to: str
    pose: Pose
    model: _Scope | None = None
    placement: str = ""


@dataclass(eq=False)
class _Scope:
    """The names in a world or in a model."""

    root: str
    path: str = ""
    frames: dict[str, _Frame] = field(default_factory=dict)


class _Unclear(Exception):
    """A pose that cannot be worked out; the message says why."""


class _Reader:
    def __init__(self, path: Path) -> None:
        self.found = ObstacleList()
        self.notes: list[str] = []
        self.name = ""
        self.meshes = MeshLoader((path.resolve().parent, *path.resolve().parent.parents[:1]))

    def read(self, root: Element) -> None:
        """Read everything, and note what is wrong."""
        version = root.get("version", "")
        if version not in VERSIONS:
            self.found.problems.append(f"<sdf>: version {version!r}; expected {VERSIONS[0]} to {VERSIONS[-1]}")
        worlds = root.findall("world")
        if len(worlds) + bool(root.findall("model")) != 1:
            self.found.problems.append(
                f"{len(worlds)} worlds and {len(root.findall('model'))} models; expected one world, or models"
            )
            return
        holder = worlds[0] if worlds else root
        self.name = holder.get("name", "")
        world = _Scope("world")
        self.declare(world, holder)
        for model in holder.findall("model"):
            self.model(world, Pose(), model)
        for state in holder.findall("state"):
            self.state(world, state)

    def declare(self, scope: _Scope, holder: Element) -> None:
        """Note all frames that a world or model has."""
        for element in holder:
            name = element.get("name", "")
            if element.tag not in ("link", "frame", "joint", "model"):
                continue
            where = f"{element.tag} {_called(scope, name)!r}"
            if not name or "::" in name or name in scope.frames or name in ("world", "__model__", "__root__"):
                self.found.problems.append(
                    f"{where}: the name is {'taken' if name in scope.frames else 'none'}; expected one of its own"
                )
                continue
            relative_to, pose = self.pose(element, where)
            if element.tag == "frame" and not relative_to:
                relative_to = element.get("attached_to", "")
            if element.tag == "joint":
                self.joint(element, where)
                relative_to = relative_to or (element.findtext("child") or "").strip()
            frame = _Frame(relative_to or scope.root, pose)
            if element.tag == "model":
                frame.model = _Scope("__model__", _called(scope, name))
                frame.placement = element.get("placement_frame", "")
                self.declare(frame.model, element)
            scope.frames[name] = frame

    def joint(self, element: Element, where: str) -> None:
        kind = element.get("type", "")
        if kind != "fixed":
            self.notes.append(f"{where}: it can move ({kind}), and stands at zero here: nothing in a scene moves")

    def model(self, scope: _Scope, stands: Pose, element: Element) -> None:
        """Take the shapes of a model; ``stands`` is where its scope is in the world."""
        frame = scope.frames.get(element.get("name", ""))
        if frame is None or frame.model is None:
            return
        inner = frame.model
        there = self.placed(scope, stands, element.get("name", ""), f"model {inner.path!r}")
        links = [link for link in element.findall("link") if link.find("collision") is not None]
        for link in links:
            name = link.get("name", "")
            label = inner.path if len(links) == 1 else _called(inner, name)
            where = f"link {_called(inner, name)!r}"
            at = None if there is None else self.placed(inner, there, name, where)
            solid = [collision for collision in link.findall("collision") if collision.find("geometry/empty") is None]
            for k, collision in enumerate(solid):
                self.collision(
                    collision, f"{where} collision[{k}]", label if k == 0 else f"{label}#{k + 1}", inner, there, at
                )
        for nested in element.findall("model"):
            if there is not None:
                self.model(inner, there, nested)

    def collision(
        self, element: Element, where: str, label: str, scope: _Scope, model: Pose | None, link: Pose | None
    ) -> None:
        """Take a shape; ``model`` and ``link`` are where those are in the world that hold it."""
        relative_to, pose = self.pose(element, where)
        above = self.placed(scope, model, relative_to, where) if relative_to and model is not None else link
        kinds = [kind for geometry in element.findall("geometry") for kind in geometry]
        if len(kinds) != 1 or len(element.findall("geometry")) != 1:
            self.found.problems.append(f"{where}: {len(kinds)} shapes; expected one <geometry> with one shape")
            return
        shape = self.found.attempt(where, lambda: self.shape(kinds[0], where))
        stands = None if above is None else above @ pose
        if isinstance(shape, Plane):
            shape, stands = shape.below(stands)
        self.found.add(where, label, shape, stands)

    def placed(self, scope: _Scope, stands: Pose, name: str, where: str) -> Pose | None:
        """Where a frame is in the world, if its scope's root is at ``stands``."""
        try:
            return stands @ _pose_in(scope, name, ())
        except _Unclear as problem:
            self.found.problems.append(f"{where}: {problem}")
            return None

    def state(self, world: _Scope, element: Element) -> None:
        """Check that a saved state has the models where they are."""
        for model in element.findall("model"):
            name = model.get("name", "")
            where = f"<state> model {name!r}"
            if name not in world.frames:
                self.found.problems.append(f"{where}: there is no such model; delete <state>")
                continue
            placed = self.placed(world, Pose(), name, where)
            _, told = self.pose(model, where)
            if placed is not None and float(np.abs(placed.matrix - told.matrix).max()) > SAME:
                self.found.problems.append(
                    f"{where}: another pose than that of the model; delete <state>, or copy its poses"
                )

    def shape(self, element: Element, where: str) -> Solid | Plane:
        kind = str(element.tag)
        if kind == "box":
            x, y, z = _numbers(element, "size", 3)
            return Box((x, y, z))
        if kind == "plane":
            a, b, c = _numbers(element, "normal", 3, (0.0, 0.0, 1.0))
            return Plane.of(a, b, c, 0.0)
        if kind == "ellipsoid":
            around, growth = around_ellipsoid(_numbers(element, "radii", 3))
            self.notes.append(
                f"{where}: an ellipsoid is checked as a polytope around it, up to {growth * 1e3:.2g} mm larger"
            )
            return around
        if kind == "mesh":
            scale = _numbers(element, "scale", 3, (1.0, 1.0, 1.0))
            pieces = self.meshes.pieces((element.findtext("uri") or "").strip(), scale, MAX_PIECES)
            return pieces[0] if len(pieces) == 1 else Compound.of_pieces(pieces)
        if kind not in SIZED:
            raise InvalidRequest("geometry", kind, "box, sphere, cylinder, capsule, cone, ellipsoid, plane or mesh")
        make, keys = SIZED[kind]
        return make(*(_numbers(element, key, 1)[0] for key in keys))

    def pose(self, element: Element, where: str) -> tuple[str, Pose]:
        """What the pose of an element is relative to, empty if it does not say so, and the pose."""
        found = element.find("pose")
        if found is None:
            return "", Pose()
        given = {name for name, value in found.attrib.items() if value or name != "frame"}
        unknown = sorted(given - {"relative_to", "rotation_format", "degrees"})
        if unknown or len(element.findall("pose")) > 1:
            self.found.problems.append(
                f"{where}: <pose> {', '.join(unknown) or 'twice'}; expected it once, and no attributes but "
                "relative_to, rotation_format and degrees"
            )
        pose = self.found.attempt(f"{where} <pose>", lambda: _pose_of(found))
        return found.get("relative_to", ""), pose or Pose()


def _called(scope: _Scope, name: str) -> str:
    return f"{scope.path}::{name}" if scope.path else name


def _pose_in(scope: _Scope, name: str, trail: tuple[tuple[int, str], ...]) -> Pose:
    """The pose of the frame ``name`` in the root frame of its scope; ``trail`` are those that are waiting for it."""
    if name == scope.root:
        return Pose()
    first, _, rest = name.partition("::")
    frame = scope.frames.get(first)
    if frame is None or (rest and frame.model is None):
        known = ", ".join([scope.root, *scope.frames])
        raise _Unclear(f"no frame {reprlib.repr(name)}; expected one of {known[:200]}")
    step = (id(scope), first)
    if step in trail or len(trail) > 200:
        raise _Unclear(f"the pose of {reprlib.repr(name)} depends on itself")
    pose = _pose_in(scope, frame.relative_to, (*trail, step)) @ frame.pose
    if frame.model is not None and frame.placement:
        pose = pose @ _pose_in(frame.model, frame.placement, (*trail, step)).inverse()
    return pose @ _pose_in(frame.model, rest, (*trail, step)) if rest and frame.model is not None else pose


def _pose_of(element: Element) -> Pose:
    """The pose that an element's text spells.

    Raises:
        InvalidRequest: it spells none.
    """
    form, degrees = element.get("rotation_format", "euler_rpy"), element.get("degrees", "false")
    expected = "x y z roll pitch yaw, or x y z and a quaternion x y z w with rotation_format quat_xyzw"
    if form not in ("euler_rpy", "quat_xyzw") or degrees not in ("true", "false", "1", "0"):
        raise InvalidRequest("pose", (form, degrees), f"{expected}, and degrees true or false")
    if not (element.text or "").strip():
        return Pose()
    values = _listed("pose", element.text, 7 if form == "quat_xyzw" else 6, expected)
    if form == "quat_xyzw":
        qx, qy, qz, qw = values[3:]
        return Pose((values[0], values[1], values[2]), (qw, qx, qy, qz))
    turned = [math.radians(value) for value in values[3:]] if degrees in ("true", "1") else values[3:]
    return Pose.from_rpy(values[:3], turned)


def _numbers(element: Element, key: str, count: int, otherwise: Sequence[float] | None = None) -> list[float]:
    """The numbers in the one element ``key`` inside ``element``."""
    found = element.findall(key)
    expected = f"one <{key}> of {count} finite number{'s' if count > 1 else ''}"
    if not found and otherwise is not None:
        return list(otherwise)
    if len(found) != 1:
        raise InvalidRequest(key, len(found), expected)
    return _listed(key, found[0].text, count, expected)


def _listed(key: str, text: str | None, count: int, expected: str) -> list[float]:
    try:
        values = plain_floats(text or "")
    except ValueError as error:
        raise InvalidRequest(key, str(error), expected) from None
    if len(values) != count or not all(map(math.isfinite, values)):
        raise InvalidRequest(key, " ".join((text or "").split())[:80], expected)
    return values
