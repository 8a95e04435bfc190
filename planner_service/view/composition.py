"""What a picture shows and from where: robots opaque or faint, obstacles, lines, names, and the eye's place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner_service.geometry import FloatArray, Pose
from planner_service.path import JointPath
from planner_service.robot import Robot
from planner_service.scene import Scene
from planner_service.view.camera import Camera
from planner_service.view.lettering import CAPTION, Caption, Mark, lettered, place_of
from planner_service.view.paint import Drawing, Line, paint, placed
from planner_service.view.raster import EMPTY, cover, numbers_of, projected
from planner_service.view.solids import Colour, IntArray, Solid, is_ground, placements, robot_solids, scene_solids

__all__ = ["GOAL", "START", "TOOL_PATH", "TOUCHING", "WAY", "Kind", "Stand", "View", "picture", "tool_path"]

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Kind:
    """How a robot is drawn: the colour that stands for it, and its opacity."""

    colour: Colour
    opacity: float


START = Kind((192, 200, 211), 1.0)
"""Opaque, in the colours of its links, which differ a little."""

WAY = Kind((84, 140, 220), 0.26)
GOAL = Kind((58, 168, 104), 0.66)

TOUCHING: Colour = (218, 44, 44)
TOOL_PATH: Colour = (20, 84, 190)
AXES: tuple[Colour, ...] = ((214, 52, 52), (46, 150, 70), (40, 90, 210))
AXIS = 0.08
"""Metres."""

TINT = 0.72
"""How much of its colour a ghost has from what it stands for."""

TOUCHED, REACHED = 0.55, 0.9
"""Opacity of an obstacle that is touched, so that what is in it is seen, and of a ghost's link that touches it."""

MOVED = 0.001
"""Metres: a ghost's links that are within that of where they were at the start are not drawn again."""

POINTS = 200
"""Of a tool path."""

ELEVATION = 0.46
AZIMUTHS = tuple(math.radians(angle) for angle in (-50, 50, -25, 25, -80, 80, -130, 130))
"""Where the eye may be; the earlier ones are preferred."""

PREFERRED = 1.15
"""How many times as much of the robot another one has to show."""

TRIAL = (160, 90)
"""Pixels of the pictures in which the eye's places are compared."""

AROUND = 0.3
"""Part of the diagonal of all robot places by which obstacles beyond them are in the picture."""

MARGIN = 0.02
"""Part of the same that is left free around all."""


@dataclass(frozen=True, eq=False)
class Stand:
    """The robot at q (n,), which need not be within its limits; ``touching`` are the links to draw red."""

    q: FloatArray
    kind: Kind = START
    touching: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class View:
    """What a picture shows.

    Attributes:
        stands: The first is drawn opaque.
        lines: Tool paths.
        frames: Goals of the tool for which there is no configuration, drawn as axes.
    """

    robot: Robot
    scene: Scene
    stands: tuple[Stand, ...]
    lines: tuple[Line, ...] = ()
    frames: tuple[Pose, ...] = ()


def tool_path(robot: Robot, path: JointPath) -> Line:
    """The way of the tool frame's origin along a path."""
    places = path(path.length * (np.arange(POINTS) / (POINTS - 1)))
    return Line(np.array([[row[3] for row in robot.tool_rows(q)] for q in places]), TOOL_PATH, 3.2)


def _axes_at(pose: Pose) -> tuple[Line, ...]:
    """The axes of a frame as short lines: x red, y green, z blue."""
    T = pose.matrix
    return tuple(Line(np.stack([T[:3, 3], T[:3, 3] + AXIS * T[:3, k]]), AXES[k], 4.0) for k in range(3))


def picture(view: View, caption: Caption, size: tuple[int, int]) -> Image:
    """The picture of a view with names and a caption, (height, width, 3) of ``size`` (width, height)."""
    touching = frozenset[str]().union(*(stand.touching for stand in view.stands))
    robots = [_robot_at(view, stand) for stand in view.stands]
    obstacles = [solid for solid in scene_solids(view.scene) if solid.frame is None]
    red = [replace(o, colour=TOUCHING, opacity=TOUCHED) for o in obstacles if o.name in touching]
    lines = (*view.lines, *(line for frame in view.frames for line in _axes_at(frame)))
    drawing = Drawing(
        (*robots[0], *(o for o in obstacles if o.name not in touching)),
        (*_ghosts(view, robots), *((o,) for o in red)),
        lines,
    )
    inner = (size[0], size[1] - CAPTION)
    camera = _best_camera(robots, obstacles, lines, inner)
    image, owners = paint(drawing, camera, inner)
    links = [solid for robot in robots for solid in robot if solid.name in touching]
    goals = [Mark("goal", _pixel(camera, np.array(frame.position)), GOAL.colour) for frame in view.frames]
    marks = [*goals, *_marks([*links, *red], camera), *_visible_marks(drawing.solids, len(robots[0]), owners)]
    return lettered(image, marks, caption)


def _robot_at(view: View, stand: Stand) -> list[Solid]:
    """The robot and what it carries in the world, red where it touches."""
    poses = placements(view.robot, stand.q)
    riding = [*robot_solids(view.robot), *(solid for solid in scene_solids(view.scene) if solid.frame is not None)]
    out = []
    for solid in riding:
        colour = TOUCHING if solid.name in stand.touching else _tinted(solid.colour, stand.kind)
        out.append(replace(placed(solid, poses[solid.frame or ""]), colour=colour, opacity=stand.kind.opacity))
    return out


def _tinted(colour: Colour, kind: Kind) -> Colour:
    if kind is START:
        return colour
    r, g, b = (round(c + TINT * (k - c)) for c, k in zip(colour, kind.colour, strict=True))
    return (r, g, b)


def _ghosts(view: View, robots: Sequence[Sequence[Solid]]) -> list[tuple[Solid, ...]]:
    """The stands but the first, without what has hardly moved; links that touch apart, as they are seen better."""
    out = []
    for stand, robot in zip(view.stands[1:], robots[1:], strict=True):
        moved = [
            solid
            for solid, before in zip(robot, robots[0], strict=True)
            if float(np.abs(solid.vertices - before.vertices).max()) > MOVED
        ]
        out.append(tuple(solid for solid in moved if solid.name not in stand.touching))
        out.append(tuple(replace(solid, opacity=REACHED) for solid in robot if solid.name in stand.touching))
    return [group for group in out if group]


def _best_camera(
    robots: Sequence[Sequence[Solid]], obstacles: Sequence[Solid], lines: Sequence[Line], size: tuple[int, int]
) -> Camera:
    """Everything in view, seen from where most of the robots is not hidden."""
    points = _in_view(robots, obstacles, lines)
    bodies = [solid for robot in robots for solid in robot]
    corners = np.concatenate([solid.vertices[solid.faces] for solid in (*bodies, *obstacles)])
    of_robots = sum(len(solid.faces) for solid in bodies)
    best, most = AZIMUTHS[0], 0.0
    for azimuth in AZIMUTHS:
        camera = Camera.around(points, TRIAL, azimuth, ELEVATION)
        keys = cover(*projected(camera, corners, np.arange(len(corners))), TRIAL)
        shown = np.count_nonzero(numbers_of(keys[keys != EMPTY]) < of_robots)
        if shown > most * PREFERRED:
            best, most = azimuth, float(shown)
    return Camera.around(points, size, best, ELEVATION)


def _in_view(robots: Sequence[Sequence[Solid]], obstacles: Sequence[Solid], lines: Sequence[Line]) -> FloatArray:
    """Points (k, 3) to have in the picture: all robots, all lines, and of obstacles what is not far beyond these."""
    corners = [solid.vertices for robot in robots for solid in robot] + [line.points for line in lines]
    inner = np.concatenate(corners) if corners else np.zeros((1, 3))
    low, high = inner.min(axis=0), inner.max(axis=0)
    diagonal = max(math.dist(low.tolist(), high.tolist()), 0.1)
    points = [inner]
    for solid in obstacles:
        held = np.clip(solid.vertices, low - AROUND * diagonal, high + AROUND * diagonal)
        near = float(np.abs(held - solid.vertices).max(axis=1).min()) == 0.0
        if near and not is_ground(solid.vertices):
            points.append(held)
    found = np.concatenate(points)
    offsets = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    return (found[:, None] + MARGIN * diagonal * offsets).reshape(-1, 3)


def _marks(solids: Sequence[Solid], camera: Camera) -> list[Mark]:
    """Names in red at the middles of solids, each once."""
    out: dict[str, Mark] = {}
    for solid in solids:
        middle = (solid.vertices.min(axis=0) + solid.vertices.max(axis=0)) / 2
        out.setdefault(solid.name, Mark(solid.name, _pixel(camera, middle), TOUCHING))
    return list(out.values())


def _pixel(camera: Camera, point: FloatArray) -> tuple[float, float]:
    """Where a point in view is in the picture."""
    x, y, _ = camera.pixels(camera.seen(point)).tolist()
    return x, y


def _visible_marks(solids: Sequence[Solid], first: int, owners: IntArray) -> list[Mark]:
    """Names of solids from the one numbered ``first`` on, those that are seen most before others."""
    areas = np.bincount(owners[owners >= 0], minlength=len(solids)).tolist()
    order = sorted(range(first, len(solids)), key=lambda k: (-areas[k], k))
    places = [(solids[k].name, place_of(owners, k)) for k in order]
    return [Mark(name, at) for name, at in places if at is not None]
