"""Composes a picture: robots opaque or translucent, obstacles, lines and names, and where it is seen from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planner_service.constraints.values import Constraint
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot
from planner_service.scene.names import Names
from planner_service.scene.scene import Scene
from planner_service.view.regions import Kept, edges, frames_at, rectangles
from planner_service.view.still.camera import Camera, combined
from planner_service.view.still.lettering import CAPTION, INK, Caption, Mark, lettered, place_of
from planner_service.view.still.paint import Drawing, Line, paint, placed
from planner_service.view.still.sights import Sights
from planner_service.view.triangles import (
    TOOL,
    Colour,
    IntArray,
    Solid,
    is_ground,
    placements,
    robot_solids,
    scene_solids,
)

__all__ = [
    "GOAL",
    "KEPT",
    "START",
    "TOOL_PATH",
    "TOUCHING",
    "WAY",
    "Kind",
    "Stand",
    "View",
    "bounds",
    "camera_of",
    "floor",
    "picture",
    "tool_path",
]

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
KEPT: Colour = (0, 150, 160)
"""Of constraints that hold; on the page, those that do not have the colour of what touches."""
AXES: tuple[Colour, ...] = ((214, 52, 52), (46, 150, 70), (40, 90, 210))
AXIS, BELOW = 0.08, 18.0
"""Metres of the axes of a frame, and pixels below its origin for its name."""

TINT = 0.72
"""Share of a ghost's colour that comes from its kind; the rest is the link's own."""

TOUCHED, REACHED = 0.55, 0.9
"""Opacity of an obstacle in contact, through which one sees what is inside it (a table has half of that, or most of the
picture would be red), and of a ghost's link in contact."""

MOVED = 0.001
"""Metres: links of a ghost that are nearer than this to where they were at the start are not drawn again."""

POINTS = 200
"""Of a tool path."""

GRID: Colour = (214, 220, 228)
CELLS, MOST_CELLS = (0.1, 0.2, 0.5, 1.0, 10.0, 100.0, 1000.0), 16
"""Metres between the grid lines of the floor, and the most cells across everything in view."""


@dataclass(frozen=True, eq=False)
class Stand:
    """The robot at q (n,), which need not be within its limits.

    Attributes:
        touching: The labels of what to draw red.
        marked: Colours of other links, by their labels.
    """

    q: FloatArray
    kind: Kind = START
    touching: frozenset[str] = frozenset()
    marked: Mapping[str, Colour] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class View:
    """What a picture shows.

    Attributes:
        stands: The first is drawn opaque.
        lines: Tool paths and bounds.
        frames: Goals of the tool for which there is no configuration, drawn as axes.
        sheets: Translucent surfaces in the world, without names.
    """

    robot: Robot
    scene: Scene
    stands: tuple[Stand, ...]
    lines: tuple[Line, ...] = ()
    frames: tuple[Pose, ...] = ()
    sheets: tuple[Solid, ...] = ()


def tool_path(robot: Robot, path: JointPath) -> Line:
    """The line of the tool frame's origin along a path."""
    places = path(path.length * (np.arange(POINTS) / (POINTS - 1)))
    return Line(robot.tool_origins(places), TOOL_PATH, 3.2)


def bounds(robot: Robot, constraints: Sequence[Constraint], Q: FloatArray) -> tuple[Line, ...]:
    """The outlines of the bounds on coordinates of a motion through Q (m, n), where they are at the first of them."""
    kept = Kept.of(robot, tuple(constraints), Q)
    lines: list[Line] = []
    for at in () if kept is None else kept.constraints.regions:
        frames = frames_at(robot, at, Q)
        T = frames.region[0]
        lines += [
            Line(combined(T[:3, :3], side) + T[:3, 3], KEPT, 2.0)
            for side in edges(rectangles(at.region, frames.points))
        ]
    return tuple(lines)


def _axes_at(pose: Pose) -> tuple[Line, ...]:
    """The axes of a frame as short lines: x red, y green, z blue."""
    T = pose.matrix
    return tuple(Line(np.stack([T[:3, 3], T[:3, 3] + AXIS * T[:3, k]]), AXES[k], 4.0) for k in range(3))


def camera_of(views: Sequence[View], size: tuple[int, int]) -> Camera:
    """One camera for pictures of several views of one scene, (width, height) of which are ``size``."""
    bodies = [_bodies(view) for view in views]
    robots = [solid for _, robots in bodies for robot in robots for solid in robot]
    lines = [line for view in views for line in _lines(view)]
    return Sights(robots, bodies[0][0], lines).camera((size[0], size[1] - CAPTION))


def picture(view: View, caption: Caption, size: tuple[int, int], camera: Camera | None = None) -> Image:
    """The picture of a view with names and a caption, (height, width, 3) of ``size`` (width, height).

    Args:
        camera: Of the picture without the caption; one that sees all of the view if None.
    """
    touching = frozenset[str]().union(*(stand.touching for stand in view.stands))
    obstacles, robots = _bodies(view)
    red = [_reddened(o) for o in obstacles if o.name in touching]
    lines = _lines(view)
    sights = Sights([*(solid for robot in robots for solid in robot), *view.sheets], obstacles, lines)
    drawing = Drawing(
        (*robots[0], *(o for o in obstacles if o.name not in touching)),
        (*_ghosts(view, robots), *((o,) for o in red), *((sheet,) for sheet in view.sheets)),
        lines,
        () if any(is_ground(solid.vertices) for solid in obstacles) else floor(sights.points),
    )
    inner = (size[0], size[1] - CAPTION)
    camera = sights.camera(inner) if camera is None else camera
    image, owners = paint(drawing, camera, inner)
    struck = [s for stand, robot in zip(view.stands, robots, strict=True) for s in robot if s.name in stand.touching]
    marked = [s for stand, robot in zip(view.stands, robots, strict=True) for s in robot if s.name in stand.marked]
    goals = [_pixel(camera, np.array(frame.position)) for frame in view.frames]
    marks = [
        *(Mark("goal", (x, y + BELOW), GOAL.colour) for x, y in goals),
        *_marks([*struck, *red], camera),
        *(replace(mark, colour=INK) for mark in _marks(marked, camera)),
        *_visible_marks(drawing.solids, len(robots[0]), owners),
    ]
    return lettered(image, marks, caption)


def _bodies(view: View) -> tuple[list[Solid], list[list[Solid]]]:
    """The obstacles of a view, and each stand's robot with what it carries, in the world and by their labels."""
    names = Names(view.robot, view.scene)
    solids = [replace(solid, name=names.object(solid.name)) for solid in scene_solids(view.scene)]
    links = [replace(solid, name=names.link(solid.name)) for solid in robot_solids(view.robot)]
    riding = [*links, *(solid for solid in solids if solid.frame is not None)]
    obstacles = [solid for solid in solids if solid.frame is None]
    return obstacles, [_robot_at(view.robot, riding, stand) for stand in view.stands]


def _lines(view: View) -> tuple[Line, ...]:
    return (*view.lines, *(line for frame in view.frames for line in _axes_at(frame)))


def _reddened(obstacle: Solid) -> Solid:
    opacity = TOUCHED / 2 if is_ground(obstacle.vertices) else TOUCHED
    return replace(obstacle, colour=TOUCHING, opacity=opacity)


def _robot_at(robot: Robot, riding: Sequence[Solid], stand: Stand) -> list[Solid]:
    """The robot and what it carries in the world, red where it touches."""
    poses = placements(robot, stand.q)
    out = []
    for solid in riding:
        own = stand.marked.get(solid.name, solid.colour)
        colour = TOUCHING if solid.name in stand.touching else _tinted(own, stand.kind)
        out.append(replace(placed(solid, poses[solid.frame or TOOL]), colour=colour, opacity=stand.kind.opacity))
    return out


def _tinted(colour: Colour, kind: Kind) -> Colour:
    if kind is START:
        return colour
    r, g, b = (round(c + TINT * (k - c)) for c, k in zip(colour, kind.colour, strict=True))
    return (r, g, b)


def _ghosts(view: View, robots: Sequence[Sequence[Solid]]) -> list[tuple[Solid, ...]]:
    """All stands but the first, without links that hardly moved; links in contact apart, as they are more opaque."""
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


def floor(points: FloatArray) -> tuple[Line, ...]:
    """A grid beneath points (k, 3)."""
    low, high = points.min(axis=0), points.max(axis=0)
    cell = next(size for size in CELLS if float(np.max(high - low)) <= MOST_CELLS * size or size == CELLS[-1])
    x, y = ([cell * k for k in range(math.floor(low[a] / cell) - 1, math.ceil(high[a] / cell) + 2)] for a in range(2))
    z = float(low[2])
    rows = [[(x[0], at, z), (x[-1], at, z)] for at in y] + [[(at, y[0], z), (at, y[-1], z)] for at in x]
    return tuple(Line(np.array(row), GRID, 1.0, hidden=0.0) for row in rows)


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
    """Names of the solids from number ``first`` on, the most visible first."""
    areas = np.bincount(owners[owners >= 0], minlength=len(solids)).tolist()
    order = sorted(range(first, len(solids)), key=lambda k: (-areas[k], k))
    places = [(solids[k].name, place_of(owners, k)) for k in order]
    return [Mark(name, at) for name, at in places if at is not None]
