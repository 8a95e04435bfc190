"""Pictures of a reachability map, one slice of it beside the robot and its scene, and of a robot on a base.

::

    from planner_service.view.still.maps import draw_map

    draw_map(robot, scene, reachability(robot, scene, grid, orientations), "map.png")
"""

from __future__ import annotations

import os

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.files.reading import as_path
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.validation import instance, items, whole
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.view.still.composition import START, WAY, Stand, View, picture
from planner_service.view.still.lettering import Caption
from planner_service.view.still.pictures import SIZE, write_png
from planner_service.view.triangles import Colour, Solid
from planner_service.workspace import PlacedBase, ReachabilityMap, VoxelVerdict, seen_from

__all__ = ["AXES", "COLOURS", "draw_base", "draw_map", "fullest_level", "layer_name", "require_map_of", "sheets_of"]

COLOURS: dict[VoxelVerdict, tuple[Colour, str, float]] = {
    VoxelVerdict.REACHABLE: ((58, 168, 104), "reachable", 0.75),
    VoxelVerdict.BLOCKED: ((218, 44, 44), "blocked, proven", 0.6),
    VoxelVerdict.OUT_OF_REACH: ((120, 130, 145), "out of reach, proven", 0.3),
    VoxelVerdict.SAID_UNREACHABLE: ((150, 110, 60), "said to be unreachable", 0.4),
    VoxelVerdict.UNKNOWN: ((232, 176, 0), "unknown", 0.85),
}
"""Of each verdict: its colour, what it means, and its opacity."""

AXES = "xyz"


def draw_map(
    robot: Robot,
    scene: Scene,
    found: ReachabilityMap,
    file: str | os.PathLike[str],
    *,
    orientation: int = 0,
    across: tuple[int, int] | None = None,
) -> None:
    """A picture of a slice of a map, one voxel thick, in the colours of its verdicts, with the robot at home.

    Args:
        orientation: Which of the map's sets of orientations.
        across: The axis (0 to 2 for x to z) and which voxel along it; None for the level z with the most reachable
            voxels.

    Raises:
        InvalidRequest: There is no such orientation or slice, or the map is about another robot or scene.
        InvalidFile: The file cannot be written.
    """
    file = as_path("file", file)
    require_map_of(robot, scene, found)
    orientation = whole("orientation", orientation, 0, len(found.orientations) - 1)
    if across is None:
        axis, row = 2, fullest_level(found, orientation)
    else:
        given = items("across", across, object, "an axis and the number of a voxel", 2)
        if len(given) != 2:
            raise InvalidRequest("across", across, "an axis and the number of a voxel")
        axis = whole("across[0]", given[0], 0, 2)
        row = whole("across[1]", given[1], 0, found.grid.counts[axis] - 1)
    sheets = sheets_of(found, orientation, axis, row)
    caption = Caption(
        f"{robot.name} in {scene.name or 'a scene'}: where its tool can be",
        (
            f"voxels with {layer_name(found, axis, row)}",
            str(found),
        ),
        tuple(COLOURS[kind][:2] for kind in sheets),
    )
    view = View(robot, scene, (Stand(robot.home),), sheets=tuple(sheets.values()))
    write_png(file, picture(view, caption, SIZE))


def require_map_of(robot: Robot, scene: Scene, found: ReachabilityMap) -> None:
    """Refuse a map of something else.

    Raises:
        InvalidRequest: It is no map, or about another robot or scene.
    """
    instance("found", found, ReachabilityMap, "a ReachabilityMap")
    instance("robot", robot, Robot, "a Robot")
    instance("scene", scene, Scene, "a Scene")
    for name, said, digest in (("robot", found.robot, robot.hash), ("scene", found.scene, scene.hash)):
        if said != digest:
            raise InvalidRequest(name, digest, f"the {name} of the map, whose hash is {said}")


def fullest_level(found: ReachabilityMap, orientation: int) -> int:
    """Which voxel along z has the most reachable ones at its height."""
    return int((found.verdicts[orientation] == VoxelVerdict.REACHABLE).sum(axis=(0, 1)).argmax())


def layer_name(found: ReachabilityMap, axis: int, row: int) -> str:
    """Where a slice is, for people."""
    width = 2.0 * float(found.grid.half[axis])
    low = found.grid.lower[axis] + width * row
    return f"{AXES[axis]} from {low:.3f} to {low + width:.3f} m"


def sheets_of(found: ReachabilityMap, orientation: int, axis: int, row: int) -> dict[VoxelVerdict, Solid]:
    """A slice of a map one voxel thick: the squares in the middle of the voxels of each verdict that there is."""
    shown = found.verdicts[orientation].take(row, axis=axis)
    kinds = [kind for kind in COLOURS if np.any(shown == kind)]
    return {kind: _sheet(found, axis, row, np.argwhere(shown == kind), kind) for kind in kinds}


def draw_base(robot: Robot, scene: Scene, base: PlacedBase, file: str | os.PathLike[str]) -> None:
    """A picture of a robot on a base, in the scene as seen from there: at its first pose, and faintly at the others.

    Raises:
        InvalidRequest: A witness is none of this robot.
        InvalidFile: The file cannot be written.
    """
    file = as_path("file", file)
    instance("robot", robot, Robot, "a Robot")
    instance("base", base, PlacedBase, "a PlacedBase")
    if base.witnesses.shape[1] != robot.n:
        raise InvalidRequest("base", base.witnesses.shape, f"witnesses of {robot.n} joints")
    seen = seen_from(base.pose, instance("scene", scene, Scene, "a Scene"))
    x, y, z = base.pose.position
    count = len(base.witnesses)
    caption = Caption(
        f"{robot.name} in {scene.name or 'a scene'}: a base at {x:.3f}, {y:.3f}, {z:.3f}",
        (
            f"{count} {'pose' if count == 1 else 'poses'}, each with a free configuration: clearance at least "
            f"{1000 * float(base.clearances.min()):.1f} mm, {float(base.rooms.min()):.3f} rad to the joint limits",
        ),
        ((START.colour, "at the first pose"), *(((WAY.colour, "at the others"),) if count > 1 else ())),
    )
    stands = tuple(Stand(q, WAY if k else START) for k, q in enumerate(base.witnesses))
    write_png(file, picture(View(robot, seen, stands), caption, SIZE))


def _sheet(found: ReachabilityMap, axis: int, row: int, cells: IntArray, kind: VoxelVerdict) -> Solid:
    """The squares in the middle of some voxels (k, 2) of a slice, seen from either side."""
    whole_cells = np.insert(cells, axis, row, axis=1)
    a, b = (side for side in range(3) if side != axis)
    corners: FloatArray = np.zeros((4, 3))
    corners[:, a], corners[:, b] = (-1.0, 1.0, 1.0, -1.0), (-1.0, -1.0, 1.0, 1.0)
    centres = found.grid.centres(whole_cells)
    vertices = (centres[:, None] + corners * found.grid.half).reshape(-1, 3)
    first = 4 * np.arange(len(cells))[:, None]
    front = np.array([[0, 1, 2], [0, 2, 3]])
    faces = np.concatenate([(first[:, None] + each).reshape(-1, 3) for each in (front, front[:, ::-1])])
    colour, meaning, opacity = COLOURS[kind]
    return Solid(meaning, vertices, faces, colour, opacity, None)
