"""What fingers hold: the part of an object between them, how wide it is there, and how good their hold is.

Fingers meet an object where they can reach it: at the wall of a box, at the handle of a door. Lines along the axis on
which they close, spread over their inner faces, tell where it begins and ends there. Of a convex object whose far
sides they reach that is its extent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, IntArray, along, cross
from planner_service.geometry.composite import Pieces
from planner_service.geometry.mass_properties import mass_properties
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape
from planner_service.geometry.validation import instance, number
from planner_service.grasping.hand import Jaw, axes_of, jaws_of
from planner_service.grasping.lines import Runs, pieces_of, runs_along
from planner_service.robot.gripper import Gripper
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle

__all__ = [
    "FRICTION",
    "GraspQuality",
    "Held",
    "grasp_quality",
    "held_by",
    "mass_of",
    "middle_of",
    "require_fingers",
    "require_friction",
    "slopes",
    "values",
]

FRICTION = 0.5
"""Coefficient of friction that is assumed: rubber on painted metal, plastic or cardboard has at least as much."""

GRID = 5
"""Lines along each side of a part of a finger. Of flat pieces the edges are cut to what faces it, which is exact."""

NO_FINGER = 0.005
"""Metres: no finger goes into a gap that is narrower, so that what is on both sides of it is held as one."""

MAX_PIECES = 5_000
"""Of an object that is to be taken."""

EXACT = 1e-9
"""Metres: a width that differs by less from an object's whole extent is that."""


@dataclass(frozen=True)
class Held:
    """What lies between the fingers of a grasp.

    Attributes:
        width: Metres between the two places where they meet the object, along the axis on which they close.
        shift: Metres by which closing pushes the object along that axis, until it is in the middle between them.
        beyond: Metres between the fingertips and the object.
        reached: Whether both fingers meet it at all.
        extent: Metres that all of the object has along that axis.
        straight: Whether it is convex, and has all of that on the line between the fingertips.
    """

    width: float
    shift: float
    beyond: float
    reached: bool
    extent: float
    straight: bool = False

    @property
    def aside(self) -> float:
        """Metres by which it is pushed, either way."""
        return abs(self.shift)

    @property
    def whole(self) -> bool:
        """Whether they close on all of the object."""
        return self.width == self.extent


def held_by(target: Obstacle, grasp: Pose, robot: Robot) -> Held:
    """What lies between the fingers of a robot whose tool is at a grasp."""
    gripper = robot.gripper
    assert gripper is not None
    axis = [_product(row, gripper.closing) for row in grasp.rotation_rows]
    local = _seen_from(target.pose, axis)
    far, near = target.shape.support(local), target.shape.support(-local)
    extent, centre = _product(local, far - near), _product(local, far + near) / 2.0
    shift = _product(axis, np.array(grasp.position) - np.array(target.pose.position)) - centre
    tips = _seen_from(target.pose, np.array(grasp.position) - np.array(target.pose.position))
    beyond = float(target.shape.distance(tips))
    whole = Held(extent, shift, beyond, True, extent)
    if isinstance(target.shape, Box) and _within(target.shape, tips.tolist(), local.tolist()) >= extent - EXACT:
        return replace(whole, straight=True)
    seen = grasp.inverse() @ target.pose
    pieces = _near(pieces_of(target.shape), seen, robot)
    middle = _runs(pieces, seen, gripper, np.zeros((1, 3)))
    convex = not hasattr(target.shape, "pieces")
    if convex and len(middle.line) and float(middle.leave[0] - middle.enter[0]) >= extent - EXACT:
        return replace(whole, straight=True)
    return _between(pieces, seen, robot, whole, middle)


def _within(box: Box, origin: Sequence[float], direction: Sequence[float]) -> float:
    """Metres of a line, in the frame of a box, that are in it."""
    enter, leave = -math.inf, math.inf
    for at, way, half in zip(origin, direction, box.half, strict=True):
        if way == 0.0:
            if abs(at) > half:
                return 0.0
            continue
        ends = (-half - at) / way, (half - at) / way
        enter, leave = max(enter, min(ends)), min(leave, max(ends))
    return max(0.0, leave - enter)


def _between(pieces: Pieces, seen: Pose, robot: Robot, whole: Held, middle: Runs) -> Held:
    """See ``held_by``: where the inner faces of the fingers meet pieces of an object ``seen`` from the tool."""
    gripper = robot.gripper
    assert gripper is not None
    axes = axes_of(gripper)
    missed = replace(whole, reached=False)
    near = _chosen(np.stack([middle.enter, middle.leave], axis=1), gripper.upper)
    first = whole.width if near is None else near[1] - near[0]
    jaws = jaws_of(robot, min(max(first, gripper.lower), gripper.upper))
    grids = [np.stack(np.meshgrid(*np.linspace(jaw.low, jaw.high, GRID).T), axis=-1).reshape(-1, 2) for jaw in jaws]
    spots = np.concatenate([np.zeros((1, 2)), *grids])
    owner = np.repeat(np.arange(-1, len(jaws)), [1, *(len(grid) for grid in grids)])
    runs = _runs(pieces, seen, gripper, spots[:, :1] * axes[0] + spots[:, 1:] * axes[2])
    edges, tips = _outline(pieces, seen, axes)
    stretches = [np.stack([runs.enter, runs.leave], axis=1)[owner[runs.line] == k] for k in range(-1, len(jaws))]
    for k, jaw in enumerate(jaws, start=1):
        stretches[k] = np.concatenate([stretches[k], _in_window(edges, tips, jaw)])
    part = _chosen(np.concatenate(stretches), gripper.upper)
    if part is None:
        return missed
    met: dict[float, list[float]] = {1.0: [], -1.0: []}
    centre, *facing = (ends[(ends[:, 0] >= part[0]) & (ends[:, 1] <= part[1])] for ends in stretches)
    for jaw, ends in zip(jaws, facing, strict=True):
        if len(ends):
            met[jaw.side].append(float((jaw.side * ends).max()) - jaw.recess)
    if not met[1.0] or not met[-1.0]:
        return missed
    high = max([*met[1.0], *centre[:, 1].tolist()])
    low = -max([*met[-1.0], *(-centre[:, 0]).tolist()])
    beyond = 0.0 if near is not None and near[0] <= 0.0 <= near[1] else whole.beyond  # or between two walls
    if whole.extent - (high - low) <= EXACT:
        return replace(whole, beyond=beyond)
    return Held(high - low, -(high + low) / 2.0, beyond, True, whole.extent)


def _outline(pieces: Pieces, seen: Pose, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The edges (e, 2, 3) of the flat pieces and the ends (k, 3) of the round ones along the closing axis.

    Both in the coordinates of ``axes``, of which the second is that of closing.
    """
    rotations = np.broadcast_to(pieces.rotations, (len(pieces), 3, 3))
    turn, at = along(axes, seen.rotation.T).T, along(axes, np.array(seen.position))
    edges: list[FloatArray] = [np.zeros((0, 2, 3))]
    tips: list[FloatArray] = [np.zeros((0, 3))]
    for shape, R, place in zip(pieces.shapes, rotations, pieces.positions, strict=True):
        own, origin = np.stack([along(turn, R[:, k]) for k in range(3)], axis=1), along(turn, place) + at
        if isinstance(shape, Box | Mesh):
            corners = _BOX * shape.half if isinstance(shape, Box) else shape.vertices
            rows = _BOX_EDGES if isinstance(shape, Box) else _sides(shape)
            edges.append((along(own, corners) + origin)[rows])
        else:
            ways = np.stack([own[1], -own[1]])
            tips.append(along(own, shape.support(ways)) + origin)
        if isinstance(shape, Cylinder | Capsule):  # its sides, which may be far from its ends
            tube = Cylinder(shape.radius, shape.length)
            ends = [tube.support(ways * np.array([1.0, 1.0, 0.0]) + np.array([0.0, 0.0, up])) for up in (-1.0, 1.0)]
            edges.append(along(own, np.stack(ends, axis=1)) + origin)
    return np.concatenate(edges), np.concatenate(tips)


_BOX = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_BOX_EDGES = np.array([[k, k | bit] for bit in (1, 2, 4) for k in range(8) if not k & bit])


def _sides(mesh: Mesh) -> IntArray:
    """The sides of a hull's triangles, each once, as rows of its corners (e, 2)."""
    sides = np.concatenate([mesh.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    return np.asarray(sides[sides[:, 0] < sides[:, 1]])


def _in_window(edges: FloatArray, tips: FloatArray, jaw: Jaw) -> FloatArray:
    """From where to where along the axis of closing edges (e, 2, 3) and tips (k, 3) face a part of a finger, (f, 2)."""
    low, high = np.array(jaw.low), np.array(jaw.high)
    start, step = edges[:, 0], edges[:, 1] - edges[:, 0]
    at, way = start[:, ::2], step[:, ::2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        to_low, to_high = (low - at) / way, (high - at) / way
    inside, still = (at >= low) & (at <= high), way == 0.0
    first = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(to_low, to_high)).max(axis=1, initial=0.0)
    last = np.where(still, np.where(inside, np.inf, -np.inf), np.maximum(to_low, to_high)).min(axis=1, initial=1.0)
    cut = first <= last
    ends = np.stack([start[cut, 1] + share[cut] * step[cut, 1] for share in (first, last)], axis=1)
    facing = tips[((tips[:, ::2] >= low) & (tips[:, ::2] <= high)).all(axis=1), 1]
    return np.concatenate([np.sort(ends, axis=1), np.stack([facing, facing], axis=1)])


def _chosen(stretches: FloatArray, widest: float) -> tuple[float, float] | None:
    """From where to where the part of an object reaches that fingers would close on, along the axis of closing.

    What the middle between the fingertips is in; if it is in none, all that is between fingers that are wide open.

    Args:
        stretches: Where some lines and edges of the object begin and end along that axis, (k, 2).
    """
    parts: list[tuple[float, float]] = []
    for enter, leave in stretches[np.argsort(stretches[:, 0], kind="stable")].tolist():
        if parts and enter < parts[-1][1] + NO_FINGER:
            parts[-1] = (parts[-1][0], max(parts[-1][1], leave))
        else:
            parts.append((enter, leave))
    around = [part for part in parts if part[0] <= 0.0 <= part[1]]
    between = [part for part in parts if part[0] < widest / 2.0 and part[1] > -widest / 2.0]
    if around or not between:
        return around[0] if around else None
    return between[0][0], between[-1][1]


def _runs(pieces: Pieces, seen: Pose, gripper: Gripper, origins: FloatArray) -> Runs:
    """Where an object is on lines along the axis of closing, from origins (k, 3) in the tool frame."""
    back = seen.inverse()
    direction = along(back.rotation, np.array(gripper.closing))
    from_ = along(back.rotation, origins) + np.array(back.position)
    return runs_along(pieces, from_, np.broadcast_to(direction, from_.shape))


def _near(pieces: Pieces, seen: Pose, robot: Robot) -> Pieces:
    """Those of the pieces of an object that may face a finger."""
    gripper = robot.gripper
    if gripper is None or len(pieces) == 1:
        return pieces
    jaws = [jaw for width in (gripper.lower, gripper.upper) for jaw in jaws_of(robot, width)]
    spread = max(math.hypot(*np.maximum(np.abs(jaw.low), np.abs(jaw.high)).tolist()) for jaw in jaws)
    back = seen.inverse()
    direction = along(back.rotation, np.array(gripper.closing))
    away = pieces.positions - np.array(back.position)
    off = away - along(away, direction)[:, None] * direction
    met = (
        np.sqrt((off * off).sum(axis=1)) <= spread + np.array([_reach(shape) for shape in pieces.kinds])[pieces.numbers]
    )
    rotations = np.broadcast_to(pieces.rotations, (len(pieces), 3, 3))[met]
    return Pieces(pieces.kinds, pieces.numbers[met], rotations, pieces.positions[met])


def _reach(shape: Shape) -> float:
    """Metres from a shape's origin within which all of it is."""
    axes = np.eye(3)
    ends = [np.abs(shape.support(sign * axes).diagonal()) for sign in (-1.0, 1.0)]
    return float(np.sqrt((np.maximum(*ends) ** 2).sum()))


@dataclass(frozen=True)
class GraspQuality:
    """How good a hold of two fingers is.

    Attributes:
        slope: Tangent of the larger angle between the axis on which they close and the surface's normal at one of both
            contacts: they slip where it exceeds the coefficient of friction (Nguyen, IJRR 7(3), 1988). Infinite where
            there is no contact.
        room: Part of the gripper's opening that is left when it holds the object, 0 to 1.
        lever: Metres from the centre of mass to the line through both contacts.
        value: 0 to 1, and 0 for no hold: the product of what is left of the friction, of the room, and of the lever,
            this compared with how far the object reaches from its centre of mass.
    """

    slope: float
    room: float
    lever: float
    value: float


def grasp_quality(robot: Robot, target: Obstacle, grasp: Pose, *, friction: float = FRICTION) -> GraspQuality:
    """How good a hold two fingers have of an object at a tool pose.

    Args:
        friction: Coefficient of friction between fingers and object.

    Raises:
        InvalidRequest: The robot has no fingers, ``friction`` is not in [0.01, 10], or the object has more than 5,000
            pieces.
    """
    gripper = require_fingers(robot)
    instance("target", target, Obstacle, "an Obstacle, such as service.scene.obstacle(name)")
    instance("grasp", grasp, Pose, "a Pose")
    limit = require_friction(friction)
    centre, farthest = mass_of(target)
    seen = grasp.inverse() @ target.pose
    runs = _runs(pieces_of(target.shape), seen, gripper, np.zeros((1, 3)))
    part = _chosen(np.stack([runs.enter, runs.leave], axis=1), gripper.upper)
    closing = np.array(gripper.closing)
    at = (seen @ Pose((float(centre[0]), float(centre[1]), float(centre[2])))).position
    lever = math.sqrt(float((cross(np.array(at), closing) ** 2).sum()))
    if part is None:
        return GraspQuality(math.inf, 0.0, lever, 0.0)
    axis = along(seen.inverse().rotation, closing)
    first, last = int(np.argmin(np.abs(runs.enter - part[0]))), int(np.argmin(np.abs(runs.leave - part[1])))
    normals = np.stack([-runs.enter_normal[first], runs.leave_normal[last]])
    slope = float(slopes(normals, axis).max())
    room = 1.0 - (part[1] - part[0]) / gripper.upper
    return GraspQuality(slope, max(0.0, room), lever, float(values(slope, room, lever / farthest, limit)))


def slopes(normals: FloatArray, axis: FloatArray) -> FloatArray:
    """Tangents (...) of the angles between normals (..., 3) and unit axes; infinite from a right angle on."""
    cosine = (normals * axis).sum(axis=-1)
    sine = np.sqrt((cross(normals, np.broadcast_to(axis, normals.shape)) ** 2).sum(axis=-1))
    return np.asarray(np.where(cosine > 0.0, sine / np.where(cosine > 0.0, cosine, 1.0), np.inf))


def values(slope: ArrayLike, room: ArrayLike, lever: ArrayLike, friction: float) -> FloatArray:
    """``GraspQuality.value`` of slopes, rooms and levers relative to how far the object reaches."""
    parts = (1.0 - np.asarray(slope) / friction, np.asarray(room), 1.0 - np.asarray(lever))
    left = [np.maximum(part, 0.0) for part in parts]
    return np.asarray(left[0] * left[1] * left[2])


def mass_of(target: Obstacle) -> tuple[FloatArray, float]:
    """An object's centre of mass (3,) in its own frame, and a bound of how far it reaches from there, in metres.

    Raises:
        InvalidRequest: It has more than 5,000 pieces.
    """
    pieces = pieces_of(target.shape)
    if len(pieces) > MAX_PIECES:
        expected = f"an object of at most {MAX_PIECES:,} pieces: cut out of a cloud what is to be taken"
        raise InvalidRequest("target", f"{target.name}, {len(pieces):,} pieces", expected)
    centre, axes = mass_properties(target.shape).centre, np.eye(3)
    ends = [np.abs(target.shape.support(sign * axes).diagonal() - centre) for sign in (-1.0, 1.0)]
    return centre, math.sqrt(float((np.maximum(*ends) ** 2).sum()))


def require_friction(friction: float) -> float:
    return number("friction", friction, "a coefficient of friction in [0.01, 10]", 0.01, 10.0)


def require_fingers(robot: Robot) -> Gripper:
    """The gripper of a robot.

    Raises:
        InvalidRequest: It has none, or no fingers.
    """
    gripper = instance("robot", robot, Robot, "a Robot").gripper
    if gripper is None or gripper.kind == "vacuum":
        given = robot.name if gripper is None else f"{robot.name}, whose gripper is a cup"
        raise InvalidRequest("robot", given, "a robot with a gripper that has fingers")
    return gripper


def middle_of(target: Obstacle) -> tuple[float, float, float]:
    """The middle of an object's extents along its own axes, in the base frame: its position, unless it is lopsided."""
    axes = np.eye(3)
    aside = 0.5 * (target.shape.support(axes) + target.shape.support(-axes)).diagonal()
    if not aside.any():
        return target.pose.position
    return (target.pose @ Pose((float(aside[0]), float(aside[1]), float(aside[2])))).position


def _seen_from(pose: Pose, direction: list[float] | FloatArray) -> FloatArray:
    """A direction in the axes of a pose, shape (3,): summed in a fixed order, which BLAS does not promise."""
    return np.array([_product(column, direction) for column in zip(*pose.rotation_rows, strict=True)])


def _product(a: tuple[float, ...] | list[float] | FloatArray, b: tuple[float, ...] | list[float] | FloatArray) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
