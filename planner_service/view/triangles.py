"""The collision shapes of robots and scenes as triangles to draw, and the poses of the links.

Every solid is closed, its triangles counter-clockwise seen from outside. Round shapes are drawn as polyhedra whose
corners lie on them; boxes, hulls and cells are drawn exactly.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray, IntArray, read_only
from planner_service.geometry.composite import Compound, HeightField, PointCloud
from planner_service.geometry.composite import Solid as AnySolid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_paths import Surface
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.robot.kinematic_tree import body_matrix
from planner_service.robot.model import Robot
from planner_service.robot_setup.visuals import Visual
from planner_service.scene.scene import Attached, Obstacle, Scene

__all__ = [
    "CARRIED",
    "TOOL",
    "Colour",
    "Copies",
    "Form",
    "IntArray",
    "Solid",
    "Triangles",
    "bounds_of",
    "copies_of",
    "crease_lines",
    "extremes",
    "is_ground",
    "lathe",
    "middle_of",
    "obstacle_colour",
    "placements",
    "robot_solids",
    "scene_solids",
    "triangles_of",
    "unit_triangles",
    "visual_solids",
]

Colour = tuple[int, int, int]
"""Red, green, blue: 0 to 255."""


TOOL = ""
"""The frame of attached objects: the robot's tool frame. No link has an empty name."""

LINKS: tuple[Colour, ...] = ((214, 219, 226), (158, 172, 190))
"""Colours of the links, by turns."""

OBSTACLES: tuple[Colour, ...] = (
    *((238, 196, 140), (202, 186, 224), (232, 178, 170), (216, 208, 148)),
    *((210, 184, 162), (178, 198, 198), (222, 190, 208), (196, 196, 172)),
)
"""Colours of the obstacles, in turn for each first word of their names."""

NAMED: Mapping[str, Colour] = MappingProxyType(
    {
        "red": (222, 92, 84),
        "green": (94, 176, 104),
        "blue": (78, 128, 216),
        "yellow": (238, 206, 84),
        "orange": (240, 158, 76),
        "white": (244, 244, 244),
        "black": (84, 88, 94),
    }
)
"""Colours of obstacles whose names begin with one of these words."""

GROUND: Colour = (236, 233, 226)
CARRIED: Colour = (240, 130, 50)

WIDE, HIGH = 0.9, 0.1
"""Metres: a body at least so wide in x and y, less than a quarter of that high, and with its top no higher above the
robot's base than this, is ground."""

ROUND, COARSE = 48, 24
"""Sides of the prism drawn for a cylinder, and of spheres and capsules that are many and drawn smooth."""

CREASE = math.radians(25.0)
"""Between the normals of two triangles whose common side is drawn as an edge."""

MAX_DRAWN = 1_000_000
"""Triangles drawn of what a robot looks like: some 35 MB for the browser."""

MAX_BOXES = 6_000
"""Boxes drawn of a cloud or a height field; a larger one is drawn in coarser cells that cover its own."""

Triangles = tuple[FloatArray, IntArray]
"""Corners (k, 3), and triangles (m, 3) as rows of them."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed surface to draw.

    Attributes:
        name: Of the link, the obstacle or the carried object.
        vertices: Corners (k, 3) in metres, in ``frame``.
        faces: Triangles (m, 3) as rows of ``vertices``, counter-clockwise seen from outside.
        colour: Red, green, blue: 0 to 255.
        opacity: 0 to 1.
        frame: The key of its frame in ``placements``; None for the world.
    """

    name: str
    vertices: FloatArray
    faces: IntArray
    colour: Colour
    opacity: float
    frame: str | None

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", read_only(self.vertices))
        faces = np.array(self.faces, dtype=np.int64)
        faces.flags.writeable = False
        object.__setattr__(self, "faces", faces)


def robot_solids(robot: Robot) -> tuple[Solid, ...]:
    """The collision shapes of each link as one solid, in the link's frame of ``placements``."""
    shapes: dict[str, list[tuple[Shape, Pose]]] = {}
    for item in robot.shapes:
        shapes.setdefault(item.link, []).append((item.shape, item.pose))
    return tuple(
        Solid(link, *_union(_convex(shape, pose) for shape, pose in placed), LINKS[k % len(LINKS)], 1.0, link)
        for k, (link, placed) in enumerate(shapes.items())
    )


def visual_solids(visuals: Mapping[str, Sequence[Visual]]) -> tuple[Solid, ...]:
    """What each link looks like as one solid, in the link's own frame; it need not be closed.

    Links are left out once ``MAX_DRAWN`` triangles are reached.
    """
    drawn, solids = 0, []
    for k, (link, items) in enumerate(visuals.items()):
        vertices, faces = _union(_appearance(item.appearance, item.pose) for item in items)
        drawn += len(faces)
        if drawn > MAX_DRAWN:
            break
        solids.append(Solid(link, vertices, faces, LINKS[k % len(LINKS)], 1.0, link))
    return tuple(solids)


def _appearance(appearance: Shape | Surface, pose: Pose) -> Triangles:
    if isinstance(appearance, Surface):
        return _moved((appearance.vertices, appearance.triangles.astype(np.int64)), pose)
    return _convex(appearance, pose)


def scene_solids(scene: Scene) -> tuple[Solid, ...]:
    """The obstacles, in the world, then the attached objects, in the frame ``TOOL``.

    Clouds and height fields of more than ``MAX_BOXES`` boxes are drawn in coarser cells that cover the exact ones.
    """
    families: dict[str, Colour] = {}
    standing = [Solid(o.name, *_placed(o), obstacle_colour(o, families), 1.0, None) for o in scene.obstacles]
    return (*standing, *(Solid(a.name, *_placed(a), CARRIED, 1.0, TOOL) for a in scene.attached))


def obstacle_colour(obstacle: Obstacle, families: dict[str, Colour]) -> Colour:
    """Its own colour; that of the ground; the one in its name; that of names with the same first word (the parts of a
    shelf), which ``families`` remembers; or the next one.
    """
    if obstacle.colour is not None:
        red, green, blue = bytes.fromhex(obstacle.colour[1:])
        return red, green, blue
    if is_ground(extremes(obstacle)):
        return GROUND
    first = re.split(r"[\W\d_]", obstacle.name.lower())[0]
    return NAMED.get(first) or families.setdefault(first, OBSTACLES[len(families) % len(OBSTACLES)])


def extremes(body: Obstacle | Attached) -> FloatArray:
    """The lowest and the highest corner, (2, 3), of the box around a body along the axes of the frame it stands in."""
    axes = body.pose.rotation
    ends = [(axes * body.shape.support(sign * axes)).sum(axis=1) for sign in (-1.0, 1.0)]
    return np.asarray(np.stack(ends) + np.array(body.pose.position))


def bounds_of(shape: AnySolid) -> FloatArray:
    """The lowest and the highest corner, (2, 3), of the box around a shape along the axes of its own frame."""
    ends = [np.diagonal(shape.support(sign * np.eye(3))) for sign in (-1.0, 1.0)]
    return np.stack(ends)


def middle_of(shape: AnySolid) -> FloatArray:
    """The middle (3,) of that box, by which a shape is taken hold of: a file's own origin may be far from it."""
    return np.asarray(bounds_of(shape).mean(axis=0))


def placements(robot: Robot, q: ArrayLike) -> dict[str, FloatArray]:
    """World poses (4, 4) of every link with shapes, and of ``TOOL``, at q (n,).

    The frame of a link is that of its body, the frame of the joint that moves it.
    """
    values = np.asarray(q, dtype=np.float64)
    bodies = [body_matrix(pose) for pose in robot.body_poses(values)]
    return {**{item.link: bodies[item.body] for item in robot.shapes}, TOOL: robot.tool_pose(values)}


def is_ground(vertices: FloatArray) -> bool:
    """Whether a body with these corners (k, 3) in the world is a table or a floor: wide, flat and low."""
    x, y, z = (vertices.max(axis=0) - vertices.min(axis=0)).tolist()
    return bool(min(x, y) >= WIDE and z < min(x, y) / 4 and vertices[:, 2].max() <= HIGH)


def _placed(body: Obstacle | Attached) -> Triangles:
    """The triangles of an obstacle in the world, or of an attached object in the tool frame."""
    if isinstance(body.shape, Compound | PointCloud | HeightField):
        return _moved(triangles_of(body.shape), body.pose)
    return _convex(body.shape, body.pose)


def triangles_of(shape: AnySolid) -> Triangles:
    """The triangles of a solid in its own frame, a capsule's ``COARSE``."""
    if isinstance(shape, Capsule):
        return lathe(_outline(shape, COARSE), COARSE)
    if isinstance(shape, Compound):
        return _union(_convex(part, pose) for part, pose in shape.parts)
    if isinstance(shape, PointCloud):
        return _boxes(*_cloud_boxes(shape))
    if isinstance(shape, HeightField):
        return _boxes(*_column_boxes(shape))
    return _convex(shape, Pose())


class Form(Enum):
    """Shapes that are drawn as scaled copies of one."""

    BOX, SPHERE, CYLINDER = "box", "sphere", "cylinder"


@dataclass(frozen=True, eq=False)
class Copies:
    """A solid as copies of one form: their centres (k, 3) in the solid's own frame, and their scales (k, 3)."""

    form: Form
    centres: FloatArray
    scales: FloatArray


def copies_of(shape: AnySolid) -> Copies | None:
    """A solid as scaled copies of a form; None for a capsule, a hull or a compound."""
    if isinstance(shape, PointCloud | HeightField):
        low, high = _cloud_boxes(shape) if isinstance(shape, PointCloud) else _column_boxes(shape)
        return Copies(Form.BOX, (low + high) / 2.0, high - low)
    if isinstance(shape, Box):
        form, scale = Form.BOX, shape.size
    elif isinstance(shape, Sphere):
        form, scale = Form.SPHERE, (shape.radius,) * 3
    elif isinstance(shape, Cylinder):
        form, scale = Form.CYLINDER, (shape.radius, shape.radius, shape.length)
    else:
        return None
    return Copies(form, np.zeros((1, 3)), np.array([scale]))


def unit_triangles(form: Form) -> Triangles:
    """The triangles of a form: a box of edges 1, a ``COARSE`` sphere of radius 1, a cylinder of radius and length 1."""
    if form is Form.SPHERE:
        return lathe(_outline(Sphere(1.0), COARSE), COARSE)
    return _convex(Box((1.0, 1.0, 1.0)) if form is Form.BOX else Cylinder(1.0, 1.0), Pose())


def crease_lines(triangles: Triangles) -> FloatArray:
    """The edges at which a closed surface bends by more than ``CREASE``, as segments (k, 2, 3)."""
    vertices, faces = triangles
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.sqrt((normals**2).sum(axis=1, keepdims=True)), 1e-300)
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort(sides.T)
    same = np.flatnonzero((sides[order][1:] == sides[order][:-1]).all(axis=1))
    first, second = order[same], order[same + 1]
    bends = (normals[first // 3] * normals[second // 3]).sum(axis=1) < math.cos(CREASE)
    return np.asarray(vertices[sides[first[bends]]])


def _moved(triangles: Triangles, pose: Pose) -> Triangles:
    (x, y, z), faces = triangles[0].T, triangles[1]
    turned = [a * x + b * y + c * z + at for (a, b, c), at in zip(pose.rotation_rows, pose.position, strict=True)]
    return np.stack(turned, axis=-1), faces


def _union(parts: Iterable[Triangles]) -> Triangles:
    vertices, faces, count = [], [], 0
    for corners, triangles in parts:
        vertices.append(corners)
        faces.append(triangles + count)
        count += len(corners)
    return np.concatenate(vertices), np.concatenate(faces)


def _convex(shape: Shape, pose: Pose) -> Triangles:
    if isinstance(shape, Box):
        half = np.array([shape.half])
        return _moved(_boxes(-half, half), pose)
    if isinstance(shape, Mesh):
        return _moved((shape.vertices, shape.faces.astype(np.int64)), pose)
    if isinstance(shape, Sphere | Cylinder | Capsule):
        return _moved(lathe(_outline(shape, ROUND)), pose)
    raise BrokenInvariant(f"a {type(shape).__name__} has no triangles")


def _outline(shape: Sphere | Cylinder | Capsule, sides: int) -> list[tuple[float, float]]:
    """(distance from the axis, height) from the lowest point to the highest."""
    if isinstance(shape, Sphere):
        return _arc(shape.radius, 0.0, -1.0, 1.0, sides)
    h = shape.length / 2
    if isinstance(shape, Cylinder):
        return [(0.0, -h), (shape.radius, -h), (shape.radius, h), (0.0, h)]
    return [*_arc(shape.radius, -h, -1.0, 0.0, sides), *_arc(shape.radius, h, 0.0, 1.0, sides)]


def _arc(radius: float, z: float, low: float, high: float, sides: int) -> list[tuple[float, float]]:
    """(distance from the axis, height) along a circle, from latitude ``low`` to ``high`` in quarter turns."""
    count = round((high - low) * sides / 4)
    angles = [math.pi / 2 * (low + (high - low) * k / count) for k in range(count + 1)]
    return [(0.0 if abs(a) > 1.57 else radius * math.cos(a), z + radius * math.sin(a)) for a in angles]


def lathe(outline: list[tuple[float, float]], sides: int = ROUND) -> Triangles:
    """A solid of revolution about z, from its outline (distance, height), upwards, from axis to axis."""
    turn = [(math.cos(2 * math.pi * k / sides), math.sin(2 * math.pi * k / sides)) for k in range(sides)]
    rings = [[(r * c, r * s, z) for c, s in turn] for r, z in outline[1:-1]]
    bottom, top = len(rings) * sides, len(rings) * sides + 1
    corners = [*(corner for ring in rings for corner in ring), (0.0, 0.0, outline[0][1]), (0.0, 0.0, outline[-1][1])]
    side = np.arange(sides)
    after, last = (side + 1) % sides, (len(rings) - 1) * sides
    pole, peak = np.full(sides, bottom), np.full(sides, top)
    faces = [np.stack([pole, after, side], axis=-1), np.stack([peak, last + side, last + after], axis=-1)]
    for base in range(0, last, sides):
        above = base + sides
        faces.append(np.stack([base + side, base + after, above + after], axis=-1))
        faces.append(np.stack([base + side, above + after, above + side], axis=-1))
    return np.array(corners), np.concatenate(faces).astype(np.int64)


SIDES = np.array(
    [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2],
     [1, 3, 7], [1, 7, 5]]
)  # fmt: skip
"""Triangles of a box; bits 0, 1, 2 of a corner's index say whether it is the high one in x, y, z."""


def _boxes(low: FloatArray, high: FloatArray) -> Triangles:
    """Axis-aligned boxes, from their lowest and highest corners, (k, 3) each."""
    bits = np.array([[number >> axis & 1 for axis in range(3)] for number in range(8)], dtype=bool)
    corners = np.where(bits, high[:, None], low[:, None]).reshape(-1, 3)
    return corners, (8 * np.arange(len(low))[:, None, None] + SIDES).reshape(-1, 3).astype(np.int64)


def _cloud_boxes(cloud: PointCloud) -> tuple[FloatArray, FloatArray]:
    if len(cloud.pieces.shapes) <= MAX_BOXES:
        return _piece_boxes(cloud)
    cells, edge = cloud.cells, cloud.resolution
    while len(cells) > MAX_BOXES:
        cells, edge = np.unique(cells // 2, axis=0), 2 * edge
    low = cells.astype(np.float64)
    return low * edge, (low + 1.0) * edge


def _column_boxes(field: HeightField) -> tuple[FloatArray, FloatArray]:
    if len(field.pieces.shapes) <= MAX_BOXES:
        return _piece_boxes(field)
    heights, edge = field.heights, field.cell
    while np.count_nonzero(heights > field.floor) > MAX_BOXES:
        even = np.pad(heights, [(0, size % 2) for size in heights.shape], constant_values=field.floor)
        rows = np.maximum(even[::2], even[1::2])
        heights, edge = np.maximum(rows[:, ::2], rows[:, 1::2]), 2 * edge
    place = np.argwhere(heights > field.floor)
    low = np.column_stack([place * edge, np.full(len(place), field.floor)])
    return low, np.column_stack([(place + 1) * edge, heights[heights > field.floor]])


def _piece_boxes(solid: PointCloud | HeightField) -> tuple[FloatArray, FloatArray]:
    half = np.array([shape.half for shape in solid.pieces.shapes if isinstance(shape, Box)])
    centres = solid.pieces.frames[:, :3, 3]
    return centres - half, centres + half
